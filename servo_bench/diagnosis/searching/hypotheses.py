"""What is tried: for every effect of the catalogue a few finite sizes, and what is free in its fit.

Sizes follow the rig and the excitation (`sizes`), so that a rig ten times as large is asked the
same question. An effect without a line there is tried at three sizes of its own prior range, so
that a new file needs nothing else.

Friction, weight and torque on the load need a load: they are tried on the rigid one and on one with
a mass of its own (contact), which is then the vehicle, and a cause only where it is needed.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product
from typing import NamedTuple

import numpy as np

from servo_bench.diagnosis.reading.orders import Wave
from servo_bench.diagnosis.searching.scales import Scales
from servo_bench.diagnosis.searching.sizes import STEEP, trial_sizes
from servo_bench.diagnosis.searching.unknowns import (
    MASS,
    Unknown,
    delay_that_is_crossed,
    widened,
)
from sim_rig.effects import catalogue, find_effect, inverter_dead_time, thermal_friction
from sim_rig.effects.cogging import PLACES
from sim_rig.effects.effect import Effect
from sim_rig.errors import EffectError
from sim_rig.model import Model

Table = Mapping[str, float]
SHARP = frozenset(
    {
        *("coulomb", "asymmetric_friction", "load_dependent_friction", "load_friction"),
        *("position_friction", "thermal_friction"),
    }
)
"""Friction whose smoothed sign change is tried sharper than its file has it, and as sharp as that
of the Coulomb friction that was found."""
HUB_SHARES, RINGING = (0.15, 0.3, 0.5), 0.03
"""Of the inertia, behind a coupling that gives way; and its damping over the critical one."""
VEHICLE, LOAD_SHARE = "contact", 0.04
"""What gives the load a mass of its own; and how much of the inertia is behind its gap."""
FACES_RAD_PER_NM, SLOWED_RAD_S2 = (5e-3, 1.5e-2), (150.0, 500.0, 1500.0, 5e3, 1.5e4, 4.5e4)
"""Of a load whose friction is known and whose mass is not: its faces, how fast it slows down."""
BOUNCING, SLOPE_S_PER_RAD = 0.03, 0.15
"""What faces take of a blow: as a damping ratio, and more of a fast one."""
ON_THE_LOAD = frozenset({"load_friction", "load_torque", "gravity_imbalance"})
SHAPES: Mapping[str, tuple[Table, ...]] = {
    "stribeck": tuple({"stribeck_rad_s": v, "transition_rad_s": 0.1 * v} for v in (0.15, 0.5, 2.0)),
    "pre_sliding": tuple({"breakaway_angle_rad": angle} for angle in (3e-5, 3e-4, 1e-3)),
    "command_deadband": tuple({"offset_fraction": kind} for kind in (0.0, 1.0)),
}
"""What is tried beside sizes. A sign change as wide as a Stribeck curve would be most of it."""
LITTLE = 0.005
"""Of rms torque: friction of a load that something else drives through its gap."""
SPRINGS = STEEP - {"clock_skew"}
CROSSING_DELAYS_S, CROSSED = (2e-5, 5e-5, 1e-4), (1.0, 0.4)
"""Of a usual rig's command, that a clock which falls behind takes away (see `crossing`); and when
it has, of the time at which a good part of every jump shows: that may be a drive's tick later. One
of -22e-6 showed so after 8 s, and had crossed at 3; beside the time itself it ended at -2.4e-6."""
DETECTED = frozenset({"missed_samples", "quantisation"})
"""Found by looking for them in the data (`lost`, `hygiene`), not by trying sizes."""


SOME = 0.1
"""Of its size, that a trial has at least of an effect that a rig's file has already."""


