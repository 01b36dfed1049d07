"""A CiA 402 servo drive: profile velocity and cyclic synchronous velocity, over any Plant.

On the wire: increments of the motor encoder, increments per second, per mille of the rated
torque, and counts of a second encoder on the load (0x60E4:1) for rigs without CiA 406. Cyclic
synchronous velocity (9) hands the target on as it is, from the SYNC that brought it. Profile
velocity (3), quick stop, halt, and fault reaction run along ramps, played as pieces of 1 ms of
constant command. Without power the motor coasts.
"""

import math
from collections.abc import Callable

import canopen
import numpy as np

from sim_rig.canopen.cia402 import POWERED, Control, State, Status, approach, next_state
from sim_rig.canopen.machine import Machine
from sim_rig.canopen.node import Slave
from sim_rig.canopen.objects import Abort, load_dictionary, refuse
from sim_rig.canopen.sensor import AngleEncoder
from sim_rig.plant import PlantOutputs
from sim_rig.settings import RigSettings

PROFILE_VELOCITY = 3
CYCLIC_SYNCHRONOUS_VELOCITY = 9

_RAMP_PIECE_US = 1000
_STANDSTILL_PATIENCE_US = 1_000_000
_STOP_AND_DISABLE = (1, 2)
_STOP_AND_HOLD = (5, 6)
_SLOW_DOWN_RAMP = (1, 5)
_CONNECTION_LOST = 0x8130
_PROFILE_ERROR = 0x20
"""The bit of the error register 0x1001 that belongs to the device profile."""

_INT16, _INT32 = 1 << 15, 1 << 31


def dictionary(node_id: int) -> canopen.ObjectDictionary:
    """The drive's object dictionary."""
    return load_dictionary("sim_drive.eds", node_id)


def _wrapped(value: int) -> int:
    """As INTEGER32, running over."""
    return (value + _INT32) % (2 * _INT32) - _INT32


def _clipped(value: float, limit: int) -> int:
    return round(min(max(value, -limit), limit - 1))


