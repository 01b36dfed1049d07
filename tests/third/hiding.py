"""What can be hidden in a rig: each cause, how large, on which rigs, and what a verdict should say.

Sizes are three to ten times what is barely detectable, log-uniform. Barely is, without sensors'
noise, a change of 0.2 to 2 % of the rms of the load's velocity or of the current on a run of its
rig (of plain friction and a delay up to 3.5 %, of a loose disc up to 5 %); of a load's torque and a
Stribeck friction, which show in the mean or in slow rows alone, 0.1 to 0.5 %; of what a load
encoder reads wrongly, a sixth of a millirad. Ranges go with the rig as `Per` says. Of lost commands
a run that holds each for some periods shows but a part: how many is in no range.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np

from tests.third.commands import runs
from tests.third.plant import Link
from tests.third.recorded import World
from tests.third.rigs import Rig

Per = Literal["one", "tau", "tau a 3 rad/s", "gap", "loop", "spring", "peak", "stop"]
"""The unit of a size, on a rig:

    one             the parameter's own
    tau             a tenth of what a motor of its inertia is rated for, N m
    tau a 3 rad/s   that over a usual velocity, N m s/rad
    gap             the gap of the rig's file, rad
    loop            1/wn of the velocity loop, s
    spring          1/(J wn^2): the loop's own compliance, rad/(N m)
    peak            K_P 2 V, the current that a full reversal asks for, A
    stop            4 zeta wn V, the acceleration of one, rad/s2
"""

COUPLED_SHARE, COUPLED_DAMPING_S = 0.4, 2e-4
"""Of a hidden coupling: the load's share of the inertia, and its damping time."""


class Hidden(NamedTuple):
    """A cause as it was drawn: `size` in its unit.

    `choice` is the order a turn, a Stribeck friction's velocity in rad/s, a supply's frequency in
    Hz; zero where there is nothing to choose, and `phase_rad` where nothing has a phase.
    """

    effect: str
    size: float
    unit: str
    choice: float = 0.0
    phase_rad: float = 0.0


class Expected(NamedTuple):
    """What a verdict's parameter should be, and how far off it may be, in its SI unit."""

    effect: str
    parameter: str
    value: float
    tolerance: float


class Range(NamedTuple):
    """Three and ten times what is barely detectable, in units of `per`; `unit` is the size's SI.

    Of a limit and a loose disc, which act by what they cut off, the small ones act more.
    """

    low: float
    high: float
    per: Per
    unit: str
    signed: bool = False


class Told(NamedTuple):
    """The verdict's parameter that is a cause's size, its true value from the rig, the world with
    everything hidden in it, and the cause; and how far off it may be: a share of it, and `beside`,
    which is what every rig has of the same kind anyhow."""

    parameter: str = ""
    value: Callable[[Rig, World, Hidden], float] = lambda _rig, _world, hidden: hidden.size
    share: float = 0.15
    beside: float = 0.0


NOT_AT_ALL = Told()


@dataclass(frozen=True, slots=True)
class Hiding:
    """One row of the table: an effect, which no other of its group is hidden beside; the rigs that
    show it, by letter; sizes; how it is hidden (a size of zero hides nothing); how it is told."""

    effect: str
    group: str
    rigs: str
    range: Range
    change: Callable[[World, Hidden], World]
    told: Told = NOT_AT_ALL
    choices: tuple[float, ...] = (0.0,)
    phased: bool = False

    def is_for(self, rig: Rig) -> bool:
        """Whether a run of this rig shows it."""
        return rig.letter in self.rigs

    def drawn(self, rig: Rig, rng: np.random.Generator) -> Hidden:
        """A size of its range, rounded as a person would write it."""
        low, high, per, unit, signed = self.range
        share = math.exp(rng.uniform(math.log(low), math.log(high)))
        sign = float(rng.choice((-1.0, 1.0))) if signed else 1.0
        choice = float(rng.choice(self.choices))
        phase_rad = round(float(rng.uniform(-math.pi, math.pi)), 3)
        size = float(f"{sign * share * unit_of(per, rig):.4g}")
        return Hidden(self.effect, size, unit, choice, phase_rad if self.phased else 0.0)

    def expected(self, rig: Rig, world: World, hidden: Hidden) -> Expected:
        """What a verdict should say of it; `world` is that with everything hidden in it."""
        value = self.told.value(rig, world, hidden)
        tolerance = self.told.share * abs(value) + self.told.beside
        return Expected(self.effect, self.told.parameter, value, tolerance)


