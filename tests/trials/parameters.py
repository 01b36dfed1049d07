"""What a named parameter should be: from the truth's strength to the catalogue's number.

Most are the same quantity. Where every rig of the truth has some of it besides (friction, drag,
lag, a wait for the loop's next period), the true value is the sum, for that is what the axis does.
`WITHOUT` says which truths have no counterpart to compare with, and why.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

from tests.truth.drive import RIPPLE_A_PER_V
from tests.truth.effects import NONE
from tests.truth.nuisances import Nuisances


@dataclass(frozen=True, slots=True)
class Known:
    """What the truth's number may need: the axis, the run's length, the named parameters."""

    nuisances: Nuisances
    inertia_kg_m2: float
    seconds: float
    named: Mapping[str, float]
    fields: Mapping[str, float]


Law = Callable[[float, Known], float]


@dataclass(frozen=True, slots=True)
class Counterpart:
    """The effect's parameter that stands for a truth's strength, and its true value."""

    effect: str
    parameter: str
    value: Law


def _same(strength: float, known: Known) -> float:
    return strength


def _ratio(known: Known, *, torque: float = 0.0, inertia: float = 0.0) -> float:
    """The true (K_T/J) over the nominal one."""
    nuisances = known.nuisances
    of_torque = (1.0 + torque) * (1.0 + nuisances.torque_constant_error)
    return of_torque / ((1.0 + inertia) * (1.0 + nuisances.inertia_error))


def _drift(strength: float, known: Known) -> float:
    """As much of K_T as is really lost by the end, for the time constant that was named."""
    named_s = known.named.get("warming_s", 600.0)
    share = 1.0 - math.exp(-known.seconds / known.fields["torque_constant_drift_s"])
    return strength * share / (1.0 - math.exp(-known.seconds / named_s))


def _wait_s(known: Known) -> float:
    """From a telegram to the loop's next period."""
    nuisances = known.nuisances
    return (-nuisances.loop_phase % nuisances.substeps) * nuisances.step_s


def _twist(strength: float, known: Known) -> float:
    """The compliance with the same antiresonance, c J_l, for the load's inertia that was named."""
    named_kg_m2 = known.named.get("load_inertia_kg_m2", 5e-5)
    return strength * NONE.coupling_share * known.inertia_kg_m2 / named_kg_m2


def _with(nuisance: str, share: float = 1.0) -> Law:
    """The strength and what every rig has of it."""
    return lambda strength, known: strength + share * float(getattr(known.nuisances, nuisance))


def _one(effect: str, parameter: str, value: Law = _same) -> tuple[Counterpart, ...]:
    return (Counterpart(effect, parameter, value),)


_TORQUE_CONSTANT, _INERTIA = (
    ("torque_constant_error", "error_fraction"),
    ("inertia_error", "error_fraction"),
)

COUNTERPARTS: Mapping[str, tuple[Counterpart, ...]] = MappingProxyType(
    {
        "coulomb_friction": _one("coulomb", "torque_nm", _with("motor_friction_nm")),
        "viscous_friction": _one(
            "viscous", "damping_nm_s_per_rad", _with("motor_viscous_nm_s_per_rad")
        ),
        "stribeck": _one("stribeck", "excess_torque_nm"),
        "asymmetric_friction": _one("asymmetric_friction", "difference_torque_nm"),
        "load_dependent_friction": _one("load_dependent_friction", "loss_fraction"),
        "position_dependent_friction": _one("position_friction", "swing_torque_nm"),
        "friction_drift": _one(
            "thermal_friction", "cold_torque_nm", lambda s, k: s * k.fields["coulomb_nm"]
        ),
        "cogging": _one("cogging", "torque_nm"),
        "torque_ripple": _one("torque_ripple", "ripple_fraction"),
        "torque_constant_error": (
            Counterpart(*_TORQUE_CONSTANT, lambda s, k: _ratio(k, torque=s) - 1.0),
            Counterpart(*_INERTIA, lambda s, k: 1.0 / _ratio(k, torque=s) - 1.0),
        ),
        "torque_constant_droop": _one("torque_constant_droop", "droop_per_a2"),
        "torque_constant_drift": _one("thermal_torque_constant", "drop_fraction", _drift),
        "inertia_error": (
            Counterpart(*_INERTIA, lambda s, k: 1.0 / _ratio(k, inertia=s) - 1.0),
            Counterpart(*_TORQUE_CONSTANT, lambda s, k: _ratio(k, inertia=s) - 1.0),
        ),
        "current_limit": _one("current_limit", "limit_per_a"),
        "current_lag": _one("current_loop_lag", "lag_s", _with("current_lag_s")),
        "velocity_filter": _one("velocity_filter_lag", "lag_s", _with("loop_period_s", 0.5)),
        "integrator_clamp": _one("integrator_clamp", "clamp_per_a"),
        "anti_windup": _one("anti_windup", "tracking_per_s"),
        # A change of the current's sign moves the lost voltage by 2 V, and the notch by I.
        "inverter_dead_time": _one(
            "inverter_dead_time", "notch_a", lambda s, k: 2.0 * RIPPLE_A_PER_V * s
        ),
        "transport_delay": _one("transport_delay", "delay_s", lambda s, k: s + _wait_s(k)),
        "command_slew": _one("command_slew", "slowness_s2_per_rad"),
        "command_scale": _one("command_scale", "error_fraction"),
        "command_offset": _one("command_offset", "offset_rad_s"),
        "clock_skew": _one("clock_skew", "skew_fraction"),
        "missed_samples": _one("missed_samples", "miss_probability"),
        "backlash_width": _one("backlash_width", "change_rad"),
        "position_dependent_backlash": _one("position_backlash", "swing_rad"),
        "coupling_compliance": _one("coupling_compliance", "compliance_rad_per_nm", _twist),
        "load_friction": _one("load_friction", "torque_nm", _with("load_friction_nm")),
        # The truth's load torque is what the load bears, the catalogue's what turns it forwards.
        "load_torque": _one("load_torque", "torque_nm", lambda s, k: -s),
        "gravity": _one("gravity_imbalance", "torque_nm"),
        "encoder_eccentricity": _one("encoder_eccentricity", "amplitude_rad"),
        "misalignment": _one("misalignment", "angle_rad"),
        "encoder_subdivision": _one("encoder_subdivision", "amplitude_rad"),
        "encoder_quantisation": _one("quantisation", "count_rad"),
        "proportional_gain_error": _one("proportional_gain_error", "error_fraction"),
        "integral_gain_error": _one("integral_gain_error", "error_fraction"),
    }
)

WITHOUT: Mapping[str, str] = MappingProxyType(
    {
        "presliding": "four springs that slip one after the other have no single break-away angle",
        "contact_stiffness": "Hertz's stiffness has no linear compliance: it depends on the torque",
        "contact_damping": "damping that grows with the torque is no damping time",
        "load_inertia": "the contact's compliance is its strength; the inertia behind it is beside",
        "command_deadband": "one takes the band off every command, the other drops small ones",
    }
)

LAX = frozenset(
    {
        *("contact_stiffness", "contact_damping", "coupling_compliance", "load_inertia"),
        *("current_lag", "velocity_filter", "transport_delay"),
    }
)
"""Contact, compliance, and lag terms: 10 % of these is as good as 3 % of the others."""


def true_value(cause: str, strength: float, effect: str, known: Known) -> tuple[str, float] | None:
    """The parameter of `effect` that stands for this truth, and what it should be."""
    for counterpart in COUNTERPARTS.get(cause, ()):
        if counterpart.effect == effect:
            return counterpart.parameter, counterpart.value(strength, known)
    return None
