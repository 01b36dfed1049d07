"""The cycle: one slot's transactions, their answers decoded, and every slot settled once.

A line carries one transaction at a time. A slot whose turn comes while the one before is still
waiting for its answer is sent as soon as the line is free within the slot, on drives that stamp
their samples (`device_time`); else, and where the next slot comes first, it is not sent at all: it
settles without values, and the drive keeps its command. A late answer still belongs to the slot
that asked. Which answer belongs to which request is
the link's business (`drivers.modbus.tcp`, `drivers.modbus.rtu`); what is given up here never comes
back.
"""

import math
from collections import deque
from dataclasses import dataclass, field

from pymodbus.pdu import ExceptionResponse, ModbusPDU

from drivers.axis import Sample
from drivers.canopen.scaling import Unwrapper
from drivers.clock import Clock
from drivers.errors import SettingsError
from drivers.modbus import profile as names
from drivers.modbus.budget import response_timeout_s
from drivers.modbus.frames import describe_exception, request_bytes
from drivers.modbus.lines import RtuLine
from drivers.modbus.link import Link, Reply
from drivers.modbus.registers import Number
from drivers.modbus.scaling import Scale
from drivers.modbus.settings import ModbusSettings
from drivers.modbus.watch import Watch
from drivers.plausible import Plausibility


@dataclass(slots=True)
class _Ask:
    """A slot that has asked, and what has come of it."""

    slot: int
    asked_ns: int
    commanded_rad: float
    velocity_rad_s: float
    step: int = 0
    done: bool = False
    received_ns: int | None = None
    sampled_ns: int | None = None
    values: dict[str, Number] = field(default_factory=dict)

    @property
    def words(self) -> str:
        """Which slot it is; one below 0 is a cycle that the master makes for itself."""
        return f"slot {self.slot}" if self.slot >= 0 else "a command of the bench's own"


