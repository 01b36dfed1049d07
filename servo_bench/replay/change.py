"""A number before and after, its standard error, and whether chance explains the difference."""

import math
from typing import Any, NamedTuple

from scipy.stats import norm

from servo_bench.report.wording import DEG
from sim_rig.effects.units import SUFFIXES

ALPHA = 1e-4
"""The chance of crying change on two runs of the same rig, over all tests of a comparison."""


class Change(NamedTuple):
    """One number of run a and of run b; `standard_error` is that of the difference.

    `p_value` is the chance of a difference so large where nothing changed; `where` says in which
    block of the rig the number lies.
    """

    name: str
    symbol: str
    unit: str
    where: str
    a: float
    b: float
    standard_error: float
    p_value: float

    @property
    def label(self) -> str:
        """The symbol as words: `coulomb.torque_nm` as "coulomb torque"."""
        if "." not in self.symbol:
            return self.symbol
        suffix = max((end for end in SUFFIXES if self.symbol.endswith(end)), key=len, default="")
        stem = self.symbol.removesuffix(suffix) if suffix.startswith("_") else self.symbol
        return stem.replace(".", " ").replace("_", " ")

    @property
    def shown(self) -> tuple[float, str]:
        """Factor and unit in which people read it: angles in degrees."""
        if self.unit == "rad":
            return DEG, "deg"
        return 1.0, self.unit.replace("m2", "m²")

    @property
    def difference(self) -> float:
        """b less a."""
        return self.b - self.a

    @property
    def share(self) -> float:
        """The difference over a; NaN where a is zero."""
        return self.difference / self.a if self.a else math.nan

    @property
    def is_known(self) -> bool:
        """Whether a is more than its own uncertainty, so that a share of it means something."""
        return abs(self.a) > 3.0 * self.standard_error

    def interval(self) -> tuple[float, float]:
        """The difference's interval of 95 %."""
        half = 1.959963984540054 * self.standard_error
        return self.difference - half, self.difference + half

    def numbers(self, changed: bool) -> dict[str, Any]:
        """As plain values, None for what is not known."""
        low, high = self.interval()
        table = {
            **self._asdict(),
            "label": self.label,
            "difference": self.difference,
            "share": self.share,
            "interval_low": low,
            "interval_high": high,
        }
        return {**{name: finite(value) for name, value in table.items()}, "changed": changed}


def two_sided(difference: float, standard_error: float) -> float:
    """The p-value of a normal difference; 1 where its error is not known."""
    if not (math.isfinite(difference) and math.isfinite(standard_error)):
        return 1.0
    if standard_error <= 0.0:
        return 1.0 if difference == 0.0 else 0.0
    return float(2.0 * norm.sf(abs(difference) / standard_error))


def finite(value: Any) -> Any:
    """None for a float that JSON cannot hold."""
    return None if isinstance(value, float) and not math.isfinite(value) else value