@dataclass(frozen=True)
class Trial:
    """One setting of an effect; `beside` are effects that carry it; `size` that of its strength.

    `swapped`: so much of its torque is taken from the Coulomb friction that was found.
    `crossed_s`: a clock that falls behind until then; the delay that makes it so goes along.
    `slowed_rad_s2`: a load of the mass that the friction which was found slows down so fast.
    """

    effect: str
    settings: Table
    size: float
    beside: Mapping[str, Table] = field(default_factory=dict)
    swapped: float = 0.0
    crossed_s: float | None = None
    slowed_rad_s2: float | None = None

    def on(self, model: Model) -> Model:
        """The model with it. Raises EffectError where it makes none."""
        for name, table in self.beside.items():
            if name not in model.effects or find_effect(name).is_off(model.effects[name]):
                model = model.with_effect(name, **table)
        params = model.effects.get(self.effect, find_effect(self.effect).params())
        kept = {k: float(v) for k, v in params._asdict().items()}
        settings = {**kept, **self.settings}
        if self.effect in SHARP and "coulomb" in model.effects:
            known = float(model.effects["coulomb"].transition_rad_s)
            settings["transition_rad_s"] = min(settings["transition_rad_s"], known)
        if self.swapped:
            model = _warm(model, self.swapped * settings["cold_torque_nm"])
        if self.crossed_s is not None:
            delay_s = -self.crossed_s * settings["skew_fraction"]
            model = model.with_effect("transport_delay", delay_s=delay_s)
        if self.slowed_rad_s2 is not None:
            settings |= _on_faces(model, self.slowed_rad_s2, settings["compliance_rad_per_nm"])
        return model.with_effect(self.effect, **settings)

    def times(self, share: float) -> "Trial":
        """So many times as strong."""
        strength = next(iter(self.settings))
        value = self.settings[strength] * share
        return replace(self, settings={**self.settings, strength: value}, size=abs(value))

    def carrying(self, share: float) -> "Trial":
        """On a vehicle with so many times the mass; the same trial where there is no vehicle."""
        if VEHICLE not in self.beside:
            return self
        vehicle = self.beside[VEHICLE]
        mass = {"load_inertia_kg_m2": vehicle["load_inertia_kg_m2"] * share}
        return replace(self, beside={**self.beside, VEHICLE: {**vehicle, **mass}})


def _on_faces(model: Model, slowed_rad_s2: float, compliance: float) -> Table:
    """Mass and damping of a load that bounces on its faces as metal does, and goes on as far as its
    friction lets it. Raises EffectError where it has none, or a mass already."""
    friction = model.effects.get("load_friction")
    if VEHICLE in model.effects or friction is None or friction.torque_nm <= 0.0:
        raise EffectError("No friction of a load was found that would tell how fast it slows down.")
    mass = min(float(friction.torque_nm) / slowed_rad_s2, 0.5 * model.nominal.inertia_kg_m2)
    return _faced(compliance, mass)


def _faced(compliance: float, mass: float) -> Table:
    """A mass behind a gap, and what its faces take of a blow."""
    return {
        "load_inertia_kg_m2": mass,
        "damping_s": 2.0 * BOUNCING * float(np.sqrt(compliance * mass)),
        "restitution_slope_s_per_rad": SLOPE_S_PER_RAD,
    }


def _warm(model: Model, taken_nm: float) -> Model:
    """Of the Coulomb friction that was found, so much is the cold's: the rest is tried beside it.

    Added to what was found it would only show that there is enough of it.
    """
    coulomb = model.effects.get("coulomb")
    if coulomb is None or coulomb.torque_nm < taken_nm:
        return model
    table = {**coulomb._asdict(), "torque_nm": float(coulomb.torque_nm) - taken_nm}
    return model.with_effect("coulomb", **table)


@dataclass(frozen=True)
class Hypothesis:
    """One effect: trials, and the fields that a fit frees, its own and its vehicle's."""

    effect: str
    trials: tuple[Trial, ...]
    free: tuple[str, ...]

    def unknowns(self, model: Model, trial: Trial) -> tuple[Unknown, ...]:
        """What a fit that starts from `trial` frees."""
        found = list(widened(self.effect, self.free, model, trial.size))
        for name in trial.beside:
            strength = find_effect(name).strengths[0]
            found += widened(name, _FREE[name], model, trial.beside[name][strength])
        if trial.swapped:
            found[0] = replace(found[0], carries="coulomb.torque_nm", share=trial.swapped)
        if self.effect in ON_THE_LOAD:  # how fast a load goes in its gap is torque over mass
            found = [self._with_its_torque(u, trial) for u in found]
        if trial.crossed_s is not None:
            delay = delay_that_is_crossed()
            found = [delay, replace(found[0], carries=delay.name, share=trial.crossed_s)]
        return tuple(sorted(found, key=lambda u: bool(u.carries)))  # what is carried is put first

    def _with_its_torque(self, unknown: Unknown, trial: Trial) -> Unknown:
        if unknown.name != f"{VEHICLE}.{MASS}":
            return unknown
        torques = sorted({self.effect, *trial.beside} - {VEHICLE})
        carries = " ".join(f"{effect}.torque_nm" for effect in torques)
        return replace(unknown, carries=carries, in_proportion=True)


