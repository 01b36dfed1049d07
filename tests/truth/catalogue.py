"""The truth's own table: what can be hidden, how strong it may be, and what nobody can tell apart.

A size is drawn log-uniformly between `low` and `high`, in units of `per`, with either sign where
`signed`. Most are physical sizes. What only acts where the command asks for it (a current limit,
a slew limit, a dead zone) is sized by what the rig and the command ask for:

    per               unit of size
    "one"             the strength's own SI unit
    "gap"             the nominal gap
    "command"         the largest commanded velocity V
    "1/command"       1/V
    "1/reversal"      1/(2 V): a size is then the time that a reversal takes, in s
    "peak"            2 V K_P: the current that a reversal asks for
    "1/peak", "1/peak2"   its reciprocal, and the square of that
    "1/integral"      the reciprocal of what the controller's integral then comes to
    "inertia"         J

A bias makes V up to 1.3 times half the largest jump: a limit or clamp of 1.5 cuts an eighth off
what that asks for, and one of 1.25 might cut nothing.

`beside` are other strengths without which the effect has nothing to act on (friction that swings
needs friction); `also` names what they are. `phases` are drawn from a turn, `choices` at random.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Literal

from tests.truth.plant import NominalValues

Per = Literal[
    "one",
    "gap",
    "command",
    "1/command",
    "1/reversal",
    "peak",
    "1/peak",
    "1/peak2",
    "1/integral",
    "inertia",
]
Beside = Callable[[float, "Scale"], Mapping[str, float]]


@dataclass(frozen=True, slots=True)
class Scale:
    """A rig and the largest velocity that it is asked for."""

    nominal: NominalValues
    velocity_rad_s: float

    def of(self, per: Per) -> float:
        """One unit of size, in the strength's SI unit. ValueError where nothing is commanded."""
        if per == "one":
            return 1.0
        if per == "gap":
            return self.nominal.backlash_gap_rad
        if per == "inertia":
            return self.nominal.inertia_kg_m2
        if self.velocity_rad_s <= 0.0:
            raise ValueError(
                f"an effect is sized per {per!r}, and the largest commanded velocity is "
                f"{self.velocity_rad_s} rad/s: play an experiment that moves the axis"
            )
        return self._of_the_command(per)

    def _of_the_command(self, per: Per) -> float:
        peak_a = 2.0 * self.velocity_rad_s * self.nominal.proportional_gain_a_s_per_rad
        return {
            "command": self.velocity_rad_s,
            "1/command": 1.0 / self.velocity_rad_s,
            "1/reversal": 0.5 / self.velocity_rad_s,
            "peak": peak_a,
            "1/peak": 1.0 / peak_a,
            "1/peak2": 1.0 / peak_a**2,
            "1/integral": 1.0 / self._integral_a(),
        }[per]

    def _integral_a(self) -> float:
        """Largest current of the controller's integral after a reversal of a bare inertia, A.

        Of its error's integral q'' + 2 zeta wn q' + wn^2 q = 0, q(0) = 0, q'(0) = 2 V, that is
        K_I 2 V/wn exp(-zeta acos(zeta) / sqrt(1 - zeta^2)); for zeta -> 1 the exponent is -1.
        """
        rig = self.nominal
        per_gain = rig.torque_constant_nm_per_a / rig.inertia_kg_m2
        wn_rad_s = math.sqrt(rig.integral_gain_a_per_rad * per_gain)
        zeta = min(0.5 * rig.proportional_gain_a_s_per_rad * per_gain / wn_rad_s, 0.999)
        least = math.exp(-zeta * math.acos(zeta) / math.sqrt(1.0 - zeta**2))
        return rig.integral_gain_a_per_rad * 2.0 * self.velocity_rad_s / wn_rad_s * least


def _alone(strength: float, scale: Scale) -> Mapping[str, float]:
    return {}


@dataclass(frozen=True, slots=True)
class Hiding:
    """One effect: its name, the field of `Effects` that is its strength, and how it is set."""

    name: str
    strength: str
    low: float
    high: float
    per: Per = "one"
    signed: bool = False
    phases: tuple[str, ...] = ()
    choices: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    beside: Beside = _alone
    also: tuple[str, ...] = ()
    resembles: tuple[str, ...] = ()

    def fields(self, size: float, scale: Scale, drawn: Mapping[str, float]) -> dict[str, float]:
        """Values of `Effects` for a size; none at all for zero. `drawn`: phases and choices."""
        if size == 0.0:
            return {}
        strength = size * scale.of(self.per)
        return {self.strength: strength, **self.beside(strength, scale), **drawn}


def _coulomb(times: float) -> Beside:
    return lambda strength, scale: {"coulomb_nm": times * abs(strength)}


def _ten_millinewtonmetres(strength: float, scale: Scale) -> Mapping[str, float]:
    return {"coulomb_nm": 0.01}


def _load(share: float, friction_nm: float = 0.0) -> Beside:
    def beside(strength: float, scale: Scale) -> Mapping[str, float]:
        inertia = {"load_inertia_kg_m2": share * scale.nominal.inertia_kg_m2}
        return inertia | ({"load_friction_nm": friction_nm} if friction_nm else {})

    return beside


