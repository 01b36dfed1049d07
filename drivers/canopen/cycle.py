"""The cycle: RPDO, SYNC, and every answer brought home to the slot that asked.

Runs once per period and owns what that needs, prepared: frames, codecs, one matcher per TPDO.
One thread, no logging, no SDO. The sample of a slot is complete when each of its TPDOs has
settled (come, or given up); samples leave in slot order.
"""

import math
import struct
from collections.abc import Callable
from typing import Any

import can

from drivers.axis import Sample
from drivers.canopen.cia402 import DISABLE_VOLTAGE
from drivers.canopen.line import Line
from drivers.canopen.matcher import Matcher
from drivers.canopen.node import EMERGENCY, HEARTBEAT, OPERATIONAL, SDO_RESPONSE, SYNC, Node
from drivers.canopen.pdo import Layout
from drivers.canopen.scaling import Unwrapper
from drivers.canopen.settings import CanopenSettings
from drivers.canopen.setup import DriveLink, EncoderLink
from drivers.canopen.watch import Watch
from drivers.errors import SettingsError

Values = tuple[int, ...]
_FLOOD = 1000
"""Frames taken in one call at most, so that a babbling bus cannot hold the loop."""


class _Stream:
    """One TPDO: its frames unpacked and matched."""

    __slots__ = ("_layout", "_watch", "last_answer_ns", "matcher", "name")

    def __init__(self, name: str, layout: Layout, timeout_ns: int, watch: Watch) -> None:
        self.name = name
        self.matcher: Matcher[Values] = Matcher(timeout_ns)
        self.last_answer_ns = 0
        self._layout = layout
        self._watch = watch

    def on_frame(self, data: bytearray, now_ns: int) -> Values | None:
        """Take a frame; None where it is no answer of ours."""
        codec = self._layout.codec
        if len(data) != codec.size:
            self._watch.on_malformed(self.name, self._layout.cob_id, len(data), codec.size, now_ns)
            return None
        values: Values = codec.unpack(data)
        self.last_answer_ns = now_ns
        if not self.matcher.answer(values, now_ns):
            self._watch.on_duplicate(self.name, now_ns)
        return values


