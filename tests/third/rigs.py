"""Seven rigs: what their files say, and how each of them is really built.

    A, D, G   a light load behind a gap, as on the paper's bench
    B, E      a rigid shaft
    C, F      a coupling that the rig's file has; E, C and F tell their friction as well

`built` draws a rig's hardware: nominal values within their tolerances, and what every rig has
beside them. None of it is worth a name: each is below what docs/diagnosis.md calls a cause ("What
every rig has", and half a percent of tau for cogging 24 times a turn).
"""

import math
from typing import NamedTuple

import numpy as np

from tests.third.plant import Axis, Link

STEP_S = 7.8125e-6
"""Of the integrator: a faces' bounce of the lightest load lasts ten."""
CURRENT_LAG_S = 40e-6
DETENT_ORDER = 24.0
OVERLOAD = 3.0
"""Largest torque over the rated one."""
INERTIA_SHARE, TORQUE_CONSTANT_SHARE = 0.003, 0.002
"""Tolerances, either way: K_T/J stays within half a percent."""


class Coupling(NamedTuple):
    """A shaft coupling: T = twist/compliance + damping/compliance times its rate."""

    compliance_rad_per_nm: float
    damping_s: float
    load_inertia_kg_m2: float


class Friction(NamedTuple):
    """That the rig's file tells of the motor's bearings."""

    coulomb_nm: float
    viscous_nm_s_per_rad: float


class Wheel(NamedTuple):
    """The load behind a gap: its own inertia and friction, and its faces' stiffness at 0.1 mrad."""

    inertia_kg_m2: float
    friction_nm: float
    stiffness_nm_per_rad: float


class Rig(NamedTuple):
    """One rig. `detent_nm` and `bearing_nm` are what no file tells of its motor."""

    name: str
    inertia_kg_m2: float
    torque_constant_nm_per_a: float
    natural_rad_s: float
    damping_ratio: float
    period_s: float
    tick_s: float
    motor_bits: int
    load_bits: int
    rated_nm: float
    velocity_rad_s: float
    travel_rad: float
    detent_nm: float
    bearing_nm: float = 0.0
    gap_rad: float = 0.0
    wheel: Wheel | None = None
    coupling: Coupling | None = None
    friction: Friction | None = None
    tells_torque: bool = True
    tells_current: bool = False

    @property
    def letter(self) -> str:
        """A to G."""
        return self.name[-1].upper()

    @property
    def proportional_gain_a_s_per_rad(self) -> float:
        """K_P = 2 zeta wn J/K_T, as rounded in the rig's file."""
        per_gain = self.inertia_kg_m2 / self.torque_constant_nm_per_a
        return round(2.0 * self.damping_ratio * self.natural_rad_s * per_gain, 7)

    @property
    def integral_gain_a_per_rad(self) -> float:
        """K_I = wn^2 J/K_T, as rounded in the rig's file."""
        per_gain = self.inertia_kg_m2 / self.torque_constant_nm_per_a
        return round(self.natural_rad_s**2 * per_gain, 6)

    @property
    def motor_count_rad(self) -> float:
        """One count of the motor's encoder, rad."""
        return 2.0 * math.pi / (1 << self.motor_bits)

    @property
    def load_count_rad(self) -> float:
        """One count of the load's encoder, rad."""
        return 2.0 * math.pi / (1 << self.load_bits)

    @property
    def rated_a(self) -> float:
        """What current per mille is of, A."""
        return round(self.rated_nm / self.torque_constant_nm_per_a, 2)

    @property
    def tau_nm(self) -> float:
        """A tenth of what a motor of this inertia is rated for (docs/diagnosis.md), N m."""
        return float(max(36e-3 * (self.inertia_kg_m2 / 2.5e-4) ** 0.6, 20.8e-3))


def _gap_rad(degrees: float) -> float:
    """As rounded in the rig's file."""
    return round(math.radians(degrees), 7)


