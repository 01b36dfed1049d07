"""Node guarding (CiA 301): the master asks by a remote frame, the node answers with its state.

For drives that have no heartbeat. The question goes out from the cycle, as a heartbeat would:
canopen's `start_node_guarding` asks from a thread of its own, which goes on when the loop hangs,
and then no drive would ever stop by itself. A node takes its master for dead after guard time
(0x100C) x life time factor (0x100D); the master takes the node for dead after the same time.
"""

import math

from drivers.canopen.profile import Address
from drivers.canopen.settings import BusOptions
from drivers.canopen.watch import Watch

GUARD_TIME: Address = (0x100C, 0)
LIFE_TIME_FACTOR: Address = (0x100D, 0)
_TOGGLE_BIT = 7
_LEAST_FACTOR, _MOST_FACTOR = 2, 255
_WITHOUT_REMOTE_FRAMES = frozenset({"socketcand", "seeedstudio", "robotell"})
"""Interfaces of python-can that send a remote frame as an empty data frame, or not at all."""


def guard_times(every_s: float, timeout_s: float) -> tuple[int, int]:
    """Guard time in ms and life time factor: asked at least every `every_s`, dead by `timeout_s`.

    One lost question must not stop a drive, so the factor is 2 at the least.
    """
    timeout_ms = max(round(timeout_s * 1e3), _LEAST_FACTOR)
    factor = math.ceil(timeout_ms / max(round(every_s * 1e3), 1))
    factor = min(max(factor, _LEAST_FACTOR), _MOST_FACTOR)
    return timeout_ms // factor, factor


def carries_remote_frames(bus: BusOptions) -> bool:
    """Whether this kind of bus takes a remote frame at all."""
    return bus.get("interface") not in _WITHOUT_REMOTE_FRAMES


class Guard:
    """The answers of one guarded node, handed to the watch that knows states and silences."""

    def __init__(self, name: str, watch: Watch) -> None:
        self._name = name
        self._watch = watch
        self._toggle: int | None = None
        self._unanswered = 0

    def on_question(self) -> None:
        """The master asks."""
        self._unanswered += 1

    def on_answer(self, data: bytearray, now_ns: int) -> None:
        """A frame on 0x700 + node: an answer, or the boot-up message of a node that restarted.

        An answer whose toggle bit has not changed counts as one that did not come (CiA 301): it is
        the one before, sent again by whatever stands between. After a question that nobody
        answered either bit is right: the question was lost, or an answer, which has toggled it.
        """
        one_was_lost, self._unanswered = self._unanswered > 1, 0
        toggle = data[0] >> _TOGGLE_BIT if data else None
        if toggle is not None and any(data) and toggle == self._toggle and not one_was_lost:
            self._watch.tell(
                now_ns,
                "guarding answer repeated",
                f"{self._name} answered node guarding with the toggle bit of the answer before: "
                "it is taken for none.",
                key=self._name,
            )
            return
        self._toggle = toggle
        self._watch.on_heartbeat(self._name, data, now_ns)