def _stopping(strength: float, scale: Scale) -> Mapping[str, float]:
    """Friction that stops the load within 5 ms of 3 rad/s, so that it rests in the gap."""
    return {"load_friction_nm": 600.0 * strength}


def _half_the_peak(strength: float, scale: Scale) -> Mapping[str, float]:
    return {"current_limit_per_a": 2.0 * scale.of("1/peak")}


COULOMB, LOAD = ("coulomb_friction",), ("load_inertia",)

IN_THE_CATALOGUE = (
    # friction at the rotor
    Hiding("coulomb_friction", "coulomb_nm", 3e-3, 30e-3),
    Hiding("viscous_friction", "viscous_nm_s_per_rad", 0.1e-3, 3e-3),
    Hiding(
        "stribeck",
        "stribeck_nm",
        1e-3,
        15e-3,
        choices={"stribeck_velocity_rad_s": (0.1, 0.3, 1.0, 3.0)},
    ),
    Hiding("presliding", "presliding_rad", 1e-5, 1e-3, beside=_ten_millinewtonmetres, also=COULOMB),
    Hiding(
        "asymmetric_friction",
        "friction_asymmetry_nm",
        0.5e-3,
        6e-3,
        signed=True,
        beside=_coulomb(2.0),
        also=COULOMB,
    ),
    Hiding("load_dependent_friction", "friction_load_share", 0.02, 0.15),
    Hiding(
        "position_dependent_friction",
        "friction_swing_nm",
        1e-3,
        10e-3,
        phases=("friction_swing_phase_rad",),
        beside=_coulomb(2.5),
        also=COULOMB,
    ),
    Hiding(
        "friction_drift",
        "friction_drift",
        0.2,
        0.5,
        choices={"friction_drift_s": (300.0, 600.0)},
        beside=_ten_millinewtonmetres,
        also=COULOMB,
    ),
    # torque at the rotor
    Hiding(
        "cogging",
        "cogging_nm",
        2e-3,
        20e-3,
        phases=("cogging_phase_rad",),
        choices={"cogging_order": (8.0, 10.0, 12.0, 24.0, 60.0)},
    ),
    Hiding(
        "torque_ripple",
        "torque_ripple",
        0.01,
        0.05,
        phases=("torque_ripple_phase_rad",),
        choices={"torque_ripple_order": (24.0, 30.0)},
    ),
    Hiding("torque_constant_error", "torque_constant_error", 0.02, 0.1, signed=True),
    Hiding("torque_constant_droop", "torque_constant_droop_per_a2", 0.05, 0.25, per="1/peak2"),
    Hiding(
        "torque_constant_drift",
        "torque_constant_drift",
        0.02,
        0.1,
        choices={"torque_constant_drift_s": (300.0, 600.0)},
    ),
    Hiding("inertia_error", "inertia_error", 0.05, 0.3, signed=True),
    # drive
    Hiding("current_limit", "current_limit_per_a", 1.5, 2.9, per="1/peak"),
    Hiding("current_lag", "current_lag_s", 0.1e-3, 1e-3),
    Hiding("velocity_filter", "velocity_filter_s", 0.2e-3, 3e-3),
    Hiding("integrator_clamp", "integrator_clamp_per_a", 1.5, 4.0, per="1/integral"),
    Hiding(
        "anti_windup",
        "anti_windup_per_s",
        100.0,
        1000.0,
        beside=_half_the_peak,
        also=("current_limit",),
    ),
    Hiding("inverter_dead_time", "dead_time_v", 0.2, 1.5),
    # command and clocks
    Hiding("transport_delay", "transport_delay_s", 0.1e-3, 8e-3),
    Hiding("command_slew", "command_slew_s2_per_rad", 1e-3, 8e-3, per="1/reversal"),
    Hiding("command_deadband", "command_deadband_rad_s", 0.02, 0.3, per="command"),
    Hiding("command_scale", "command_scale_error", 0.002, 0.01, signed=True),
    Hiding("command_offset", "command_offset_rad_s", 0.01, 0.2, per="command", signed=True),
    Hiding("clock_skew", "clock_skew", 5e-6, 100e-6, signed=True),
    Hiding("missed_samples", "missed_probability", 1e-3, 1e-2),
    # from rotor to load
    Hiding("backlash_width", "backlash_error_rad", 0.02, 0.25, per="gap", signed=True),
    Hiding(
        "position_dependent_backlash",
        "backlash_swing_rad",
        0.05,
        0.4,
        per="gap",
        phases=("backlash_swing_phase_rad",),
    ),
    Hiding("contact_stiffness", "contact_softness_rad15_per_nm", 1e-3, 20e-3),
    Hiding("contact_damping", "contact_damping_s_per_rad", 0.3, 10.0),
    Hiding(
        "coupling_compliance",
        "coupling_compliance_rad_per_nm",
        1 / 2000,
        1 / 20,
    ),
    Hiding(
        "load_inertia",
        "load_inertia_kg_m2",
        0.01,
        0.1,
        per="inertia",
        beside=_stopping,
        also=("load_friction",),
    ),
    Hiding("load_friction", "load_friction_nm", 2e-3, 30e-3),
    Hiding(
        "load_torque", "load_torque_nm", 5e-3, 100e-3, signed=True, beside=_load(0.04), also=LOAD
    ),
    Hiding(
        "gravity",
        "gravity_nm",
        2e-3,
        50e-3,
        phases=("gravity_phase_rad",),
        beside=_load(0.04),
        also=LOAD,
    ),
    # load encoder
    Hiding(
        "encoder_eccentricity",
        "eccentricity_rad",
        0.2e-3,
        4e-3,
        phases=("eccentricity_phase_rad",),
    ),
    Hiding("misalignment", "misalignment_rad", 0.0087, 0.0524),
    Hiding(
        "encoder_subdivision",
        "subdivision_rad",
        30e-6,
        400e-6,
        choices={"subdivision_lines": (256.0, 512.0)},
    ),
    Hiding("encoder_quantisation", "quantum_rad", 0.2e-3, 1.5e-3),
    # what somebody set in the drive
    Hiding("proportional_gain_error", "proportional_gain_error", 0.02, 0.2, signed=True),
    Hiding("integral_gain_error", "integral_gain_error", 0.03, 0.3, signed=True),
)

