"""A CiA 402 drive and a CiA 406 encoder on CANopen as one `drivers.axis.Axis`.

    enter:  open bus → set up by SDO → operational → enable by PDO, SYNC running, velocity 0
    leave:  quick stop → disable voltage → pre-operational → close bus, whatever was raised

One thread does everything. This master's heartbeat goes out with `command`, so a loop that hangs
falls silent and the drive stops by itself (0x1016, 0x6007 = quick stop): command at least every
`heartbeat_timeout_s`, and on drives that watch SYNC (CSV) without a pause after entering.
"""

from collections.abc import Mapping, Sequence
from statistics import median_low
from types import TracebackType
from typing import Self

from drivers.axis import Sample, StopAsked, WireEvent, never
from drivers.canopen import cia402
from drivers.canopen.budget import check_bus_load
from drivers.canopen.cia402 import State
from drivers.canopen.cycle import Cycle
from drivers.canopen.line import Line, open_bus
from drivers.canopen.listening import refuse_another_master
from drivers.canopen.node import NMT_PRE_OPERATIONAL, SYNC, Node
from drivers.canopen.settings import CanopenSettings
from drivers.canopen.setup import (
    DriveLink,
    open_drive,
    open_encoder,
    set_up_drive,
    set_up_encoder,
)
from drivers.canopen.stopping import stop_by_sdo
from drivers.canopen.timing import check_period
from drivers.canopen.watch import Watch
from drivers.clock import SYSTEM_CLOCK, Clock
from drivers.errors import (
    DriveError,
    DriverError,
    StopAskedError,
    SyncMissingError,
    WireError,
)

_FAULT_RESET_S = 0.5
_PROBES, _PROBING_S = 3, 0.3
_SETTLE_NS = 200_000_000
STANDSTILL_RAD_S = 0.5
"""A shaft slower than this, between two samples, is believed to stand: a coarse encoder's one
count in a short period must stay below."""
_OFF = frozenset({State.SWITCH_ON_DISABLED, State.FAULT, State.NOT_READY})


