"""A drive on Modbus TCP or RTU, and the encoder that hangs on it, as one `drivers.axis.Axis`.

    enter:  open the line → identity, ratings → watchdog → reset of a fault → velocity 0 → enable
    leave:  velocity 0 and stop → at rest → disable → watchdog off → close, whatever was raised

One thread does everything. A drive with a communication timeout stops by itself when this master
falls silent: command at least that often (`ModbusSettings.own_stop_s`).
"""

from collections.abc import Sequence
from types import TracebackType
from typing import Self

from drivers.axis import Sample, StopAsked, WireEvent, never
from drivers.clock import SYSTEM_CLOCK, Clock
from drivers.errors import DriveError, StopAskedError, WireError
from drivers.modbus import profile as names
from drivers.modbus.cycle import Cycle
from drivers.modbus.link import Link
from drivers.modbus.settings import ModbusSettings
from drivers.modbus.setup import Registers, arm_watchdog, check_identity, read_scale
from drivers.modbus.stopping import not_confirmed, open_link, stop_anew, stop_over
from drivers.modbus.watch import Watch


class ModbusAxis:
    """One axis on Modbus; see `drivers.axis.Axis`.

    Entering raises SettingsError, WireError, or DriveError, and StopAskedError where `stop_asked`
    says so before the drive is enabled, and leaves nothing enabled. Leaving
    raises WireError where the drive did not confirm its stop and nothing else is being raised;
    otherwise that is added to the other exception as a note.
    """

    def __init__(
        self,
        settings: ModbusSettings,
        clock: Clock = SYSTEM_CLOCK,
        stop_asked: StopAsked = never,
    ) -> None:
        self._settings = settings
        self._profile = settings.drive.profile
        self._clock = clock
        self._stop_asked = stop_asked
        self._reset()

    def _reset(self) -> None:
        self._watch = Watch()
        self._link: Link | None = None
        self._cycle: Cycle | None = None
        self.may_be_powered = False  # from the first thing on that must be undone

    def __enter__(self) -> Self:
        self._reset()
        try:
            self._cycle = self._set_up()
        except BaseException as error:
            self._leave(error)
            raise
        self._cycle.guarded = True
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._leave(error)

    def command(self, velocity_rad_s: float, slot: int) -> int:
        """Send the set-point of this slot and ask for its sample; the time just before, in ns.

        Raises WireError when the line fails, SettingsError for a velocity that does not fit.
        """
        return self._running().ask(velocity_rad_s, slot)

    def samples(self, until_ns: int) -> Sequence[Sample]:
        """Samples settled since the last call; see `drivers.axis.Axis`. WireError as `command`."""
        cycle = self._running()
        cycle.receive(until_ns)
        return cycle.samples()

    def finish(self) -> Sequence[Sample]:
        """The slots whose answer has not come; see `drivers.axis.Axis`."""
        samples = self._running().finish()
        self._watch.tell_totals(self._clock.now_ns())
        return samples

    def events(self) -> Sequence[WireEvent]:
        """What else happened on the wire, from set-up on, since the last call."""
        return self._watch.drain()

    def _running(self) -> Cycle:
        if self._cycle is None:
            raise WireError("this axis has not been entered. Use it inside its `with` block.")
        return self._cycle

    def _note(self, kind: str, text: str) -> None:
        self._watch.tell(self._clock.now_ns(), kind, text)

    def _set_up(self) -> Cycle:
        settings, profile = self._settings, self._profile
        self._link = link = open_link(settings, self._clock)
        registers = Registers(link, settings, self._clock)
        check_identity(registers, settings)
        scale = read_scale(registers, settings, self._note)
        until_ns = self._clock.now_ns() + round(settings.drive.enable_timeout_s * 1e9)
        registers.follow(profile.prepare, until_ns)
        self._refuse_a_drive_in_use(registers)
        self._heed_stop()
        self.may_be_powered = True
        registers.follow(profile.set_up, until_ns)
        arm_watchdog(registers, settings, self._note)
        self._reset_fault(registers, until_ns)
        registers.write(names.TARGET, 0)
        self._heed_stop()
        registers.follow(profile.enable, until_ns)
        status = registers.status()
        if not profile.bits.enabled.hold(status):
            raise DriveError(
                f"{link.name} took every step of its enabling, but its statusword is "
                f"0x{status:04X}{registers.error_text()}. See its display and its enable input."
            )
        return Cycle(link, settings, scale, self._watch, self._clock)

    def _heed_stop(self) -> None:
        if self._stop_asked():
            raise StopAskedError

    def _refuse_a_drive_in_use(self, registers: Registers) -> None:
        """Somebody else's drive is not taken over while it turns."""
        status = registers.status()
        if self._profile.bits.enabled.hold(status):
            raise DriveError(
                f"{registers.link.name} is enabled already (statusword 0x{status:04X}): somebody "
                "else drives it, or a run has ended without stopping it. Stop it there, or switch "
                "the drive off and on."
            )

    def _reset_fault(self, registers: Registers, until_ns: int) -> None:
        fault = self._profile.bits.fault
        if not fault.hold(registers.status()):
            return
        code = registers.error_text()
        self._note("fault reset", f"{registers.link.name} is in fault{code}: it gets one reset.")
        registers.follow(self._profile.reset, until_ns)
        if fault.hold(registers.status()):
            raise DriveError(
                f"{registers.link.name} is in fault and a reset did not clear it{code}. Remove its "
                "cause (the drive's display tells more), then run again."
            )

    def _leave(self, active: BaseException | None) -> None:
        """Stop, power off, close. Every step is tried, whatever the one before it did."""
        link, self._link, self._cycle = self._link, None, None
        if link is None:
            return
        problem = None
        try:
            if self.may_be_powered:
                problem = self._stop(link)
                self.may_be_powered = problem is not None
        finally:
            link.close()
        if problem is not None:
            if active is None:
                raise WireError(problem)
            active.add_note(problem)

    def _stop(self, link: Link) -> str | None:
        """Bring the drive to rest and power it off; what is wrong, or None when confirmed.

        A line that fails on the way is opened once more: a drive that turns is worth a second try.
        """
        settings, clock = self._settings, self._clock
        try:
            return stop_over(link, settings, clock)
        except WireError:
            link.close()
            return stop_anew(settings, clock)
        except DriveError as refused:
            return not_confirmed(settings, str(refused))