_FREE = {
    "coulomb": ("torque_nm", "transition_rad_s"),
    "asymmetric_friction": ("difference_torque_nm", "transition_rad_s"),
    "load_dependent_friction": ("loss_fraction", "transition_rad_s"),
    "position_friction": ("swing_torque_nm", "phase_rad", "transition_rad_s"),
    "load_friction": ("torque_nm", "transition_rad_s"),
    "stribeck": ("excess_torque_nm", "stribeck_rad_s", "transition_rad_s"),
    "thermal_friction": ("cold_torque_nm", "transition_rad_s"),
    "pre_sliding": ("torque_nm", "breakaway_angle_rad"),
    "contact": (
        *("compliance_rad_per_nm", "damping_s", "load_inertia_kg_m2"),
        "restitution_slope_s_per_rad",
    ),
    "coupling_compliance": ("compliance_rad_per_nm", "damping_s", "load_inertia_kg_m2"),
    "inverter_dead_time": ("notch_a", "recovery_s"),
    "current_limit": ("limit_per_a",),
}


def hypotheses(
    scales: Scales,
    *,
    motor_orders: Sequence[float] = (),
    waves: Sequence[Wave] = (),
    ripple_orders: Sequence[float] = (),
    load_orders: Sequence[float] = (),
    crossed_s: float | None = None,
    without: Sequence[str] = (),
    only: Sequence[str] = (),
) -> tuple[Hypothesis, ...]:
    """All that can be tried on this rig, `without` some that carry no other effect either."""
    found, believed = [], dict(scales.believed)
    for name, effect in catalogue().items():
        if name in DETECTED or name in without or (only and name not in only):
            continue
        if name in ("backlash_width", "position_backlash") and scales.gap_rad <= 0.0:
            continue
        orders = _Orders(motor_orders, ripple_orders, load_orders)
        tried = _trials(effect, scales, orders)
        trials = tuple(t for t in tried if t.beside.keys().isdisjoint(without))
        if name == "clock_skew" and crossed_s is not None:
            trials = tuple(_crossing(crossed_s))
        if name == VEHICLE:
            trials += tuple(_slowed(scales))
        if name in believed and "phase_rad" not in effect.params._fields:
            trials = tuple(_about(trials, float(getattr(believed[name], effect.strengths[0]))))
        if trials:
            found.append(Hypothesis(name, trials, _FREE.get(name) or _default_free(effect)))
        if name == "cogging" and waves:
            found.append(_as_measured(waves))
    return tuple(found)


def _about(trials: Sequence[Trial], believed: float) -> Iterator[Trial]:
    """The trials beside what the rig's file has: more of it, and less; none of which is nothing."""
    sizes = [next(iter(trial.settings.values())) for trial in trials]
    signed = min(sizes, default=0.0) < 0.0
    for trial, size in zip(trials, sizes, strict=True):
        strength = next(iter(trial.settings))
        for value in (believed + size, *(() if signed else (believed - size,))):
            if abs(value) > SOME * abs(size) and (signed or value > 0.0):
                yield replace(trial, settings={**trial.settings, strength: value})


def _as_measured(waves: Sequence[Wave]) -> Hypothesis:
    """Cogging of all the orders that stand in the errors, at their own sizes and phases."""
    settings = cogging_of(waves)
    free = tuple(name for name in settings if not name.endswith("order"))
    return Hypothesis("cogging", (Trial("cogging", settings, waves[0].torque_nm),), free)


def cogging_of(waves: Sequence[Wave]) -> dict[str, float]:
    """The effect's parameters for as many waves as it has places."""
    settings: dict[str, float] = {}
    for which, wave in zip(PLACES, waves, strict=False):
        settings |= {
            f"{which}torque_nm": wave.torque_nm,
            f"{which}order": wave.order,
            f"{which}phase_rad": wave.phase_rad,
        }
    return settings


class _Orders(NamedTuple):
    """Periods a revolution that are tried: of a torque, of one with the current, of the load's."""

    motor: Sequence[float]
    ripple: Sequence[float]
    load: Sequence[float]


def _default_free(effect: Effect) -> tuple[str, ...]:
    """The first strength, and its phase where it has one."""
    phases = ("phase_rad",) if "phase_rad" in effect.params._fields else ()
    return effect.strengths[:1] + phases


def _trials(
    effect: Effect,
    scales: Scales,
    orders: "_Orders",
) -> Iterator[Trial]:
    sizes = trial_sizes(effect, scales)
    strength = effect.strengths[0]
    swapped = _mean_warmth(scales) if effect.name == "thermal_friction" else 0.0
    for choice, beside in _choices(effect.name, scales, orders):
        coasting = effect.name == "load_friction" and VEHICLE in beside
        for size in (*sizes, *(_slowing_nm(scales) if coasting else ())):
            settings = {strength: size, **choice}
            if effect.name == "coupling_compliance":
                settings["damping_s"] = _ringing_s(settings, scales)
            elif effect.name == VEHICLE:
                settings |= _faced(size, settings["load_inertia_kg_m2"])
            yield Trial(effect.name, settings, abs(size), beside, swapped)


