"""What an answer is worth, now that the seal is open. A function of values; opens nothing itself.

Each named cause is one of

    right       in the class of a hidden cause (`names.right_names`)
    companion   stands for what the hidden cause needs beside it
    nuisance    something that every rig of the truth has, no larger than it is there
    wrong

Top-1: the first name that is neither companion nor nuisance. A trial is right where

    one             the top-1 is right
    pair            each of the two is named
    none            the verdict is "none"
    outside, removed   the verdict is "unknown"

In the ambiguity set: a right name is among the causes or what they say they are confused with.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal

from servo_bench.diagnosis.judging.verdict import Cause, Verdict
from tests.trials import nuisances as always
from tests.trials.drawing import Question
from tests.trials.names import companions, own_names, right_names
from tests.trials.parameters import Known, true_value
from tests.truth.hidden import HiddenTruth
from tests.truth.nuisances import scattered

Worth = Literal["right", "companion", "nuisance", "wrong"]


@dataclass(frozen=True, slots=True)
class Named:
    """One named cause, judged."""

    effect: str
    confidence: float
    worth: Worth


@dataclass(frozen=True, slots=True)
class Measured:
    """A parameter beside what it should be."""

    cause: str
    effect: str
    parameter: str
    value: float
    true: float
    relative_error: float
    covered: bool


@dataclass(frozen=True, slots=True)
class Gain:
    """The held-out error, as the verdict says it; `forced` is of the true cause fitted instead."""

    before: float
    after: float
    noise_floor: float
    share_explained: float
    forced: float | None = None


@dataclass(frozen=True, slots=True)
class Score:
    """A trial's result."""

    verdict: str
    top: str
    right: bool
    in_set: bool
    spurious: int
    found: int
    named: tuple[Named, ...]
    measured: tuple[Measured, ...]
    gain: Gain | None

    def numbers(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self)


def score(
    question: Question, truth: HiddenTruth, verdict: Verdict | None, forced: float | None = None
) -> Score:
    """Judge a verdict; None, a failed diagnosis, is wrong about everything."""
    if verdict is None:
        return Score("failed", "failed", False, False, 0, 0, (), (), None)
    classes = accepted(question, truth)
    named = tuple(_judged(cause, question, truth) for cause in verdict.causes)
    top = next((n for n in named if n.worth in {"right", "wrong"}), None)
    claimed = set(verdict.names)
    wide = claimed.union(*(cause.ambiguous_with for cause in verdict.causes))
    found = sum(not names.isdisjoint(claimed) for names in classes)
    return Score(
        verdict=verdict.verdict,
        top=top.effect if top else named[0].effect if named else verdict.verdict,
        right=_is_right(question, verdict, top, found, len(classes)),
        in_set=bool(classes) and all(not names.isdisjoint(wide) for names in classes),
        spurious=sum(n.worth == "wrong" for n in named),
        found=found,
        named=named,
        measured=tuple(_measured(question, truth, verdict)),
        gain=_gain(verdict, forced),
    )


def accepted(question: Question, truth: HiddenTruth) -> tuple[frozenset[str], ...]:
    """For each hidden cause the names that are right; none where no name can be."""
    if question.kind not in {"one", "pair"}:
        return ()
    return tuple(right_names(cause, question.channels) for cause in truth.causes)


def _is_right(
    question: Question, verdict: Verdict, top: Named | None, found: int, hidden: int
) -> bool:
    if question.kind == "one":
        return top is not None and top.worth == "right"
    if question.kind == "pair":
        return found == hidden
    return verdict.verdict == ("none" if question.kind == "none" else "unknown")


def _judged(cause: Cause, question: Question, truth: HiddenTruth) -> Named:
    worth: Worth = "wrong"
    if any(cause.effect in names for names in accepted(question, truth)):
        worth = "right"
    elif question.kind != "removed" and cause.effect in companions(truth, question.channels):
        worth = "companion"
    elif always.is_there(cause.effect, _values(cause)):
        worth = "nuisance"
    return Named(cause.effect, cause.confidence, worth)


def _values(cause: Cause) -> dict[str, float]:
    return {name: quantity.value for name, quantity in cause.parameters.items()}


def _measured(question: Question, truth: HiddenTruth, verdict: Verdict) -> Iterator[Measured]:
    """Parameters of the named causes that have a counterpart in the truth."""
    if question.kind not in {"one", "pair"}:
        return
    velocity_rad_s = question.plan.velocity_rad_s
    strengths = truth.strengths(question.nominal, velocity_rad_s)
    fields = truth.effects(question.nominal, velocity_rad_s)._asdict()
    for cause in verdict.causes:
        for hidden, strength in strengths.items():
            known = Known(
                scattered(truth.noise_seed),
                question.nominal.inertia_kg_m2,
                question.seconds,
                {**verdict.effects.get(cause.effect, {}), **_values(cause)},
                fields,
            )
            compared = true_value(hidden, strength, cause.effect, known)
            if compared is not None and compared[0] in cause.parameters:
                yield _compared(hidden, cause, *compared)


def _compared(hidden: str, cause: Cause, parameter: str, true: float) -> Measured:
    quantity = cause.parameters[parameter]
    low, high = quantity.ci95
    relative = abs(quantity.value - true) / abs(true) if true else math.inf
    return Measured(
        hidden, cause.effect, parameter, quantity.value, true, relative, low <= true <= high
    )


def _gain(verdict: Verdict, forced: float | None) -> Gain | None:
    error = verdict.error
    if error is None:
        return None
    return Gain(error.before, error.after, error.noise_floor, error.share_explained, forced)


def own_effect(truth: HiddenTruth) -> tuple[str, ...]:
    """The effects that describe the truth itself, for a fit of the true model."""
    return tuple(sorted(name for cause in truth.causes for name in own_names(cause)))


def hidden_numbers(question: Question, truth: HiddenTruth) -> Mapping[str, Any]:
    """What was hidden, for JSON."""
    return {
        "causes": list(truth.causes),
        "sizes": {drawn.name: drawn.size for drawn in truth.drawn},
        "fields": {drawn.name: dict(drawn.fields) for drawn in truth.drawn},
        "strengths": truth.strengths(question.nominal, question.plan.velocity_rad_s),
    }
