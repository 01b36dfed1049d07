"""Which answers are right. Written before any campaign, and not changed after one.

The truth and the catalogue of effects were named by different hands. `RIGHT` says for each name of
the truth the effects that describe it, with a sentence of reason where that is not one of the same
name. What nobody could tell apart on the given channels is added by two rules:

    DECLARED      equations that are the same, on any channels
    measured      a projected cosine above `ALIKE` between the changes that two causes make to the
                  truth's own recordings (`measuring.py`; likeness.json). What all channels
                  cannot tell apart, the load encoder alone cannot either

`companions` are right beside the cause and never instead of it.
"""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Literal

from tests.truth.catalogue import BY_NAME
from tests.truth.hidden import HiddenTruth

Channels = Literal["all", "load"]

ALIKE = 0.95
LIKENESS = Path(__file__).with_name("likeness.json")


@dataclass(frozen=True, slots=True)
class Right:
    """Effects that describe a truth, and why."""

    names: tuple[str, ...]
    reason: str = "the same equation up to its numerics"


_SOFT = (
    "the catalogue has one contact, linear and damped, whose mass is the load: Hertz's stiffness, "
    "its damping and the load's inertia are its three numbers"
)

RIGHT: Mapping[str, Right] = MappingProxyType(
    {
        "coulomb_friction": Right(("coulomb",)),
        "viscous_friction": Right(("viscous",)),
        "stribeck": Right(("stribeck",)),
        "presliding": Right(
            ("pre_sliding",), "slipping springs (Jenkin, Iwan) against one bristle (Dahl)"
        ),
        "asymmetric_friction": Right(("asymmetric_friction",)),
        "load_dependent_friction": Right(("load_dependent_friction",)),
        "position_dependent_friction": Right(("position_friction",)),
        "friction_drift": Right(("thermal_friction",)),
        "cogging": Right(("cogging",)),
        "torque_ripple": Right(("torque_ripple",)),
        "torque_constant_error": Right(("torque_constant_error",)),
        "torque_constant_droop": Right(("torque_constant_droop",)),
        "torque_constant_drift": Right(("thermal_torque_constant",)),
        "inertia_error": Right(("inertia_error",)),
        "current_limit": Right(("current_limit",)),
        "current_lag": Right(("current_loop_lag",)),
        "velocity_filter": Right(("velocity_filter_lag",)),
        "integrator_clamp": Right(("integrator_clamp",)),
        "anti_windup": Right(("anti_windup",)),
        "inverter_dead_time": Right(
            ("inverter_dead_time",), "a pulse of current at its zero crossing in both"
        ),
        "transport_delay": Right(("transport_delay",)),
        "command_slew": Right(("command_slew",)),
        "command_deadband": Right(
            ("command_deadband",), "soft (taken off the size) against hard (small ones ignored)"
        ),
        "command_scale": Right(("command_scale",)),
        "command_offset": Right(("command_offset",)),
        "clock_skew": Right(("clock_skew",)),
        "missed_samples": Right(("missed_samples",)),
        "backlash_width": Right(("backlash_width",)),
        "position_dependent_backlash": Right(("position_backlash",)),
        "contact_stiffness": Right(("contact",), _SOFT),
        "contact_damping": Right(("contact",), _SOFT),
        "coupling_compliance": Right(("coupling_compliance",)),
        "load_inertia": Right(("contact",), _SOFT),
        "load_friction": Right(("load_friction",)),
        "load_torque": Right(("load_torque",)),
        "gravity": Right(("gravity_imbalance",)),
        "encoder_eccentricity": Right(("encoder_eccentricity",)),
        "misalignment": Right(("misalignment",)),
        "encoder_subdivision": Right(("encoder_subdivision",)),
        "encoder_quantisation": Right(("quantisation",)),
        "proportional_gain_error": Right(("proportional_gain_error",)),
        "integral_gain_error": Right(("integral_gain_error",)),
    }
)

DECLARED: tuple[tuple[frozenset[str], str], ...] = (
    (
        frozenset({"torque_constant_error", "inertia_error"}),
        "only K_T/J moves the axis, and the drive's own torque figure is K_T nominal times i",
    ),
    (
        frozenset({"asymmetric_friction", "load_torque"}),
        "a constant torque while turning, and these runs turn throughout",
    ),
)
"""Truths that are one class. A deadband and a scale are not: several levels are commanded."""


@cache
def measured_likeness(channels: Channels) -> Mapping[str, Mapping[str, float]]:
    """Projected cosines between the truth's causes, from likeness.json: both ways, no diagonal."""
    found = json.loads(LIKENESS.read_text())["cosines"]
    pairs = found["all"] if channels == "all" else found["all"] + found["load"]
    both: dict[str, dict[str, float]] = {}
    for one, other, cosine in pairs:
        for name, like in ((one, other), (other, one)):
            row = both.setdefault(name, {})
            row[like] = max(cosine, row.get(like, 0.0))
    return both


def class_of(cause: str, channels: Channels) -> frozenset[str]:
    """The truth's causes that cannot be told from this one on these channels, itself among them."""
    declared = (names for names, _ in DECLARED if cause in names)
    near = measured_likeness(channels).get(cause, {})
    measured = (other for other, cosine in near.items() if cosine > ALIKE)
    return frozenset({cause}).union(*declared, measured)


def right_names(cause: str, channels: Channels) -> frozenset[str]:
    """The effects that are right where this cause is hidden; none for one that has no equal."""
    if cause not in RIGHT:
        return frozenset()
    alike = class_of(cause, channels)
    return frozenset(name for one in alike if one in RIGHT for name in RIGHT[one].names)


def own_names(cause: str) -> frozenset[str]:
    """The effects that describe this very cause."""
    return frozenset(RIGHT[cause].names) if cause in RIGHT else frozenset()


def companions(truth: HiddenTruth, channels: Channels) -> frozenset[str]:
    """The effects that stand for what the causes need beside them.

    Pre-sliding friction brings its own sliding torque: the catalogue's bristle is both, so that
    Coulomb friction is its companion and need not be named.
    """
    also = truth.also | {name for cause in truth.causes for name in BY_NAME[cause].also}
    return frozenset(name for one in also for name in right_names(one, channels))
