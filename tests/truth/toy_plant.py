"""A second hand's servo axis: a digital PI drive, a rotor, a coupling with play, an encoder shaft.

It shares no equation, no integrator, and no step with the software rig's own model, and knows of
it only the two methods of `sim_rig.plant.Plant`. A model that is fitted to this plant meets what a
model meets on a real rig: things that are there and that it does not have.

    loop, every 250 us     w~ = (n_k - n_(k-1)) q / T        n: counts of the motor encoder
                           x += K_I T (r - w~)
                           i* = K_P (r - w~) + x
    current                tau di/dt = i* - i
    rotor                  (J - J_l) dw/dt   in  K_T i + noise - B w - c - T_m Sgn(w)
    encoder shaft          J_l dw_l/dt       in  c - T_l Sgn(w_l)
    contact                c = +-max(0, k p^1.5 (1 + chi dp/dt)),   p = |th - th_l| - gap / 2 > 0

The nominal J is rotor and shaft together. Sgn is set-valued: at rest friction takes any value up
to its limit and holds. The contact is Hertz's with the damping of Hunt and Crossley (J. Appl.
Mech. 42, 1975), and never pulls. The noise is torque ripple of the power stage, drawn once per
loop period, absent while the stage is off.

Integrator: Moreau's time stepping (half drift, kick, half drift). The current's mean over a step
is exact, the contact's damping is implicit in its own impulse, friction is the projection that
the set-valued law asks for. Hertz's force starts with zero slope, so contact needs no events.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from sim_rig.plant import Plant, PlantOutputs


class NominalValues(Protocol):
    """What is read of a rig's nominal values."""

    @property
    def torque_constant_nm_per_a(self) -> float: ...
    @property
    def inertia_kg_m2(self) -> float: ...
    @property
    def proportional_gain_a_s_per_rad(self) -> float: ...
    @property
    def integral_gain_a_per_rad(self) -> float: ...
    @property
    def backlash_gap_rad(self) -> float: ...


@dataclass(frozen=True, slots=True)
class ToyTruth:
    """What the axis really is, beside its nominal values; a gap of None is the nominal one.

    Friction is far below a servo motor's usual 1-5 % of rated torque: a nuisance here, not an
    effect. The shaft is the rotor of a small encoder; its friction stops it faster than the drive
    can slow the motor down, so it stays where it is left in the gap.
    """

    backlash_gap_rad: float | None = None
    loop_period_s: float = 250e-6
    substeps: int = 4
    current_lag_s: float = 60e-6
    motor_counts_per_revolution: int = 1 << 20
    motor_friction_nm: float = 0.3e-3
    motor_viscous_nm_s_per_rad: float = 2e-5
    load_inertia_kg_m2: float = 3e-7
    load_friction_nm: float = 0.3e-3
    contact_stiffness_nm_per_rad15: float = 400.0
    contact_damping_s_per_rad: float = 0.5
    torque_noise_nm: float = 0.2e-3

    @property
    def step_s(self) -> float:
        """The integrator's step."""
        return self.loop_period_s / self.substeps


