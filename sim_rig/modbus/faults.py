"""What ordered faults make of an answer on its way out. See `sim_rig.modbus.orders`."""

from collections.abc import Callable, Sequence

from pymodbus.framer import FramerRTU

from sim_rig.modbus.orders import Order

_EXCEPTION = 0x80


class Answers:
    """The way out of one drive's answers, whole frames in and bytes out.

    Once `unplugged` the line carries nothing any more, in either direction.
    """

    def __init__(self, orders: Sequence[Order], *, rtu: bool, enabled: Callable[[], bool]) -> None:
        self._orders = orders
        self._rtu = rtu
        self._enabled = enabled
        self._request = 0
        self._held = b""
        self.unplugged = False

    def __call__(self, frame: bytes) -> bytes:
        """What goes onto the line in place of this frame; may be nothing."""
        if self.unplugged:
            return b""
        if not self._enabled():
            self._request = 0
            return frame
        kinds = {order.kind: order for order in self._orders if order.hits(self._request)}
        self._request += 1
        if "unplugged" in kinds:
            self.unplugged = True
            return b""
        if "exception" in kinds:
            frame = self._refusal(frame, kinds["exception"].code)
        if "damaged" in kinds:
            frame = self._damaged(frame)
        if "duplicated" in kinds:
            frame += frame
        if "lost" in kinds:
            frame = b""
        if "late" in kinds:
            self._held += frame
            return b""
        held, self._held = self._held, b""
        return held + frame

    def _refusal(self, frame: bytes, code: int) -> bytes:
        if self._rtu:
            body = bytes([frame[0], frame[1] | _EXCEPTION, code])
            return body + FramerRTU.compute_CRC(body).to_bytes(2, "big")
        return frame[:4] + b"\0\x03" + frame[6:7] + bytes([frame[7] | _EXCEPTION, code])

    def _damaged(self, frame: bytes) -> bytes:
        if self._rtu:
            return frame[:-1] + bytes([frame[-1] ^ 0xFF])
        return bytes([frame[0] ^ 0x80]) + frame[1:]
