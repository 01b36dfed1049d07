"""Experiments that could be played for a diagnosis: a small grid inside a rig's limits.

    levels        five levels (GF(5)), or one M-sequence at three amplitudes
    amplitude     what crosses the gap twice a period, two thirds of it, and what the velocity limit
                  allows where that is more; without a gap that, a half and a quarter of it
    bias          as much as the travel allows, up to 1 rad/s, or none: full turns of the shaft
    dwell         a command for one period, or for three: what happens long after a change

The validation has uniform levels, a smaller amplitude, and the bias turned round, so that the rig
comes back.

Inside the limits is not the command alone: the motor overshoots it, and the motor trips a run. So
every candidate is played on the rig's model, and made smaller until the motion has `ROOM`.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from typing import Literal

import numpy as np

from servo_bench.errors import ConfigError
from servo_bench.excitation.amplitude import MARGIN
from servo_bench.excitation.enumeration import primitive_polynomials
from servo_bench.excitation.experiment import Experiment, Schedule
from servo_bench.excitation.prediction import predict
from servo_bench.excitation.sequences import (
    FieldSequence,
    FromRecording,
    MultiAmplitude,
    Periodic,
    RandomUniform,
)
from servo_bench.kernels.shifts import collision_free_memory
from servo_bench.rig import Limits, RigConfig

Levels = Literal["five levels", "three amplitudes"]

ROOM = 0.85
"""Of every limit, that the model's motion may use, because the rig that is looked at is not quite
its model; commands may use `MARGIN`."""
SHRINKINGS, SMALLEST_RAD_S = 4, 0.01
CROSSINGS = 2.0
"""Gaps that the largest command crosses in a period."""
SLOWEST_RAD_S, FASTEST_RAD_S, MOST_BIAS_RAD_S = 1.0, 6.0, 1.0
AMPLITUDES, AMPLITUDES_WITHOUT_GAP = (1.0, 2.0 / 3.0), (1.0, 0.5, 0.25)
BIASES, DWELLS = (1.0, 0.0), (1, 3)
FASTER = 1.5
"""Of the gap's amplitude: what is less is no other candidate."""
IDENTIFIED, LONGEST_MEMORY, LONGEST_LEAD_IN, STANDSTILL_S = 0.75, 18, 256, 2.0
SHARES = (1.0, 2.0 / 3.0, 1.0 / 3.0)
VALIDATION_SHARE, VALIDATION_SEED = 0.85, 11
FEWEST_CHIPS = 640
HALVINGS = 6


@dataclass(frozen=True, slots=True)
class Plan:
    """One candidate, and how it was chosen."""

    levels: Levels
    amplitude_rad_s: float
    bias_rad_s: float
    dwell: int
    experiment: Experiment

    @property
    def words(self) -> str:
        """A line for a table."""
        return f"{self.levels}, hold {self.dwell}"


def candidates(rig: RigConfig, rig_name: str, minutes: float, period_s: float) -> tuple[Plan, ...]:
    """The grid, as far as the rig's limits allow. ConfigError where none fits, or it is short."""
    slots = round(60.0 * minutes / period_s)
    if slots < FEWEST_CHIPS * max(DWELLS):
        least = FEWEST_CHIPS * max(DWELLS) * period_s / 60.0
        raise ConfigError(
            f"{minutes:g} minutes at a period of {period_s * 1e3:g} ms are {slots} periods: too "
            f"few to tell causes apart. Give --minutes {math.ceil(10 * least) / 10:g} or more."
        )
    if minutes * 60.0 + STANDSTILL_S > rig.limits.run_time_s:
        raise ConfigError(
            f"{minutes:g} minutes are longer than the rig's limits.run_time_s = "
            f"{rig.limits.run_time_s:g}. Give fewer --minutes."
        )
    found = tuple(_grid(rig, rig_name, slots, period_s))
    if not found:
        limits = rig.limits
        torque = "" if limits.torque_nm is None else f", limits.torque_nm = {limits.torque_nm:g}"
        raise ConfigError(
            f"no excitation fits into limits.travel_rad = {limits.travel_rad:g} and "
            f"limits.velocity_rad_s = {limits.velocity_rad_s:g}{torque}: what is commanded, or the "
            "motion of the rig's model, goes further. Give fewer --minutes, or raise the limits if "
            "the rig allows it."
        )
    return found


def _amplitudes_rad_s(rig: RigConfig, period_s: float) -> tuple[float, ...]:
    """The largest first. A gap and friction show where little is asked of the motor, and what
    saturates where much is: which counts is what `separation` tells."""
    fastest = MARGIN * rig.limits.velocity_rad_s
    gap_rad = rig.nominal.backlash_gap_rad
    if not gap_rad > 0.0:
        return tuple(share * fastest for share in AMPLITUDES_WITHOUT_GAP)
    wanted = min(max(CROSSINGS * gap_rad / period_s, SLOWEST_RAD_S), FASTEST_RAD_S, fastest)
    faster = (fastest,) if fastest > FASTER * wanted else ()
    return (*faster, *(share * wanted for share in AMPLITUDES))