def unit_of(per: Per, rig: Rig) -> float:
    """One unit of size on this rig, in SI."""
    wn, velocity_rad_s = rig.natural_rad_s, runs(rig).velocity_rad_s
    units: dict[Per, float] = {
        "one": 1.0,
        "tau": rig.tau_nm,
        "tau a 3 rad/s": rig.tau_nm / 3.0,
        "gap": rig.gap_rad,
        "loop": 1.0 / wn,
        "spring": 1.0 / (rig.inertia_kg_m2 * wn**2),
        "peak": rig.proportional_gain_a_s_per_rad * 2.0 * velocity_rad_s,
        "stop": 4.0 * rig.damping_ratio * wn * velocity_rad_s,
    }
    return units[per]


def _with(world: World, values: Mapping[str, Any]) -> World:
    """The world with these numbers of its axis."""
    return world._replace(axis=world.axis._replace(**values))


def _scaled(name: str) -> Callable[[World, Hidden], World]:
    """A change of a field of the axis by a share of it."""

    def change(world: World, hidden: Hidden) -> World:
        value = getattr(world.axis, name) * (1.0 + hidden.size)
        return _with(world, {name: value})

    return change


def _added(name: str) -> Callable[[World, Hidden], World]:
    """A change of a field of the axis by what is added to it."""

    def change(world: World, hidden: Hidden) -> World:
        return _with(world, {name: getattr(world.axis, name) + hidden.size})

    return change


def _set(name: str, choice: str = "", phase: str = "") -> Callable[[World, Hidden], World]:
    """A change that sets a field of the axis, and the choice and the phase that go with it."""

    def change(world: World, hidden: Hidden) -> World:
        values = {name: hidden.size}
        values |= {choice: hidden.choice} if choice else {}
        values |= {phase: hidden.phase_rad} if phase else {}
        return _with(world, values)

    return change


def _limited(world: World, hidden: Hidden) -> World:
    return _with(world, {"current_limit_a": hidden.size}) if hidden.size > 0.0 else world


def _coupled(world: World, hidden: Hidden) -> World:
    """A part of the inertia behind a spring."""
    axis = world.axis
    if hidden.size <= 0.0:
        return world
    behind_kg_m2 = COUPLED_SHARE * axis.inertia_kg_m2
    values = {
        "link": Link.COUPLING,
        "inertia_kg_m2": axis.inertia_kg_m2 - behind_kg_m2,
        "load_inertia_kg_m2": behind_kg_m2,
        "stiffness_nm_per_rad": 1.0 / hidden.size,
        "coupling_damping_nm_s_per_rad": COUPLED_DAMPING_S / hidden.size,
    }
    return _with(world, values)


def _delayed(world: World, hidden: Hidden) -> World:
    return world._replace(delay_s=hidden.size)


def _losing(world: World, hidden: Hidden) -> World:
    return world._replace(loss_probability=hidden.size)


def _eccentric(world: World, hidden: Hidden) -> World:
    return world._replace(eccentricity_rad=hidden.size, eccentricity_phase_rad=hidden.phase_rad)


def _torque_per_inertia(rig: Rig, world: World, _hidden: Hidden) -> float:
    """K_T/J over that of the rig's file, less one: only their ratio moves anything."""
    axis = world.axis
    there = axis.torque_constant_nm_per_a / axis.total_inertia_kg_m2
    return there / (rig.torque_constant_nm_per_a / rig.inertia_kg_m2) - 1.0


def _all_coulomb(_rig: Rig, world: World, _hidden: Hidden) -> float:
    return world.axis.coulomb_nm


def _all_viscous(_rig: Rig, world: World, _hidden: Hidden) -> float:
    return world.axis.viscous_nm_s_per_rad


def _all_gap(rig: Rig, world: World, _hidden: Hidden) -> float:
    return world.axis.gap_rad - rig.gap_rad


def _reciprocal(_rig: Rig, _world: World, hidden: Hidden) -> float:
    return 1.0 / hidden.size


