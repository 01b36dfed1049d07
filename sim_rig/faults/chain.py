"""The faults of a rig, one after the other, between its nodes and its bus.

A frame that a fault holds up waits here, and those of its identifier behind it: on CAN they cannot
overtake it. `due_us` says until when. SYNCs are counted from the one
after which the drive is enabled until the master puts the drive back to pre-operational: every
run meets the same faults.
"""

import heapq
from collections.abc import Callable, Sequence

from sim_rig.faults.fault import Fault, Frame
from sim_rig.faults.frames import SYNC
from sim_rig.faults.sdo_abort import SdoAbort

Deliver = Callable[[Frame, int], None]
Send = Callable[[Frame], None]

_NMT = 0x000
_END_OF_RUN = frozenset({0x80, 0x81, 0x82})


class Chain:
    """`deliver` hands a frame to the nodes, `send` puts one on the bus."""

    def __init__(
        self,
        faults: Sequence[Fault],
        deliver: Deliver,
        send: Send,
        is_enabled: Callable[[], bool],
    ) -> None:
        self._faults = faults
        self._deliver = deliver
        self._send = send
        self._is_enabled = is_enabled
        self._syncs: int | None = None
        self._now_us = 0
        self._waiting: list[tuple[int, int, bool, Frame]] = []
        self._number = 0
        self._last_due_us: dict[int, int] = {}

    def receive(self, came: Frame, time_us: int) -> None:
        """A frame from the bus."""
        self._set_time(time_us)
        if came.can_id == SYNC:
            self._count()
        elif came.can_id == _NMT and len(came.data) == 2 and came.data[0] in _END_OF_RUN:
            self._end_run()
        frames = [came]
        for fault in self._faults:
            frames = [left for frame in frames for left in fault.incoming(frame)]
            if isinstance(fault, SdoAbort) and (answer := fault.take_answer()):
                self.outgoing(answer.can_id, answer.data)
        for frame in frames:
            self._pass(frame, incoming=True)

    def outgoing(self, can_id: int, data: bytes) -> None:
        """A frame from a node; a SYNC of its own counts as any."""
        if can_id == SYNC:
            self._count()
        frames = [Frame(can_id, data)]
        for fault in self._faults:
            frames = [left for frame in frames for left in fault.outgoing(frame)]
        for frame in frames:
            self._pass(frame, incoming=False)

    def tick(self, now_us: int) -> None:
        """Let go what was held up until now."""
        self._set_time(max(self._now_us, now_us))
        while self._waiting and self._waiting[0][0] <= now_us:
            due_us, _, incoming, frame = heapq.heappop(self._waiting)
            if incoming:
                self._deliver(frame, due_us)
            else:
                self._send(frame)

    def due_us(self) -> int | None:
        """When `tick` has to be called next; None while nothing waits."""
        return self._waiting[0][0] if self._waiting else None

    def _set_time(self, now_us: int) -> None:
        self._now_us = now_us
        for fault in self._faults:
            fault.now_us = now_us

    def _pass(self, frame: Frame, *, incoming: bool) -> None:
        behind_us = self._last_due_us.get(frame.can_id, 0)
        if frame.delay_us or behind_us > self._now_us:
            self._number += 1
            due_us = max(self._now_us + frame.delay_us, behind_us)
            self._last_due_us[frame.can_id] = due_us
            heapq.heappush(self._waiting, (due_us, self._number, incoming, frame))
        elif incoming:
            self._deliver(frame, self._now_us)
        else:
            self._send(frame)

    def _count(self) -> None:
        if self._syncs is None:
            if not self._is_enabled():
                return
            self._syncs = 0
        else:
            self._syncs += 1
        for fault in self._faults:
            fault.on_sync(self._syncs)

    def _end_run(self) -> None:
        if self._syncs is not None:
            self._syncs = None
            for fault in self._faults:
                fault.rearm()
