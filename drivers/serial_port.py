"""Opening and reading a serial device with errors in words; what it means is each driver's own."""

import os
import termios
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import serial

from drivers.errors import SettingsError, WireError


def open_port(
    device: str,
    baud_rate: int,
    *,
    data_bits: int = 8,
    parity: str,
    stop_bits: int,
    table: str = "bus",
) -> Any:
    """A pyserial port that never blocks, ours alone. `table` is the rig file's, for messages.

    Raises SettingsError where the device cannot be set so, WireError where it cannot be opened.
    """
    speed = f"{baud_rate} Bd {data_bits}{parity}{stop_bits}"
    try:
        port = serial.Serial(
            device,
            baud_rate,
            bytesize=data_bits,
            parity=parity,
            stopbits=stop_bits,
            timeout=0,
            exclusive=True,
        )
    except (ValueError, OverflowError) as error:
        raise SettingsError(
            f"{device} at {speed} cannot be: {error}. Correct [{table}]."
        ) from error
    except termios.error as error:
        raise SettingsError(
            f"{device} refuses {speed}: {error}. The device or its driver has no such "
            f"speed, parity, or stop bits (a pty has no parity): correct [{table}]."
        ) from error
    except OSError as error:
        raise WireError(
            f"cannot open {device}: {error}. Plug the adapter in, correct {table}.device, close "
            "what else uses it, or join the group that owns it (often dialout)."
        ) from error
    os.set_blocking(port.fileno(), False)
    with suppress(NotImplementedError, ValueError, OSError):
        port.set_low_latency_mode(True)  # else USB adapters hold bytes back for 16 ms
    return port


def read_now(port: Any, most: int, gone: Callable[[object], Exception]) -> bytes:
    """What has come, at most so many bytes; empty where nothing has. Raises `gone(why)`."""
    try:
        data = os.read(port.fileno(), most)
    except BlockingIOError:
        return b""
    except OSError as error:
        raise gone(error) from error
    if not data:
        raise gone("the device has been unplugged or closed")
    return data
