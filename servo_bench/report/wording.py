"""Numbers as people read them: degrees, percent, microseconds. SI stays in the JSON."""

import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from servo_bench.recording.recording import Event

NOT_KNOWN = "not known"
DEG = 180.0 / math.pi
CEILING_SHOWN = 99.99
SHOWN_UNITS: tuple[tuple[str, str, float], ...] = (
    ("_nm_per_a", "N m/A", 1.0),
    ("_kg_m2", "kg m²", 1.0),
    ("_a_s_per_rad", "A s/rad", 1.0),
    ("_a_per_rad", "A/rad", 1.0),
    ("_rad_s", "deg/s", DEG),
    ("_rad", "deg", DEG),
    ("_nm", "N m", 1.0),
    ("_s", "s", 1.0),
)
"""Ending of a name, the unit it is shown in, and the factor to it; the first that fits."""


@dataclass(frozen=True, slots=True)
class Row:
    """One line of a table: a name, its value as text, and the unit, where it has one."""

    name: str
    value: str
    unit: str = ""


def percent(value: float | None, digits: int = 2) -> str:
    """A percentage with its sign, or that it is not known."""
    return NOT_KNOWN if value is None or not math.isfinite(value) else f"{value:.{digits}f} %"


def small_percent(value: float) -> str:
    """A percentage that may be tiny: three significant digits, never a power of ten."""
    if not math.isfinite(value):
        return NOT_KNOWN
    digits = 2 if value == 0.0 else max(2, 2 - math.floor(math.log10(abs(value))))
    return f"{value:.{min(digits, 9)}f} %"


def ceiling(value: float) -> str:
    """The noise ceiling, where all digits may be nines."""
    return f"above {CEILING_SHOWN} %" if value > CEILING_SHOWN else percent(value)


def quantity(value: float | None, factor: float, unit: str, digits: int = 3) -> str:
    """An SI value in a reader's unit with so many significant digits."""
    if value is None or not math.isfinite(value):
        return NOT_KNOWN
    return f"{value * factor:.{digits}g} {unit}"


def settings(table: Mapping[str, Any], prefix: str = "") -> list[Row]:
    """A nested configuration as rows, in readers' units; a nested name is written with a dot."""
    rows: list[Row] = []
    for key, value in table.items():
        if isinstance(value, Mapping):
            rows += settings(value, f"{prefix}{key}.")
        else:
            rows.append(_setting(prefix + str(key), value))
    return rows


def numbers(table: Mapping[str, Any], prefix: str = "") -> list[Row]:
    """Figures as they are in the JSON, digit for digit, in SI."""
    rows: list[Row] = []
    for key, value in table.items():
        if isinstance(value, Mapping):
            rows += numbers(value, f"{prefix}{key}.")
        else:
            rows.append(Row(prefix + str(key), json.dumps(value, ensure_ascii=False)))
    return rows


def event_rows(events: Iterable[Event], start_ns: int) -> list[tuple[str, str, str, str]]:
    """Each event's time after `start_ns`, its kind, its text, and its data as JSON."""
    return [
        (
            f"{round((event.time_ns - start_ns) / 1e9, 3) + 0.0:.3f}",
            event.kind,
            event.text,
            json.dumps(dict(event.data), ensure_ascii=False, default=str) if event.data else "",
        )
        for event in events
    ]


def _setting(name: str, value: Any) -> Row:
    ending, unit, factor = next(
        (shown for shown in SHOWN_UNITS if name.endswith(shown[0])), ("", "", 1.0)
    )
    shown = name.removesuffix(ending)
    match value:
        case bool():
            return Row(name, str(value).lower())
        case int() | float() if unit:
            return Row(shown, f"{value * factor:.6g}", unit)
        case float():
            return Row(name, f"{value:.10g}")
        case None:
            return Row(shown, "none")
        case _:
            return Row(name, str(value))
