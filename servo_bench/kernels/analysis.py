"""From a recording to its Volterra kernels and what they predict on commands they never saw."""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from servo_bench.excitation.experiment import Phase
from servo_bench.kernels.comparison import Comparison, compare
from servo_bench.kernels.filling import spoilt_by
from servo_bench.kernels.identification import (
    Identification,
    command_delay,
)
from servo_bench.kernels.played import Played, need_resolvable
from servo_bench.kernels.plays import (
    MeasuredPlay,
    amplitude_of,
    distance_from,
    measured_play,
    plays_of,
    separated_orders,
)
from servo_bench.kernels.predict import predict
from servo_bench.kernels.quality import RunQuality, run_quality
from servo_bench.kernels.response import LARGEST_UNEVENNESS, Response, Timebase, response_of
from servo_bench.kernels.separation import SeparatedKernels
from servo_bench.kernels.volterra import Kernels
from servo_bench.recording.recording import Recording

Array = NDArray[np.float64]

ENOUGH_STANDSTILL = 16
"""Increments from which the noise at standstill is told."""
LEAST_OF_STEPS = 1e-9
"""Of the largest step of an angle: what is less is rounding of the numbers themselves."""


@dataclass(frozen=True, slots=True, eq=False)
class Validation:
    """The prediction of the validation phase, from commands alone.

    `velocity` compares rad/s over the n slots from `first_slot` on. The angles, rad, shape
    (n + 1,), are at `time_s`; the predicted ones integrate the predicted velocities from the
    measured start value, and nothing else is fitted: what the kernels' memory cuts off is an
    error of the steady gain, which adds up in the angle.
    """

    first_slot: int
    velocity: Comparison
    time_s: Array
    angle_rad: Array
    angle_order1_rad: Array
    angle_order3_rad: Array

    @property
    def angle_error_order1_rms_rad(self) -> float:
        """Root mean square of the angle predicted by the linear kernel, less the measured."""
        return _rms(self.angle_order1_rad - self.angle_rad)

    @property
    def angle_error_order3_rms_rad(self) -> float:
        """Root mean square of the angle predicted up to order 3, less the measured."""
        return _rms(self.angle_order3_rad - self.angle_rad)


@dataclass(frozen=True, slots=True, eq=False)
class Analysis:
    """Kernels of a recording, and how well they explain it.

    kernels                of the load's velocity, rad/s per chip; lag 0 is the command that was
                           given `delay_periods` slots before
    delay_periods          whole periods between a command and the first answer to it, removed
    timebase               "device": increments are over the device's own time; else "nominal"
    identification         the (mean) identification period, and the same kernels' prediction
    validation             None where no validation was recorded
    noise_rad_s            standard deviation of the increments at standstill, or of the
                           encoder's steps where those are larger; NaN where neither is known
    noise_ceiling_percent  100 (1 - noise variance / variance of the response): no prediction can
                           account for more; NaN where the noise is not known
    energy_percent         share of the response's variance in the kernels of orders 1, 2, 3
    quality                of the run itself
    flags                  sentences about what the reader must know; empty for a flawless run
    played                 the sequence that identified
    bias_rad_s             the constant velocity that was added to it
    repeat_noise_rad_s     standard deviation of a sample between periods; NaN of a single period
    separated              orders told apart by several amplitudes, where there were several
    """

    kernels: Kernels
    delay_periods: int
    timebase: Timebase
    identification: Comparison
    validation: Validation | None
    noise_rad_s: float
    noise_ceiling_percent: float
    energy_percent: tuple[float, float, float]
    quality: RunQuality
    flags: tuple[str, ...]
    played: Played
    bias_rad_s: float
    repeat_noise_rad_s: float
    separated: SeparatedKernels | None

    @property
    def amplitudes(self) -> int:
        """How many amplitudes identified."""
        return len(self.separated.amplitudes) if self.separated else 1

    @property
    def odd_percent(self) -> float:
        """Share of the response's variance in the odd orders, which a symmetric rig has alone."""
        return self.energy_percent[0] + self.energy_percent[2]

    @property
    def even_percent(self) -> float:
        """Share of the response's variance in order 2: what differs between the directions."""
        return self.energy_percent[1]

    def numbers(self) -> dict[str, Any]:
        """Everything that is one number, ready for JSON; None for what is not known."""
        kernels, validation = self.kernels, self.validation
        numbers: dict[str, Any] = {
            "polynomial": kernels.polynomial,
            "amplitude_rad_s": kernels.amplitude,
            "period_s": kernels.period_s,
            "memory": kernels.memory,
            "collision_free_memory": self.played.resolvable_memory,
            "sequence": self.played.kind,
            "levels": kernels.levels,
            "amplitudes": self.amplitudes,
            "bias_rad_s": self.bias_rad_s,
            "periods": kernels.periods,
            "delay_periods": self.delay_periods,
            "timebase": self.timebase,
            "vaf_same_order1_percent": self.identification.vaf_order1_percent,
            "vaf_same_order3_percent": self.identification.vaf_order3_percent,
            "vaf_fresh_order1_percent": validation and validation.velocity.vaf_order1_percent,
            "vaf_fresh_order3_percent": validation and validation.velocity.vaf_order3_percent,
            "angle_error_order1_rms_rad": validation and validation.angle_error_order1_rms_rad,
            "angle_error_order3_rms_rad": validation and validation.angle_error_order3_rms_rad,
            "noise_rad_s": self.noise_rad_s,
            "repeat_noise_rad_s": self.repeat_noise_rad_s,
            "noise_ceiling_percent": self.noise_ceiling_percent,
            "energy_order1_percent": self.energy_percent[0],
            "energy_order2_percent": self.energy_percent[1],
            "energy_order3_percent": self.energy_percent[2],
            "odd_percent": self.odd_percent,
            "even_percent": self.even_percent,
            "constant_rad_s": kernels.constant,
            "coefficient_scatter_rad_s": kernels.scatter,
            "coefficient_standard_error_rad_s": kernels.standard_error,
        }
        known = {name: _known(value) for name, value in numbers.items()}
        return {**known, "run": self.quality.numbers(), "flags": list(self.flags)}


