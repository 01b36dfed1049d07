"""Which numbers of a model are free in a fit: by what name, how far, and in steps of what size.

    K_T, J, K_P, K_I, gap     nominal values, or by their field names (`inertia_kg_m2`)
    cogging.torque_nm         any parameter of any effect

A spread is one standard deviation of what is believed before the recording is seen:

    nominal values            10 % of the value; the gap 10 %, and never below 1 mrad
    LogUniform(low, high)     sqrt(low high): the middle of its range
    Uniform(low, high)        (high - low)/sqrt(12)
    Known(low, high)          a quarter of the value
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from servo_bench.errors import ConfigError, gathered
from sim_rig.effects import catalogue, find_effect
from sim_rig.effects.effect import Effect, Prior
from sim_rig.model import Model

SYMBOLS = {
    "K_T": "torque_constant_nm_per_a",
    "J": "inertia_kg_m2",
    "K_P": "proportional_gain_a_s_per_rad",
    "K_I": "integral_gain_a_per_rad",
    "gap": "backlash_gap_rad",
}
NOMINAL_SPREAD = 0.1
NOMINAL_FACTOR = 10.0
"""A nominal value is sought between a tenth and ten times of what the data sheet says."""
LARGEST_GAP_RAD = math.radians(20.0)
SMALLEST_GAP_SPREAD_RAD = 1e-3
TURN = 2.0 * math.pi
UNITS = {
    **{"_nm": "N m", "_rad": "rad", "_rad_s": "rad/s", "_s": "s", "_a": "A", "_v": "V"},
    **{"_kg_m2": "kg m2", "_hz": "Hz", "_k": "K", "_m": "m", "_per_s": "1/s"},
    **{"_per_a": "1/A", "_per_a2": "1/A2", "_per_k": "1/K", "_per_rad": "1/rad"},
    **{"_nm_per_a": "N m/A", "_a_s_per_rad": "A s/rad", "_a_per_rad": "A/rad"},
    **{"_nm_s_per_rad": "N m s/rad", "_rad_per_nm": "rad/(N m)", "_nm_per_rad": "N m/rad"},
    **{"_s_per_rad": "s/rad", "_s2_per_rad": "s2/rad", "_nm_s2_per_rad2": "N m s2/rad2"},
    **{"_per_nm": "1/(N m)", "_s_per_m": "s/m"},
}
"""What a name ends in, and the unit for people; every suffix of `sim_rig.effects.units`."""


@dataclass(frozen=True, slots=True)
class FreeParameter:
    """One free number. `symbol` is what people call it; `low` and `high` bound the search."""

    symbol: str
    unit: str
    effect: str | None
    field: str
    low: float
    high: float
    spread: float
    centre: float
    logarithmic: bool = False
    circular: bool = False

    @property
    def name(self) -> str:
        """`inertia_kg_m2`, or `cogging.torque_nm`."""
        return f"{self.effect}.{self.field}" if self.effect else self.field

    @property
    def is_strength(self) -> bool:
        """Whether zero means that there is none of it."""
        if self.effect is None:
            return self.field == "backlash_gap_rad"
        return self.field in find_effect(self.effect).strengths

    def of(self, model: Model) -> float:
        """Its value in a model."""
        return _value(model, self.effect, self.field)

    def put(self, model: Model, value: float) -> Model:
        """The model with another value. Raises the model's own errors where it has no meaning."""
        if self.effect is None:
            return replace(model, nominal=replace(model.nominal, **{self.field: value}))
        params = model.effects.get(self.effect, find_effect(self.effect).params())
        changed = params._replace(**{self.field: value})
        return replace(model, effects={**model.effects, self.effect: changed})

    def surprise(self, value: float) -> float:
        """How many standard deviations from what was believed before."""
        if not self.logarithmic:
            return (value - self.centre) / self.spread
        # Between the ends the logarithm counts; zero, which is "none", lies one range below.
        low, high = self.centre**2 / self.high, self.high
        deviation = math.log(high / low) / math.sqrt(12.0)
        return math.log(max(value + low, low) / self.centre) / deviation


def free_parameters(model: Model, names: Sequence[str]) -> tuple[FreeParameter, ...]:
    """The named numbers of `model`.

    Raises ConfigError for a name that does not exist, is given twice, or can change nothing.
    """
    if not names:
        raise ConfigError(f"nothing is free: name what to fit, such as {_examples()}.")
    found = tuple(_one(model, name.strip()) for name in names)
    unique = {parameter.name for parameter in found}
    if len(unique) < len(found):
        raise ConfigError(f"{', '.join(names)}: each number can be free once; name it once.")
    for parameter in found:
        _check_acts(parameter, model, unique)
    return found


