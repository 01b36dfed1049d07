"""What a trial plays: chosen from a seed by rules, for this rig, as a good engineer would.

Identification   five levels (GF(5)), or one M-sequence at three amplitudes
bias             0.5..1 rad/s either way, so that the shaft makes full turns
amplitude        1..2 gap crossings a chip, within 3..6 rad/s
validation       uniform levels, a smaller amplitude, and the bias turned round
hold-out         a record of its own: the other kind of identification, other seeds, amplitudes

A chip lasts 8 ms. Where the encoder is read faster, a chip is held for several periods and its
velocities are written out.

`wide_plan` plays what nobody recommends, and many have: one M-sequence, five levels, or uniform
ones, of 2..12 rad/s every 4 to 16 ms, with no bias or some.
"""

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from servo_bench.excitation.enumeration import primitive_polynomials
from servo_bench.excitation.experiment import Experiment
from servo_bench.excitation.sequences import (
    FieldSequence,
    FromRecording,
    MSequence,
    MultiAmplitude,
    RandomUniform,
)
from servo_bench.kernels.shifts import collision_free_memory
from tests.truth.plant import NominalValues

CHIP_S = 0.008
SLOWEST_RAD_S, FASTEST_RAD_S = 3.0, 6.0
BIAS_RAD_S = (0.5, 1.0)
IDENTIFICATION_SHARE = 0.75
HOLD_OUT_SHARE, SHORTEST_HOLD_OUT_S = 0.4, 4.0
STANDSTILL_S, LONGEST_LEAD_IN, LONGEST_MEMORY = 2.0, 256, 18
AMPLITUDES = 3
KINDS = ("levels", "amplitudes")
WIDE_KINDS = ("binary", "levels", "uniform")
WIDE_PERIODS_S, WIDE_RAD_S = (0.004, 0.008, 0.01, 0.016), (2.0, 12.0)
WIDE_BIAS_RAD_S = (0.0, 0.5, 1.0)


class Plan(NamedTuple):
    """Both records of a trial."""

    seen: Experiment
    held_out: Experiment

    @property
    def velocity_rad_s(self) -> float:
        """The largest velocity that either commands; hidden limits are sized by it."""
        return max(one.schedule().peak_velocity_rad_s for one in self)


def plan(rng: np.random.Generator, nominal: NominalValues, seconds: float, period_s: float) -> Plan:
    """The records of a trial, the first `seconds` long; ConfigError where that is too short."""
    crossing_rad_s = nominal.backlash_gap_rad / CHIP_S
    wanted_rad_s = float(rng.uniform(1.0, 2.0)) * crossing_rad_s
    largest_rad_s = min(max(wanted_rad_s, SLOWEST_RAD_S), FASTEST_RAD_S)
    bias_rad_s = float(rng.uniform(*BIAS_RAD_S) * rng.choice((-1.0, 1.0)))
    first = int(rng.integers(len(KINDS)))
    held_s = max(HOLD_OUT_SHARE * seconds, SHORTEST_HOLD_OUT_S)
    smaller_rad_s = largest_rad_s * float(rng.uniform(0.6, 0.9))
    seen = _Record("seen", KINDS[first], largest_rad_s, bias_rad_s, seconds)
    held = _Record("held out", KINDS[1 - first], smaller_rad_s, -bias_rad_s, held_s)
    return Plan(_experiment(rng, seen, period_s), _experiment(rng, held, period_s))


def wide_plan(rng: np.random.Generator, seconds: float) -> Plan:
    """The records of a trial that is like none of the others, the first `seconds` long."""
    period_s = float(rng.choice(WIDE_PERIODS_S))
    largest_rad_s = float(np.exp(rng.uniform(*np.log(WIDE_RAD_S))))
    bias_rad_s = float(rng.choice(WIDE_BIAS_RAD_S))
    kind = str(rng.choice(WIDE_KINDS))
    held_s = max(HOLD_OUT_SHARE * seconds, SHORTEST_HOLD_OUT_S)
    seen = _Record("seen", kind, largest_rad_s, bias_rad_s, seconds, period_s)
    held = _Record("held out", "uniform", 0.8 * largest_rad_s, -bias_rad_s, held_s, period_s)
    return Plan(_experiment(rng, seen, period_s), _experiment(rng, held, period_s))


class _Record(NamedTuple):
    name: str
    kind: str
    amplitude_rad_s: float
    bias_rad_s: float
    seconds: float
    chip_s: float = CHIP_S