def analyse(
    recording: Recording, *, memory: int | None = None, polynomial: str | None = None
) -> Analysis:
    """Kernels up to order 3 from the identification periods, judged on the validation.

    Memory (samples) and polynomial are the experiment's where they are not given; without an
    experiment a plain M-sequence is meant, and the memory is the largest that it can resolve. Of
    several amplitudes the kernels are those nearest to the validation's. Raises RecordingError
    where channels, angles, or the end of the period are missing, FitError where the angle does
    not answer the sequence or the memory is too long, ConfigError for a polynomial that is none.
    """
    response = response_of(recording)
    plays, left_out = plays_of(recording, response, polynomial)
    bias_rad_s = plays[0].bias_rad_s
    response = replace(response, command_rad_s=response.command_rad_s - bias_rad_s)
    samples = _memory_of(recording, plays[0]) if memory is None else memory
    need_resolvable(plays[0].played, samples)
    delay = command_delay(response, max(plays, key=amplitude_of), samples)
    measured = [measured_play(response, play, samples, delay) for play in plays]
    main = min(measured, key=distance_from(response))
    kernels, variance = main.kernels, float(main.periods.var())
    chips = main.found.played.chips
    noise = _noise_rad_s(recording, response)
    shares = _shares_percent(kernels, main.periods.mean(axis=0), chips)
    validation = _validation(kernels, response, delay)
    flags = _flags(recording, response, main, validation, delay=delay)
    if left_out:
        flags.append(f"{left_out} of {left_out + len(plays)} amplitudes were not played whole.")
    return Analysis(
        kernels=kernels,
        delay_periods=delay,
        timebase=response.timebase,
        identification=compare(
            kernels,
            main.periods.mean(axis=0),
            chips,
            chips,
            np.logical_not(main.spoilt.all(axis=0)),
        ),
        validation=validation,
        noise_rad_s=noise,
        noise_ceiling_percent=100.0 * (1.0 - noise**2 / variance),
        energy_percent=(float(shares[0]), float(shares[1]), float(shares[2])),
        quality=run_quality(recording),
        flags=tuple(flags),
        played=main.found.played,
        bias_rad_s=bias_rad_s,
        repeat_noise_rad_s=main.repeat_noise_rad_s,
        separated=separated_orders(measured),
    )


def _memory_of(recording: Recording, found: Identification) -> int:
    if recording.experiment is None:
        return found.played.resolvable_memory
    return recording.experiment.memory


def _validation(kernels: Kernels, response: Response, delay: int) -> Validation | None:
    """Predict from `delay` after the phase begins: only then its own commands arrive."""
    slots = response.slots_of(Phase.VALIDATION)
    first = slots.start + delay
    last = min(slots.stop, response.velocity_rad_s.size)
    if slots.stop == 0 or last - first < kernels.memory:
        return None
    inputs = response.command_rad_s / kernels.amplitude
    velocity = compare(
        kernels,
        response.velocity_rad_s[first:last],
        inputs[first - delay : last - delay],
        inputs[: first - delay],
        ~spoilt_by(response.disturbed, kernels.memory + delay)[first:last],
    )
    angle = response.angle_rad[first : last + 1]
    return Validation(
        first_slot=first,
        velocity=velocity,
        time_s=np.arange(angle.size, dtype=np.float64) * response.period_s,
        angle_rad=angle,
        angle_order1_rad=_integrated(angle[0], velocity.order1, response.period_s),
        angle_order3_rad=_integrated(angle[0], velocity.order3, response.period_s),
    )


