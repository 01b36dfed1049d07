"""Which samples of a response belong to which chip of the identification sequence.

The lead-in plays the tail of the sequence, so from the kernels' memory after its start on the
response is in its periodic steady state, and any N samples in a row are a whole period.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from servo_bench.errors import FitError, RecordingError
from servo_bench.excitation.experiment import Phase
from servo_bench.excitation.sequences import MultiAmplitude
from servo_bench.kernels.filling import spoilt_by
from servo_bench.kernels.levels import linear_answer
from servo_bench.kernels.played import Played, as_played
from servo_bench.kernels.response import LARGEST_MISSING_SHARE, Response
from servo_bench.kernels.volterra import extract

Array = NDArray[np.float64]

SIGNIFICANT_SCATTERS = 8.0
SIGNIFICANT_SHARE = 0.05
"""A lag has answered where its coefficient passes both: scatters, and a share of the largest."""


@dataclass(frozen=True, slots=True)
class Identification:
    """Where a sequence was played: chip 0 in slot `start`, periodic from `first` to `stop`."""

    played: Played
    amplitude_rad_s: float
    bias_rad_s: float
    chips: int
    first: int
    start: int
    stop: int

    @property
    def polynomial(self) -> str:
        """Of the sequence."""
        return self.played.polynomial

    @property
    def periods(self) -> int:
        """Whole periods that were commanded from `start` on."""
        return (self.stop - self.start) // self.chips


def locate(response: Response, sequence: Played | str) -> Identification:
    """Find the sequence in the commands and check that it is this one; a polynomial means binary.

    Raises RecordingError where less than a period was played, FitError where it is another
    sequence, ConfigError where the polynomial is not primitive.
    """
    slots, lead_in = (response.slots_of(p) for p in (Phase.IDENTIFICATION, Phase.LEAD_IN))
    return _located(response, as_played(sequence), slots, lead_in)


def locate_amplitudes(
    response: Response, sequence: MultiAmplitude
) -> tuple[tuple[Identification, ...], int]:
    """Each amplitude's play that is whole, in the order played, and how many are not.

    RecordingError where fewer than two are; else as `locate`.
    """
    whole = response.slots_of(Phase.IDENTIFICATION)
    played = Played(sequence.polynomial)
    length = played.chips.size * sequence.periods
    plays = [
        slice(whole.start + begin, whole.start + begin + length)
        for begin in sequence.period_starts()
    ]
    kept = [slots for slots in plays if slots.stop <= whole.stop]
    if len(kept) < 2:
        raise RecordingError(
            f"the recording holds {len(kept)} whole plays at one amplitude of the "
            f"{len(plays)} that were to be played: orders are told apart by two or more. Record "
            f"to the end."
        )
    settling = sequence.settling
    found = [
        _located(response, played, slots, slice(slots.start - settling, slots.start))
        for slots in kept
    ]
    return tuple(found), len(plays) - len(kept)


def _located(response: Response, played: Played, slots: slice, lead_in: slice) -> Identification:
    chips = played.chips
    count = slots.stop - slots.start
    if count < chips.size:
        raise RecordingError(
            f"the recording holds {count} slots of identification, but one period of "
            f"{played.polynomial} has {chips.size}: no kernel can be extracted. Record at least "
            f"one whole period, or play a polynomial of a lower degree."
        )
    amplitude, bias = _levels(response.command_rad_s[slots], chips)
    commands = bias + amplitude * chips
    tolerance = amplitude / (2.0 * (np.unique(chips).size - 1))
    wrong = _wrong_share(response, slots, slots.start, commands, tolerance)
    if wrong > LARGEST_MISSING_SHARE:
        highest = float(np.abs(response.command_rad_s[slots]).max())
        name = "M-sequence" if played.kind == "m-sequence" else f"{played.kind} sequence"
        raise FitError(
            f"the commands of slots {slots.start} to {slots.stop - 1} are not the {name} of "
            f"{played.polynomial} at +-{highest:.4g} rad/s: {100.0 * wrong:.1f} % of them differ. "
            f"Name the polynomial that was played, or check that the recording is whole."
        )
    periodic = lead_in.stop == slots.start and (
        _wrong_share(response, lead_in, slots.start, commands, tolerance) <= LARGEST_MISSING_SHARE
    )
    return Identification(
        played=played,
        amplitude_rad_s=amplitude,
        bias_rad_s=bias,
        chips=chips.size,
        first=lead_in.start if periodic else slots.start,
        start=slots.start,
        stop=slots.stop,
    )


def _levels(commands: Array, chips: Array) -> tuple[float, float]:
    """Half the distance of the outermost levels, and their middle: amplitude and bias."""
    level = np.resize(chips, commands.size)
    high, low = (float(np.median(commands[level == end])) for end in (1.0, -1.0))
    return abs(high - low) / 2.0, (high + low) / 2.0


def _wrong_share(
    response: Response, slots: slice, start: int, commands: Array, tolerance: float
) -> float:
    """The share of slots whose command is not the sequence's to within `tolerance`."""
    places = (np.arange(slots.start, slots.stop) - start) % commands.size
    distance = np.abs(response.command_rad_s[slots] - commands[places])
    return float(np.mean(~(distance < tolerance))) if places.size else 0.0


