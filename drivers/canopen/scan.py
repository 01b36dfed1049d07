"""Who is on the bus? Every node is asked for its identity; who is heard otherwise counts too."""

from dataclasses import dataclass

from canopen.objectdictionary import ObjectDictionary
from canopen.sdo.exceptions import SdoError

from drivers.canopen.line import Line
from drivers.canopen.node import SDO_REQUEST, BusSdoClient

_ALL = range(1, 128)
_PACE_S = 0.002
"""Slowly enough for an adapter's queue of ten frames at 125 kbit/s."""
_SETTLE_S = 0.2
_READ_DEVICE_TYPE = bytes((0x40, 0x00, 0x10, 0, 0, 0, 0, 0))


@dataclass(frozen=True, slots=True)
class Found:
    """A node that answers, and what it says of itself; None where it does not say."""

    node_id: int
    device_type: int | None
    vendor_id: int | None
    product_code: int | None
    revision: int | None

    @property
    def profile(self) -> str:
        """Its CiA profile in words."""
        number = None if self.device_type is None else self.device_type & 0xFFFF
        known = {402: "CiA 402 drive", 406: "CiA 406 encoder", 401: "CiA 401 I/O"}
        return known.get(number or 0, "no profile told" if not number else f"CiA {number}")

    def __str__(self) -> str:
        vendor = "?" if self.vendor_id is None else f"0x{self.vendor_id:X}"
        product = "?" if self.product_code is None else f"0x{self.product_code:X}"
        return f"node {self.node_id}: {self.profile}, vendor {vendor}, product {product}"


def find_nodes(line: Line, timeout_s: float = 0.2) -> list[Found]:
    """Every node that answers an SDO or is heard otherwise; WireError where the bus fails."""
    scanner = line.network.scanner
    scanner.reset()
    for node_id in _ALL:
        line.send(SDO_REQUEST + node_id, _READ_DEVICE_TYPE)
        _listen(line, _PACE_S)
    _listen(line, _SETTLE_S)
    return [_identity(line, node_id, timeout_s) for node_id in sorted(scanner.nodes)]


def _listen(line: Line, duration_s: float) -> None:
    line.receive_until(line.clock.now_ns() + round(duration_s * 1e9), lambda: False)


def _identity(line: Line, node_id: int, timeout_s: float) -> Found:
    client = BusSdoClient(node_id, ObjectDictionary(), line, timeout_s)

    def read(index: int, sub: int) -> int | None:
        try:
            return int.from_bytes(client.upload(index, sub)[:4], "little")
        except SdoError:
            return None

    return Found(node_id, read(0x1000, 0), read(0x1018, 1), read(0x1018, 2), read(0x1018, 3))