IN_THE_CATALOGUE = (
    Hiding(
        "coulomb",
        "friction",
        "ABCEFG",
        Range(0.08, 0.26, "tau", "N m"),
        _added("coulomb_nm"),
        Told("torque_nm", _all_coulomb),
    ),
    Hiding(
        "viscous",
        "friction",
        "ABCDEFG",
        Range(0.04, 0.13, "tau a 3 rad/s", "N m s/rad"),
        _added("viscous_nm_s_per_rad"),
        Told("damping_nm_s_per_rad", _all_viscous),
    ),
    Hiding(
        "stribeck",
        "friction",
        "BCEF",
        Range(0.05, 0.16, "tau", "N m"),
        _set("stribeck_nm", "stribeck_rad_s"),
        Told("excess_torque_nm", share=0.25),
        choices=(0.8, 1.2),
    ),
    Hiding(
        "cogging",
        "wave",
        "ABCEFG",
        Range(0.05, 0.16, "tau", "N m"),
        _set("cogging_nm", "cogging_order", "cogging_phase_rad"),
        Told("torque_nm"),
        choices=(12.0, 30.0),
        phased=True,
    ),
    Hiding(
        "torque_ripple",
        "wave",
        "BCEF",
        Range(0.03, 0.1, "one", "1"),
        _set("ripple_fraction", "ripple_order", "ripple_phase_rad"),
        Told("ripple_fraction"),
        choices=(24.0,),
        phased=True,
    ),
    Hiding(
        "torque_constant_error",
        "gain",
        "ABCDEFG",
        Range(0.024, 0.08, "one", "1", signed=True),
        _scaled("torque_constant_nm_per_a"),
        Told("error_fraction", _torque_per_inertia, beside=0.006),
    ),
    Hiding(
        "current_limit",
        "limit",
        "E",
        Range(0.36, 0.46, "peak", "A"),
        _limited,
        Told("limit_per_a", _reciprocal),
    ),
    Hiding(
        "velocity_filter_lag",
        "lag",
        "ABCDEFG",
        Range(0.04, 0.13, "loop", "s"),
        _set("filter_lag_s"),
        Told("lag_s", beside=0.13e-3),
    ),
    Hiding(
        "transport_delay",
        "lag",
        "ABCDEFG",
        Range(0.03, 0.1, "loop", "s"),
        _delayed,
        Told("delay_s", beside=0.13e-3),
    ),
    Hiding(
        "encoder_eccentricity",
        "disc",
        "BCEF",
        Range(0.5e-3, 1.7e-3, "one", "rad"),
        _eccentric,
        Told("amplitude_rad"),
        phased=True,
    ),
    Hiding(
        "gravity_imbalance",
        "load",
        "BCEF",
        Range(0.07, 0.22, "tau", "N m"),
        _set("gravity_nm", phase="gravity_phase_rad"),
        Told("torque_nm"),
        phased=True,
    ),
    Hiding(
        "load_torque",
        "load",
        "BCEF",
        Range(0.08, 0.26, "tau", "N m", signed=True),
        _added("load_torque_nm"),
        Told("torque_nm"),
    ),
    Hiding(
        "backlash_width",
        "gap",
        "ADG",
        Range(0.06, 0.2, "gap", "rad", signed=True),
        _added("gap_rad"),
        Told("change_rad", _all_gap, beside=0.2e-3),
    ),
    Hiding(
        "coupling_compliance",
        "link",
        "BE",
        Range(0.01, 0.033, "spring", "rad/(N m)"),
        _coupled,
        Told("compliance_rad_per_nm", share=0.25),
    ),
    Hiding(
        "missed_samples",
        "bus",
        "ABCDEFG",
        Range(0.002, 0.0066, "one", "1"),
        _losing,
        Told("miss_probability", share=0.5),
    ),
    Hiding(
        "proportional_gain_error",
        "gain",
        "ABCDEFG",
        Range(0.04, 0.13, "one", "1", signed=True),
        _scaled("proportional_gain_a_s_per_rad"),
        Told("error_fraction", beside=0.006),
    ),
    Hiding(
        "integral_gain_error",
        "gain",
        "ABCDEFG",
        Range(0.07, 0.22, "one", "1", signed=True),
        _scaled("integral_gain_a_per_rad"),
        Told("error_fraction", beside=0.006),
    ),
)
OUTSIDE_THE_CATALOGUE = (
    Hiding(
        "inertia that goes with the angle",
        "outside",
        "BCEF",
        Range(0.05, 0.16, "one", "1"),
        _set("inertia_wave_fraction", "inertia_wave_order", "inertia_wave_phase_rad"),
        choices=(2.0,),
        phased=True,
    ),
    Hiding(
        "a loose encoder disc",
        "outside",
        "BEF",
        Range(0.3, 0.45, "stop", "rad/s2"),
        _set("disc_slip_rad_s2"),
    ),
    Hiding(
        "an oscillating supply",
        "outside",
        "BCEFG",
        Range(0.08, 0.26, "one", "1"),
        _set("supply_fraction", "supply_hz", "supply_phase_rad"),
        choices=(2.6, 3.1),
        phased=True,
    ),
)
BY_NAME = {hiding.effect: hiding for hiding in IN_THE_CATALOGUE + OUTSIDE_THE_CATALOGUE}