class Cycle:
    """Commands and samples of one axis that is set up. `controlword` goes out with every ask.

    `statusword` is the last that came, at `statusword_ns`; while `guarded`, one that is not
    operation enabled is an event. Raises `drivers.errors.WireError` when the bus fails.
    """

    def __init__(
        self,
        line: Line,
        drive: DriveLink,
        encoder: EncoderLink | None,
        settings: CanopenSettings,
        watch: Watch,
    ) -> None:
        self.controlword = DISABLE_VOLTAGE
        self.statusword: int | None = None
        self.statusword_ns = 0
        self.guarded = False
        self._line = line
        self._bus = line.bus
        self._now_ns = line.clock.now_ns
        self._watch = watch
        self._drive = drive
        self._timeout_s = settings.answer_timeout_s
        self._digits_per_rad_s = 1.0 / drive.scale.rad_s_per_digit
        self._prepare_frames(settings)
        self._prepare_streams(encoder, settings)
        self._prepare_decoding(encoder, settings)

    def _prepare_frames(self, settings: CanopenSettings) -> None:
        command = self._drive.command
        self._pack_command = command.codec.pack_into
        self._command = _frame(command.cob_id, bytes(command.codec.size))
        self._sync = _frame(SYNC, b"")
        self._heartbeat = _frame(HEARTBEAT + settings.master_node_id, bytes((OPERATIONAL,)))
        self._heartbeat_ns = round(settings.drive.heartbeat_s * 1e9)
        self._next_heartbeat_ns = 0
        own = (self._command, self._sync, self._heartbeat)
        self._own = frozenset(frame.arbitration_id for frame in own) | {0x000}

    def _prepare_streams(self, encoder: EncoderLink | None, settings: CanopenSettings) -> None:
        timeout_ns = round(settings.answer_timeout_s * 1e9)
        drive, watch = self._drive, self._watch
        self._state = _Stream(drive.node.name, drive.state, timeout_ns, watch)
        self._motion: _Stream | None = None
        self._position: _Stream | None = None
        if drive.motion:
            self._motion = _Stream(drive.node.name, drive.motion, timeout_ns, watch)
        if encoder:
            self._position = _Stream(encoder.node.name, encoder.position, timeout_ns, watch)
        self._streams = tuple(s for s in (self._state, self._motion, self._position) if s)
        self._matchers = tuple(stream.matcher for stream in self._streams)

        self._handlers: dict[int, Callable[[bytearray, int], Any]] = {
            drive.state.cob_id: self._on_state
        }
        if drive.motion and self._motion:
            self._handlers[drive.motion.cob_id] = self._motion.on_frame
        if encoder and self._position:
            self._handlers[encoder.position.cob_id] = self._position.on_frame
        self._supervise(drive.node, sends_heartbeat=drive.sends_heartbeat)
        if encoder:
            self._supervise(encoder.node, sends_heartbeat=encoder.sends_heartbeat)

    def _supervise(self, node: Node, *, sends_heartbeat: bool) -> None:
        watch, name = self._watch, node.name
        self._handlers[HEARTBEAT + node.node_id] = lambda d, t: watch.on_heartbeat(name, d, t)
        self._handlers[EMERGENCY + node.node_id] = lambda d, t: watch.on_emergency(name, d, t)
        self._handlers[SDO_RESPONSE + node.node_id] = lambda _d, _t: None
        if sends_heartbeat:
            watch.expect_heartbeat(name, self._now_ns())

    def _prepare_decoding(self, encoder: EncoderLink | None, settings: CanopenSettings) -> None:
        drive = self._drive
        self._unwrap_motor = Unwrapper(1 << len(drive.node.variable(0x6064)))
        self._torque_at = drive.state.place(0x6077)
        self._velocity_at = drive.motion.place(0x606C) if drive.motion else None
        self._time_at = drive.motion.place(0x1013) if drive.motion else None
        self._encoder_time_at: int | None = None
        self._rad_per_load_count = 0.0
        if encoder and settings.encoder:
            self._unwrap_load = Unwrapper(encoder.modulus)
            if self._time_at is None:
                self._encoder_time_at = encoder.position.place(0x1013)
            self._rad_per_load_count = (
                settings.encoder.direction * 2.0 * math.pi / settings.encoder.counts_per_revolution
            )

    def ask(self, velocity_rad_s: float, slot: int) -> int:
        """Send controlword and velocity, then SYNC; returns the time just before the SYNC."""
        try:
            digits = round(velocity_rad_s * self._digits_per_rad_s)
            self._pack_command(self._command.data, 0, self.controlword, digits)
        except (struct.error, ValueError, OverflowError) as error:
            raise SettingsError(
                f"a velocity of {velocity_rad_s} rad/s does not fit the drive's target velocity "
                f"(0x60FF): {error}. Lower the amplitude."
            ) from error
        try:
            self._bus.send(self._command)
            asked_ns = self._now_ns()
            self._bus.send(self._sync)
            if asked_ns >= self._next_heartbeat_ns:
                self._bus.send(self._heartbeat)
                self._next_heartbeat_ns = asked_ns + self._heartbeat_ns
        except (can.CanError, OSError) as error:
            raise self._line.broken(error) from error
        for matcher in self._matchers:
            matcher.ask(slot, asked_ns)
        return asked_ns

    def receive(self, until_ns: int) -> None:
        """Take frames until nothing is missing or `until_ns`; without anything missing, until
        nothing is waiting."""
        waiting = self._missing()
        look_ns = self._now_ns()
        for _ in range(_FLOOD):
            wait_ns = until_ns - look_ns if waiting else 0
            frame = self._read(wait_ns * 1e-9 if wait_ns > 0 else 0.0)
            if frame is not None:
                look_ns = self._now_ns()
                self._dispatch(frame, look_ns)
                if waiting and not self._missing():
                    return
            elif wait_ns <= 0:
                self._judge(look_ns)
                return
            else:
                look_ns = self._now_ns()

    def _read(self, timeout_s: float) -> can.Message | None:
        try:
            return self._bus.recv(timeout_s)
        except (can.CanError, OSError) as error:
            raise self._line.broken(error) from error

    def _missing(self) -> bool:
        for matcher in self._matchers:  # noqa: SIM110 (a generator costs more than the loop)
            if matcher.missing:
                return True
        return False

    def _dispatch(self, frame: can.Message, now_ns: int) -> None:
        if frame.is_error_frame or frame.is_remote_frame:
            return
        cob_id = frame.arbitration_id
        handler = self._handlers.get(cob_id)
        if handler is not None and not frame.is_extended_id:
            handler(frame.data, now_ns)
        elif cob_id not in self._own:
            self._watch.on_stranger(cob_id, now_ns)

    def _on_state(self, data: bytearray, now_ns: int) -> None:
        values = self._state.on_frame(data, now_ns)
        if values is None:
            return
        self.statusword = statusword = values[0]
        self.statusword_ns = now_ns
        watch = self._watch
        if self.guarded and statusword & watch.statusword_mask != watch.statusword_value:
            watch.on_statusword(self._drive.node.name, statusword, now_ns)

    def _judge(self, now_ns: int) -> None:
        """Nothing unread has arrived by `now_ns`: what is overdue now is lost."""
        for stream in self._streams:
            matcher = stream.matcher
            if matcher.missing:
                settled = len(matcher.settled)
                matcher.give_up(now_ns)
                silent_s = (now_ns - stream.last_answer_ns) * 1e-9
                if len(matcher.settled) > settled and silent_s > self._timeout_s:
                    self._watch.on_silence(stream.name, self._timeout_s, now_ns)
        if self._watch.overdue(now_ns):
            self._watch.judge_heartbeats(now_ns)

    def samples(self) -> list[Sample]:
        """The samples that have become complete, in slot order; those of slots below 0 are the
        master's own and stay here."""
        complete: list[Sample] = []
        while all(matcher.settled for matcher in self._matchers):
            sample = self._next_sample()
            if sample.slot >= 0:
                complete.append(sample)
        return complete

    def _next_sample(self) -> Sample:
        slot, asked_ns, drive_ns, state = self._state.matcher.settled.popleft()
        if state is None:
            self._lost(self._state, slot)
        statusword = counts = torque_nm = velocity_rad_s = time_us = None
        load_counts = encoder_ns = None
        scale = self._drive.scale
        if state is not None:
            statusword, counts = state[0], self._unwrap_motor(state[1])
            if self._torque_at is not None and scale.nm_per_permille is not None:
                torque_nm = state[self._torque_at] * scale.nm_per_permille
        if self._motion is not None:
            _, _, _, motion = self._motion.matcher.settled.popleft()
            if motion is None:
                self._lost(self._motion, slot)
            else:
                if self._velocity_at is not None:
                    velocity_rad_s = motion[self._velocity_at] * scale.rad_s_per_digit
                if self._time_at is not None:
                    time_us = motion[self._time_at]
        if self._position is not None:
            _, _, encoder_ns, position = self._position.matcher.settled.popleft()
            if position is None:
                self._lost(self._position, slot)
            else:
                load_counts = self._unwrap_load(position[0])
                if self._encoder_time_at is not None:
                    time_us = position[self._encoder_time_at]
        return Sample(
            slot=slot,
            asked_ns=asked_ns,
            drive_answered_ns=drive_ns,
            encoder_answered_ns=encoder_ns,
            device_time_us=time_us,
            statusword=statusword,
            motor_position_counts=counts,
            motor_position_rad=None if counts is None else counts * scale.rad_per_count,
            motor_velocity_rad_s=velocity_rad_s,
            motor_torque_nm=torque_nm,
            load_angle_counts=load_counts,
            load_angle_rad=None if load_counts is None else load_counts * self._rad_per_load_count,
        )

    def _lost(self, stream: _Stream, slot: int) -> None:
        if slot >= 0:
            self._watch.on_lost(stream.name, slot, self._now_ns())


def _frame(cob_id: int, data: bytes) -> can.Message:
    return can.Message(arbitration_id=cob_id, is_extended_id=False, data=data)
