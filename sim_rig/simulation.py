"""The paper's rig without a wire: a row of commands in, angles and current at every ask out.

The same steps as `paper_plant`, so a run over the wire and `simulate` with its recorded SYNC
times agree to rounding; here whole slots are taken at once.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sim_rig.errors import RigSettingsError
from sim_rig.motor import MotorState, Step, doubling_steps, motor_current_a, step_lengths_us
from sim_rig.play import Limits
from sim_rig.settings import Nominal

Array = NDArray[np.float64]


class RigState(NamedTuple):
    """Where a simulation starts and where it stopped.

    `command_rad_s` is what the motor is being told at the time, None with the power stage off.
    """

    motor: MotorState = MotorState()
    load_angle_rad: float = 0.0
    command_rad_s: float | None = None


class Simulated(NamedTuple):
    """The rig at every ask, before that slot's command acts: arrays of shape (slots,), SI.

    `motor_current_a` is thus what the command of the slot before still draws.
    """

    motor_angle_rad: Array
    motor_velocity_rad_s: Array
    motor_current_a: Array
    load_angle_rad: Array
    end: RigState


def simulate(
    nominal: Nominal,
    commands_rad_s: ArrayLike,
    durations_s: ArrayLike,
    start: RigState = RigState(),  # noqa: B008 - a NamedTuple of floats, immutable
) -> Simulated:
    """Play slot after slot: hold command k, shape (slots,), for duration k, shape (slots,) or ().

    Durations are taken to the whole microsecond. The motor is a linear recurrence over slots;
    the play sees the motor after every step of at most 512 us inside them.
    Raises RigSettingsError where shapes or durations make no sense.
    """
    commands = np.atleast_1d(np.asarray(commands_rad_s, np.float64))
    durations_us = _whole_microseconds(durations_s, commands)
    states = _motor_states(nominal, commands, durations_us, start.motor)
    theta, omega, z = states[:-1].T
    load, end_load = _load_angles(nominal, states[:-1], commands, durations_us, start)
    held = np.concatenate(([start.command_rad_s or 0.0], commands))
    current = motor_current_a(nominal, held[:-1], omega, z)
    if current.size and start.command_rad_s is None:
        current[0] = 0.0
    end_theta, end_omega, end_z = (float(value) for value in states[-1])
    end = RigState(
        MotorState(end_theta, end_omega, end_z),
        end_load,
        float(commands[-1]) if commands.size else start.command_rad_s,
    )
    return Simulated(theta.copy(), omega.copy(), current, load, end)


def _whole_microseconds(durations_s: ArrayLike, commands: Array) -> NDArray[np.int64]:
    durations = np.asarray(durations_s, np.float64)
    if commands.ndim != 1 or durations.shape not in ((), commands.shape):
        raise RigSettingsError(
            f"commands of shape {commands.shape} and durations of shape {durations.shape}: "
            "give one row of commands, and one duration for each or one for all."
        )
    finite = np.isfinite(commands).all() and np.isfinite(durations).all()
    if not finite or (durations < 0).any():
        raise RigSettingsError("commands must be finite, and durations finite and not negative.")
    return np.broadcast_to(np.rint(durations * 1e6).astype(np.int64), commands.shape)


def _step_row(nominal: Nominal, duration_us: int) -> Iterator[Step]:
    """The step to the end of each part of a duration, all from its beginning."""
    steps = doubling_steps(nominal)
    so_far = Step(np.eye(3), np.zeros(3))
    for length in step_lengths_us(duration_us):
        so_far = so_far.then(steps[length])
        yield so_far


def _motor_states(
    nominal: Nominal, commands: Array, durations_us: NDArray[np.int64], start: MotorState
) -> Array:
    """(theta, omega, z) at every ask and at the end: shape (slots + 1, 3)."""
    identity = Step(np.eye(3), np.zeros(3))
    wholes = {}
    for us in np.unique(durations_us).tolist():
        whole = identity
        for whole in _step_row(nominal, us):  # noqa: B007 - the last one is meant
            pass
        wholes[us] = (*whole.phi[:, 1:].ravel().tolist(), *whole.gamma.tolist())
    theta, omega, z = start
    # The recurrence is sequential: plain floats are ten times faster here than small arrays.
    states = [(theta, omega, z)]
    for r, us in zip(commands.tolist(), durations_us.tolist(), strict=True):
        t_w, t_z, w_w, w_z, z_w, z_z, t_r, w_r, z_r = wholes[us]
        theta += t_w * omega + t_z * z + t_r * r
        omega, z = w_w * omega + w_z * z + w_r * r, z_w * omega + z_z * z + z_r * r
        states.append((theta, omega, z))
    return np.array(states)


def _load_angles(
    nominal: Nominal,
    states: Array,
    commands: Array,
    durations_us: NDArray[np.int64],
    start: RigState,
) -> tuple[Array, float]:
    """The load's angle at every ask, shape (slots,), and at the end."""
    gap = nominal.backlash_gap_rad
    low, high = np.full(commands.size, -np.inf), np.full(commands.size, np.inf)
    for us in np.unique(durations_us).tolist():
        slots = np.flatnonzero(durations_us == us)
        x, r = states[slots], commands[slots]
        movement = Limits(low[slots], high[slots])
        for step in _step_row(nominal, us):
            movement = movement.then(Limits.around(x @ step.phi[0] + step.gamma[0] * r, gap))
        low[slots], high[slots] = movement
    load = start.load_angle_rad
    loads = [load]
    for low_rad, high_rad in zip(low.tolist(), high.tolist(), strict=True):
        load = min(max(load, low_rad), high_rad)
        loads.append(load)
    return np.array(loads[:-1]), load
