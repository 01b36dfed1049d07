"""A run as the bench records it: telegrams, clocks, counts and the drive's own figures.

    take = record(rig, world, experiment, seed, start)
    write(path, rig, experiment, take.rows, utc_ns)

A slot is asked some tens of microseconds after its deadline, rarely later. Its SYNC is on a bus of
1 Mbit/s for 62 us; then the drive has the command and both encoders are sampled. Motor counts have
a tenth of a count of noise, the load's 0.15, current a thousandth of the rated one, and the drive
tells torque and current in thousandths.
"""

import math
import tomllib
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from servo_bench.excitation.experiment import Experiment
from servo_bench.recording.alignment import alignment
from servo_bench.recording.provenance import ClockPair, provenance
from servo_bench.recording.recording import SAMPLE_DTYPE, Event
from servo_bench.recording.writer import RecordingWriter
from servo_bench.rig import rig_from_table
from tests.third.plant import Array, Axis, Played, play
from tests.third.rigs import Rig, rig_toml

FIRST_DEADLINE_S = 0.05
FRAME_S, FRAME_JITTER_S = 62e-6, 1.5e-6
LATE_S, LATE_SPREAD_S, RARELY_LATE_S, RARELY = 35e-6, 12e-6, 150e-6, 0.004
CLOCK_SHARE = 3e-6
"""How far the device's clock and the host's part, either way."""
MOTOR_NOISE_COUNTS, LOAD_NOISE_COUNTS, CURRENT_NOISE_SHARE = 0.1, 0.15, 1e-3
PER_MILLE = 1e-3
STATUSWORD = 4663
"""CiA 402 0x6041: operation enabled, voltage on, the target followed."""
NS_PER_S = 1_000_000_000
DEVICE_WRAP_US = 1 << 32


class World(NamedTuple):
    """An axis and what is wrong beside it: on the bus, and at the load's encoder."""

    axis: Axis
    delay_s: float = 0.0
    loss_probability: float = 0.0
    eccentricity_rad: float = 0.0
    eccentricity_phase_rad: float = 0.0


class Start(NamedTuple):
    """Where a run begins: the motor's angle, the load's place in its gap (-0.5 to 0.5 of it), and
    what the load's counter was zeroed at, rad; None where it is zeroed here."""

    motor_rad: float = 0.0
    place: float = 0.0
    zero_rad: float | None = None


class Take(NamedTuple):
    """Rows of SAMPLE_DTYPE, what really happened, and what the load's counter was zeroed at."""

    rows: NDArray[np.void]
    played: Played
    zero_rad: float
    lost: int


class _Telegrams(NamedTuple):
    """When each slot was asked and on the bus, and what the drive got, shapes (slots,)."""

    late_s: Array
    asked_s: Array
    sync_s: Array
    command_rad_s: Array
    lost: int


def record(rig: Rig, world: World, experiment: Experiment, seed: int, start: Start) -> Take:
    """Play an experiment on a rig's axis; `seed` is of noise, clocks, and lost telegrams."""
    rng = np.random.default_rng(seed)
    schedule = experiment.schedule()
    sent = _telegrams(rig, world, schedule.velocity_rad_s, rng)
    load_rad = start.motor_rad + start.place * world.axis.gap_rad
    axis = world.axis._replace(motor_start_rad=start.motor_rad, load_start_rad=load_rad)
    played = play(axis, sent.sync_s + world.delay_s, sent.command_rad_s, sent.sync_s)
    zero_rad = start.zero_rad
    if zero_rad is None:
        zero_rad = load_rad + float(_eccentric_rad(world, np.array(load_rad)))
    rows = np.zeros(schedule.slots, SAMPLE_DTYPE)
    rows["slot"], rows["phase"] = np.arange(schedule.slots), schedule.phase
    rows["chip"], rows["velocity_command_rad_s"] = schedule.chip, schedule.velocity_rad_s
    rows["statusword"] = STATUSWORD
    read_rad = played.disc_rad + _eccentric_rad(world, played.load_rad)
    _count(rows, rig, played.motor_rad, read_rad - zero_rad, rng)
    _tell(rows, rig, played, rng)
    _stamp(rows, sent, rng)
    return Take(rows, played, zero_rad, sent.lost)


def _telegrams(
    rig: Rig, world: World, velocity_rad_s: Array, rng: np.random.Generator
) -> _Telegrams:
    slots = velocity_rad_s.size
    late_s = LATE_S + LATE_SPREAD_S * rng.lognormal(0.0, 0.5, slots)
    rare = rng.random(slots) < RARELY
    late_s[rare] += rng.exponential(RARELY_LATE_S, int(rare.sum()))
    late_s = np.minimum(late_s, 0.3 * rig.period_s)
    asked_s = FIRST_DEADLINE_S + rig.period_s * np.arange(slots) + late_s
    sync_s = asked_s + FRAME_S + np.abs(rng.normal(0.0, FRAME_JITTER_S, slots))
    lost = rng.random(slots) < world.loss_probability
    return _Telegrams(late_s, asked_s, sync_s, received(velocity_rad_s, lost), int(lost[1:].sum()))