def _integrated(start: float, velocity: Array, period_s: float) -> Array:
    return start + np.concatenate([[0.0], np.cumsum(velocity) * period_s])


def _noise_rad_s(recording: Recording, response: Response) -> float:
    """At standstill, or by the encoder's steps: a still encoder's counts hide their size.

    Rounding to steps q is noise of variance q^2/12 in each angle, q^2/6 in an increment. NaN where
    nothing stood still and no rig's file tells the steps: the least that an angle moved bounds
    them, but is no measure of a noise.
    """
    slots = response.slots_of(Phase.STANDSTILL)
    still = response.velocity_rad_s[slots.start : max(slots.stop - 1, 0)]
    measured = float(still.std()) if still.size >= ENOUGH_STANDSTILL else float("nan")
    counts = recording.rig.load_counts_per_revolution if recording.rig is not None else None
    if counts is not None:
        return float(np.fmax(measured, _rounding_rad_s(2.0 * np.pi / counts, response)))
    return float(np.maximum(measured, _rounding_rad_s(_least_moved_rad(recording), response)))


def _rounding_rad_s(step_rad: float, response: Response) -> float:
    return step_rad / (math.sqrt(6.0) * response.period_s)


def _least_moved_rad(recording: Recording) -> float:
    steps = np.abs(np.diff(np.asarray(recording["load_angle_rad"], np.float64)))
    steps = steps[np.isfinite(steps)]
    moved = steps[steps > LEAST_OF_STEPS * steps.max(initial=0.0)]
    return float(moved.min(initial=np.inf)) if moved.size else 0.0


def _flags(
    recording: Recording,
    response: Response,
    main: MeasuredPlay,
    validation: Validation | None,
    *,
    delay: int,
) -> list[str]:
    kernels, found = main.kernels, main.found
    flags = []
    if recording.cut:
        flags.append("The recording was cut before its run ended.")
    if response.missing_angles:
        flags.append(
            f"{response.missing_angles} load angles were missing ({response.missing_slots} whole "
            f"slots)."
        )
    if response.disturbed.any():
        spoilt = spoilt_by(response.disturbed, kernels.memory + delay)
        flags.append(
            f"{int(response.disturbed.sum())} slots were disturbed: an angle is missing, or they "
            f"lasted over {100 * LARGEST_UNEVENNESS:.0f} % longer or shorter than a period. They "
            f"and the memory after them, {int(spoilt.sum())} slots, count neither for the kernels "
            "nor in a VAF."
        )
    wanted = recording.experiment.memory if recording.experiment else kernels.memory
    if found.played.kind == "field" and kernels.memory < wanted:
        flags.append(
            f"The kernels reach over {kernels.memory} of the experiment's {wanted} samples. On "
            f"{found.polynomial} over GF({found.played.field}) every later answer, a linear one "
            "too, is a sum of products within that reach: what the rig remembers longer is aliased "
            "into these kernels. The other estimators are not bound to that."
        )
    if kernels.periods < found.periods:
        flags.append(f"Only {kernels.periods} of {found.periods} periods could be used.")
    if validation is None:
        flags.append(
            "No validation was recorded that is longer than the memory: nothing judges these "
            "kernels on fresh input."
        )
    else:
        played = np.abs(response.command_rad_s[response.slots_of(Phase.VALIDATION)])
        if kernels.levels > 2:  # between its outermost levels it has others
            played = played.max(keepdims=True)
        if np.abs(played - kernels.amplitude).max() > 1e-3 * kernels.amplitude:
            flags.append(
                "The validation was not played at the amplitude of the identification: kernels "
                "hold at their own amplitude only."
            )
    return flags


def _shares_percent(kernels: Kernels, period: Array, chips: Array) -> Array:
    """Of the response's variance, in each of the orders 1 to 3, %; shape (3,).

    Of two levels by Parseval. On more levels orders overlap (u^3 is not u's stranger there): each
    is told what it explains of the period beside those below it, fitted as a whole.
    """
    variance = float(np.var(period))
    if kernels.levels == 2 or variance == 0.0:
        return np.asarray(100.0 * kernels.energies[1:] / variance)
    upto = [predict(kernels, chips, order, history=chips) for order in (1, 2, 3)]
    parts = np.stack([upto[0], upto[1] - upto[0], upto[2] - upto[1]], axis=1)
    parts -= parts.mean(axis=0)
    centred, explained = period - period.mean(), [0.0]
    for orders in (1, 2, 3):
        known = parts[:, :orders]
        left = centred - known @ np.linalg.lstsq(known, centred)[0]
        explained.append(100.0 * (1.0 - float(np.var(left)) / variance))
    return np.diff(explained)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _known(value: Any) -> Any:
    return None if isinstance(value, float) and not np.isfinite(value) else value
