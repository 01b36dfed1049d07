"""The angles sampled faster than the command: rows as ever, the fast samples beside them."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from drivers.canopen.budget import bus_budget, check_bus_load
from drivers.errors import SettingsError
from servo_bench.devices import SerialEncoderConfig
from servo_bench.diagnosis.comparing.rows import rows_of
from servo_bench.errors import BenchError, ConfigError, RecordingError, WireError, gathered
from servo_bench.excitation.experiment import Experiment, MSequence, RandomBinary
from servo_bench.foreign.exporting import export
from servo_bench.kernels.quality import run_quality
from servo_bench.recording.mcap_file import load
from servo_bench.recording.recording import FAST_FIELDS, Recording
from servo_bench.recording.recover import recover
from servo_bench.report.main_numbers import run_rows
from servo_bench.rig import Limits, RigConfig, load_rig
from servo_bench.run.axes import open_axis
from servo_bench.run.busloop import Player
from servo_bench.run.finding import Level
from servo_bench.run.preflight import preflight
from servo_bench.run.session import run
from servo_bench.run.table import UNPLAYED, SlotTable
from servo_bench.run.virtual import play_virtually, run_virtually, save
from sim_rig.process import spawn
from tests.test_run_player import IdealAxis, JumpingClock

PLAN = Experiment(
    name="short",
    rig="none",
    period_s=0.008,
    memory=8,
    standstill_s=0.1,
    lead_in=16,
    identification=MSequence(polynomial="2327", amplitude_rad_s=2.0, length=160),
    validation=RandomBinary(kind="random-binary", seed=2, amplitude_rad_s=2.0, length=64),
)
WIDE = Limits(velocity_rad_s=1e6, travel_rad=1e6, run_time_s=1000.0)
TICK_NS = 1_000_000


def of(**drive: object) -> RigConfig:
    rig = load_rig("rigs/paper.toml")
    return rig.model_copy(update={"drive": rig.drive.model_copy(update=drive)})


@pytest.fixture(scope="module")
def fast() -> Recording:
    return run_virtually(PLAN, of(samples_per_command=8))


def test_the_rows_of_the_commands_are_those_of_a_run_that_samples_once(fast: Recording) -> None:
    plain = run_virtually(PLAN, of())
    assert not plain.fast
    assert np.array_equal(fast["slot"], plain["slot"])
    assert np.array_equal(fast["velocity_command_rad_s"], plain["velocity_command_rad_s"])
    for channel in ("load_angle_counts", "motor_position_counts"):
        assert np.abs(fast[channel] - plain[channel]).max() <= 1
    assert np.ptp(plain["load_angle_counts"]) > 1000
    ours, once = rows_of(fast), rows_of(plain)
    assert np.allclose(ours.durations_s, once.durations_s, atol=1e-5)
    assert ours.even[:-1].all()
    assert not ours.broken[:-1].any()


def test_the_fast_samples_have_a_time_base_of_their_own(fast: Recording) -> None:
    samples = fast.fast
    assert [name for name, _ in FAST_FIELDS] == list(samples)
    assert np.array_equal(samples["slot"] * 8 + samples["part"], np.arange(8 * len(fast)))
    steps_us = np.diff(samples["device_time_us"])
    assert np.abs(steps_us - 1000).max() <= 2
    own = samples["part"] == 0
    for channel in ("asked_ns", "load_angle_counts", "load_angle_rad", "motor_position_counts"):
        assert np.array_equal(samples[channel][own], fast[channel])
    # what a sample per command cannot see: the motor between two commands is on no straight line
    counts = samples["motor_position_counts"].reshape(-1, 8).astype(float)
    straight = counts[:-1, :1] + (counts[1:, :1] - counts[:-1, :1]) * np.arange(8) / 8
    assert np.abs(counts[:-1] - straight).max() > 20


def test_they_are_written_read_and_recovered(fast: Recording, tmp_path: Path) -> None:
    out = tmp_path / "fast.mcap"
    save(fast, out)
    whole = load(out)
    for name in fast.fast:
        assert np.array_equal(whole.fast[name], fast.fast[name], equal_nan=True)
    data = out.read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(data[: len(data) * 2 // 3])
    recover(cut, tmp_path / "saved.mcap")
    saved = load(tmp_path / "saved.mcap", allow_cut=True)
    kept = len(saved.fast["slot"])
    assert 0 < kept <= len(fast.fast["slot"])
    assert np.array_equal(saved.fast["load_angle_counts"], fast.fast["load_angle_counts"][:kept])


def test_they_are_exported_and_the_report_says_how_many_there_are(
    fast: Recording, tmp_path: Path
) -> None:
    out = tmp_path / "fast.npz"
    export(fast, out, "npz", fast=True)
    with np.load(out) as columns:
        assert next(iter(columns)) == "t_s"
        assert np.allclose(np.diff(columns["t_s"]), 0.001, atol=1e-5)
        assert np.array_equal(columns["load_angle_counts"], fast.fast["load_angle_counts"])
    plain = replace(fast, fast={})
    with pytest.raises(RecordingError, match="one sample per command"):
        export(plain, tmp_path / "none.npz", "npz", fast=True)
    told = {row.name: row.value for row in run_rows(run_quality(fast), fast)}
    assert told["samples of the angles"].startswith("8 per command")
    assert "samples of the angles" not in {row.name for row in run_rows(run_quality(plain), plain)}


def test_a_run_that_ends_early_keeps_what_was_sampled_in_its_last_slot() -> None:
    rig = of(samples_per_command=8).with_faults("emcy node=drive code=0x7300 at=403")
    done = play_virtually(PLAN, rig)
    assert "0x7300" in str(done.error)
    slots, parts = done.recording.fast["slot"], done.recording.fast["part"]
    assert done.recording["slot"][-1] == slots[-1] == 50
    assert 1 <= parts[-1] <= 7


class TickAxis(IdealAxis):
    """Its ticks are a millisecond; remembers what it was commanded in each."""

    @property
    def commanded(self) -> dict[int, float]:
        return {tick: velocity for tick, _, velocity in self.asks}


def played(holes_ns: Sequence[int]) -> tuple[TickAxis, np.ndarray, np.ndarray, list[str]]:
    schedule = PLAN.schedule()
    axis = TickAxis(JumpingClock(holes_ns))
    told: list[str] = []
    with SlotTable.create(schedule.slots, 8) as table:
        player = Player(axis, schedule, table, WIDE, axis.clock, samples_per_slot=8)
        player.play(0, lambda kind, _text, **_data: told.append(kind))
        assert table.done == schedule.slots
        rows, fast = table.rows.copy(), table.fast.copy()
    return axis, rows, fast, told


@pytest.mark.parametrize(
    ("at", "late", "lost_slots", "lost_ticks"),
    [
        (163, 2, [], [163, 164]),  # inside slot 20: its row stays
        (158, 5, [20], range(158, 163)),  # the command of slot 20 is lost
        (160, 24, [20, 21, 22], range(160, 184)),  # whole slots
        (163, 12, [21], range(163, 175)),  # a rest, and the next slot's command
    ],
)
def test_a_slot_is_missed_where_its_command_is(
    at: int, late: int, lost_slots: list[int], lost_ticks: Sequence[int]
) -> None:
    axis, rows, fast, told = played([0] * at + [late * TICK_NS])
    schedule = PLAN.schedule()
    assert list(np.flatnonzero(rows["slot"] == UNPLAYED)) == lost_slots
    assert list(np.flatnonzero(fast["slot"] == UNPLAYED)) == list(lost_ticks)
    assert told == ["slot skipped" if lost_slots else "samples skipped"]
    held = np.repeat(schedule.velocity_rad_s, 8)
    for slot in lost_slots:
        held[8 * slot : 8 * slot + 8] = held[8 * slot - 1]  # the one before, longer
    assert all(axis.commanded[tick] == held[tick] for tick in axis.commanded)


def test_an_answer_that_comes_some_ticks_late_is_in_its_own_row() -> None:
    schedule = PLAN.schedule()
    axis = IdealAxis(JumpingClock(), late=3)
    with SlotTable.create(schedule.slots, 8) as table:
        player = Player(axis, schedule, table, WIDE, axis.clock, samples_per_slot=8)
        player.play(0, lambda *_told, **_data: None)
        fast = table.fast.copy()
        rows = table.rows.copy()
    assert np.array_equal(fast["slot"][:-8], np.repeat(np.arange(schedule.slots - 1), 8))
    assert np.array_equal(fast["motor_position_rad"][::8], rows["motor_position_rad"])
    assert (np.diff(rows["motor_position_rad"]) != 0.0).any()


# What the bus can hold


@pytest.mark.parametrize(
    ("bit_rate", "samples", "holds"),
    [(1_000_000, 8, True), (500_000, 8, False), (500_000, 4, True), (125_000, 1, True)],
)
def test_a_bit_rate_that_cannot_hold_the_samples_is_refused_with_the_sum(
    bit_rate: int, samples: int, holds: bool
) -> None:
    rig = of(samples_per_command=samples).with_bus(bitrate=bit_rate)
    settings = rig.canopen_settings(PLAN.period_s)
    # by hand: 47 + 8 n + floor((33 + 8 n) / 4) bits; SYNC 0, three answers of 8, 8, and 8 bytes
    # (the drive's statusword, position, torque; its velocity and time; the encoder's), the RPDO's 6
    # bytes once for `samples` SYNCs, three heartbeats of a byte every 100 ms
    bits = 55 + 3 * 135 + 115 / samples + 3 * 65 * 0.08 / samples
    assert bus_budget(settings).bits == pytest.approx(bits)
    assert holds == (bits * samples / 0.008 <= 0.9 * bit_rate)
    (finding,) = [it for it in preflight(PLAN, rig) if it.subject == "bus load"]
    assert (finding.level is Level.STOP) == (not holds)
    if holds:
        check_bus_load(settings)
        return
    with pytest.raises(SettingsError, match=r"SYNC every 1 ms.*SYNC 55.*: 4\d\d bits.*500 kbit/s"):
        check_bus_load(settings)
    with pytest.raises(BenchError, match="does not go over this bus"):
        enter(rig)


def enter(rig: RigConfig) -> None:
    """Enter the rig's axis, which refuses before it opens anything."""
    with gathered(), open_axis(rig, PLAN.period_s):
        pytest.fail("entered")