def response_periods(
    response: Response, found: Identification, memory: int, delay_periods: int
) -> tuple[Array, NDArray[np.bool_]]:
    """The velocity that answers each chip, in rad/s, shape (periods, N), steady state only.

    With it, alike in shape, which samples a hole in the run has spoilt.
    Sample t is the slot `delay_periods` after chip t. Where the recording ends too early the
    window moves back into the lead-in. RecordingError where no whole period is left.
    """
    earliest = found.first + delay_periods + memory - 1
    latest = min(found.stop + delay_periods, response.velocity_rad_s.size)
    periods = min(found.periods, (latest - earliest) // found.chips)
    if periods < 1:
        raise RecordingError(
            f"the recording answers {max(latest - earliest, 0)} chips in steady state, but one "
            f"period of {found.polynomial} has {found.chips}: it ends too early, or its lead-in "
            f"({found.start - found.first} chips) is shorter than delay and memory "
            f"({delay_periods + memory - 1}). Record to the end, with a longer lead-in."
        )
    begin = min(max(found.start + delay_periods, earliest), latest - periods * found.chips)
    window = slice(begin, begin + periods * found.chips)
    first_chip = (begin - delay_periods - found.start) % found.chips
    spoilt = spoilt_by(response.disturbed, memory + delay_periods)
    return (
        np.roll(response.velocity_rad_s[window].reshape(periods, -1), first_chip, axis=1),
        np.roll(spoilt[window].reshape(periods, -1), first_chip, axis=1),
    )


def command_delay(response: Response, found: Identification, memory: int) -> int:
    """How many whole periods pass before a command shows: the first lag that answers.

    A drive that executes one SYNC later has 1. FitError where no lag answers at all.
    """
    at_once, spoilt = response_periods(response, found, memory, 0)
    at_once = np.where(spoilt, 0.0, at_once)
    strength, scatter = _linear(at_once, found, memory)
    largest = float(strength.max())
    if largest <= SIGNIFICANT_SCATTERS * scatter:
        raise FitError(
            f"the load angle does not answer the commands: its strongest linear lag is "
            f"{largest:.3g} rad/s, with a scatter of {scatter:.3g} where nothing can be. "
            f"Check that the load encoder is coupled and is the recorded channel, and that the "
            f"amplitude moves the load through its backlash."
        )
    threshold = max(SIGNIFICANT_SCATTERS * scatter, SIGNIFICANT_SHARE * largest)
    return int(np.flatnonzero(strength > threshold)[0])


def _linear(periods: Array, found: Identification, memory: int) -> tuple[Array, float]:
    """The size of each linear coefficient, (M,), and their scatter where none can be."""
    if found.played.kind == "m-sequence":
        kernels = extract(periods, found.polynomial, found.amplitude_rad_s, memory, 1)
        return np.abs(kernels.c1), kernels.scatter
    shifts = np.abs(linear_answer(periods.mean(axis=0), found.played.chips))
    return shifts[:memory], float(1.4826 * np.median(shifts))
