"""The cycle: RPDO, SYNC, and every answer brought home to the slot that asked.

Runs once per period and owns what that needs, prepared: frames, codecs, one matcher per TPDO.
One thread, no logging, no SDO. The sample of a slot is complete when each of its TPDOs has
settled (come, or given up); samples leave in slot order.

Where the drive produces SYNC, an ask is the SYNC that comes after the command: `ask` sends and
waits for it. A SYNC that comes while no command has gone out for it is a slot that nobody asked:
`next_slot` says which one is next.
"""

import math
import struct
from collections import deque
from collections.abc import Callable
from typing import Any

import can

from drivers.axis import Sample
from drivers.canopen.cia402 import DISABLE_VOLTAGE
from drivers.canopen.guarding import Guard, guard_times
from drivers.canopen.line import Line
from drivers.canopen.node import EMERGENCY, HEARTBEAT, OPERATIONAL, SDO_RESPONSE, SYNC, Node
from drivers.canopen.profile import POSITION, STATUSWORD, TIME_STAMP, TORQUE, VELOCITY, Address
from drivers.canopen.scaling import Unwrapper
from drivers.canopen.settings import CanopenSettings
from drivers.canopen.setup import DriveLink, EncoderLink
from drivers.canopen.stream import (
    Place,
    Stream,
    data_frame,
    pair,
    remote_frame,
    scaled,
    value_at,
)
from drivers.canopen.watch import Watch
from drivers.errors import SettingsError, SyncMissingError
from drivers.plausible import Plausibility

_FLOOD = 1000
"""Frames taken in one call at most, so that a babbling bus cannot hold the loop."""
_FOR_EVER_NS = 1 << 62
SYNC_PATIENCE_S = 0.1
"""A drive's SYNC may be late by so much, and by three periods at the least."""


