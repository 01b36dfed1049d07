"""How long an experiment is, before anything of it is laid out in memory."""

from servo_bench.excitation.experiment import Experiment
from servo_bench.excitation.sequences import (
    MAX_CHIPS,
    FieldSequence,
    FromRecording,
    InverseRepeat,
    MSequence,
    MultiAmplitude,
    RandomBinary,
    RandomUniform,
    Sequence,
)

LARGEST_DEGREE = 64
"""Of what is counted: no sequence that can be played comes near."""


def counted_slots(experiment: Experiment) -> int:
    """How many slots an experiment has, without laying them out; fewer where its sequences are
    none, which their schedule says in words."""
    sequences = (experiment.identification, experiment.validation)
    standstill = round(min(experiment.standstill_s / experiment.period_s, MAX_CHIPS + 1))
    return standstill + experiment.lead_in + sum(_chips(sequence) for sequence in sequences)


def _chips(sequence: Sequence) -> int:
    match sequence:
        case FromRecording():
            return len(sequence.commands_rad_s)
        case RandomBinary() | RandomUniform() | MSequence(length=int()):
            return sequence.length or 0
        case FieldSequence():
            degree = sequence.degree if not sequence.polynomial else len(sequence.polynomial) - 1
            return int(sequence.field ** min(degree or 0, LARGEST_DEGREE) - 1) * sequence.periods
        case MultiAmplitude():
            whole = sequence.settling + _period(sequence.polynomial) * sequence.periods
            return whole * len(sequence.amplitudes_rad_s)
        case InverseRepeat():
            return 2 * _period(sequence.polynomial) * sequence.periods
        case _:
            return _period(sequence.polynomial) * sequence.periods


def _period(polynomial: str) -> int:
    """Of a binary M-sequence, by its characteristic polynomial in octal."""
    try:
        degree = int(polynomial, 8).bit_length() - 1
    except ValueError:
        return 0
    return int((1 << min(max(degree, 0), LARGEST_DEGREE)) - 1)
