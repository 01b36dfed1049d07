"""Grey-box fit: chosen numbers of the rig's own model, fitted to a recording.

    fit(recording, model, ("J", "K_P", "coulomb.torque_nm")) -> Fit

The fit sees lead-in and identification (of data from elsewhere, the first three quarters); what it
gained is measured on the validation, which it never saw, or on another recording. See docs/fit.md.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from servo_bench.diagnosis.comparing.comparison import Choice, Comparison, compare
from servo_bench.diagnosis.comparing.rows import Array
from servo_bench.diagnosis.fitting.driven import compare_driven, is_driven
from servo_bench.diagnosis.fitting.foreign_ranges import for_elsewhere
from servo_bench.diagnosis.fitting.free import FreeParameter, free_parameters
from servo_bench.diagnosis.fitting.sharpening import sharpened
from servo_bench.diagnosis.fitting.solver import Problem, Report, Solved, solve
from servo_bench.diagnosis.fitting.starting import starting_numbers
from servo_bench.diagnosis.fitting.twist import compare_locked
from servo_bench.diagnosis.fitting.uncertainty import (
    correlation,
    covariance,
    deviations_of,
    inseparable,
)
from servo_bench.errors import FitError
from servo_bench.recording.blocks import Name
from servo_bench.recording.recording import Recording
from sim_rig.model import Model

NO_MODEL, WORSE = 0.7, 1.05
"""Of the motion, what is left where a model is none of the recording's; and of the error on data
that no fit saw, what is more than chance."""
AT_BOUND = 1e-3
"""Closer than this to a bound, in spreads, is at it."""
UNSEEN_SHARE = 0.5
"""A standard error beyond this share of the value, and beyond its spread: nothing is told of it."""


class Estimate(NamedTuple):
    """One fitted number; `standard_error` is one standard deviation, in the same unit."""

    name: str
    symbol: str
    unit: str
    before: float
    value: float
    standard_error: float


class SignalError(NamedTuple):
    """One signal's rms error, measured minus simulated, in its unit; `floor` is its noise."""

    name: str
    unit: str
    channel: str
    floor: float
    seen_before: float
    seen_after: float
    held_out_before: float
    held_out_after: float

    @property
    def gain(self) -> float:
        """The share of the held-out error that the fit removed; negative if it grew."""
        return 1.0 - self.held_out_after / self.held_out_before if self.held_out_before else 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """Fitted values and what they are worth.

    `correlation` is in the order of `estimates`. Where `converged` is false, `reason` says why
    and what to do, and the values are where the search stopped. `notes` say what the correlation
    and the values mean. `signals` begin with the one that counts: the load, where it was recorded.
    """

    model: Model
    before: Model
    block: Name
    window_s: float | None
    estimates: tuple[Estimate, ...]
    correlation: Array
    signals: tuple[SignalError, ...]
    iterations: int
    simulations: int
    converged: bool
    reason: str
    notes: tuple[str, ...]

    def __getitem__(self, name: str) -> Estimate:
        """The estimate of that name or symbol; KeyError where it was not free."""
        for estimate in self.estimates:
            if name in (estimate.name, estimate.symbol):
                return estimate
        raise KeyError(name)

    def signal(self, name: str) -> SignalError:
        """The error of that signal, as "load velocity"; KeyError where it was not compared."""
        for signal in self.signals:
            if signal.name == name:
                return signal
        raise KeyError(name)

    @property
    def gain(self) -> float:
        """The first signal's gain."""
        return self.signals[0].gain

    def numbers(self) -> dict[str, Any]:
        """Everything as plain numbers and text, for JSON; NaN as null."""
        return {
            "block": self.block,
            "window_s": self.window_s,
            "converged": self.converged,
            "reason": self.reason,
            "notes": list(self.notes),
            "iterations": self.iterations,
            "simulations": self.simulations,
            "estimates": {e.name: _plain(e._asdict()) for e in self.estimates},
            "correlation": [[float(value) for value in row] for row in self.correlation],
            "signals": {s.name: _plain({**s._asdict(), "gain": s.gain}) for s in self.signals},
        }


def fit(
    recording: Recording,
    model: Model,
    free: Sequence[str],
    *,
    block: Choice = "auto",
    window_s: float | None = None,
    prior: bool = False,
    held_out: Recording | None = None,
    report: Report | None = None,
) -> Fit:
    """Fit the named numbers of `model`, in the block that the recording's channels allow.

    `prior` adds what was believed before as one observation each. `held_out` is another recording
    to be judged on. `report` is called at every iteration.

    Raises ConfigError for a name that cannot be free, FitError where the data do not suffice. A
    search that fails is no exception: `Fit.converged` and `Fit.reason`.
    """
    parameters = free_parameters(model, free)
    comparison = compared(recording, model, block, window_s)
    judged = compared(held_out, model, comparison.block, window_s) if held_out else None
    if recording.plant is not None:
        parameters = for_elsewhere(parameters, comparison, model)
    problem = Problem(comparison, model, parameters, prior=prior)
    solved = sharpened(problem, solve(problem, starting_numbers(problem), report))
    numbers = _turned(solved.numbers * problem.spreads, parameters) / problem.spreads
    best = problem.at(numbers)
    cov = covariance(solved)
    together = correlation(cov)
    deviations = deviations_of(cov)
    alike = inseparable(parameters, together, deviations)
    estimates = tuple(
        Estimate(p.name, p.symbol, p.unit, p.of(model), p.of(best), float(s * p.spread))
        for p, s in zip(parameters, deviations, strict=True)
    )
    reasons = [*_failures(solved, problem), *_unseen(parameters, estimates, alike.members)]
    signals = _signal_errors(comparison, judged, model, best)
    fits_ill = _fits_ill(judged or comparison, signals[0])
    return Fit(
        model=best,
        before=model,
        block=comparison.block,
        window_s=comparison.window_s,
        estimates=estimates,
        correlation=together,
        signals=signals,
        iterations=solved.iterations,
        simulations=solved.simulations,
        converged=not reasons,
        reason=" ".join(reasons),
        notes=(*fits_ill, *alike.sentences, *_nothing_of(parameters, solved)),
    )