A = Rig(
    name="bench-a",
    inertia_kg_m2=2.5e-4,
    torque_constant_nm_per_a=0.036,
    natural_rad_s=62.5,
    damping_ratio=0.5,
    period_s=0.008,
    tick_s=125e-6,
    motor_bits=20,
    load_bits=16,
    rated_nm=0.64,
    velocity_rad_s=8.0,
    travel_rad=25.0,
    detent_nm=1e-4,
    bearing_nm=1.5e-4,
    gap_rad=_gap_rad(1.2),
    wheel=Wheel(5e-8, 2e-4, 150.0),
)
B = Rig(
    name="bench-b",
    inertia_kg_m2=1.0e-4,
    torque_constant_nm_per_a=0.050,
    natural_rad_s=100.0,
    damping_ratio=0.7,
    period_s=0.004,
    tick_s=62.5e-6,
    motor_bits=20,
    load_bits=17,
    rated_nm=0.32,
    velocity_rad_s=14.0,
    travel_rad=80.0,
    detent_nm=1e-4,
    bearing_nm=2e-4,
    tells_current=True,
)
C = Rig(
    name="bench-c",
    inertia_kg_m2=6.0e-4,
    torque_constant_nm_per_a=0.090,
    natural_rad_s=40.0,
    damping_ratio=0.7,
    period_s=0.008,
    tick_s=125e-6,
    motor_bits=20,
    load_bits=16,
    rated_nm=1.0,
    velocity_rad_s=12.0,
    travel_rad=80.0,
    detent_nm=3e-4,
    coupling=Coupling(0.004, 3e-4, 2.5e-4),
    friction=Friction(6e-3, 4e-4),
)
D = Rig(
    name="bench-d",
    inertia_kg_m2=5.0e-5,
    torque_constant_nm_per_a=0.030,
    natural_rad_s=90.0,
    damping_ratio=0.6,
    period_s=0.004,
    tick_s=62.5e-6,
    motor_bits=19,
    load_bits=15,
    rated_nm=0.16,
    velocity_rad_s=12.0,
    travel_rad=60.0,
    detent_nm=3e-5,
    bearing_nm=4e-5,
    gap_rad=_gap_rad(0.6),
    wheel=Wheel(2e-8, 8e-5, 60.0),
)
E = Rig(
    name="bench-e",
    inertia_kg_m2=1.0e-3,
    torque_constant_nm_per_a=0.120,
    natural_rad_s=30.0,
    damping_ratio=0.8,
    period_s=0.008,
    tick_s=250e-6,
    motor_bits=17,
    load_bits=14,
    rated_nm=2.4,
    velocity_rad_s=16.0,
    travel_rad=120.0,
    detent_nm=4e-4,
    friction=Friction(1.2e-2, 6e-4),
    tells_current=True,
)
F = Rig(
    name="bench-f",
    inertia_kg_m2=3.0e-4,
    torque_constant_nm_per_a=0.060,
    natural_rad_s=75.0,
    damping_ratio=0.6,
    period_s=0.004,
    tick_s=125e-6,
    motor_bits=20,
    load_bits=17,
    rated_nm=0.8,
    velocity_rad_s=12.0,
    travel_rad=80.0,
    detent_nm=2e-4,
    coupling=Coupling(0.005, 2e-4, 6e-5),
    friction=Friction(4e-3, 2e-4),
    tells_torque=False,
    tells_current=True,
)
G = Rig(
    name="bench-g",
    inertia_kg_m2=2.0e-4,
    torque_constant_nm_per_a=0.040,
    natural_rad_s=55.0,
    damping_ratio=0.5,
    period_s=0.008,
    tick_s=125e-6,
    motor_bits=20,
    load_bits=12,
    rated_nm=0.32,
    velocity_rad_s=9.0,
    travel_rad=40.0,
    detent_nm=7e-5,
    bearing_nm=1e-4,
    gap_rad=_gap_rad(0.9),
    wheel=Wheel(4e-8, 1.5e-4, 120.0),
)
RIGS = (A, B, C, D, E, F, G)