class ToyPlant:
    """The axis behind the `Plant` protocol, at rest, the load somewhere in the gap (seeded)."""

    def __init__(self, nominal: NominalValues, seed: int, truth: ToyTruth) -> None:
        gap_rad = truth.backlash_gap_rad
        self._nominal = nominal
        self._truth = truth
        self._half_gap_rad = (nominal.backlash_gap_rad if gap_rad is None else gap_rad) / 2.0
        rng = np.random.default_rng(seed)
        self._motor_rad = 0.0
        self._motor_rad_s = 0.0
        self._load_rad = float(rng.uniform(-0.8, 0.8)) * self._half_gap_rad
        self._load_rad_s = 0.0
        self._current_a = 0.0
        self._integral_a = 0.0
        self._reference_a = 0.0
        self._ripple_nm = 0.0
        self._count = 0
        self._ripple = _white(rng, truth.torque_noise_nm)
        self._elapsed_s = 0.0
        self._steps = 0

    def advance(self, velocity_command_rad_s: float | None, duration_s: float) -> None:
        """Hold the command for `duration_s`; the loop takes it up at its next own period."""
        self._elapsed_s += duration_s
        due = math.floor(self._elapsed_s / self._truth.step_s + 1e-6)
        while self._steps < due:
            into_period = self._steps % self._truth.substeps
            if into_period == 0:
                self._control(velocity_command_rad_s)
            steps = min(self._truth.substeps - into_period, due - self._steps)
            self._move(steps)
            self._steps += steps

    def outputs(self) -> PlantOutputs:
        """The state now; within a step, angles go on at their velocities."""
        rest_s = self._elapsed_s - self._steps * self._truth.step_s
        return PlantOutputs(
            motor_position_rad=self._motor_rad + rest_s * self._motor_rad_s,
            motor_velocity_rad_s=self._motor_rad_s,
            motor_current_a=self._current_a,
            load_angle_rad=self._load_rad + rest_s * self._load_rad_s,
        )

    def energy_j(self) -> float:
        """Kinetic energy of both inertias and what the contact stores: (2/5) k p^2.5."""
        truth = self._truth
        pressed_rad = abs(self._motor_rad - self._load_rad) - self._half_gap_rad
        return (
            0.5 * (self._nominal.inertia_kg_m2 - truth.load_inertia_kg_m2) * self._motor_rad_s**2
            + 0.5 * truth.load_inertia_kg_m2 * self._load_rad_s**2
            + 0.4 * truth.contact_stiffness_nm_per_rad15 * math.pow(max(0.0, pressed_rad), 2.5)
        )

    def _control(self, velocity_command_rad_s: float | None) -> None:
        """One period of the digital velocity loop; with the power stage off it only counts."""
        nominal, truth = self._nominal, self._truth
        quantum_rad = math.tau / truth.motor_counts_per_revolution
        count = math.floor(self._motor_rad / quantum_rad)
        measured_rad_s = (count - self._count) * quantum_rad / truth.loop_period_s
        self._count = count
        if velocity_command_rad_s is None:
            self._integral_a = self._reference_a = self._ripple_nm = 0.0
            return
        error_rad_s = velocity_command_rad_s - measured_rad_s
        self._integral_a += nominal.integral_gain_a_per_rad * truth.loop_period_s * error_rad_s
        self._reference_a = nominal.proportional_gain_a_s_per_rad * error_rad_s + self._integral_a
        self._ripple_nm = next(self._ripple)

    def _move(self, steps: int) -> None:
        """Integrate `steps` steps; symbols as in the module's docstring, all in locals (speed)."""
        truth, h = self._truth, self._truth.step_s
        per_motor = h / (self._nominal.inertia_kg_m2 - truth.load_inertia_kg_m2)
        per_load = h / truth.load_inertia_kg_m2
        motor_stop = per_motor * truth.motor_friction_nm
        load_stop = per_load * truth.load_friction_nm
        drag = 1.0 - per_motor * truth.motor_viscous_nm_s_per_rad
        decay = math.exp(-h / truth.current_lag_s)
        mean = (1.0 - decay) * truth.current_lag_s / h
        k, chi = truth.contact_stiffness_nm_per_rad15, truth.contact_damping_s_per_rad
        implicit = 0.5 * chi * (per_motor + per_load)
        torque_constant, ripple = self._nominal.torque_constant_nm_per_a, self._ripple_nm
        reference, half_gap, half_h = self._reference_a, self._half_gap_rad, 0.5 * h
        th, w, th_l, w_l = self._motor_rad, self._motor_rad_s, self._load_rad, self._load_rad_s
        lag = self._current_a - reference
        for _ in range(steps):
            th += half_h * w
            th_l += half_h * w_l
            w = drag * w + per_motor * (torque_constant * (reference + mean * lag) + ripple)
            lag *= decay
            twist = th - th_l
            if twist > half_gap or twist < -half_gap:
                side = 1.0 if twist > 0.0 else -1.0
                pressed = side * twist - half_gap
                elastic = k * pressed * math.sqrt(pressed)
                torque = elastic * (1.0 + chi * side * (w - w_l)) / (1.0 + elastic * implicit)
                if torque > 0.0:
                    w -= per_motor * side * torque
                    w_l += per_load * side * torque
            if w > motor_stop:
                w -= motor_stop
            elif w < -motor_stop:
                w += motor_stop
            else:
                w = 0.0
            if w_l > load_stop:
                w_l -= load_stop
            elif w_l < -load_stop:
                w_l += load_stop
            else:
                w_l = 0.0
            th += half_h * w
            th_l += half_h * w_l
        self._motor_rad, self._motor_rad_s, self._load_rad, self._load_rad_s = th, w, th_l, w_l
        self._current_a = reference + lag


def _white(rng: np.random.Generator, deviation: float, block: int = 4096) -> Iterator[float]:
    """White Gaussian numbers without end."""
    while True:
        yield from rng.normal(0.0, deviation, block).tolist()


def make(nominal: NominalValues, seed: int) -> Plant:
    """The axis whose gap is the nominal one: "tests.truth.toy_plant:make" in a rig's settings."""
    return ToyPlant(nominal, seed, ToyTruth())


def hidden(**changes: Any) -> Callable[[NominalValues, int], Plant]:
    """A factory like `make` for an axis with some of `ToyTruth`'s values changed."""
    truth = replace(ToyTruth(), **changes)

    def make_changed(nominal: NominalValues, seed: int) -> Plant:
        return ToyPlant(nominal, seed, truth)

    return make_changed
