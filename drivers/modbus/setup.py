"""Talking to the drive outside the cycle: registers, steps, and what must be true of them."""

from collections.abc import Callable, Sequence

from drivers.clock import Clock
from drivers.errors import DriveError, SettingsError
from drivers.modbus import profile as names
from drivers.modbus.budget import response_timeout_s
from drivers.modbus.frames import read_request, write_request
from drivers.modbus.link import Link, transact
from drivers.modbus.plan import Exchange, write_function
from drivers.modbus.profile import DriveProfile, Step
from drivers.modbus.registers import Number
from drivers.modbus.scaling import Scale, scale_of
from drivers.modbus.settings import ModbusSettings

_POLL_S = 0.01
Note = Callable[[str, str], None]


class Registers:
    """A drive's items over an open link, one transaction each; errors as `link.transact`."""

    def __init__(self, link: Link, settings: ModbusSettings, clock: Clock) -> None:
        self.link = link
        self.profile: DriveProfile = settings.drive.profile
        self._clock = clock
        self._reads = settings.plan.reads
        longest = max(settings.plan.exchanges, key=self._timeout_of(settings))
        self._timeout_s = self._timeout_of(settings)(longest)

    def _timeout_of(self, settings: ModbusSettings) -> Callable[[Exchange], float]:
        return lambda exchange: response_timeout_s(self.profile, settings.line, exchange)

    def read(self, name: str) -> Number:
        """One item, in digits."""
        codec = self.profile.codec(name)
        item = codec.item
        function = item.read or self.profile.functions.read
        request = read_request(function, item.address, item.words)
        what = f"read {name} (register 0x{item.address:04X})"
        pdu = transact(self.link, request, self._timeout_s, self._clock, what)
        return codec.decode(pdu.registers)

    def write(self, name: str, digits: Number) -> None:
        """One item, in digits."""
        codec = self.profile.codec(name)
        address, words = codec.item.address, codec.encode(digits)
        function = write_function(self.profile, codec)
        if function == 6 and len(words) > 1:
            function = 16
        request = write_request(function, address, words)
        what = f"write {digits} to {name} (register 0x{address:04X})"
        transact(self.link, request, self._timeout_s, self._clock, what)

    def state(self) -> dict[str, Number]:
        """What the cycle reads, read by itself."""
        values: dict[str, Number] = {}
        for exchange in self._reads:
            block = exchange.read
            assert block is not None  # noqa: S101 - these are the plan's reads
            pdu = transact(
                self.link, exchange.request({}), self._timeout_s, self._clock, "read its state"
            )
            values |= block.decode(pdu.registers)
        return values

    def status(self) -> int:
        """The statusword."""
        return int(self.read(names.STATUS))

    def follow(self, steps: Sequence[Step], until_ns: int) -> None:
        """Take steps one after the other; DriveError where one does not come true in time."""
        for step in steps:
            self.write(step.write, step.value)
            if step.until is None:
                continue
            status = self.status()
            while not step.until.hold(status):
                if self._clock.now_ns() >= until_ns:
                    raise DriveError(
                        f"{self.link.name} did not do as told in time: after {step.write} = "
                        f"{step.value} its statusword is 0x{status:04X}, wanted "
                        f"0x{step.until.value:04X} under 0x{step.until.mask:04X}"
                        f"{self.error_text()}. See the drive's display, its DC link, and its "
                        "enable input, or raise drive.enable_timeout_s."
                    )
                self._clock.sleep_s(_POLL_S)
                status = self.status()

    def error_text(self) -> str:
        """The drive's error code as a piece of a sentence; empty where it has none."""
        if names.ERROR_CODE not in self.profile.items:
            return ""
        return f", error code 0x{int(self.read(names.ERROR_CODE)):04X}"


def check_identity(registers: Registers, settings: ModbusSettings) -> None:
    """Is this the drive that the profile describes, with the encoders that the rig has?

    Raises DriveError for another drive, SettingsError for other encoders.
    """
    profile, drive = registers.profile, settings.drive
    for name, wanted in profile.identity.items():
        got = registers.read(name)
        if got != wanted:
            raise DriveError(
                f"{registers.link.name} is no {profile.title}: {name} is {got}, its profile says "
                f"{wanted}. Choose the right drive.profile, or correct drive.unit."
            )
    load_counts = drive.load.counts_per_revolution if drive.load else None
    for name, setting, configured in (
        (names.MOTOR_COUNTS, "drive.counts_per_revolution", drive.counts_per_revolution),
        (names.LOAD_COUNTS, "drive.second_encoder.counts_per_revolution", load_counts),
    ):
        if name in profile.items and configured is not None:
            told = registers.read(name) * profile.items[name].scale
            if told != configured:
                raise SettingsError(
                    f"{registers.link.name}: {name} is {told:g}, but the configuration says "
                    f"{setting} = {configured}: every angle would be wrong by that. Make them the "
                    "same."
                )


def read_scale(registers: Registers, settings: ModbusSettings, note: Note) -> Scale:
    """Scale factors, with what the drive itself tells of its ratings."""
    items = registers.profile.items
    rated: dict[str, float | None] = {
        names.RATED_TORQUE: settings.drive.rated_torque_nm,
        names.RATED_CURRENT: None,
    }
    for name in rated:
        if name in items:
            rated[name] = float(registers.read(name)) * items[name].scale or None
    scale = scale_of(
        settings.drive,
        rated_torque_nm=rated[names.RATED_TORQUE],
        rated_current_a=rated[names.RATED_CURRENT],
    )
    if scale.torque_nm is None:
        note(
            "no torque",
            f"{registers.link.name} tells no torque, or not what it is per mille of: give "
            "drive.rated_torque_nm.",
        )
    if scale.current_a is None and names.CURRENT in items:
        note(
            "no motor current",
            f"{registers.link.name} tells a current, but not what it is per mille of: "
            "motor_current_a stays empty. Give its profile an item rated_current.",
        )
    return scale


def arm_watchdog(registers: Registers, settings: ModbusSettings, note: Note) -> None:
    """Let the drive stop by itself when no request comes any more. DriveError where it will not."""
    watchdog, own_stop_s = registers.profile.watchdog, settings.own_stop_s
    if watchdog is None or own_stop_s is None:
        note(
            "master not watched",
            f"{registers.link.name} does not stop by itself when this master dies; the operator "
            "has acknowledged it (drive.without_watchdog).",
        )
        return
    digits = round(own_stop_s / watchdog.unit_s)
    registers.write(watchdog.item, digits)
    kept = registers.read(watchdog.item)
    if kept != digits:
        raise DriveError(
            f"{registers.link.name} did not keep its communication timeout ({watchdog.item}): "
            f"wrote {digits}, read {kept}. It would not stop by itself: see its manual."
        )
    note(
        "own stop",
        f"{registers.link.name}: {watchdog.action} {own_stop_s:g} s after its master's last word.",
    )