class Cycle:
    """Commands and samples of one axis that is set up.

    `digits` is what goes out beside the target velocity. `statusword` is the last that came; while
    `guarded`, one that is not enabled is a fatal event. Raises WireError when the line is lost.
    """

    def __init__(
        self, link: Link, settings: ModbusSettings, scale: Scale, watch: Watch, clock: Clock
    ) -> None:
        self.link = link
        self.guarded = False
        self.statusword: int | None = None
        profile = settings.drive.profile
        self.digits: dict[str, Number] = dict(profile.cycle.values) | {names.TARGET: 0}
        self._settings = settings
        self._profile = profile
        self._scale = scale
        self._watch = watch
        self._clock = clock
        self._exchanges = settings.plan.exchanges
        self._timeouts_ns = [
            round(response_timeout_s(profile, settings.line, exchange) * 1e9)
            for exchange in self._exchanges
        ]
        longest_s = sum(self._timeouts_ns) * 1e-9
        self._silence_ns = round(max(settings.answer_timeout_s, 3 * longest_s) * 1e9)
        self._asks: deque[_Ask] = deque()
        self._open: _Ask | None = None
        self._deferred: _Ask | None = None
        self._give_up_ns = 0
        self._last_good_ns = clock.now_ns()
        self._last_trouble = "no answer at all"
        self._lost = 0
        self._last_slot: int | None = None
        self._commanded_rad = self._in_force_rad_s = 0.0
        self._unwrap_motor = Unwrapper(profile.items[names.POSITION].modulus)
        load = profile.items.get(names.LOAD)
        self._unwrap_load = Unwrapper(load.modulus if load else 1 << 32)
        self._plausible = Plausibility(settings.stuck_travel_rad, link.name, self._cannot_be)

    def ask(self, velocity_rad_s: float, slot: int) -> int:
        """Send the slot's command and ask for its sample; the time just before, in ns.

        Raises SettingsError for a velocity that does not fit the drive's register.
        """
        self.digits[names.TARGET] = velocity_rad_s / self._scale.command_rad_s
        try:
            request = self._exchanges[0].request(self.digits, self._lost)
        except ValueError as error:
            raise SettingsError(
                f"a velocity of {velocity_rad_s} rad/s does not fit the drive's target velocity: "
                f"{error}. Lower the amplitude."
            ) from error
        self._skip(self._deferred)
        self._deferred = None
        lost = self._lost
        self.receive(0)
        if self._lost != lost:  # an answer was given up just now: ask for another length than its
            request = self._exchanges[0].request(self.digits, self._lost)
        self._pass_slots_before(slot)
        ask = _Ask(slot, self._clock.now_ns(), self._commanded_rad, velocity_rad_s)
        self._asks.append(ask)
        if self._open is None:
            self._begin(ask, request)
        elif self._scale.time_us is not None:
            self._deferred = ask
        else:
            self._skip(ask)
        self._commanded_rad += self._in_force_rad_s * self._settings.period_s
        return ask.asked_ns

    def _pass_slots_before(self, slot: int) -> None:
        """In slots that the bench has missed the drive went on with the command before them."""
        missed = 0 if self._last_slot is None else max(slot - self._last_slot - 1, 0)
        self._commanded_rad += missed * self._in_force_rad_s * self._settings.period_s
        self._last_slot = slot

    def _begin(self, ask: _Ask, request: ModbusPDU) -> None:
        self._in_force_rad_s = ask.velocity_rad_s
        ask.asked_ns = self.link.begin(request)
        self._note_sampling(ask, request, ask.asked_ns)
        self._give_up_ns = ask.asked_ns + self._timeouts_ns[0]
        self._open = ask

    def _note_sampling(self, ask: _Ask, request: ModbusPDU, sent_ns: int) -> None:
        """On a serial line the drive reads its encoders when the request has come; the request
        that reads the motor's position counts. When that is on a network nobody knows."""
        block, line = self._exchanges[ask.step].read, self._settings.line
        if isinstance(line, RtuLine) and block is not None and names.POSITION in block.names:
            ask.sampled_ns = sent_ns + round(request_bytes(request) * line.character_s * 1e9)

    def _begin_deferred(self, until_ns: int) -> None:
        """Send what had to wait for the line, if its time is not over."""
        ask = self._deferred
        if ask is not None and self._open is None and self._clock.now_ns() < until_ns:
            self._deferred = None
            self._begin(ask, self._exchanges[0].request(self.digits, self._lost))

    def _skip(self, ask: _Ask | None) -> None:
        if ask is not None:
            ask.done = True
            self._tell(
                "slot not sent",
                f"{self.link.name} had not answered in time: {ask.words} was not sent, the "
                "drive keeps its velocity.",
            )

    def receive(self, until_ns: int) -> None:
        """Take answers until nothing is open, or `until_ns`."""
        self._begin_deferred(until_ns)
        while self._open is not None:
            reply = self.link.poll(min(until_ns, self._give_up_ns))
            if reply is not None:
                self._take(self._open, reply)
            elif self._clock.now_ns() >= self._give_up_ns:
                self._lose(self._open)
            elif self._clock.now_ns() >= until_ns:
                break
            self._begin_deferred(until_ns)
        self._judge_silence()

    def samples(self) -> list[Sample]:
        """The samples that have settled, in slot order; slots below 0 are the master's own."""
        settled: list[Sample] = []
        while self._asks and self._asks[0].done:
            ask = self._asks.popleft()
            if ask.slot >= 0:
                settled.append(self._sample(ask))
        return settled

    def finish(self) -> list[Sample]:
        """The slots that have not settled, as they are; the line is left to whoever stops."""
        self.guarded = False
        for ask in self._asks:
            ask.done = True
        self._open = self._deferred = None
        return self.samples()

    def _take(self, ask: _Ask, reply: Reply) -> None:
        """An answer to the open request: the next transaction, or the end of the slot."""
        pdu = reply.pdu
        if isinstance(pdu, ExceptionResponse):
            self._last_trouble = describe_exception(pdu)
            self._tell("exception reply", f"{self.link.name}: {self._last_trouble}.")
            self._settle(ask)
            return
        block = self._exchanges[ask.step].read
        if block is not None:
            ask.values |= block.decode(pdu.registers[: block.count])
        ask.step += 1
        if ask.step < len(self._exchanges):
            request = self._exchanges[ask.step].request(self.digits, self._lost)
            sent_ns = self.link.begin(request)
            self._note_sampling(ask, request, sent_ns)
            self._give_up_ns = sent_ns + self._timeouts_ns[ask.step]
            return
        ask.received_ns = self._last_good_ns = reply.received_ns
        self._settle(ask)
        self._look_at_status(int(ask.values[names.STATUS]))

    def _lose(self, ask: _Ask) -> None:
        self.link.abandon()
        self._lost += 1
        self._last_trouble = f"no answer ({self.link.damaged} damaged frames so far)"
        waited_ms = (self._clock.now_ns() - ask.asked_ns) * 1e-6
        self._tell(
            "answer lost",
            f"{self.link.name} did not answer {ask.words} within {waited_ms:.1f} ms; an answer "
            "that comes now is thrown away.",
        )
        self._settle(ask)

    def _settle(self, ask: _Ask) -> None:
        ask.done = True
        self._open = None

    def _look_at_status(self, statusword: int) -> None:
        self.statusword = statusword
        if self.guarded and not self._profile.bits.enabled.hold(statusword):
            fault = self._profile.bits.fault.hold(statusword)
            why = "it is in fault" if fault else "somebody or something has switched it off"
            self._tell(
                "drive not enabled",
                f"{self.link.name} is no longer enabled (statusword 0x{statusword:04X}): {why}. "
                "See the drive's display.",
                fatal=True,
            )

    def _judge_silence(self) -> None:
        silent_ns = self._clock.now_ns() - self._last_good_ns
        if silent_ns > self._silence_ns and self._asks:
            self._tell(
                "drive silent",
                f"{self.link.name} has given no good answer for {silent_ns * 1e-9:.2f} s; last: "
                f"{self._last_trouble}. Check its supply, the cable, and who else is on the line.",
                fatal=True,
            )

    def _tell(self, kind: str, text: str, *, fatal: bool = False) -> None:
        self._watch.tell(self._clock.now_ns(), kind, text, fatal=fatal)

    def _cannot_be(self, kind: str, text: str) -> None:
        self._tell(kind, text, fatal=True)

    def _sample(self, ask: _Ask) -> Sample:
        if ask.received_ns is None:
            return Sample(slot=ask.slot, asked_ns=ask.asked_ns)
        values, scale = ask.values, self._scale
        counts = self._unwrap_motor(int(values[names.POSITION]))
        motor_rad = counts * scale.rad_per_count
        load_counts = load_rad = None
        if self._settings.drive.load is not None:
            load_counts = self._unwrap_load(int(values[names.LOAD]))
            load_rad = load_counts * scale.rad_per_load_count
        if self.guarded:
            load = None if load_counts is None or load_rad is None else (load_counts, load_rad)
            self._plausible.look(ask.asked_ns * 1e-9, ask.commanded_rad, (counts, motor_rad), load)
        return Sample(
            slot=ask.slot,
            asked_ns=ask.asked_ns,
            drive_answered_ns=ask.received_ns,
            encoder_answered_ns=None if load_counts is None else ask.received_ns,
            device_time_us=_whole(_scaled(values.get(names.TIME), scale.time_us)),
            statusword=int(values[names.STATUS]),
            motor_position_counts=counts,
            motor_position_rad=motor_rad,
            motor_velocity_rad_s=_scaled(values.get(names.VELOCITY), scale.velocity_rad_s),
            motor_torque_nm=_scaled(values.get(names.TORQUE), scale.torque_nm),
            motor_current_a=_scaled(values.get(names.CURRENT), scale.current_a),
            motor_sampled_ns=ask.sampled_ns,
            load_sampled_ns=None if load_counts is None else ask.sampled_ns,
            load_angle_counts=load_counts,
            load_angle_rad=load_rad,
            drive_temperature_c=_scaled(values.get(names.TEMPERATURE), self._scale.temperature_c),
        )


def _scaled(digits: Number | None, scale: float | None) -> float | None:
    """A value in its unit; None where the drive does not have it, or answers with no number."""
    if digits is None or scale is None or not math.isfinite(digits):
        return None
    return digits * scale


def _whole(value: float | None) -> int | None:
    return None if value is None else round(value)