def _middles(asked: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """The middle of each node's delays; who did not answer each time is judged in the cycle."""
    names = set(asked[0]).intersection(*asked[1:])
    return {name: median_low([delays[name] for delays in asked]) for name in sorted(names)}


class CanopenAxis:
    """One axis on CANopen; see `drivers.axis.Axis`.

    Entering raises SettingsError, WireError, or DriveError, and StopAskedError where `stop_asked`
    says so before the drive is enabled, and leaves nothing enabled. Leaving
    raises WireError where the drive did not confirm its stop and nothing else is being raised;
    otherwise that is added to the other exception as a note.
    """

    def __init__(
        self,
        settings: CanopenSettings,
        clock: Clock = SYSTEM_CLOCK,
        stop_asked: StopAsked = never,
    ) -> None:
        self._settings = settings
        self._clock = clock
        self._stop_asked = stop_asked
        self._period_ns = round(settings.period_s * 1e9)
        self._reset()

    def _reset(self) -> None:
        drive = self._settings.drive
        self._watch = Watch(drive.heartbeat_timeout_s, csv=drive.mode == "csv")
        self._line: Line | None = None
        self._nodes: list[Node] = []
        self._drive: DriveLink | None = None
        self._cycle: Cycle | None = None
        self.may_be_powered = False
        self._own_slot = -(1 << 62)  # ascending and below 0: asked by this master for itself

    def __enter__(self) -> Self:
        self._reset()
        try:
            cycle = self._set_up()
            self.may_be_powered = True
            self._enable(cycle)
        except BaseException as error:
            self._leave(error)
            raise
        cycle.guarded = True
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._leave(error)

    def command(self, velocity_rad_s: float, slot: int) -> int:
        """Send the set-point of this slot, then SYNC; the time just before the SYNC, in ns.

        Where the drive produces SYNC, wait for its next one. Raises WireError when the bus fails or
        no SYNC comes, SettingsError for a velocity beyond 0x60FF.
        """
        return self._running().ask(velocity_rad_s, slot)

    def samples(self, until_ns: int) -> Sequence[Sample]:
        """Samples settled since the last call; see `drivers.axis.Axis`. WireError as `command`."""
        cycle = self._running()
        cycle.receive(until_ns)
        return cycle.samples()

    def finish(self) -> Sequence[Sample]:
        """What has come of the asks that are still open; see `drivers.axis.Axis`."""
        samples = self._running().finish()
        self._watch.tell_totals(self._clock.now_ns())
        return samples

    def next_slot(self, slot: int) -> int:
        """The slot, `slot` or a later one, that the next SYNC of a drive that produces it asks."""
        return self._running().next_slot(slot)

    def events(self) -> Sequence[WireEvent]:
        """What else happened on the wire, from set-up on, since the last call."""
        return self._watch.drain()

    def _running(self) -> Cycle:
        if self._cycle is None:
            raise WireError("this axis has not been entered. Use it inside its `with` block.")
        return self._cycle

    def _set_up(self) -> Cycle:
        settings, watch = self._settings, self._watch
        check_period(settings)
        check_bus_load(settings)
        self._line = line = Line(open_bus(settings.bus), self._clock)

        def note(kind: str, text: str) -> None:
            watch.tell(self._clock.now_ns(), kind, text)

        refuse_another_master(line, settings)
        drive_node = open_drive(line, settings.drive)
        encoder_node = None
        if settings.encoder:
            encoder_node = open_encoder(line, settings.encoder, settings.drive.sdo_timeout_s)
        self._nodes.append(drive_node)
        self._drive = set_up_drive(drive_node, settings, note)
        encoder = None
        if encoder_node and settings.encoder:
            self._nodes.append(encoder_node)
            encoder = set_up_encoder(encoder_node, settings.encoder, settings.drive, note)
        if cia402.decode_state(drive_node.read(0x6041)) == State.FAULT:
            code = self._error_code()
            note("fault reset", f"{drive_node.name} is in fault{code}: it gets one fault reset.")
        self._cycle = Cycle(line, self._drive, encoder, settings, watch)
        return self._cycle

    def _enable(self, cycle: Cycle) -> None:
        """Lead the drive to operation enabled at velocity 0, one controlword per cycle."""
        self._check_latency(cycle)
        drive = self._settings.drive
        start_ns = tick_ns = self._clock.now_ns()
        reset_ns: int | None = None
        cleared = False
        while tick_ns - start_ns < drive.enable_timeout_s * 1e9:
            if self._stop_asked():
                raise StopAskedError
            tick_ns = self._tick(cycle, tick_ns)
            if self._watch.lost_node and self._watch.first_fatal is not None:
                raise WireError(self._watch.first_fatal.text)
            if cycle.statusword is None:
                continue
            if cycle.statusword & self._watch.statusword_mask == self._watch.statusword_value:
                return
            state = cia402.decode_state(cycle.statusword)
            cycle.controlword = cia402.controlword_towards_enabled(state)
            if state == State.FAULT:  # bit 7 has been 0 until now: this is its rising edge
                cycle.controlword = cia402.FAULT_RESET
                reset_ns = tick_ns if reset_ns is None else reset_ns
                if cleared or tick_ns - reset_ns > _FAULT_RESET_S * 1e9:
                    raise DriveError(self._fault_text())
            else:
                cleared = reset_ns is not None
        raise self._not_enabled(cycle)

    def _check_latency(self, cycle: Cycle) -> None:
        """Refuse a node that mostly needs longer than a period: its answers would pile up, and
        which SYNC one of them belongs to could only be guessed. Late ones for some 10 ms are the
        computer's, which others share; a node is late for as long as it is asked.
        """
        asked: list[dict[str, float]] = []
        end_ns = self._clock.now_ns() + round(_PROBING_S * 1e9)
        while len(asked) < _PROBES or self._clock.now_ns() < end_ns:
            self._own_slot += 1
            asked.append(cycle.latencies_s(self._own_slot))
            middle_s = _middles(asked)
            slowest_s = max(middle_s.values(), default=0.0)
            if len(asked) >= _PROBES and slowest_s <= self._settings.period_s:
                return
        for name, late_s in middle_s.items():
            if late_s > self._settings.period_s:
                raise WireError(
                    f"{name} answers SYNC after {late_s * 1e3:.2f} ms in the middle of "
                    f"{len(asked)}, and the period is {self._settings.period_s * 1e3:g} ms. "
                    "Choose a longer period, raise the bit rate, or take what delays the answers "
                    "off the bus."
                )

    def _tick(self, cycle: Cycle, tick_ns: int) -> int:
        """One cycle of this master's own at velocity 0; returns the next cycle's time."""
        if not self._settings.sync_by_drive:
            self._clock.sleep_until(tick_ns)
        else:
            cycle.receive(0)  # what came before this cycle's SYNC
        self._own_slot += 1
        cycle.ask(0.0, self._own_slot)
        tick_ns = max(tick_ns + self._period_ns, self._clock.now_ns())
        cycle.receive(tick_ns)
        cycle.samples()
        return tick_ns

    def _fault_text(self) -> str:
        return (
            f"{self._drive_name} is in fault and a fault reset did not clear it"
            f"{self._error_code(with_remedy=True)}, then run again."
        )

    def _error_code(self, *, with_remedy: bool = False) -> str:
        """The drive's error code as a piece of a sentence; empty where it cannot be read."""
        node = self._nodes[0]
        if not node.has(0x603F):
            return ": remove its cause (the drive's display tells more)" if with_remedy else ""
        code = node.read(0x603F)
        text = f": error code (0x603F) {cia402.describe_error_code(code)}"
        return f"{text}. To do: {cia402.remedy(code)}" if with_remedy else text

    def _not_enabled(self, cycle: Cycle) -> DriverError:
        timeout = f"within {self._settings.drive.enable_timeout_s:g} s"
        if cycle.statusword is None:
            return WireError(
                f"{self._drive_name} did not answer SYNC {timeout}: no statusword came by PDO. "
                "Power-cycle the drive; see whether it produces SYNC itself."
            )
        seen = cia402.describe_statusword(cycle.statusword)
        if cia402.decode_state(cycle.statusword) == State.OPERATION_ENABLED:
            return DriveError(
                f"{self._drive_name} is enabled but does not follow its velocity command {timeout} "
                f"(statusword 0x{cycle.statusword:04X}, bit 12 is 0). Check mode CSV, the SYNC "
                "period, and the drive's limits."
            )
        advice = "See the drive's display and its enable input."
        if not cycle.statusword & cia402.VOLTAGE_ENABLED:
            advice = "Switch on the DC link."
        return DriveError(
            f"{self._drive_name} did not reach operation enabled {timeout}: last state {seen}. "
            f"{advice} Or raise drive.enable_timeout_s."
        )

    @property
    def _drive_name(self) -> str:
        return f"drive {self._settings.drive.node.node_id}"

    def _leave(self, active: BaseException | None) -> None:
        """Stop, power off, close. Every step is tried, whatever the one before it did."""
        line, cycle, drive = self._line, self._cycle, self._drive
        self._line = self._cycle = None
        if line is None:
            return
        problem: str | None = None
        stopped = cycle is None
        try:
            if cycle is not None and drive is not None:
                problem = self._stop(cycle, drive)
                stopped = problem is None
                self.may_be_powered = not stopped
        finally:
            try:
                self._release(cycle, drive, stopped=stopped)
            finally:
                line.close()
        if problem is not None:
            if active is None:
                raise WireError(problem)
            active.add_note(problem)

    def _stop(self, cycle: Cycle, drive: DriveLink) -> str | None:
        """Bring the drive to rest and power it off; what is wrong, or None when confirmed."""
        cycle.guarded = False
        try:
            if self._stop_on_sync(cycle) or stop_by_sdo(
                drive.node, self._settings.drive.stop_timeout_s
            ):
                return None
            reason = ""
        except DriverError as error:
            reason = f" ({error})"
        last = "none" if cycle.statusword is None else cia402.describe_statusword(cycle.statusword)
        own_stop = (
            f"it watches this master (0x{drive.watchdog[0]:04X}) and quick-stops by itself "
            f"{self._settings.drive.heartbeat_timeout_s:g} s after its last word (0x6007)"
            if drive.watchdog
            else "it does not watch this master's heartbeat (no 0x1016) and may still turn"
        )
        return (
            f"{self._drive_name} did not confirm its stop; last state: {last}{reason}. If it is "
            f"still powered, {own_stop}. Use the emergency stop if the shaft turns."
        )

    def _stop_on_sync(self, cycle: Cycle) -> bool:
        try:
            return self._stop_by_pdo(cycle)
        except SyncMissingError:
            return False  # no PDO acts without the drive's SYNC; an SDO does

    def _stop_by_pdo(self, cycle: Cycle) -> bool:
        """Quick stop, then power off, until statusword and position say so.

        False where no statusword comes. A statusword that says off while the shaft turns is not
        believed: it gets quick stop for as long as any other. A drive whose quick stop holds the
        axis (0x605A from 5 on) is powered off when it has stood for a while; the others do so
        themselves. Raises WireError where it turns on.
        """
        begun_ns = tick_ns = self._clock.now_ns()
        quick_ns = begun_ns + round(self._settings.drive.stop_timeout_s * 1e9)
        silence_ns = round(self._settings.answer_timeout_s * 1e9)
        moved_ns = begun_ns
        holds = (self._settings.drive.profile.stopping.quick_stop_option or 5) >= 5
        off = False
        cycle.controlword = cia402.QUICK_STOP
        while tick_ns < quick_ns + silence_ns and not self._watch.lost_node:
            tick_ns = self._tick(cycle, tick_ns)
            if tick_ns - max(cycle.statusword_ns, begun_ns) > silence_ns:
                return False
            if cycle.statusword is not None and cycle.statusword_ns > begun_ns:
                state = cia402.decode_state(cycle.statusword)
                off = state in _OFF
                if state == State.OPERATION_ENABLED and tick_ns - begun_ns > silence_ns:
                    return False  # answers come, commands do not arrive
                if off and self._stands(cycle):
                    cycle.controlword = cia402.DISABLE_VOLTAGE
                    self._tick(cycle, tick_ns)
                    return True
                if not self._stands(cycle):
                    moved_ns = tick_ns
                if holds and state == State.QUICK_STOP_ACTIVE and tick_ns - moved_ns > _SETTLE_NS:
                    cycle.controlword = cia402.DISABLE_VOLTAGE
                elif not off:
                    cycle.controlword = cia402.controlword_towards_disabled(state)
            if tick_ns >= quick_ns:
                cycle.controlword = cia402.DISABLE_VOLTAGE
        if off and not self._watch.lost_node:
            raise WireError(
                "its statusword says off, but its position says that the shaft still turns at "
                f"{cycle.motor_velocity_rad_s or 0.0:.3g} rad/s: it coasts, or the statusword lies"
            )
        return False

    @staticmethod
    def _stands(cycle: Cycle) -> bool:
        velocity_rad_s = cycle.motor_velocity_rad_s
        return velocity_rad_s is not None and abs(velocity_rad_s) < STANDSTILL_RAD_S

    def _release(self, cycle: Cycle | None, drive: DriveLink | None, *, stopped: bool) -> None:
        """Last words on the bus, as far as it still takes them."""
        try:
            if cycle is not None and not stopped:
                cycle.controlword = cia402.DISABLE_VOLTAGE
                cycle.ask(0.0, self._own_slot + 1)
            elif drive is not None:
                if self._settings.sync_by_drive:
                    drive.node.write(0x1005, 0, SYNC)
                if drive.watchdog:
                    drive.node.write(*drive.watchdog, 0)
        except DriverError:
            pass  # a bus or node that is gone takes nothing; the stop has been judged already
        for node in self._nodes:
            try:
                node.nmt(NMT_PRE_OPERATIONAL)
            except DriverError:
                return
