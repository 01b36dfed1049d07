"""One TPDO's answers on their way into a sample, and the frames that ask for them."""

import can

from drivers.canopen.matcher import Matcher
from drivers.canopen.pdo import Layout
from drivers.canopen.watch import Watch

Values = tuple[int, ...]
Place = tuple[int, int]
"""Which of the streams, and where in its values."""


class Stream:
    """One TPDO: its frames unpacked and matched."""

    __slots__ = ("_layout", "_watch", "last_answer_ns", "matcher", "name")

    def __init__(self, name: str, layout: Layout, timeout_ns: int, watch: Watch) -> None:
        self.name = name
        self.matcher: Matcher[Values] = Matcher(timeout_ns)
        self.last_answer_ns = 0
        self._layout = layout
        self._watch = watch

    def on_frame(self, data: bytearray, now_ns: int) -> Values | None:
        """Take a frame; None where it is no answer of ours."""
        codec = self._layout.codec
        if len(data) != codec.size:
            self._watch.on_malformed(self.name, self._layout.cob_id, len(data), codec.size, now_ns)
            return None
        values: Values = codec.unpack(data)
        self.last_answer_ns = now_ns
        if not self.matcher.answer(values, now_ns):
            self._watch.on_duplicate(self.name, now_ns)
        return values


def value_at(values: list[Values | None], place: Place | None) -> int | None:
    """One object of a slot's answers; None where it is not mapped, or its answer was lost."""
    if place is None:
        return None
    answer = values[place[0]]
    return None if answer is None else answer[place[1]]


def pair(counts: int | None, angle_rad: float | None) -> tuple[int, float] | None:
    """Both, or None where one did not come."""
    return None if counts is None or angle_rad is None else (counts, angle_rad)


def scaled(value: int | None, unit: float | None) -> float | None:
    """Digits in their unit; None where they did not come, or nobody knows the unit."""
    return None if value is None or unit is None else value * unit


def remote_frame(cob_id: int) -> can.Message:
    """Node guarding's remote frame: one byte is asked for."""
    return can.Message(arbitration_id=cob_id, is_extended_id=False, is_remote_frame=True, dlc=1)


def data_frame(cob_id: int, data: bytes) -> can.Message:
    """A frame of this master's."""
    return can.Message(arbitration_id=cob_id, is_extended_id=False, data=data)