OUTSIDE_THE_CATALOGUE = (
    Hiding("air_drag", "air_drag_nm_s2_per_rad2", 0.3e-3, 3e-3, resembles=("viscous_friction",)),
    Hiding(
        "gear_mesh",
        "gear_mesh_nm",
        3e-3,
        20e-3,
        choices={"gear_mesh_order": (6.63, 17.37, 29.11)},
        resembles=("cogging",),
    ),
    Hiding(
        "hysteresis_brake",
        "hysteresis_brake_nm",
        3e-3,
        20e-3,
        choices={"hysteresis_brake_rad": (0.1, 0.3, 0.5)},
        resembles=("coulomb_friction", "presliding"),
    ),
    Hiding(
        "slipping_hub",
        "slip_per_nm",
        8.0,
        40.0,
        beside=_load(0.1, friction_nm=15e-3),
        also=("load_inertia", "load_friction"),
        resembles=("command_offset",),
    ),
    Hiding(
        "bracket_creep",
        "creep_rad_per_nm",
        50e-3,
        500e-3,
        choices={"creep_s": (0.2, 0.5, 1.0)},
    ),
    Hiding("supply_sag", "supply_sag_s_per_rad", 0.05, 0.25, per="1/command"),
    Hiding(
        "forgotten_notch",
        "notch_depth",
        0.5,
        1.0,
        choices={"notch_hz": (25.0, 40.0, 80.0)},
        resembles=("current_lag", "velocity_filter"),
    ),
    Hiding(
        "command_resampling",
        "command_resampling_s",
        2.3e-3,
        5e-3,
        resembles=("transport_delay",),
    ),
    Hiding("command_jitter", "command_jitter_s", 0.3e-3, 2e-3, resembles=("transport_delay",)),
    Hiding("bit_errors", "bit_errors_per_s", 0.2, 3.0, resembles=("missed_samples",)),
    Hiding("floor_vibration", "vibration_rad", 0.2e-3, 2e-3, choices={"vibration_hz": (23.0,)}),
    Hiding(
        "warming_gap",
        "backlash_warming",
        0.1,
        0.5,
        choices={"backlash_warming_s": (20.0, 60.0)},
        resembles=("backlash_width",),
    ),
    Hiding(
        "velocity_hold",
        "velocity_hold_s",
        1e-3,
        4e-3,
        resembles=("velocity_filter", "current_lag", "transport_delay"),
    ),
    Hiding("integrator_leak", "integrator_leak_per_s", 3.0, 30.0),
    Hiding(
        "friction_feedforward",
        "friction_feedforward_a",
        0.03,
        0.15,
        per="peak",
        resembles=("coulomb_friction", "command_scale"),
    ),
)

BY_NAME: Mapping[str, Hiding] = MappingProxyType(
    {hiding.name: hiding for hiding in IN_THE_CATALOGUE + OUTSIDE_THE_CATALOGUE}
)


@dataclass(frozen=True, slots=True)
class Ambiguity:
    """Effects that look the same; `unless` says what would tell them apart."""

    names: frozenset[str]
    unless: str


AMBIGUITIES = (
    Ambiguity(
        frozenset({"torque_constant_error", "inertia_error"}),
        "a torque or an inertia that is known otherwise: the drive's own torque is K_T i",
    ),
    Ambiguity(
        frozenset({"asymmetric_friction", "load_torque"}),
        "a dwell at w = 0, where friction takes what comes and a load torque must be held; or a "
        "gap, in which the load rests on one flank only",
    ),
    Ambiguity(
        frozenset({"command_deadband", "command_scale"}),
        "a command of more than one size",
    ),
)


def same_as(name: str) -> frozenset[str]:
    """All names that count as right where this one is hidden, itself among them."""
    return frozenset({name}).union(*(a.names for a in AMBIGUITIES if name in a.names))