def _experiment(rng: np.random.Generator, record: _Record, period_s: float) -> Experiment:
    name, kind, amplitude_rad_s, bias_rad_s, seconds, chip_s = record
    holds = max(round(chip_s / period_s), 1)
    standstill_s = min(STANDSTILL_S, seconds / 10.0)
    chips = round((seconds - standstill_s) / (holds * period_s))
    lead_in = min(LONGEST_LEAD_IN, chips // 16)
    identification, memory = DRAWS[kind](rng, chips, amplitude_rad_s, bias_rad_s)
    left = chips - lead_in - identification.velocity_rad_s().size
    validation = RandomUniform(
        kind="random-uniform",
        seed=int(rng.integers(1 << 31)),
        amplitude_rad_s=amplitude_rad_s * float(rng.uniform(0.7, 0.95)),
        length=left,
        bias_rad_s=-bias_rad_s,
    )
    return Experiment(
        name=name,
        rig="rig.toml",
        period_s=period_s,
        memory=memory,
        standstill_s=standstill_s,
        lead_in=lead_in * holds,
        identification=_held(identification, holds),
        validation=_held(validation, holds),
    )


def _levels(
    rng: np.random.Generator, chips: int, amplitude_rad_s: float, bias_rad_s: float
) -> tuple[FieldSequence, int]:
    room = IDENTIFICATION_SHARE * chips
    degree = int(math.log(room + 1.0, 5.0))
    sequence = FieldSequence(
        kind="field",
        field=5,
        degree=degree,
        amplitude_rad_s=amplitude_rad_s,
        periods=int(room // (5**degree - 1)),
        bias_rad_s=bias_rad_s,
    )
    return sequence, min(LONGEST_MEMORY, chips // 32)


def _amplitudes(
    rng: np.random.Generator, chips: int, amplitude_rad_s: float, bias_rad_s: float
) -> tuple[MultiAmplitude, int]:
    """Three amplitudes, the others a third and two thirds, each moved by up to 15 %."""
    share = IDENTIFICATION_SHARE * chips / AMPLITUDES
    degree = int(math.log2(0.85 * share))
    candidates = primitive_polynomials(degree)
    polynomial = oct(int(candidates[int(rng.integers(candidates.size))]))[2:]
    shares = np.array([1 / 3, 2 / 3]) * rng.uniform(0.85, 1.15, 2)
    sequence = MultiAmplitude(
        kind="multi-amplitude",
        polynomial=polynomial,
        amplitudes_rad_s=(amplitude_rad_s, *(float(s) * amplitude_rad_s for s in shares)),
        settling=int(min(256, share - (2**degree - 1))),
        bias_rad_s=bias_rad_s,
    )
    return sequence, min(LONGEST_MEMORY, chips // 32, collision_free_memory(polynomial, 3))


def _binary(
    rng: np.random.Generator, chips: int, amplitude_rad_s: float, bias_rad_s: float
) -> tuple[MSequence, int]:
    degree = int(math.log2(IDENTIFICATION_SHARE * chips))
    candidates = primitive_polynomials(degree)
    polynomial = oct(int(candidates[int(rng.integers(candidates.size))]))[2:]
    sequence = MSequence(
        polynomial=polynomial, amplitude_rad_s=amplitude_rad_s, bias_rad_s=bias_rad_s
    )
    return sequence, min(LONGEST_MEMORY, chips // 32, collision_free_memory(polynomial, 3))


def _uniform(
    rng: np.random.Generator, chips: int, amplitude_rad_s: float, bias_rad_s: float
) -> tuple[FromRecording, int]:
    sequence = RandomUniform(
        kind="random-uniform",
        seed=int(rng.integers(1 << 31)),
        amplitude_rad_s=amplitude_rad_s,
        length=int(IDENTIFICATION_SHARE * chips),
        bias_rad_s=bias_rad_s,
    )
    return _written_out(sequence, 1), min(LONGEST_MEMORY, chips // 32)


Played = FieldSequence | MSequence | MultiAmplitude | RandomUniform | FromRecording
Draw = Callable[[np.random.Generator, int, float, float], tuple[Played, int]]
DRAWS: Mapping[str, Draw] = {
    "levels": _levels,
    "amplitudes": _amplitudes,
    "binary": _binary,
    "uniform": _uniform,
}


def _held(sequence: Played, holds: int) -> Played:
    """Each chip for so many periods."""
    return sequence if holds == 1 else _written_out(sequence, holds)


def _written_out(sequence: Played, holds: int) -> FromRecording:
    velocities = np.repeat(np.round(sequence.velocity_rad_s(), 6), holds)
    return FromRecording(commands_rad_s=tuple(velocities.tolist()))