def received(velocity_rad_s: Array, lost: NDArray[np.bool_]) -> Array:
    """What the drive follows: where a telegram is lost, the last one that came; the first comes."""
    came = np.where(lost, 0, np.arange(velocity_rad_s.size))
    return np.asarray(velocity_rad_s[np.maximum.accumulate(came)])


def _eccentric_rad(world: World, load_rad: Array) -> Array:
    """What an eccentric disc adds to the angle that it reads."""
    angle_rad = load_rad + world.eccentricity_phase_rad
    return np.asarray(world.eccentricity_rad * np.sin(angle_rad))


def _count(
    rows: NDArray[np.void], rig: Rig, motor_rad: Array, load_rad: Array, rng: np.random.Generator
) -> None:
    motor = _counts(motor_rad, rig.motor_count_rad, MOTOR_NOISE_COUNTS, rng)
    load = _counts(load_rad, rig.load_count_rad, LOAD_NOISE_COUNTS, rng)
    rows["motor_position_counts"], rows["load_angle_counts"] = motor, load
    rows["motor_position_rad"] = motor * rig.motor_count_rad
    rows["load_angle_rad"] = load * rig.load_count_rad


def _counts(
    angle_rad: Array, count_rad: float, noise_counts: float, rng: np.random.Generator
) -> NDArray[np.int64]:
    noise = rng.normal(0.0, noise_counts, angle_rad.size)
    return np.floor(angle_rad / count_rad + noise + 0.5).astype(np.int64)


def _tell(rows: NDArray[np.void], rig: Rig, played: Played, rng: np.random.Generator) -> None:
    """The drive's own figures; NaN for those that it does not tell."""
    noise_a = rng.normal(0.0, CURRENT_NOISE_SHARE * rig.rated_a, len(rows))
    current_a = played.current_a + noise_a
    step_nm, step_a = PER_MILLE * rig.rated_nm, PER_MILLE * rig.rated_a
    torque_nm = current_a * rig.torque_constant_nm_per_a
    rows["motor_velocity_rad_s"] = played.counted_rad_s
    rows["motor_torque_nm"] = np.round(torque_nm / step_nm) * step_nm
    rows["motor_current_a"] = np.round(current_a / step_a) * step_a
    if not rig.tells_torque:
        rows["motor_torque_nm"] = math.nan
    if not rig.tells_current:
        rows["motor_current_a"] = math.nan


def _stamp(rows: NDArray[np.void], sent: _Telegrams, rng: np.random.Generator) -> None:
    begun_ns = 5_000 * NS_PER_S + int(rng.integers(1_000 * NS_PER_S))
    device_us = int(rng.integers(10**8, 3 * 10**9))
    skew = 1.0 + rng.uniform(-CLOCK_SHARE, CLOCK_SHARE)
    asked_ns = np.round(sent.asked_s * skew * NS_PER_S).astype(np.int64)
    rows["asked_ns"] = begun_ns + asked_ns
    sampled_us = np.floor(sent.sync_s * 1e6).astype(np.int64)
    rows["device_time_us"] = (device_us + sampled_us) % DEVICE_WRAP_US
    rows["lateness_s"] = sent.late_s
    rows["drive_latency_s"] = 260e-6 + rng.gamma(2.0, 20e-6, len(rows))
    rows["encoder_latency_s"] = rows["drive_latency_s"] + rng.gamma(2.0, 8e-6, len(rows))


def write(
    path: Path, rig: Rig, experiment: Experiment, rows: NDArray[np.void], utc_ns: int
) -> None:
    """The recording's file, as a run of the bench at `utc_ns` leaves it."""
    config = rig_from_table(tomllib.loads(rig_toml(rig)), f"{rig.name}.toml")
    first_ns, last_ns = (int(rows["asked_ns"][k]) for k in (0, -1))
    pair = ClockPair(first_ns - NS_PER_S, utc_ns, 60)
    command = ("servo-bench", "run", "experiment.toml", "--rig", "rig.toml", "-o", path.name)
    facts = provenance(pair, command)
    playing = Event(first_ns - 8_000_000, "playing", "the drive is enabled", {"start_ns": first_ns})
    stopping = Event(last_ns + 300_000_000, "stopping", "the last slot was played")
    with RecordingWriter(path, experiment, config, facts, 1.0 / experiment.period_s) as writer:
        writer.event(playing)
        writer.samples(rows)
        writer.event(stopping)
        writer.alignment(alignment(rows))
