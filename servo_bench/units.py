"""SI inside; degrees and rpm only where people read and write.

A configuration key may end in a reader's unit (`backlash_gap_deg`, `amplitude_rpm`); `to_si`
renames it to the field's own (`backlash_gap_rad`, `amplitude_rad_s`) and scales the value, or
each of a list (`amplitudes_deg_s = [30, 60]`).
"""

import math
from collections.abc import Mapping
from typing import Any

READER_UNITS: dict[str, tuple[str, float]] = {
    "_deg_s": ("_rad_s", math.pi / 180.0),
    "_deg": ("_rad", math.pi / 180.0),
    "_rpm": ("_rad_s", 2.0 * math.pi / 60.0),
    "_mnm": ("_nm", 1e-3),
    "_ms": ("_s", 1e-3),
}


def to_si(table: Mapping[str, Any]) -> dict[str, Any]:
    """Rename and scale every key of `table` that ends in a reader's unit.

    Raises ValueError when a quantity is given twice, once in each unit, or as text.
    """
    converted: dict[str, Any] = {}
    for key, value in table.items():
        name, number = _si(key, value)
        if name in converted or (name != key and name in table):
            raise ValueError(f"{name} is given twice, once as {key}: give it once")
        converted[name] = number
    return converted


def spellings(key: str) -> tuple[str, ...]:
    """A field's name, and how readers may write it in their units."""
    others = (
        key.removesuffix(si_suffix) + suffix
        for suffix, (si_suffix, _) in READER_UNITS.items()
        if key.endswith(si_suffix) and not (si_suffix == "_s" and key.endswith("_rad_s"))
    )
    return key, *others


def _si(key: str, value: Any) -> tuple[str, Any]:
    for suffix, (si_suffix, factor) in READER_UNITS.items():
        if key.endswith(suffix):
            scaled = _scaled(value, factor)
            if scaled is None and isinstance(value, str | bool):
                raise ValueError(f"{key} = {value!r}: give a number, without quotation marks")
            return (
                (key, value) if scaled is None else (key.removesuffix(suffix) + si_suffix, scaled)
            )
    return key, value


def _scaled(value: Any, factor: float) -> Any:
    """A number, or a list of them (of lists ...), times `factor`; None where anything is no number.

    An empty list counts as one of numbers: what is wrong with it is said under the field's name.
    """
    if isinstance(value, list | tuple):
        scaled = [_scaled(item, factor) for item in value]
        return None if None in scaled else scaled
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    return value * factor
