"""A recording judged by a plan: one finding for every limit, and whether all hold."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from servo_bench.check.plan import Bounds, Plan, known_figure
from servo_bench.check.verdict import verdict_of, words_of
from servo_bench.diagnosis.fitting.fit import fit
from servo_bench.errors import ConfigError
from servo_bench.kernels.analysis import Analysis, analyse
from servo_bench.recording.recording import Recording

INTERVAL = 1.96
"""Standard errors in half an interval of 95 %."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One limit and what was found. `value` is None where it is not known, which does not pass.

    `standard_error` is that of a fitted value; `remark` says what a reader should know.
    """

    group: str
    name: str
    value: float | str | None
    allowed: str
    passed: bool
    standard_error: float | None = None
    remark: str = ""

    @property
    def text(self) -> str:
        """The value as people read it."""
        if self.value is None:
            return "not known"
        if isinstance(self.value, str):
            return self.value
        error = "" if self.standard_error is None else f" ± {self.standard_error:.2g}"
        return f"{self.value:.6g}{error}"

    @property
    def sentence(self) -> str:
        """What was found, and what is allowed."""
        remark = f" {self.remark}" if self.remark else ""
        return f"{self.name} is {self.text}; allowed: {self.allowed}.{remark}"

    def numbers(self) -> dict[str, Any]:
        """As plain values."""
        return {
            "group": self.group,
            "name": self.name,
            "value": self.value,
            "standard_error": self.standard_error,
            "allowed": self.allowed,
            "passed": self.passed,
            "remark": self.remark,
        }


@dataclass(frozen=True, slots=True, eq=False)
class Judgement:
    """All findings of a plan on one recording; `analysis` is None where no figure was limited."""

    plan: Plan
    findings: tuple[Finding, ...]
    analysis: Analysis | None
    seconds: float

    @property
    def passed(self) -> bool:
        """Whether every finding passed."""
        return all(finding.passed for finding in self.findings)

    @property
    def sentence(self) -> str:
        """The judgement in one line."""
        failed = [finding.name for finding in self.findings if not finding.passed]
        if failed:
            count = f"{len(failed)} of {len(self.findings)}"
            return f"{self.plan.name}: FAILED {count}: {', '.join(failed)}."
        return f"{self.plan.name}: passed, {len(self.findings)} of {len(self.findings)}."

    def numbers(self) -> dict[str, Any]:
        """As plain values, ready for JSON."""
        return {
            "plan": self.plan.name,
            "passed": self.passed,
            "findings": [finding.numbers() for finding in self.findings],
            "figures": self.analysis.numbers() if self.analysis else None,
        }


def judge(plan: Plan, recording: Recording) -> Judgement:
    """Judge a recording.

    Raises ConfigError for a figure or number that does not exist, and what analysis, fit, or
    diagnosis raise where the recording cannot tell.
    """
    analysis = analyse(recording) if plan.limits else None
    figures = _flat(analysis.numbers()) if analysis else {}
    findings = [
        *(_limited(plan, figures, name, bounds) for name, bounds in plan.limits.items()),
        *_fitted(plan, recording),
        *_diagnosed(plan, recording),
    ]
    seconds = len(recording) * recording.period_s
    return Judgement(plan, tuple(findings), analysis, seconds)


def _limited(plan: Plan, figures: Mapping[str, Any], name: str, bounds: Bounds) -> Finding:
    value = known_figure(plan, figures, name)
    if value is None:
        remark = "The recording does not tell it."
        return Finding("limits", name, None, bounds.text, passed=False, remark=remark)
    if isinstance(value, str | list):
        raise ConfigError(f"plan {plan.name!r} limits {name}, which is no number but {value!r}.")
    number = float(value)
    return Finding("limits", name, number, bounds.text, passed=bounds.hold(number))


def _fitted(plan: Plan, recording: Recording) -> Iterator[Finding]:
    if not plan.fit:
        return
    if recording.rig is None:
        raise ConfigError(f"plan {plan.name!r} has [fit], and the recording does not name its rig.")
    found = fit(recording, recording.rig.model(), list(plan.fit))
    for name, bounds in plan.fit.items():
        estimate = found[name]
        error = estimate.standard_error
        near = [
            end
            for end in (bounds.least, bounds.most)
            if end is not None and abs(estimate.value - end) < INTERVAL * error
        ]
        remark = "The limit lies within its interval of 95 %." if near else ""
        yield Finding(
            group="fit",
            name=name,
            value=estimate.value,
            allowed=bounds.text,
            passed=found.converged and bounds.hold(estimate.value),
            standard_error=error if math.isfinite(error) else None,
            remark=remark if found.converged else found.reason,
        )


def _diagnosed(plan: Plan, recording: Recording) -> Iterator[Finding]:
    if plan.verdict is None:
        return
    words = words_of(verdict_of([recording]))
    yield Finding(
        group="verdict",
        name="verdict",
        value=", ".join(words),
        allowed=" or ".join(plan.verdict.allowed),
        passed=set(words) <= set(plan.verdict.allowed),
    )


def _flat(table: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in table.items():
        nested = isinstance(value, Mapping)
        flat |= _flat(value, f"{prefix}{key}.") if nested else {f"{prefix}{key}": value}
    return flat
