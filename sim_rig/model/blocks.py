"""Each block alone, from its measured input to its own output; the same page, the loop cut open.

    controller     command, motor motion -> current
    mechanics      current               -> motor motion
    transmission   motor motion          -> load angle

Samples are taken at the slots' beginnings: n samples, n - 1 durations, n values out; the first
comes `time_s` after the rig's clock began, by which frictions warm and clocks fall apart. Between
samples motion is the cubic through angles and velocities, and current a straight line, so its
jumps at command edges want samples at 1 kHz or more.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from sim_rig.errors import SimulationError
from sim_rig.model.model import Model
from sim_rig.model.running import Inputs, checked_durations, own_array, play
from sim_rig.model.skeleton import MECHANICS, MOTION
from sim_rig.model.state import Array, ModelState, Simulated


class MotorMotion(NamedTuple):
    """Angle and velocity of the motor at every sample."""

    angle_rad: Array
    velocity_rad_s: Array


def controller(
    model: Model,
    durations_s: ArrayLike,
    commands_rad_s: ArrayLike,
    motor_angle_rad: ArrayLike,
    motor_velocity_rad_s: ArrayLike | None = None,
    *,
    integral_rad: float = 0.0,
    time_s: float = 0.0,
) -> Array:
    """The current, A, at every sample, before that sample's command acts. n - 1 commands.

    The first value is what the integrator's state at the start makes of the first velocity. A clock
    of commands that is ahead (`clock_skew` below zero) is not played here: in the whole loop only.
    """
    commands = own_array(commands_rad_s)
    done = _from_motion(
        *(model, durations_s, commands, motor_angle_rad, motor_velocity_rad_s),
        Start(integral_rad, None, time_s),
    )
    return np.append(done.motor_current_a, done.end.recorded[2])


def mechanics(
    model: Model,
    durations_s: ArrayLike,
    current_a: ArrayLike,
    *,
    angle_rad: float = 0.0,
    velocity_rad_s: float = 0.0,
    time_s: float = 0.0,
) -> MotorMotion:
    """The motor's motion under a current, A, shape (n,). The load, if elastic, goes with it."""
    current = _samples("current_a", current_a)
    durations = checked_durations(current[1:], durations_s)
    given = np.zeros((durations.size, 4))
    given[:, 0] = current[:-1]
    given[:, 1] = np.diff(current) / durations
    start = model.state(
        motor_angle_rad=angle_rad,
        motor_velocity_rad_s=velocity_rad_s,
        load_angle_rad=angle_rad,
        load_velocity_rad_s=velocity_rad_s,
        command_rad_s=0.0,
        time_s=time_s,
    )
    done = play(model, Inputs(np.zeros(durations.size), durations, given, MECHANICS), start)
    return MotorMotion(
        np.append(done.motor_angle_rad, done.end.recorded[0]),
        np.append(done.motor_velocity_rad_s, done.end.recorded[1]),
    )


def transmission(
    model: Model,
    durations_s: ArrayLike,
    motor_angle_rad: ArrayLike,
    motor_velocity_rad_s: ArrayLike | None = None,
    *,
    load_angle_rad: float | None = None,
    time_s: float = 0.0,
) -> Array:
    """The recorded load angle, rad, at every sample; the load begins mid-gap unless told."""
    samples = np.zeros(_samples("motor_angle_rad", motor_angle_rad).size - 1)
    done = _from_motion(
        *(model, durations_s, samples, motor_angle_rad, motor_velocity_rad_s),
        Start(0.0, load_angle_rad, time_s),
    )
    return np.append(done.load_angle_rad, done.end.recorded[3])


def _samples(name: str, values: ArrayLike) -> Array:
    samples = own_array(values)
    if samples.ndim != 1 or samples.size < 2 or not np.isfinite(samples).all():
        raise SimulationError(
            f"{name} of shape {samples.shape}: give one row of at least two finite samples."
        )
    return samples


class Start(NamedTuple):
    """Where a block begins, beside the motor's motion."""

    integral_rad: float
    load_angle_rad: float | None
    time_s: float


def _from_motion(  # noqa: PLR0917 - the two blocks' common ground
    model: Model,
    durations_s: ArrayLike,
    commands: Array,
    motor_angle_rad: ArrayLike,
    motor_velocity_rad_s: ArrayLike | None,
    begin: Start,
) -> Simulated:
    angle = _samples("motor_angle_rad", motor_angle_rad)
    durations = checked_durations(angle[1:], durations_s)
    if commands.shape != durations.shape:
        raise SimulationError(
            f"{commands.size} commands for {angle.size} samples: give one for each slot between "
            f"two samples, {angle.size - 1}."
        )
    if motor_velocity_rad_s is None:
        from scipy.interpolate import CubicSpline  # noqa: PLC0415 - slow to import, seldom needed

        times = np.concatenate(([0.0], np.cumsum(durations)))
        velocity: Array = CubicSpline(times, angle)(times, 1)
    else:
        velocity = _samples("motor_velocity_rad_s", motor_velocity_rad_s)
    start: ModelState = model.state(
        motor_angle_rad=float(angle[0]),
        motor_velocity_rad_s=float(velocity[0]),
        integral_rad=begin.integral_rad,
        load_angle_rad=float(angle[0]) if begin.load_angle_rad is None else begin.load_angle_rad,
        load_velocity_rad_s=0.0,
        command_rad_s=float(commands[0]),
        time_s=begin.time_s,
    )
    given = cubic_motion(angle, velocity, durations)
    return play(model, Inputs(commands, durations, given, MOTION), start)


def cubic_motion(angle: Array, velocity: Array, durations: Array) -> Array:
    """Angle, velocity, acceleration and its slope at every slot's start: shape (slots, 4)."""
    mean = np.diff(angle) / durations
    first, second = velocity[:-1], velocity[1:]
    acceleration = (6.0 * mean - 4.0 * first - 2.0 * second) / durations
    slope = (6.0 * (first + second) - 12.0 * mean) / durations**2
    return np.stack((angle[:-1], first, acceleration, slope), axis=1)
