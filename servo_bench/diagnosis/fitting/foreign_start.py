"""The model that a fit of data from elsewhere starts from, where no rig and no model is given.

What the map's plant says is taken. What nobody published is found by least squares over short
stretches, roughly, because a fit looks for it within a tenth and ten times of where it starts:

    d omega = g int effort + h int omega + c int sgn(omega) (+ s int sin(angle)) + rest

J = K/g, and with a pendulum, whose weight is known, J = -m g l/s and K = g J. K is the torque per
unit of the effort, K_T for a current and K_T/R for a voltage; one where nothing is known of it.
"""

import numpy as np

from servo_bench.diagnosis.fitting.driven import resistance_ohm
from servo_bench.diagnosis.fitting.foreign_channels import (
    Array,
    Motion,
    Stretch,
    effort_of,
    stretches,
    torque_of,
    with_voltage,
)
from servo_bench.diagnosis.fitting.twist import compare_locked
from servo_bench.errors import ConfigError, FitError
from servo_bench.recording.plant import ForeignPlant
from servo_bench.recording.recording import Recording
from sim_rig.model import Model
from sim_rig.settings import Nominal

GRAVITY_M_S2 = 9.80665
ROWS = 32
"""Points of an even stretch (two to a sample) from one end of an increment to the other."""
ALMOST_NONE = 1e-6
"""A proportional gain of a loop that has none, over its integral gain times a second."""


def starting_model(recording: Recording) -> Model:
    """From the recording's plant and its data.

    Raises ConfigError where the recording is of a rig of its own kind, FitError where neither an
    effort with its motion, nor a position loop of known gain, nor a locked output was recorded.
    """
    plant = recording.plant
    if plant is None:
        raise ConfigError(
            "the recording says nothing of its rig: give --rig RIG.toml, or --model MODEL.toml "
            "with [nominal]."
        )
    if plant.output_locked:
        return _locked(recording)
    recording = with_voltage(recording)
    effort = effort_of(recording)
    told = plant.axis_nm_per_a or 1.0
    inertia, torque_constant, drag = _inertia(recording, plant, effort, told)
    loop, gain = plant.position_loop, 1.0
    ohm = resistance_ohm(recording)
    if loop is not None:
        gain = loop.proportional_gain_v_per_rad / ohm
    nominal = Nominal(
        torque_constant_nm_per_a=torque_constant,
        inertia_kg_m2=inertia,
        proportional_gain_a_s_per_rad=ALMOST_NONE * gain,
        integral_gain_a_per_rad=gain,
        backlash_gap_rad=0.0,
    )
    model = Model(nominal)
    if plant.pendulum is not None:
        weight = plant.pendulum.mass_kg * GRAVITY_M_S2 * plant.pendulum.length_m
        model = model.with_effect("gravity_imbalance", torque_nm=weight)
    if loop is not None and loop.voltage_limit_v is not None:
        model = model.with_effect("current_limit", limit_per_a=ohm / loop.voltage_limit_v)
    if effort == "voltage_v" and plant.resistance_ohm is None and drag > 0.0:
        model = model.with_effect("viscous", damping_nm_s_per_rad=drag)
    return model


def _locked(recording: Recording) -> Model:
    """Half of the range a gap, half a spring, and a tenth of the torque friction."""
    seen = compare_locked(recording)
    plant = recording.plant
    twist, peak = float(np.ptp(seen.measured)), float(np.abs(seen.torque).max())
    torque_constant = (plant and plant.axis_nm_per_a) or 1.0
    peak *= torque_constant if torque_of(recording) == "current_a" else 1.0
    gap = (plant and plant.backlash_gap_rad) or 0.5 * twist
    model = Model(Nominal(torque_constant, (plant and plant.inertia_kg_m2) or 1e-3, 1.0, 1.0, gap))
    model = model.with_effect("coupling_compliance", compliance_rad_per_nm=0.25 * twist / peak)
    return model.with_effect("coulomb", torque_nm=0.1 * peak)


def _inertia(
    recording: Recording, plant: ForeignPlant, effort: str, told: float
) -> tuple[float, float, float]:
    """(J, K_T, viscous damping) as far as the plant does not say them."""
    per_unit = 1.0
    ohm = resistance_ohm(recording)
    if effort in ("motor_torque_nm", "torque_nm"):
        per_unit = 1.0 / told  # a torque is played as a current
    found, weight = _regressed(recording, effort), 0.0
    grip = found[0]
    if not grip > 0.0:
        raise FitError(
            f"the motion does not follow {effort}: acceleration over it has the slope {grip:.3g}. "
            "Is its sign right in the map? Else give --model MODEL.toml to start from."
        )
    constant = told * per_unit / ohm if effort == "voltage_v" else told * per_unit
    inertia = plant.inertia_kg_m2 or constant / grip
    if plant.pendulum is not None:
        mass, length = plant.pendulum.mass_kg, plant.pendulum.length_m
        weight = mass * GRAVITY_M_S2 * length
        hanging = weight / -found[3] if found[3] < 0.0 else 2.0 * mass * length**2
        inertia = max(hanging, mass * length**2)
        if plant.inertia_kg_m2 is not None:
            inertia = plant.inertia_kg_m2 + mass * length**2
        if plant.torque_constant_nm_per_a is None:
            told = grip * inertia * ohm if effort == "voltage_v" else grip * inertia
    return inertia, told, max(-found[1], 0.0) * inertia


def _regressed(recording: Recording, effort: str) -> Array:
    """(g, h, c, s): acceleration over effort, velocity, its sign, and the angle's sine."""
    motion: Motion = "motor_position_rad"
    if motion not in recording:
        motion = "motor_velocity_rad_s"
    parts = [_increments(part) for part in stretches(recording, 0, motion, effort)]
    if not parts:
        raise FitError(
            f"no stretch of {effort} and {motion} is long enough to start from: record two seconds "
            "without a hole, or give --model MODEL.toml to start from."
        )
    gained, columns = np.concatenate([p[0] for p in parts]), np.vstack([p[1] for p in parts])
    scale = np.linalg.norm(columns, axis=0)
    scale = np.where(scale > 0.0, scale, 1.0)
    found: Array = np.linalg.lstsq(columns / scale, gained)[0] / scale
    return found


def _increments(part: Stretch) -> tuple[Array, Array]:
    """What the velocity gained over `ROWS` points, and what may have made it."""
    speed, step_s = part.velocity_rad_s, part.step_s
    count = (speed.size - 1) // ROWS

    def mean(values: Array) -> Array:
        return np.asarray(values[: count * ROWS].reshape(count, ROWS).mean(axis=1))

    slow = mean(speed)
    apart_s = 2.0 * ROWS * step_s
    gained = (slow[2:] - slow[:-2]) / apart_s
    sources = (
        part.effort,
        speed,
        np.sign(speed),
        np.nan_to_num(np.sin(part.angle_rad)),
        np.ones(speed.size),
    )
    means = [mean(values) for values in sources]
    # the mean of three neighbours, weighed as the difference of the two outer means weighs them
    columns = [0.25 * m[:-2] + 0.5 * m[1:-1] + 0.25 * m[2:] for m in means]
    return gained, np.stack(columns, axis=1)
