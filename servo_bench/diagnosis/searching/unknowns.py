"""What is sought in a fit, and what is believed of it before.

Some numbers of every rig are a little wrong, and no cause worth naming: the nuisances. Each may
move within a band about zero, sized by the rig itself (tau: a tenth of its rated torque; omega:
3 rad/s), and is freed in every fit:

    coulomb                 0 .. 4 % of tau            current_loop_lag      0 .. 0.1 ms
    viscous                 0 .. 0.5 % of tau/omega    velocity_filter_lag   0 .. 0.25 ms
    torque_constant_error   -0.5 .. 0.5 %   transport_delay       0 .. 0.13 ms
    inertia_error           -0.5 .. 0.5 %   backlash_width        -1 .. 1 mrad, 5 %
    proportional_gain_error -0.1 .. 0.1 ms of K_I/K_P

A drive sums its velocity error once a period T. Where the newest one counts in full, its integral
is ahead of the continuous one by T/2 of that, which is a K_P that is larger by K_I T/2 (backward
Euler; forward, smaller).

A cause of the same name is one that leaves its band; a gap's error may be one within it (`gap`).
Where a rig's file has an effect already, its band is about that (`about`).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from servo_bench.diagnosis.fitting.free import FreeParameter, free_parameters
from sim_rig.effects import find_effect
from sim_rig.model import Model

MASS = "load_inertia_kg_m2"
USUAL_SHARE, LEAST_SHARE = 0.2, 4e-4
"""Of the inertia, behind the gap or the coupling."""
STIFFEST, FACE, USUAL_INERTIA_KG_M2 = 0.25, ("contact", "compliance_rad_per_nm"), 2.5e-4
"""Of the smallest compliance of a face on a rig of a hundred watts: one that is stiffer throws the
load no other way, and every step of its simulation becomes shorter."""
USUAL_RAD_S = 3.0
"""Speed to which the torque of viscous friction is told."""
WIDE = 30.0
"""So many times the size that is tried is sought, at most, of what has no bound of its own."""

MOST_DELAY_S, FINE_DELAY_S = 1.3e-4, 1e-5
HALF_PERIOD_S = 1e-4
"""Of the slowest usual velocity loop of a drive."""


@dataclass(frozen=True, slots=True)
class Unknown:
    """One number that is sought between `low` and `high`, in steps of `step`.

    `centre` and `deviation` are what is believed; an infinite deviation believes nothing.
    What changes nearly the same as another number `carries` that one: putting it takes `share` of
    the change off there, so that the two can be sought apart (see `seeking`); or, where they are
    known by their ratio, changes that one `in_proportion`. Several are told with spaces between.
    """

    effect: str
    field: str
    low: float
    high: float
    step: float
    centre: float = 0.0
    deviation: float = np.inf
    circular: bool = False
    carries: str = ""
    share: float = 0.0
    in_proportion: bool = False

    @property
    def name(self) -> str:
        """`cogging.torque_nm`."""
        return f"{self.effect}.{self.field}"

    def of(self, model: Model) -> float:
        """Its value there."""
        return _value(model.effects, self.name)

    def put(self, model: Model, value: float) -> Model:
        """The model with another value."""
        return put_all(model, (self,), (value,))

    @property
    def carried(self) -> tuple[str, ...]:
        """Names of the numbers that go along."""
        return tuple(self.carries.split())

    def share_of(self, carried: str, model: Model) -> float:
        """How much of a change is taken off there."""
        return self._share_of(carried, model.effects)

    def into(self, effects: dict[str, Any], value: float) -> None:
        """Put it among parameters by effect; nothing is checked before they make a model."""
        change = value - _value(effects, self.name)
        for carried in self.carried:
            effect, field = carried.split(".")
            if self.in_proportion and effect not in effects:
                continue
            left = _value(effects, carried) - self._share_of(carried, effects) * change
            _put(effects, effect, field, left if self.in_proportion else max(left, 0.0))
        _put(effects, self.effect, self.field, value)

    def _share_of(self, carried: str, effects: Mapping[str, Any]) -> float:
        own = _value(effects, self.name)
        if not self.in_proportion or own == 0.0:
            return self.share
        return -_value(effects, carried) / own


def _value(effects: Mapping[str, Any], name: str) -> float:
    effect, field = name.split(".")
    return float(getattr(_params(effects, effect), field))


def _put(effects: dict[str, Any], effect: str, field: str, value: float) -> None:
    effects[effect] = _params(effects, effect)._replace(**{field: value})


def _params(effects: Mapping[str, Any], effect: str) -> Any:
    return effects[effect] if effect in effects else find_effect(effect).params()


def nuisances(
    rig_torque_nm: float, gap_rad: float, integral_per_s: float = 0.0
) -> tuple[Unknown, ...]:
    """The bands of every rig with such a torque, gap, and K_I/K_P."""
    torque = 0.04 * rig_torque_nm
    damping = 0.005 * rig_torque_nm / USUAL_RAD_S
    gap = min(1e-3, 0.05 * gap_rad)
    gain = HALF_PERIOD_S * integral_per_s
    bands = (
        ("coulomb", "torque_nm", 0.0, torque),
        ("viscous", "damping_nm_s_per_rad", 0.0, damping),
        ("current_loop_lag", "lag_s", 0.0, 1e-4),
        ("velocity_filter_lag", "lag_s", 0.0, 2.5e-4),
        ("transport_delay", "delay_s", 0.0, MOST_DELAY_S),
        ("torque_constant_error", "error_fraction", -0.005, 0.005),
        ("inertia_error", "error_fraction", -0.005, 0.005),
        *((("backlash_width", "change_rad", -gap, gap),) if gap > 0.0 else ()),
        *((("proportional_gain_error", "error_fraction", -gain, gain),) if gain > 0.0 else ()),
    )
    return tuple(_band(*band) for band in bands)


def about(band: Sequence[Unknown], model: Model) -> tuple[Unknown, ...]:
    """The bands about what a rig's file has already: as far to both sides of that."""
    return tuple(_about(unknown, unknown.of(model)) for unknown in band)