def compared(
    recording: Recording, model: Model, block: Choice, window_s: float | None
) -> Comparison:
    """The recording beside the model, whatever drives it and whether its output is free."""
    if recording.plant is not None and recording.plant.output_locked:
        return compare_locked(recording, block, window_s)
    if is_driven(recording):
        return compare_driven(recording, model, block, window_s)
    return compare(recording, model, block, window_s)


def _turned(values: Array, parameters: Sequence[FreeParameter]) -> Array:
    """Phases between -pi and pi."""
    turned = (values + math.pi) % (2.0 * math.pi) - math.pi
    return np.where([p.circular for p in parameters], turned, values)


def _failures(solved: Solved, problem: Problem) -> Iterator[str]:
    if not solved.settled:
        yield (
            f"The search had not settled after {solved.iterations} iterations: start it again "
            "from what it found, or free fewer numbers."
        )
    if solved.cost_after > solved.cost_before * (1.0 + 1e-6):
        yield (
            "The search ended worse than it began: the error is too rough in these numbers. "
            "Free fewer of them."
        )
    for k, parameter in enumerate(problem.free):
        number = solved.numbers[k]
        low = number - problem.low[k] < AT_BOUND and parameter.low != 0.0
        if low or problem.high[k] - number < AT_BOUND:
            bound = parameter.low if low else parameter.high
            yield (
                f"{parameter.symbol} stopped at its bound, {bound:g} {parameter.unit}: beyond lies "
                "no usual value. Another cause acts like it; free that one, or mend the model."
            )


def _unseen(
    parameters: Sequence[FreeParameter], estimates: Sequence[Estimate], alike: frozenset[str]
) -> Iterator[str]:
    """Of what acts alike the notes speak."""
    for parameter, found in zip(parameters, estimates, strict=True):
        if parameter.symbol in alike:
            continue
        if not found.standard_error < max(parameter.spread, UNSEEN_SHARE * abs(found.value)):
            yield (
                f"{parameter.symbol} is not seen in this recording: its standard error is "
                f"{found.standard_error:.2g} {parameter.unit}, and {parameter.spread:.2g} was "
                "open before. Fix it, or play what excites it."
            )


def _nothing_of(parameters: Sequence[FreeParameter], solved: Solved) -> Iterator[str]:
    for parameter, number in zip(parameters, solved.numbers, strict=True):
        if parameter.low == 0.0 and number < AT_BOUND:
            yield f"{parameter.symbol} ended at zero: the recording wants none of it."


def _signal_errors(
    comparison: Comparison, judged: Comparison | None, model: Model, best: Model
) -> tuple[SignalError, ...]:
    before, after = comparison.errors_of([model, best])
    seen = [comparison.rms(errors, comparison.seen) for errors in (before, after)]
    held = [comparison.rms(errors, comparison.held_out) for errors in (before, after)]
    if judged is not None:
        if len(judged.signals) != len(comparison.signals):
            raise FitError(
                "the recording to be judged on has other channels than the fitted one: give one "
                "with the same channels."
            )
        everywhere = judged.seen | judged.held_out
        held = [judged.rms(errors, everywhere) for errors in judged.errors_of([model, best])]
    return tuple(
        SignalError(
            *(signal.name, signal.unit, signal.channel, signal.floor),
            *(float(errors[k]) for errors in (*seen, *held)),
        )
        for k, signal in enumerate(comparison.signals)
    )


def _fits_ill(judged: Comparison, first: SignalError) -> Iterator[str]:
    """Where standard errors say how well numbers of a wrong model are known."""
    moved = float(judged.rms(judged.measured, judged.held_out | judged.seen)[0])
    left = first.held_out_after
    if left > NO_MODEL * moved:
        yield (
            f"The fitted model misses {left:.3g} {first.unit} of the {first.name}, which is "
            f"{moved:.3g}: it does not describe this recording, whatever the standard errors say. "
            "See that the rig's file is this rig's, and has its gains."
        )
    elif left > WORSE * first.held_out_before:
        yield (
            f"On data that the fit did not see its error grew, from {first.held_out_before:.3g} to "
            f"{left:.3g} {first.unit}: what is wrong with the model is none of these numbers."
        )


def _plain(values: Mapping[str, Any]) -> dict[str, Any]:
    return {
        name: None if isinstance(value, float) and not math.isfinite(value) else value
        for name, value in values.items()
        if name != "name"
    }