def _value(model: Model, effect: str | None, field: str) -> float:
    if effect is None:
        return float(getattr(model.nominal, field))
    params = model.effects.get(effect, find_effect(effect).params())
    return float(getattr(params, field))


def _one(model: Model, name: str) -> FreeParameter:
    if "." in name:
        return _of_effect(model, *name.split(".", 1))
    field = SYMBOLS.get(name, name)
    symbols = {field: symbol for symbol, field in SYMBOLS.items()}
    if field not in symbols:
        effects = ", ".join(catalogue())
        raise ConfigError(
            f"{name!r} cannot be free: there is no such value. Choose from {', '.join(SYMBOLS)} "
            f"({', '.join(symbols)}), or EFFECT.PARAMETER of {effects}."
        )
    value = _value(model, None, field)
    low, high, spread = value / NOMINAL_FACTOR, value * NOMINAL_FACTOR, NOMINAL_SPREAD * value
    if field == "backlash_gap_rad":
        low, high = 0.0, max(LARGEST_GAP_RAD, high)
        spread = max(spread, SMALLEST_GAP_SPREAD_RAD)
    return FreeParameter(symbols[field], unit_of(field), None, field, low, high, spread, value)


def _of_effect(model: Model, effect_name: str, field: str) -> FreeParameter:
    with gathered():
        effect = find_effect(effect_name)
    priors = {parameter.name: parameter.prior for parameter in effect.parameters}
    prior = priors.get(field)
    if prior is None:
        raise ConfigError(
            f"{effect_name} has no parameter {field!r}: it has {', '.join(priors)}. "
            f"Free {effect_name}.{effect.strengths[0]}, say."
        )
    low, high, centre, spread = _range(prior, _value(model, effect_name, field))
    if field.endswith("seed") or not math.isfinite(spread):
        raise ConfigError(
            f"{effect_name}.{field} cannot be free: it is no quantity with a usual range. "
            f"Set it in the model, and free one of {', '.join(effect.strengths)}."
        )
    circular = field.endswith("phase_rad") and math.isclose(prior.high - prior.low, TURN)
    if circular:
        low, high = -math.inf, math.inf
    return FreeParameter(
        symbol=f"{effect_name}.{field}",
        unit=unit_of(field),
        effect=effect_name,
        field=field,
        low=low,
        high=high,
        spread=spread,
        centre=centre,
        logarithmic=_is_magnitude(prior),
        circular=circular,
    )


def _is_magnitude(prior: Prior) -> bool:
    return prior.least == 0.0 < prior.low


def _range(prior: Prior, value: float) -> tuple[float, float, float, float]:
    """(low, high, centre, spread); a value that stands outside the usual range widens it."""
    if _is_magnitude(prior):
        middle = math.sqrt(prior.low * prior.high)
        return 0.0, max(prior.high, value), middle, max(middle, 0.25 * value)
    low, high = min(prior.low, value), max(prior.high, value)
    if prior.above > -math.inf:
        return low, high, value, 0.25 * abs(value)
    return low, high, 0.5 * (prior.low + prior.high), (prior.high - prior.low) / math.sqrt(12.0)


def _check_acts(parameter: FreeParameter, model: Model, free: set[str]) -> None:
    """A phase or a velocity of an effect that is off, and stays off, changes nothing."""
    if parameter.effect is None or parameter.is_strength:
        return
    effect = find_effect(parameter.effect)
    params = model.effects.get(parameter.effect, effect.params())
    strengths = {f"{effect.name}.{name}" for name in effect.strengths}
    if effect.is_off(params) and not strengths & free:
        raise ConfigError(
            f"{parameter.name} changes nothing while {effect.name} is off: free one of "
            f"{', '.join(sorted(strengths))} too, or set it in the model."
        )


def strength_beside(parameter: FreeParameter, effect: Effect) -> str:
    """The strength that a phase belongs to: the one with the same beginning, else the first."""
    prefix = parameter.field.removesuffix("phase_rad")
    beside = (name for name in effect.strengths if prefix and name.startswith(prefix))
    return next(beside, effect.strengths[0])


def unit_of(name: str) -> str:
    """The unit that a name ends in, for people: `kg m2`, `N m/A`; "1" for a pure number."""
    known = sorted((suffix for suffix in UNITS if name.endswith(suffix)), key=len)
    return UNITS[known[-1]] if known else "1"


def _examples() -> str:
    return "J,K_P,K_I,gap,coulomb.torque_nm"