class Drive:
    """The drive behind a slave; `machine` moves as it commands."""

    def __init__(self, slave: Slave, machine: Machine, settings: RigSettings) -> None:
        self._slave = slave
        self._machine = machine
        self._store = store = slave.store
        self._counts_per_rad = settings.motor_counts_per_revolution / math.tau
        self._torque_constant = settings.nominal.torque_constant_nm_per_a
        self._rated_torque_nm = settings.rated_torque_nm
        self.sensor = AngleEncoder(
            settings.motor_counts_per_revolution,
            settings.motor_encoder_noise_rad,
            np.random.default_rng([settings.seed, 1]),
        )
        self.load_sensor = AngleEncoder(
            settings.load_counts_per_revolution,
            settings.load_encoder_noise_rad,
            np.random.default_rng([settings.seed, 3]),
        )
        self.status_filter: Callable[[int], int] | None = None
        store.set_default((0x6075, 0), round(1e3 * self._rated_current_a))
        store.set_default((0x6076, 0), round(1e3 * self._rated_torque_nm))
        store.set_default((0x608F, 1), settings.motor_counts_per_revolution)
        store.on_write((0x6040, 0), self._control)
        store.on_write((0x605A, 0), self._check_quick_stop_option)
        store.on_write((0x6060, 0), self._check_mode)
        store.on_write((0x60C2, 1), self._check_period)
        store.on_write((0x60C2, 2), self._check_period_index)
        self.reset()
        machine.driven_by(self._play)
        slave.attach(self)

    def reset(self) -> None:
        """Power off, no fault; what turns, goes on turning."""
        self.state = State.SWITCH_ON_DISABLED
        self._controlword = 0
        self._demand_increments_s = 0.0
        self._standing_us = 0
        self._publish()

    def sample(self, time_us: int) -> None:
        """Let the machine reach `time_us`; put what the drive knows into its objects."""
        self._machine.advance_to(time_us)
        self._publish()

    def connection_lost(self) -> None:
        """Object 0x6007, while the axis is driven."""
        if self.state is not State.OPERATION_ENABLED:
            return
        match self._store[0x6007, 0]:
            case 1:
                self._store[0x603F, 0] = _CONNECTION_LOST
                self._store[0x1001, 0] |= _PROFILE_ERROR
                self._enter(State.FAULT_REACTION_ACTIVE)
            case 2:
                self._enter(State.SWITCH_ON_DISABLED)
            case 3:
                self._enter(State.QUICK_STOP_ACTIVE)
        self._publish_status()

    def trip(self, code: int) -> None:
        """Fall into fault by itself, with an emergency: the fault reaction, then power off."""
        self._store[0x603F, 0] = code
        self._slave.emergency(code, _PROFILE_ERROR)
        if self.state in POWERED:
            self._enter(State.FAULT_REACTION_ACTIVE)
        else:
            self._enter(State.FAULT)
        self._publish_status()

    def let_go(self) -> None:
        """Lose the power stage, without a word."""
        self._enter(State.SWITCH_ON_DISABLED)
        self._publish_status()

    @property
    def moves(self) -> bool:
        """Whether the axis is driven, or turns."""
        return self.state in POWERED or self._machine.outputs.motor_velocity_rad_s != 0.0

    # The master's words

    def _control(self, controlword: int) -> None:
        before, self._controlword = self._controlword, controlword
        state = next_state(
            self.state,
            controlword,
            before,
            quick_stop_holds=self._store[0x605A, 0] in _STOP_AND_HOLD,
        )
        if self.state is State.FAULT and state is not State.FAULT:
            self._store[0x603F, 0] = 0
            self._slave.emergency_over(_PROFILE_ERROR)
        self._enter(state)
        self._publish_status()

    def _enter(self, state: State) -> None:
        if state in POWERED and self.state not in POWERED:
            self._demand_increments_s = self._velocity_increments_s
        self._standing_us = 0
        self.state = state

    def _check_quick_stop_option(self, option: int) -> None:
        if option not in _STOP_AND_DISABLE + _STOP_AND_HOLD:
            raise refuse(Abort.INVALID_VALUE)

    def _check_mode(self, mode: int) -> None:
        if mode not in (PROFILE_VELOCITY, CYCLIC_SYNCHRONOUS_VELOCITY):
            raise refuse(Abort.INVALID_VALUE)
        self._store[0x6061, 0] = mode

    def _check_period(self, value: int) -> None:
        if not 1 <= value <= 100:
            raise refuse(Abort.INVALID_VALUE)

    def _check_period_index(self, index: int) -> None:
        if index != -3:
            raise refuse(Abort.INVALID_VALUE)

    # Motion

    @property
    def _cyclic(self) -> bool:
        return self._store[0x6060, 0] == CYCLIC_SYNCHRONOUS_VELOCITY

    @property
    def _halted(self) -> bool:
        return bool(self._controlword & Control.HALT)

    @property
    def _velocity_increments_s(self) -> float:
        return self._machine.outputs.motor_velocity_rad_s * self._counts_per_rad

    @property
    def _rated_current_a(self) -> float:
        return self._rated_torque_nm / self._torque_constant

    def _target(self) -> float:
        if self.state is not State.OPERATION_ENABLED or self._halted:
            return 0.0
        target = self._store[0x60FF, 0]
        if self._cyclic:
            return float(target)
        limit = self._store[0x607F, 0]
        return float(min(max(target, -limit), limit))

    def _slope(self) -> float | None:
        """Increments/s^2 of the ramp in force; None where the target is followed at once."""
        store = self._store
        if self.state is State.OPERATION_ENABLED and not self._halted:
            if self._cyclic:
                return None
            speeding_up = abs(self._target()) > abs(self._demand_increments_s)
            return float(store[0x6083 if speeding_up else 0x6084, 0])
        stopping = self.state is State.QUICK_STOP_ACTIVE
        slow = self.state is State.OPERATION_ENABLED or (
            stopping and store[0x605A, 0] in _SLOW_DOWN_RAMP
        )
        return float(store[0x6084 if slow else 0x6085, 0])

    def _play(self, duration_us: int) -> None:
        """Advance the plant under what is commanded, ramps in pieces."""
        plant = self._machine.plant
        while duration_us > 0:
            piece_us = duration_us
            if self.state not in POWERED:
                plant.advance(None, piece_us * 1e-6)
            else:
                target, slope = self._target(), self._slope()
                if slope is None:
                    self._demand_increments_s = target
                elif self._demand_increments_s != target or self._is_stopping:
                    piece_us = min(duration_us, _RAMP_PIECE_US)
                    self._demand_increments_s = approach(
                        self._demand_increments_s, target, slope * piece_us * 1e-6
                    )
                plant.advance(self._demand_increments_s / self._counts_per_rad, piece_us * 1e-6)
                self._end_stop(piece_us)
            duration_us -= piece_us

    @property
    def _is_stopping(self) -> bool:
        """Whether power is to be switched off once the axis stands."""
        return self.state is State.FAULT_REACTION_ACTIVE or (
            self.state is State.QUICK_STOP_ACTIVE and self._store[0x605A, 0] in _STOP_AND_DISABLE
        )

    def _end_stop(self, piece_us: int) -> None:
        """Switch off at standstill (the velocity reads as zero), or when patience has ended."""
        if not self._is_stopping or self._demand_increments_s != 0.0:
            return
        self._standing_us += piece_us
        stands = abs(self._velocity_increments_s) < 0.5
        if stands or self._standing_us >= _STANDSTILL_PATIENCE_US:
            fault = self.state is State.FAULT_REACTION_ACTIVE
            self._enter(State.FAULT if fault else State.SWITCH_ON_DISABLED)

    # What the drive tells

    def _publish(self) -> None:
        outputs = self._machine.outputs
        store = self._store
        store[0x6064, 0] = _wrapped(self.sensor.counts(outputs.motor_position_rad))
        store[0x60E4, 1] = _wrapped(self.load_sensor.counts(outputs.load_angle_rad))
        store[0x606C, 0] = _clipped(outputs.motor_velocity_rad_s * self._counts_per_rad, _INT32)
        store[0x606B, 0] = _clipped(self._demand_now(), _INT32)
        self._publish_current(outputs)
        self._publish_status()

    def _publish_current(self, outputs: PlantOutputs) -> None:
        per_mille = 1e3 * outputs.motor_current_a / self._rated_current_a
        self._store[0x6077, 0] = self._store[0x6078, 0] = _clipped(per_mille, _INT16)

    def _demand_now(self) -> float:
        return self._demand_increments_s if self.state in POWERED else 0.0

    def _publish_status(self) -> None:
        status = self.state | Status.VOLTAGE_ENABLED | Status.REMOTE | self._mode_bits()
        self._store[0x6041, 0] = self.status_filter(status) if self.status_filter else status

    def _mode_bits(self) -> int:
        if self.state is not State.OPERATION_ENABLED:
            return 0
        if self._cyclic:
            return 0 if self._halted else Status.FOLLOWS_COMMAND
        velocity, target = self._velocity_increments_s, self._target()
        window = self._store[0x606D, 0]
        reached = self._demand_increments_s == target and abs(velocity - target) <= window
        limited = not self._halted and target != self._store[0x60FF, 0]
        return (
            (Status.TARGET_REACHED if reached else 0)
            | (Status.INTERNAL_LIMIT if limited else 0)
            | (Status.STANDSTILL if abs(velocity) <= window else 0)
        )
