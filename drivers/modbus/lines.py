"""The two lines Modbus runs on, as values, and how long bytes take on them."""

from dataclasses import dataclass
from typing import Literal

from drivers.errors import SettingsError

T35_FIXED_S = 1.75e-3
"""t3.5 above 19200 Bd: Modbus over serial line, V1.02, section 2.5.1.1."""
_FIXED_ABOVE_BD = 19200


@dataclass(frozen=True, slots=True)
class TcpLine:
    """Modbus TCP. `round_trip_s` is what the network takes there and back."""

    host: str
    port: int = 502
    round_trip_s: float = 0.0005
    connect_timeout_s: float = 2.0

    def __post_init__(self) -> None:
        if not (self.host and 0 < self.port < 1 << 16):
            raise SettingsError(
                f"bus.host = {self.host!r}, bus.port = {self.port}: Modbus TCP needs the drive's "
                "address and its port (502 on most drives)."
            )

    @property
    def name(self) -> str:
        """For messages."""
        return f"{self.host}:{self.port}"


@dataclass(frozen=True, slots=True)
class RtuLine:
    """Modbus RTU on a serial device: 8 data bits, always."""

    device: str
    baud_rate: int = 115200
    parity: Literal["N", "E", "O"] = "E"
    stop_bits: Literal[1, 2] = 1

    def __post_init__(self) -> None:
        if not self.device or self.baud_rate < 300:
            raise SettingsError(
                f"bus.device = {self.device!r}, bus.baud_rate = {self.baud_rate}: Modbus RTU needs "
                'a serial device and its speed, e.g. device = "/dev/ttyUSB0", baud_rate = 115200.'
            )
        if self.parity not in ("N", "E", "O") or self.stop_bits not in (1, 2):
            raise SettingsError(
                f"bus.parity = {self.parity!r}, bus.stop_bits = {self.stop_bits}: parity is N, E, "
                "or O, stop bits are 1 or 2 (8N2, 8E1, and 8O1 are Modbus's own)."
            )

    @property
    def name(self) -> str:
        """For messages."""
        return f"{self.device} at {self.speed}"

    @property
    def speed(self) -> str:
        """Speed and character, as in "115200 Bd 8E1"."""
        return f"{self.baud_rate} Bd 8{self.parity}{self.stop_bits}"

    @property
    def character_s(self) -> float:
        """Start bit, eight data bits, parity if any, stop bits."""
        bits = 9 + (self.parity != "N") + self.stop_bits
        return bits / self.baud_rate

    @property
    def t35_s(self) -> float:
        """The silence that ends a frame."""
        return T35_FIXED_S if self.baud_rate > _FIXED_ABOVE_BD else 3.5 * self.character_s


Line = TcpLine | RtuLine
