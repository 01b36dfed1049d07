"""Every play of an identification: where it was, its periods, and the kernels of each."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from servo_bench.errors import RecordingError
from servo_bench.excitation.experiment import MSequence, Phase
from servo_bench.excitation.fields import first_primitive
from servo_bench.excitation.sequences import FieldSequence, InverseRepeat, MultiAmplitude
from servo_bench.kernels.filling import extract_filled
from servo_bench.kernels.identification import (
    Identification,
    locate,
    locate_amplitudes,
    response_periods,
)
from servo_bench.kernels.played import Played
from servo_bench.kernels.response import Response
from servo_bench.kernels.separation import SeparatedKernels, separate_amplitudes
from servo_bench.kernels.volterra import Kernels
from servo_bench.recording.recording import Recording

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredPlay:
    """One play: where it was, its periods as filled and what was spoilt in them, its kernels."""

    found: Identification
    periods: Array
    spoilt: NDArray[np.bool_]
    kernels: Kernels

    @property
    def repeat_noise_rad_s(self) -> float:
        """Standard deviation of a sample between periods; NaN of a single one."""
        whole = self.periods[:, ~self.spoilt.any(axis=0)]
        if len(whole) < 2 or not whole.size:
            return float("nan")
        return float(np.sqrt(np.mean(np.var(whole, axis=0, ddof=1))))


def measured_play(
    response: Response, found: Identification, memory: int, delay: int
) -> MeasuredPlay:
    """A play's periods, `delay` slots after its commands, and their kernels."""
    answers, spoilt = response_periods(response, found, memory, delay)
    kernels, periods = extract_filled(
        answers, spoilt, found.played, found.amplitude_rad_s, memory, period_s=response.period_s
    )
    return MeasuredPlay(found, periods, spoilt, kernels)


def plays_of(
    recording: Recording, response: Response, polynomial: str | None
) -> tuple[tuple[Identification, ...], int]:
    """Every play of the identification, and how many more were cut off.

    `polynomial`, where given, replaces the experiment's. RecordingError where nothing says what
    was played, and as `locate`.
    """
    identification = recording.experiment.identification if recording.experiment else None
    match identification:
        case MultiAmplitude():
            renamed = {"polynomial": polynomial or identification.polynomial}
            return locate_amplitudes(response, identification.model_copy(update=renamed))
        case InverseRepeat():
            played = Played(polynomial or identification.polynomial, "inverse-repeat")
        case FieldSequence():
            known = identification.polynomial or first_primitive(
                identification.field, identification.degree or 0
            )
            played = Played(polynomial or known, "field", identification.field)
        case MSequence():
            played = Played(polynomial or identification.polynomial)
        case _ if polynomial is not None:
            played = Played(polynomial)
        case None:
            raise RecordingError(
                "the recording does not say which M-sequence was played. Name its polynomial, in "
                "octal with the highest power first (the paper's experiment: 40473)."
            )
        case _:
            raise RecordingError(
                f"the recording was identified with commands {identification.kind}: no kernel can "
                f"be told from them. Play an m-sequence, inverse-repeat, field, or "
                f"multi-amplitude sequence, or name the polynomial if they are an M-sequence."
            )
    return (locate(response, played),), 0


def amplitude_of(found: Identification) -> float:
    """Of a play, in rad/s."""
    return found.amplitude_rad_s


def distance_from(response: Response) -> Callable[[MeasuredPlay], float]:
    """Of a play's amplitude from the validation's largest command, or from the largest at all."""
    slots = response.slots_of(Phase.VALIDATION)
    played = np.abs(response.command_rad_s[slots])
    if not played.size:
        return lambda one: -one.found.amplitude_rad_s
    wanted = float(played.max())
    return lambda one: abs(one.found.amplitude_rad_s - wanted)


def separated_orders(measured: Sequence[MeasuredPlay]) -> SeparatedKernels | None:
    """Orders told apart by two amplitudes or more; None for one."""
    if len(measured) < 2:
        return None
    return separate_amplitudes(
        np.stack([one.periods.mean(axis=0) for one in measured]),
        tuple(one.found.amplitude_rad_s for one in measured),
        measured[0].found.polynomial,
        measured[0].kernels.memory,
    )