def built(rig: Rig, rng: np.random.Generator) -> Axis:
    """The rig's hardware, nothing hidden: every number within its tolerance."""

    def near(value: float, share: float) -> float:
        return value * (1.0 + share * float(rng.uniform(-1.0, 1.0)))

    axis = Axis(
        inertia_kg_m2=near(rig.inertia_kg_m2, INERTIA_SHARE),
        torque_constant_nm_per_a=near(rig.torque_constant_nm_per_a, TORQUE_CONSTANT_SHARE),
        current_lag_s=CURRENT_LAG_S,
        coulomb_nm=rig.bearing_nm,
        detent_nm=rig.detent_nm,
        detent_order=DETENT_ORDER,
        detent_phase_rad=float(rng.uniform(-math.pi, math.pi)),
        tick_s=rig.tick_s,
        substeps=round(rig.tick_s / STEP_S),
        proportional_gain_a_s_per_rad=rig.proportional_gain_a_s_per_rad,
        integral_gain_a_per_rad=rig.integral_gain_a_per_rad,
        current_limit_a=OVERLOAD * rig.rated_nm / rig.torque_constant_nm_per_a,
        motor_count_rad=rig.motor_count_rad,
    )
    if rig.friction is not None:
        axis = axis._replace(
            coulomb_nm=near(rig.friction.coulomb_nm, 0.03),
            viscous_nm_s_per_rad=near(rig.friction.viscous_nm_s_per_rad, 0.03),
        )
    if rig.coupling is not None:
        stiffness = 1.0 / near(rig.coupling.compliance_rad_per_nm, 0.02)
        axis = axis._replace(
            link=Link.COUPLING,
            inertia_kg_m2=axis.inertia_kg_m2 - rig.coupling.load_inertia_kg_m2,
            load_inertia_kg_m2=near(rig.coupling.load_inertia_kg_m2, 0.003),
            stiffness_nm_per_rad=stiffness,
            coupling_damping_nm_s_per_rad=stiffness * near(rig.coupling.damping_s, 0.05),
        )
    if rig.wheel is not None:
        axis = axis._replace(
            link=Link.FACES,
            inertia_kg_m2=axis.inertia_kg_m2 - rig.wheel.inertia_kg_m2,
            load_inertia_kg_m2=near(rig.wheel.inertia_kg_m2, 0.02),
            stiffness_nm_per_rad=near(rig.wheel.stiffness_nm_per_rad, 0.2),
            face_damping_s_per_rad=near(0.15, 0.2),
            gap_rad=near(rig.gap_rad, 0.005),
            load_friction_nm=near(rig.wheel.friction_nm, 0.03),
        )
    return axis


def rig_toml(rig: Rig) -> str:
    """The rig's file, with nothing simulated."""
    text = f"""name = "{rig.name}"

[nominal]
torque_constant_nm_per_a = {rig.torque_constant_nm_per_a!r}
inertia_kg_m2 = {rig.inertia_kg_m2!r}
proportional_gain_a_s_per_rad = {rig.proportional_gain_a_s_per_rad!r}
integral_gain_a_per_rad = {rig.integral_gain_a_per_rad!r}
backlash_gap_rad = {rig.gap_rad!r}

[bus]
interface = "socketcand"
host = "127.0.0.1"
port = 29536
channel = "can0"
tcp_tune = true

[drive]
node_id = 1
eds = "eds/sim_drive.eds"
vendor_id = 0
product_code = 402
counts_per_revolution = {1 << rig.motor_bits}

[encoder]
node_id = 2
eds = "eds/sim_encoder.eds"
vendor_id = 0
product_code = 406
counts_per_revolution = {1 << rig.load_bits}

[limits]
velocity_rad_s = {rig.velocity_rad_s!r}
travel_rad = {rig.travel_rad!r}
run_time_s = 3600
"""
    if rig.friction is not None:
        text += f"""
[effects.coulomb]
torque_nm = {rig.friction.coulomb_nm!r}
transition_rad_s = 0.05

[effects.viscous]
damping_nm_s_per_rad = {rig.friction.viscous_nm_s_per_rad!r}
"""
    if rig.coupling is not None:
        text += f"""
[effects.coupling_compliance]
compliance_rad_per_nm = {rig.coupling.compliance_rad_per_nm!r}
damping_s = {rig.coupling.damping_s!r}
load_inertia_kg_m2 = {rig.coupling.load_inertia_kg_m2!r}
"""
    return text
