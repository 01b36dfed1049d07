"""What a rig's operator plays: a run to identify it by, and another one that judges.

A, D and G play five levels, each command held for three periods, as `servo-bench design diagnosis`
proposes; E and F the same with a bias that takes them through full turns; B and C what is in
somebody's file, a command a period. The hold-out is an inverse-repeat sequence, at six tenths.
"""

from collections.abc import Mapping
from functools import cache
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from servo_bench.excitation.experiment import Experiment
from servo_bench.excitation.sequences import (
    FieldSequence,
    FromRecording,
    InverseRepeat,
    MultiAmplitude,
    RandomUniform,
)
from tests.third.rigs import Rig

HELD = 3
"""Periods for which a designed run holds each command."""
STANDSTILL_S = 2.0
VALIDATION_SHARE = 0.85
HOLD_OUT_SHARE, HOLD_OUT_BIAS_SHARE = 0.6, 0.15
SLOW_PERIOD_S = 0.008


class Runs(NamedTuple):
    """Both experiments of a trial."""

    seen: Experiment
    held_out: Experiment

    @property
    def velocity_rad_s(self) -> float:
        """The largest velocity that either commands."""
        return max(one.schedule().peak_velocity_rad_s for one in self)


class _Levels(NamedTuple):
    """Five levels up to `amplitude_rad_s`, over the field GF(5); then `validation` others."""

    amplitude_rad_s: float
    bias_rad_s: float
    degree: int
    periods: int
    validation: int
    held: int = HELD


class _Amplitudes(NamedTuple):
    """One M-sequence at three amplitudes; then `validation` levels."""

    amplitudes_rad_s: tuple[float, float, float]
    bias_rad_s: float
    polynomial: str
    settling: int
    memory: int
    validation: int
    held: int = HELD

    @property
    def amplitude_rad_s(self) -> float:
        return max(self.amplitudes_rad_s)


_PLAYED: Mapping[str, _Levels | _Amplitudes] = MappingProxyType(
    {
        "bench-a": _Levels(2.5693, 0.5, degree=4, periods=2, validation=979),
        "bench-b": _Levels(6.0, 0.8, degree=5, periods=3, validation=3000, held=1),
        "bench-c": _Amplitudes(
            (6.0, 3.5, 1.5), 0.7, "4005", settling=128, memory=10, validation=1800, held=1
        ),
        "bench-d": _Levels(3.4907, 0.0, degree=5, periods=1, validation=1370),
        "bench-e": _Levels(6.4, 3.2, degree=4, periods=2, validation=979),
        "bench-f": _Amplitudes(
            (4.8, 3.2, 1.6), 2.4, "1021", settling=256, memory=9, validation=2193
        ),
        "bench-g": _Levels(3.927, 1.0, degree=4, periods=2, validation=979),
    }
)
TURNING = frozenset(_PLAYED) - {"bench-d"}
"""Rigs whose motor makes more than a full turn: elsewhere nothing that repeats with it shows."""


@cache
def runs(rig: Rig) -> Runs:
    """Both experiments of this rig."""
    return Runs(_seen(rig), _held_out(rig))


def _seen(rig: Rig) -> Experiment:
    played = _PLAYED[rig.name]
    slow = rig.period_s == SLOW_PERIOD_S
    if isinstance(played, _Levels):
        memory, lead_in = 18, 444 if slow else 768
        identification: FieldSequence | MultiAmplitude = FieldSequence(
            kind="field",
            field=5,
            degree=played.degree,
            amplitude_rad_s=played.amplitude_rad_s,
            periods=played.periods,
            bias_rad_s=played.bias_rad_s,
        )
    else:
        memory, lead_in = played.memory, 256 if played.held == 1 else 768
        identification = MultiAmplitude(
            kind="multi-amplitude",
            polynomial=played.polynomial,
            amplitudes_rad_s=played.amplitudes_rad_s,
            settling=played.settling,
            bias_rad_s=played.bias_rad_s,
        )
    validation = RandomUniform(
        kind="random-uniform",
        seed=21,
        amplitude_rad_s=VALIDATION_SHARE * played.amplitude_rad_s,
        length=played.validation,
        bias_rad_s=-played.bias_rad_s,
    )
    return Experiment(
        name="diagnosis",
        rig=f"{rig.name}.toml",
        period_s=rig.period_s,
        memory=memory,
        standstill_s=STANDSTILL_S,
        lead_in=lead_in,
        identification=identification if played.held == 1 else _held(identification, played.held),
        validation=validation if played.held == 1 else _held(validation, played.held),
    )


def _held(sequence: FieldSequence | MultiAmplitude | RandomUniform, periods: int) -> FromRecording:
    """Every command of a sequence for so many periods, written out."""
    velocity_rad_s = np.repeat(np.round(sequence.velocity_rad_s(), 4), periods)
    return FromRecording(commands_rad_s=tuple(velocity_rad_s.tolist()))


def _held_out(rig: Rig) -> Experiment:
    played = _PLAYED[rig.name]
    top_rad_s = played.amplitude_rad_s + (played.bias_rad_s if played.held > 1 else 0.0)
    slow = rig.period_s == SLOW_PERIOD_S
    return Experiment(
        name="judge",
        rig=f"{rig.name}.toml",
        period_s=rig.period_s,
        memory=18,
        standstill_s=STANDSTILL_S,
        lead_in=128 if slow else 256,
        identification=InverseRepeat(
            kind="inverse-repeat",
            polynomial="1021" if slow else "2011",
            amplitude_rad_s=round(HOLD_OUT_SHARE * top_rad_s, 3),
            bias_rad_s=round(HOLD_OUT_BIAS_SHARE * top_rad_s, 3),
        ),
        validation=RandomUniform(
            kind="random-uniform",
            seed=77,
            amplitude_rad_s=round(VALIDATION_SHARE * top_rad_s, 3),
            length=1500 if slow else 2500,
            bias_rad_s=round(-0.1 * top_rad_s, 3),
        ),
    )
