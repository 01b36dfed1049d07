"""The analysis of today beside the figures of then: what has changed, and why.

A figure may differ because the recording is another one, because the analysis was asked otherwise
(memory, polynomial), or because the code is another version. The three are told apart: figures of
the run itself need no analysis, and the stored memory and polynomial are tried with today's code.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from servo_bench import __version__
from servo_bench.errors import BenchError, RecordingError
from servo_bench.kernels.analysis import analyse
from servo_bench.recording.recording import Recording

ROUNDING = 1e-6
"""Relative: what another processor or library may round otherwise."""
OPTIONS = ("memory", "polynomial")
VERSION_KEY = "servo_bench"
OTHERS = frozenset(
    {"estimators", "against_grey_box", "grey_box", "lags_s", "c1_rad_s", "c2_rad_s", VERSION_KEY}
)
"""What stands beside the analysis' own figures: other estimators', the curves, the version."""


@dataclass(frozen=True, slots=True)
class FigureChange:
    """One figure by its dotted name; None on a side that does not have it."""

    name: str
    then: Any
    now: Any


@dataclass(frozen=True, slots=True)
class Reanalysis:
    """Figures of today, and against stored ones what has changed and why."""

    numbers_now: Mapping[str, Any]
    changes: tuple[FigureChange, ...]
    compared: int
    reasons: tuple[str, ...]

    def numbers(self) -> dict[str, Any]:
        """As plain values, ready for JSON."""
        return {
            "compared": self.compared,
            "changed": {change.name: [change.then, change.now] for change in self.changes},
            "reasons": list(self.reasons),
            "figures": dict(self.numbers_now),
            VERSION_KEY: __version__,
        }


def reanalyse(recording: Recording, then: Mapping[str, Any]) -> Reanalysis:
    """Analyse with today's code and compare with the stored figures `then`.

    RecordingError where `then` are no figures of an analysis; errors of `analyse` as they are.
    """
    stored = _flat(then)
    if "memory" not in stored or "polynomial" not in stored:
        raise RecordingError(
            "the stored figures are not those of an analysis: they have no memory and polynomial. "
            "Give what servo-bench analyse --json wrote."
        )
    now = analyse(recording).numbers()
    changes, compared = _changes(stored, _flat(now))
    return Reanalysis(
        numbers_now=now,
        changes=changes,
        compared=compared,
        reasons=tuple(_reasons(recording, stored, now, changes)),
    )


def _changes(
    then: Mapping[str, Any], now: Mapping[str, Any]
) -> tuple[tuple[FigureChange, ...], int]:
    every = dict.fromkeys((*then, *now))
    names = [name for name in every if name.partition(".")[0] not in OTHERS]
    changed = [
        FigureChange(name, then.get(name), now.get(name))
        for name in names
        if not _same(then.get(name), now.get(name))
    ]
    return tuple(changed), len(names)


def _same(then: Any, now: Any) -> bool:
    numbers = [v for v in (then, now) if isinstance(v, int | float) and not isinstance(v, bool)]
    if len(numbers) == 2:
        return math.isclose(then, now, rel_tol=ROUNDING, abs_tol=1e-12)
    return bool(then == now)


def _reasons(
    recording: Recording,
    then: Mapping[str, Any],
    now: Mapping[str, Any],
    changes: tuple[FigureChange, ...],
) -> Iterator[str]:
    if not changes:
        yield "Every figure is as it was."
        return
    if any(change.name in ("run.slots", "run.missed_slots") for change in changes):
        yield (
            "The run itself counts other slots than then: the figures are another recording's, or "
            "the file has changed since."
        )
        return
    other = [name for name in OPTIONS if then[name] != now[name]]
    if other:
        told = ", ".join(f"{name} {then[name]} (now {now[name]})" for name in other)
        yield f"They were made with {told}, which explains {_explained(recording, then)}."
        return
    yield from _by_version(recording, then)


def _explained(recording: Recording, then: Mapping[str, Any]) -> str:
    """What is left to explain with the memory and polynomial of then."""
    try:
        memory, polynomial = int(then["memory"]), str(then["polynomial"])
        again = analyse(recording, memory=memory, polynomial=polynomial).numbers()
    except (BenchError, ValueError) as error:
        return f"an unknown part: today's analysis refuses them ({error})"
    left, _ = _changes(then, _flat(again))
    if not left:
        return "everything: asked so, today's code gives the stored figures"
    return f"a part: asked so, {', '.join(change.name for change in left)} still differ"


def _by_version(recording: Recording, then: Mapping[str, Any]) -> Iterator[str]:
    analysed = then.get(VERSION_KEY)
    recorded = recording.provenance.get("servo_bench")
    if analysed is not None and analysed != __version__:
        yield f"They were made with servo-bench {analysed}, and this is {__version__}."
    elif analysed is None and recorded is not None and recorded != __version__:
        yield (
            f"The figures do not say which version made them. The run was recorded with "
            f"servo-bench {recorded}, and this is {__version__}: see CHANGELOG.md."
        )
    else:
        yield (
            f"Recording, memory, polynomial, and version ({__version__}) are the same: the code "
            "between two releases has changed, or a library under it."
        )


def _flat(table: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in table.items():
        nested = isinstance(value, Mapping)
        flat |= _flat(value, f"{prefix}{key}.") if nested else {f"{prefix}{key}": value}
    return flat