class Cycle:
    """Commands and samples of one axis that is set up. `controlword` goes out with every ask.

    `statusword` is the last that came, at `statusword_ns`; while `guarded`, one that is not
    operation enabled is an event. `motor_velocity_rad_s` is from the last two positions, None where
    one of them did not come. Raises `drivers.errors.WireError` when the bus fails.
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
        self.motor_velocity_rad_s: float | None = None
        self._line = line
        self._bus, self._read = line.bus, line.read
        self._now_ns = line.clock.now_ns
        self._watch = watch
        self._drive = drive
        self._timeout_s = settings.answer_timeout_s
        self._command_every = settings.command_every
        self._last_block, self._sent_rad_s = -1, math.nan
        self._follows = settings.sync_by_drive
        self._sync_patience_s = max(SYNC_PATIENCE_S, 3 * settings.period_s)
        self._armed: tuple[int, float] | None = None
        self._asked_slot, self._asked_ns = -(1 << 62), 0
        self._held_rad_s = 0.0
        self._unasked: set[int] = set()
        self._digits_per_rad_s = 1.0 / drive.scale.rad_s_per_digit
        self._period_s = settings.period_s
        self._commanded_rad = 0.0
        self._commanded: deque[float] = deque()  # at each ask that has not settled
        self._plausible = Plausibility(settings.stuck_travel_rad, drive.node.name, self._cannot_be)
        self._prepare_frames(settings)
        self._prepare_streams(encoder, settings)
        self._prepare_decoding(encoder, settings)

    def _prepare_frames(self, settings: CanopenSettings) -> None:
        command = self._drive.mapping.command
        self._pack_command = command.codec.pack_into
        self._command = data_frame(command.cob_id, bytes(command.codec.size))
        self._sync = data_frame(SYNC, b"")
        drive = settings.drive
        self._heartbeat = data_frame(HEARTBEAT + settings.master_node_id, bytes((OPERATIONAL,)))
        self._heartbeat_ns = round(drive.heartbeat_s * 1e9)
        if self._drive.guarded:
            guard_ms, _ = guard_times(drive.heartbeat_s, drive.heartbeat_timeout_s)
            self._heartbeat = remote_frame(HEARTBEAT + drive.node.node_id)
            self._heartbeat_ns = guard_ms * 1_000_000
        self._next_heartbeat_ns = 0
        self._guard: Guard | None = None
        own = (self._command, self._sync, self._heartbeat)
        self._own = frozenset(frame.arbitration_id for frame in own) | {0x000}  # buses that echo

    def _prepare_streams(self, encoder: EncoderLink | None, settings: CanopenSettings) -> None:
        timeout_ns = round(settings.answer_timeout_s * 1e9)
        drive, watch = self._drive, self._watch
        layouts = [(drive.node.name, layout) for layout in drive.mapping.answers]
        if encoder:
            layouts.append((encoder.node.name, encoder.position))
        self._streams = tuple(Stream(name, it, timeout_ns, watch) for name, it in layouts)
        self._matchers = tuple(stream.matcher for stream in self._streams)
        self._handlers: dict[int, Callable[[bytearray, int], Any]] = {
            layout.cob_id: stream.on_frame
            for stream, (_, layout) in zip(self._streams, layouts, strict=True)
        }
        self._state_at, self._statusword_at = self._required(STATUSWORD)
        self._state = self._streams[self._state_at]
        self._handlers[drive.mapping.answers[self._state_at].cob_id] = self._on_state
        self._supervise(drive.node, sends_heartbeat=drive.sends_heartbeat)
        if encoder:
            self._supervise(encoder.node, sends_heartbeat=encoder.sends_heartbeat)
        if drive.guarded:
            self._guard = guard = Guard(drive.node.name, watch)
            self._handlers[HEARTBEAT + drive.node.node_id] = guard.on_answer
            watch.expect_heartbeat(drive.node.name, self._now_ns(), guarded=True)
        if self._follows:
            self._handlers[SYNC] = self._on_sync

    def _where(self, address: Address | None) -> Place | None:
        """In which of the drive's answers an object comes, and at which place there."""
        if address is not None:
            for stream, layout in enumerate(self._drive.mapping.answers):
                place = layout.place(address)
                if place is not None:
                    return stream, place
        return None

    def _required(self, address: Address) -> Place:
        place = self._where(address)
        assert place is not None  # noqa: S101 - no profile without it
        return place

    def _supervise(self, node: Node, *, sends_heartbeat: bool) -> None:
        watch, name = self._watch, node.name
        self._handlers[HEARTBEAT + node.node_id] = lambda d, t: watch.on_heartbeat(name, d, t)
        self._handlers[EMERGENCY + node.node_id] = lambda d, t: watch.on_emergency(name, d, t)
        self._handlers[SDO_RESPONSE + node.node_id] = lambda _d, _t: None
        if sends_heartbeat:
            watch.expect_heartbeat(name, self._now_ns())

    def _prepare_decoding(self, encoder: EncoderLink | None, settings: CanopenSettings) -> None:
        drive, mapping = self._drive, self._drive.mapping
        self._position: tuple[int | None, int] = None, 0
        self._motor_at = self._required(POSITION)
        self._unwrap_motor = Unwrapper(1 << len(drive.node.variable(*POSITION)))
        self._torque_at = self._where(TORQUE)
        self._velocity_at = self._where(VELOCITY)
        self._current_at, self._a_per_digit = self._where(mapping.current), drive.scale.a_per_digit
        if self._current_at is None:
            self._current_at, self._a_per_digit = self._torque_at, drive.scale.a_per_torque_digit
        self._time_at = self._where(TIME_STAMP)
        self._load_at = self._where(mapping.load)
        load = settings.encoder or settings.drive.second_encoder
        modulus = encoder.modulus if encoder else 1 << 32
        if encoder:
            self._load_at = len(self._streams) - 1, 0
            time_place = encoder.position.place(TIME_STAMP)
            if self._time_at is None and time_place is not None:
                self._time_at = len(self._streams) - 1, time_place
        elif mapping.load:
            modulus = 1 << len(drive.node.variable(*mapping.load))
        self._unwrap_load = Unwrapper(modulus)
        self._rad_per_load_count = 0.0
        if load is not None:
            self._rad_per_load_count = load.direction * 2.0 * math.pi / load.counts_per_revolution

    def ask(self, velocity_rad_s: float, slot: int) -> int:
        """Send controlword and velocity, then SYNC; returns the time just before the SYNC.

        Of `command_every` slots only the first sends a command, and one that commands something
        else; the master's own, below 0, all.
        Where the drive produces SYNC this waits for it, and returns when it came: WireError where
        none does.
        """
        try:
            digits = round(velocity_rad_s * self._digits_per_rad_s)
            self._pack_command(self._command.data, 0, self.controlword, digits)
        except (struct.error, ValueError, OverflowError) as error:
            raise SettingsError(
                f"a velocity of {velocity_rad_s} rad/s does not fit the drive's target velocity "
                f"(0x60FF): {error}. Lower the amplitude."
            ) from error
        try:
            block = slot // self._command_every
            if slot < 0 or block != self._last_block or velocity_rad_s != self._sent_rad_s:
                self._bus.send(self._command)
                self._last_block, self._sent_rad_s = block, velocity_rad_s
            now_ns = self._now_ns()
            if not self._follows:
                self._bus.send(self._sync)
            if now_ns >= self._next_heartbeat_ns:
                self._bus.send(self._heartbeat)
                self._next_heartbeat_ns = now_ns + self._heartbeat_ns
                if self._guard:
                    self._guard.on_question()
        except (can.CanError, OSError) as error:
            raise self._line.broken(error) from error
        if self._follows:
            self._armed = slot, velocity_rad_s
            self._await_sync(now_ns)
        else:
            self._open(slot, now_ns, velocity_rad_s)
        return self._asked_ns

    def _open(self, slot: int, asked_ns: int, velocity_rad_s: float) -> None:
        """A SYNC has asked: note it, with the command that acts from it on."""
        for matcher in self._matchers:
            matcher.ask(slot, asked_ns)
        if slot > self._asked_slot >= 0:  # the command before was held in slots that were missed
            missed = slot - self._asked_slot - 1
            self._commanded_rad += missed * self._held_rad_s * self._period_s
        self._asked_slot, self._asked_ns, self._held_rad_s = slot, asked_ns, velocity_rad_s
        self._commanded.append(self._commanded_rad)
        self._commanded_rad += velocity_rad_s * self._period_s

    def _on_sync(self, _data: bytearray, now_ns: int) -> None:
        """The drive's SYNC: it asks for the slot that was commanded, or for one that was not."""
        if self._armed is None:
            slot, velocity_rad_s = self._asked_slot + 1, self._held_rad_s
            self._unasked.add(slot)
        else:
            (slot, velocity_rad_s), self._armed = self._armed, None
        self._open(slot, now_ns, velocity_rad_s)

    def _await_sync(self, begun_ns: int) -> None:
        look_ns, give_up_ns = begun_ns, begun_ns + round(self._sync_patience_s * 1e9)
        while self._armed is not None:
            if look_ns >= give_up_ns:
                self._armed = None
                name, patience_s = self._drive.node.name, self._sync_patience_s
                raise SyncMissingError(self._watch.on_sync_silence(name, patience_s, look_ns))
            frame = self._read((give_up_ns - look_ns) * 1e-9)
            look_ns = self._now_ns()
            if frame is not None:
                self._dispatch(frame, look_ns)

    def next_slot(self, slot: int) -> int:
        """The slot that the drive's next SYNC will ask for, `slot` or a later one."""
        self.receive(0)
        return max(slot, self._asked_slot + 1)

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

    def latencies_s(self, slot: int) -> dict[str, float]:
        """Ask once at velocity 0 and wait for all: how late each node's last answer came, in s.

        A node that does not answer within the timeout is left out. For a drive that is still off.
        """
        asked_ns = self.ask(0.0, slot)
        self.receive(asked_ns + round(self._timeout_s * 1e9))
        self.samples()
        late_s: dict[str, float] = {}
        for stream in self._streams:
            if stream.last_answer_ns > asked_ns:
                took_s = (stream.last_answer_ns - asked_ns) * 1e-9
                late_s[stream.name] = max(took_s, late_s.get(stream.name, 0.0))
        return late_s

    def _missing(self) -> bool:
        for matcher in self._matchers:  # noqa: SIM110 (a generator costs more than the loop)
            if matcher.missing:
                return True
        return False

    def _dispatch(self, frame: can.Message, now_ns: int) -> None:
        if frame.is_error_frame:
            self._watch.on_error_frame(frame.arbitration_id, frame.data, now_ns)
            return
        if frame.is_remote_frame:
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
        self.statusword = statusword = values[self._statusword_at]
        self.statusword_ns = now_ns
        watch = self._watch
        if self.guarded and statusword & watch.statusword_mask != watch.statusword_value:
            watch.on_statusword(self._drive.node.name, statusword, now_ns)

    def _judge(self, now_ns: int) -> None:
        """Nothing unread has arrived by `now_ns`: what is overdue now is lost."""
        silent: list[Stream] = []
        for stream in self._streams:
            matcher = stream.matcher
            if matcher.missing:
                settled = len(matcher.settled)
                matcher.give_up(now_ns)
                silent_s = (now_ns - stream.last_answer_ns) * 1e-9
                if len(matcher.settled) > settled and silent_s > self._timeout_s:
                    silent.append(stream)
        names = list(dict.fromkeys(stream.name for stream in silent))
        if len(silent) == len(self._streams) and len(names) > 1:
            self._watch.on_bus_silence(names, self._timeout_s, now_ns)
        else:
            for name in names:
                self._watch.on_silence(name, self._timeout_s, now_ns)
        if self._watch.overdue(now_ns):
            self._watch.judge_heartbeats(now_ns)

    def samples(self) -> list[Sample]:
        """The samples that have become complete, in slot order; those of slots below 0 are the
        master's own and stay here."""
        complete: list[Sample] = []
        while all(matcher.settled for matcher in self._matchers):
            sample = self._next_sample()
            if sample.slot in self._unasked:
                self._unasked.discard(sample.slot)
            elif sample.slot >= 0:
                complete.append(sample)
        return complete

    def finish(self) -> list[Sample]:
        """What has come of the asks that are still open; nothing of it is judged any more."""
        self.guarded = False
        for matcher in self._matchers:
            matcher.give_up(_FOR_EVER_NS)
        return self.samples()

    def _next_sample(self) -> Sample:
        settled = [matcher.settled.popleft() for matcher in self._matchers]
        slot, asked_ns, drive_ns, _ = settled[self._state_at]
        commanded_rad = self._commanded.popleft()
        values = [one.payload for one in settled]
        for stream, payload in zip(self._streams, values, strict=True):
            if payload is None:
                self._lost(stream, slot)
        scale = self._drive.scale
        counts = value_at(values, self._motor_at)
        if counts is not None:
            counts = self._unwrap_motor(counts)
        self._note_motion(counts, asked_ns)
        load_counts = value_at(values, self._load_at)
        if load_counts is not None:
            load_counts = self._unwrap_load(load_counts)
        motor_rad = scaled(counts, scale.rad_per_count)
        load_rad = scaled(load_counts, self._rad_per_load_count)
        if self.guarded:
            self._plausible.look(
                asked_ns * 1e-9,
                commanded_rad,
                pair(counts, motor_rad),
                pair(load_counts, load_rad),
            )
        return Sample(
            slot=slot,
            asked_ns=asked_ns,
            drive_answered_ns=drive_ns,
            encoder_answered_ns=settled[self._load_at[0]].received_ns if self._load_at else None,
            device_time_us=value_at(values, self._time_at),
            statusword=value_at(values, (self._state_at, self._statusword_at)),
            motor_position_counts=counts,
            motor_position_rad=motor_rad,
            motor_velocity_rad_s=scaled(value_at(values, self._velocity_at), scale.rad_s_per_digit),
            motor_torque_nm=scaled(value_at(values, self._torque_at), scale.nm_per_digit),
            motor_current_a=scaled(value_at(values, self._current_at), self._a_per_digit),
            motor_sampled_ns=None if counts is None else asked_ns,
            load_sampled_ns=None if load_counts is None else asked_ns,
            load_angle_counts=load_counts,
            load_angle_rad=load_rad,
        )

    def _cannot_be(self, kind: str, text: str) -> None:
        self._watch.tell(self._now_ns(), kind, text, fatal=True, key=kind)

    def _note_motion(self, counts: int | None, asked_ns: int) -> None:
        before, self._position = self._position, (counts, asked_ns)
        self.motor_velocity_rad_s = None
        if counts is not None and before[0] is not None:
            moved_rad = (counts - before[0]) * self._drive.scale.rad_per_count
            self.motor_velocity_rad_s = moved_rad / max((asked_ns - before[1]) * 1e-9, 1e-4)

    def _lost(self, stream: Stream, slot: int) -> None:
        if slot >= 0:
            self._watch.on_lost(stream.name, slot, self._now_ns())
