"""The bus as the set-up sees it: opened with errors in words, one thread, no notifier.

Whoever waits reads the bus himself and hands every frame to canopen's dispatcher, so no thread
ever reads the bus but the one that runs the axis.
"""

import errno
import logging
import socket
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import can
import canopen
from can.interfaces import BACKENDS

from drivers.canopen.settings import BusOptions
from drivers.clock import SYSTEM_CLOCK, Clock
from drivers.errors import SettingsError, WireError

logging.getLogger("canopen").addHandler(logging.NullHandler())  # what it logs, errors here say

_GREETING = b"< hi >"
_PROBE_TIMEOUT_S = 2.0
_GARBLED = 100
"""Garbled frames passed over in one read at most."""
_EXTRAS = {
    "slcan": "serial",
    "serial": "serial",
    "robotell": "serial",
    "seeedstudio": "serial",
    "udp_multicast": "multicast",
}
"""Interfaces of python-can that need a package more, and the extra that brings it."""
_HELP = {
    errno.EAFNOSUPPORT: "this kernel has no CAN. Load the modules can and can_raw, or use an "
    "interface that needs none (slcan, socketcand)",
    errno.ENODEV: "there is no such CAN interface. See `ip link`; create it or correct bus.channel",
    errno.ENETDOWN: "the CAN interface is down. `ip link set <channel> up type can bitrate ...`",
    errno.ENOENT: "there is no such device. Plug the adapter in, or correct bus.channel",
    errno.EACCES: "access denied. Join the group that owns the device (often dialout)",
}


def known_interface(options: BusOptions) -> str:
    """The bus's interface; SettingsError for one that python-can does not know."""
    interface = options.get("interface")
    if interface not in BACKENDS:
        raise SettingsError(
            f"bus.interface is {interface!r}, which python-can does not know. Choose one of "
            f"{', '.join(sorted(BACKENDS))}."
        )
    return str(interface)


def open_bus(options: BusOptions) -> can.BusABC:
    """Open the bus that the options describe; only they count, no configuration file.

    Raises SettingsError for an interface or option that python-can does not know, WireError
    where it knows but nothing is there.
    """
    keywords: dict[str, Any] = dict(options)
    where = ", ".join(f"{key} = {value}" for key, value in options.items())
    interface = known_interface(options)
    if interface == "socketcand":
        _probe_socketcand(str(options.get("host", "")), options.get("port"))
    try:
        return can.Bus(ignore_config=True, **keywords)
    except (can.CanInterfaceNotImplementedError, ImportError, NameError) as error:
        # NameError: python-can's kvaser without its library
        raise SettingsError(
            f"cannot open the bus ({where}): {error}. {_missing_package(interface)}"
        ) from error
    except (TypeError, ValueError, KeyError) as error:
        raise SettingsError(
            f"cannot open the bus ({where}): {error}. Correct the options of [bus]."
        ) from error
    except can.CanError as error:
        raise WireError(
            f"cannot open the bus ({where}): {error}. Check adapter and channel."
        ) from error
    except OSError as error:
        reason = _HELP.get(error.errno or 0, f"{error}. Check adapter and channel")
        raise WireError(f"cannot open the bus ({where}): {reason}.") from error


def _missing_package(interface: str) -> str:
    extra = _EXTRAS.get(interface)
    if extra is None:
        return "Install what this interface needs."
    return f"Install what this interface needs: pip install 'python-can[{extra}]'."


def _probe_socketcand(host: str, port: object) -> None:
    """See that a server listens and greets, at once: the client would spin for ten seconds."""
    if not host or not isinstance(port, int):
        raise SettingsError(
            f"bus.host = {host!r}, bus.port = {port!r}: a socketcand bus needs the name of its "
            'server and its port number, e.g. host = "127.0.0.1", port = 29536.'
        )
    where = f"{host}:{port}"
    try:
        with socket.create_connection((host, port), timeout=_PROBE_TIMEOUT_S) as connection:
            greeting = connection.recv(len(_GREETING))
    except (OSError, OverflowError) as error:
        raise WireError(
            f"no socketcand server at {where}: {error}. Start the software rig or the server "
            "there, or correct bus.host and bus.port."
        ) from error
    if greeting != _GREETING:
        raise WireError(
            f"what listens at {where} is no socketcand server: it said {greeting!r} instead of "
            f"{_GREETING!r}. Correct bus.host and bus.port."
        )


class Line:
    """An open bus, canopen's dispatcher on it, and a clock."""

    def __init__(self, bus: can.BusABC, clock: Clock = SYSTEM_CLOCK) -> None:
        self.bus = bus
        self.clock = clock
        self.network = canopen.Network(bus)

    @property
    def name(self) -> str:
        """What the bus calls itself."""
        return str(self.bus.channel_info)

    def send(self, cob_id: int, data: bytes) -> None:
        """Send a data frame; WireError where the bus does not take it."""
        try:
            self.network.send_message(cob_id, data)
        except (can.CanError, OSError) as error:
            raise self.broken(error) from error

    def read(self, timeout_s: float) -> can.Message | None:
        """The next frame; None where none came in time. WireError if the bus dies.

        One that is garbled is as good as lost: slcan and its like read lines of text, and a byte
        that was damaged on the serial line makes python-can raise what `int` and `decode` do.
        """
        for _ in range(_GARBLED):
            try:
                return self.bus.recv(timeout_s)
            except (ValueError, IndexError):
                pass
            except (can.CanError, OSError) as error:
                if not isinstance(error.__cause__, UnicodeDecodeError):
                    raise self.broken(error) from error
                self._forget_line()
            timeout_s = 0.0  # what has come already; whoever waits on looks at the clock
        return None

    def _forget_line(self) -> None:
        """Text that cannot be decoded: python-can's slcan would keep it and fail at it for ever."""
        text = getattr(self.bus, "_buffer", None)
        if isinstance(text, bytearray):
            text.clear()

    def close(self) -> None:
        """Close the bus. One that is gone cannot be closed in order, and that is no news."""
        with suppress(can.CanError, OSError):
            self.bus.shutdown()

    def receive_until(self, deadline_ns: int, done: Callable[[], bool]) -> bool:
        """Dispatch frames until `done` or the deadline; True if done. WireError if the bus dies."""
        while not done():
            remaining_ns = deadline_ns - self.clock.now_ns()
            if remaining_ns <= 0:
                return False
            frame = self.read(remaining_ns * 1e-9)
            if frame is not None and not (frame.is_error_frame or frame.is_remote_frame):
                self.network.notify(frame.arbitration_id, frame.data, frame.timestamp)
        return True

    def broken(self, error: Exception) -> WireError:
        """The error for a bus that failed under way."""
        reason = " ".join(str(error).split("Traceback")[0].split())
        code = getattr(error, "error_code", None) or getattr(error, "errno", None) or 0
        advice = _HELP.get(code, "Check server, adapter, and cable")
        return WireError(f"the bus ({self.name}) is gone: {reason}. {_sentence(advice)}")


def _sentence(words: str) -> str:
    return f"{words[:1].upper()}{words[1:]}."