def _about(unknown: Unknown, believed: float) -> Unknown:
    if believed == 0.0:
        return unknown
    low, high = believed - unknown.high, believed + unknown.high
    least = -np.inf if unknown.low < 0.0 else 0.0
    return replace(unknown, low=max(low, least), high=high, centre=believed)


def delay_that_is_crossed() -> Unknown:
    """The delay's band in fine steps: its ratio to a clock's skew is when that uses it up."""
    return replace(_band("transport_delay", "delay_s", 0.0, MOST_DELAY_S), step=FINE_DELAY_S)


def _band(effect: str, field: str, low: float, high: float) -> Unknown:
    return Unknown(
        effect,
        field,
        low,
        high,
        step=0.5 * high,
        centre=0.5 * (low + high),
        deviation=high if low < 0.0 else 0.5 * high,
    )


def widened(effect: str, fields: Sequence[str], model: Model, size: float) -> tuple[Unknown, ...]:
    """These parameters of an effect, free over all that has a meaning.

    `size`, that of the strength on this rig, sets the steps, and widens a range that was written
    for a rig of a hundred watts.
    """
    found = free_parameters(_on(model, effect), [f"{effect}.{field}" for field in fields])
    inertia = model.nominal.inertia_kg_m2
    return tuple(_wide(p, effect, size, inertia) for p in found)


def _on(model: Model, effect: str) -> Model:
    """The model with the effect's sample, so that every parameter acts."""
    sample = dict(find_effect(effect).sample)
    params = find_effect(effect).params(**sample)._asdict()
    if MASS in params:
        sample[MASS] = min(float(params[MASS]), USUAL_SHARE * model.nominal.inertia_kg_m2)
    return model.with_effect(effect, **sample)


def _wide(parameter: FreeParameter, effect: str, size: float, inertia: float) -> Unknown:
    field = parameter.field
    if parameter.circular:
        return Unknown(effect, field, -np.inf, np.inf, step=0.5, circular=True)
    prior = next(p.prior for p in find_effect(effect).parameters if p.name == field)
    own = WIDE * abs(size) if parameter.is_strength else 0.0
    low = max(prior.least, 0.0) if prior.least >= 0.0 else -max(10.0 * abs(prior.low), own)
    high = min(prior.most, max(10.0 * prior.high, own))
    if (effect, field) == FACE:
        low = STIFFEST * prior.low * USUAL_INERTIA_KG_M2 / inertia
    if field == MASS:
        low, high = LEAST_SHARE * inertia, inertia
    elif prior.above > -np.inf:
        low, high = max(0.2 * prior.low, prior.above), min(prior.most, 1.5 * prior.high)
    step = 0.3 * size if parameter.is_strength else 0.3 * parameter.centre
    step = abs(step) or 0.1 * (prior.high - prior.low)
    return Unknown(effect, field, max(low, prior.least), high, step=step)


def put_all(model: Model, unknowns: Sequence[Unknown], values: Sequence[float]) -> Model:
    """The model with all of them, one after another: one that carries others moves those.

    Raises EffectError where the end has no meaning; on the way there it need not have one.
    """
    effects = dict(model.effects)
    for unknown, value in zip(unknowns, values, strict=True):
        unknown.into(effects, float(value))
    return replace(model, effects=effects)


def at_centres(model: Model, unknowns: Sequence[Unknown]) -> Model:
    """The model with all of them in the middle of what is believed."""
    return put_all(model, unknowns, [u.centre for u in unknowns])


def merged(old: Sequence[Unknown], new: Sequence[Unknown]) -> tuple[Unknown, ...]:
    """The old ones, less those that the new ones stand for, and the new ones."""
    names = {u.name for u in new}
    return (*(u for u in old if u.name not in names), *new)