def test_where_the_drive_wants_them_equal_it_is_refused_in_words() -> None:
    rig = of(samples_per_command=4, profile="delta-asda-a2", mode="pv", vendor_id=0)
    with pytest.raises(ConfigError, match=r"wants 0x60C2 and the SYNC period equal"):
        enter(rig)


def test_a_serial_encoder_cannot_follow_a_drive_that_produces_sync() -> None:
    counter = SerialEncoderConfig(
        protocol="serial", device="/dev/ttyUSB0", counts_per_revolution=65536
    )
    rig = of(sync="drive").model_copy(update={"encoder": counter})
    with pytest.raises(ConfigError, match=r"serial line.*drive.sync = .master."):
        rig.canopen_settings(0.008)


def test_the_drive_is_told_both_periods() -> None:
    settings = of(samples_per_command=8).canopen_settings(0.008)
    assert (settings.period_s, settings.command_every) == (0.001, 8)
    assert settings.command_period_s == pytest.approx(0.008)
    assert replace(settings, command_every=1).command_period_s == pytest.approx(0.001)


@pytest.mark.long
@pytest.mark.wire
def test_on_a_real_bus_at_a_millisecond(tmp_path: Path) -> None:
    rig = of(samples_per_command=8).on_a_free_port()
    with spawn(rig.simulation_settings()) as simulated:
        try:
            summary = run(PLAN, rig.with_bus(**simulated.bus), tmp_path / "run.mcap")
        except WireError as error:
            if "answers SYNC after" in str(error):
                pytest.skip(f"no computer that plays the software rig at 1 ms: {error}")
            raise
    recording = load(tmp_path / "run.mcap")
    assert len(recording) == summary.played > 150
    samples = recording.fast
    assert len(samples["slot"]) > 0.7 * 8 * len(recording)
    own = np.isin(samples["slot"], recording["slot"]) & (samples["part"] == 0)
    assert np.array_equal(samples["load_angle_counts"][own], recording["load_angle_counts"])
    ticks = samples["slot"] * 8 + samples["part"]
    device_us = samples["device_time_us"]
    seen = device_us != np.iinfo(np.int64).min
    apart_us = np.diff(device_us[seen]) - 1000 * np.diff(ticks[seen])
    assert np.median(np.abs(apart_us)) < 200