def _slowing_nm(s: Scales) -> tuple[float, ...]:
    """Friction that brings a vehicle's load to rest about as far as its gap is wide: between them
    no template of one tells of the other."""
    if s.gap_rad <= 0.0:
        return ()
    slowed_rad_s2 = 0.5 * s.speed_rad_s**2 / s.gap_rad
    mass = LOAD_SHARE * s.inertia_kg_m2
    return tuple(share * slowed_rad_s2 * mass for share in (0.5, 1.0, 2.0, 4.0))


def _crossing(crossed_s: float) -> Iterator[Trial]:
    """Clocks that take a usual delay away until then: what crosses is steep, and found by no step
    from elsewhere."""
    for share, delay_s in product(CROSSED, CROSSING_DELAYS_S):
        at_s = share * crossed_s
        skew = -delay_s / at_s
        yield Trial("clock_skew", {"skew_fraction": skew}, abs(skew), crossed_s=at_s)


def _slowed(s: Scales) -> Iterator[Trial]:
    """A mass for a load of which only the friction is known: how fast it slows down tells it."""
    for compliance, slowed in product(FACES_RAD_PER_NM, SLOWED_RAD_S2):
        size = compliance * s.yielding
        yield Trial(VEHICLE, {"compliance_rad_per_nm": size}, size, slowed_rad_s2=slowed)


def _ringing_s(settings: Table, s: Scales) -> float:
    """Of a coupling that rings for some periods, as metal does; a resonance is a narrow valley."""
    share = settings["load_inertia_kg_m2"] / s.inertia_kg_m2
    swinging = settings["load_inertia_kg_m2"] * (1.0 - share)
    return float(2.0 * RINGING * np.sqrt(settings["compliance_rad_per_nm"] * swinging))


def _mean_warmth(s: Scales) -> float:
    """How much of the cold's friction is there on the average of the record."""
    return float(np.exp(-0.5 * s.seconds / thermal_friction.Params().warming_s))


def _choices(
    name: str, s: Scales, orders: "_Orders"
) -> Iterator[tuple[Table, Mapping[str, Table]]]:
    """What is not sought by steps but by trying: orders, velocities, a vehicle."""
    if name == "cogging":
        yield from (({"order": float(order)}, {}) for order in orders.motor)
    elif name == "torque_ripple":
        yield from (
            ({"electrical_order": float(order), "pole_pair_count": 1.0}, {})
            for order in orders.ripple
        )
    elif name == "encoder_subdivision":
        yield from (({"line_order": float(order)}, {}) for order in orders.load)
    elif name in SHARP:
        yield from (({"transition_rad_s": 0.1}, beside) for beside in _vehicles(name, s))
    elif name in SHAPES:
        yield from ((shape, {}) for shape in SHAPES[name])
    elif name == "anti_windup":
        limits_a = (*s.peaks_a, *s.currents_a)
        yield from (({}, {"current_limit": {"limit_per_a": 1.0 / a}}) for a in limits_a)
    elif name == "inverter_dead_time":
        width = min(inverter_dead_time.Params().transition_a, s.current_a / 3.0)
        yield from (({"pole_pair_count": p, "transition_a": width}, {}) for p in (2.0, 4.0, 5.0))
    elif name == "contact":
        yield from (
            ({"load_inertia_kg_m2": share * s.inertia_kg_m2}, {}) for share in (0.004, 0.015, 0.05)
        )
    elif name == "coupling_compliance":
        yield from (({"load_inertia_kg_m2": share * s.inertia_kg_m2}, {}) for share in HUB_SHARES)
    else:
        yield from (({}, beside) for beside in _vehicles(name, s))


def _vehicles(name: str, s: Scales) -> Iterator[Mapping[str, Table]]:
    """None, and for what acts on the load a load with a mass, which rubs a little."""
    yield {}
    if name not in ON_THE_LOAD:
        return
    compliance = 2e-3 * s.yielding
    face = _faced(compliance, LOAD_SHARE * s.inertia_kg_m2)
    vehicle: dict[str, Table] = {VEHICLE: {"compliance_rad_per_nm": compliance, **face}}
    if name != "load_friction":
        vehicle["load_friction"] = {"torque_nm": LITTLE * s.torque_nm}
    yield vehicle