def _grid(rig: RigConfig, rig_name: str, slots: int, period_s: float) -> Iterator[Plan]:
    every: tuple[Levels, ...] = ("five levels", "three amplitudes")
    seen: set[tuple[object, ...]] = set()
    for levels, dwell, part in product(every, DWELLS, BIASES):
        allowed = 1.0  # of what was wanted, by the motion at the amplitude before
        for wanted in _amplitudes_rad_s(rig, period_s):
            amplitude = allowed * wanted
            plan = _fitted(rig, rig_name, levels, dwell, amplitude, part, slots, period_s)
            if plan is None:
                continue
            allowed = plan.amplitude_rad_s / wanted
            key = (levels, dwell, plan.amplitude_rad_s, plan.bias_rad_s)
            if key not in seen:
                seen.add(key)
                yield plan


def _fitted(  # noqa: PLR0917 - the grid's axes
    rig: RigConfig,
    rig_name: str,
    levels: Levels,
    dwell: int,
    amplitude: float,
    part: float,
    slots: int,
    period_s: float,
) -> Plan | None:
    """With the largest bias of that part that the limits allow; None where even without it none."""
    bias = part * min(MOST_BIAS_RAD_S, 0.5 * amplitude)
    tries = [bias * 0.5**k for k in range(HALVINGS)] if bias else [0.0]
    for one in tries:
        size = min(amplitude, MARGIN * rig.limits.velocity_rad_s - one)
        if size < SMALLEST_RAD_S:
            continue
        for _ in range(SHRINKINGS):
            plan = _plan(rig_name, levels, dwell, size, round(one, 4), slots, period_s)
            schedule = plan.experiment.schedule()
            if not _may_be_commanded(schedule, rig.limits):
                break
            used = _used_by_motion(schedule, rig)
            if used <= ROOM:
                return plan
            size *= 0.99 * ROOM / used
            if size < SMALLEST_RAD_S:
                break
    return None


def _may_be_commanded(schedule: Schedule, limits: Limits) -> bool:
    return (
        schedule.peak_travel_rad <= MARGIN * limits.travel_rad
        and schedule.peak_velocity_rad_s <= MARGIN * limits.velocity_rad_s
        and schedule.duration_s <= limits.run_time_s
    )


def _used_by_motion(schedule: Schedule, rig: RigConfig) -> float:
    """The largest share of a limit that the rig's model uses."""
    seen, limits = predict(schedule, rig), rig.limits
    shares = [
        seen.motor_travel_rad / limits.travel_rad,
        seen.load_travel_rad / limits.travel_rad,
        seen.peak_velocity_rad_s / limits.velocity_rad_s,
        seen.load_velocity_rad_s / limits.velocity_rad_s,
    ]
    if limits.torque_nm is not None:
        torque_nm = seen.peak_current_a * rig.nominal.torque_constant_nm_per_a
        shares.append(torque_nm / limits.torque_nm)
    return max(shares)


def _plan(  # noqa: PLR0917 - the grid's axes
    rig_name: str,
    levels: Levels,
    dwell: int,
    amplitude: float,
    bias: float,
    slots: int,
    period_s: float,
) -> Plan:
    amplitude = round(amplitude, 4)
    chips = slots // dwell
    sequence, memory = (_five if levels == "five levels" else _three)(chips, amplitude, bias)
    lead_in = min(LONGEST_LEAD_IN, chips // 16)
    left = max(chips - lead_in - sequence.velocity_rad_s().size, chips // 8)
    validation = RandomUniform(
        kind="random-uniform",
        seed=VALIDATION_SEED,
        amplitude_rad_s=VALIDATION_SHARE * amplitude,
        length=left,
        bias_rad_s=-bias,
    )
    experiment = Experiment(
        name="diagnosis",
        rig=rig_name,
        period_s=period_s,
        memory=memory,
        standstill_s=STANDSTILL_S,
        lead_in=lead_in * dwell,
        identification=held(sequence, dwell),
        validation=validation if dwell == 1 else held(validation, dwell),
    )
    return Plan(levels, amplitude, bias, dwell, experiment)


def _five(chips: int, amplitude: float, bias: float) -> tuple[Periodic, int]:
    room = IDENTIFIED * chips
    degree = int(math.log(room + 1.0, 5.0) + 1e-9)
    sequence = FieldSequence(
        kind="field",
        field=5,
        degree=degree,
        amplitude_rad_s=amplitude,
        periods=int(room // (5**degree - 1)),
        bias_rad_s=bias,
    )
    return sequence, min(LONGEST_MEMORY, chips // 32)


def _three(chips: int, amplitude: float, bias: float) -> tuple[Periodic, int]:
    share = IDENTIFIED * chips / len(SHARES)
    degree = int(math.log2(0.85 * share))
    polynomials = primitive_polynomials(degree)
    polynomial = oct(int(polynomials[0]))[2:]
    sequence = MultiAmplitude(
        kind="multi-amplitude",
        polynomial=polynomial,
        amplitudes_rad_s=tuple(round(s * amplitude, 4) for s in SHARES),
        settling=int(min(256, share - (2**degree - 1))),
        bias_rad_s=bias,
    )
    return sequence, min(LONGEST_MEMORY, chips // 32, collision_free_memory(polynomial, 3))


def held(sequence: Periodic | RandomUniform, periods: int) -> Periodic:
    """Each command for so many periods; written out, so that no kernel can be told from it."""
    if periods == 1 and not isinstance(sequence, RandomUniform):
        return sequence
    velocities = np.repeat(np.round(sequence.velocity_rad_s(), 4), periods)
    return FromRecording(commands_rad_s=tuple(velocities.tolist()))
