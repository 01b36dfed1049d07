"""The counter's far end of a pty, whose bytes take the time that they would on a line.

    arrival of a request = max(now, line free) + n · t_char        the count is taken then
    answer complete      = that + turnaround + m · t_char          the bytes are handed over then

The rig looks at its machine only then, when what came over the drive's wire before the request has
been heard.
"""

import asyncio
import os
import selectors
import threading
import time
import tty
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager, suppress

from sim_rig.counter.box import CounterBox
from sim_rig.counter.settings import CounterSettings
from sim_rig.errors import SimRigError

_LONGEST = 256
_START_TIMEOUT_S = 5.0


class CounterLine:
    """One counter at the far end of a pty; belongs to the running event loop."""

    def __init__(self, box: CounterBox, settings: CounterSettings) -> None:
        self._box = box
        self._settings = settings
        self._loop = asyncio.get_running_loop()
        self._near, self._far = os.openpty()
        tty.setraw(self._far)  # held open: else the rig would hang up when a master closes
        os.set_blocking(self._near, False)
        self.device = os.ttyname(self._far)
        self._received = bytearray()
        self._last_byte_s = 0.0
        self._free_s = 0.0  # when the way back is free for another answer
        self._is_cut = False
        answer_s = box.framing.answer_bytes * settings.character_s
        self._takes_s = settings.turnaround_s + answer_s
        self._loop.add_reader(self._near, self._read)

    def close(self) -> None:
        """Hang up."""
        if not self._is_cut:
            self._is_cut = True
            self._loop.remove_reader(self._near)
            os.close(self._near)
            os.close(self._far)

    def _read(self) -> None:
        character_s = self._settings.character_s
        self._last_byte_s = max(time.monotonic(), self._last_byte_s)
        for byte in os.read(self._near, 4096):
            self._last_byte_s += character_s
            self._received.append(byte)
            number = self._box.framing.request(self._received)
            if number is not None:
                self._received.clear()
                self._loop.call_at(
                    self._last_byte_s + self._takes_s, self._answer, number, self._last_byte_s
                )
        del self._received[:-_LONGEST]

    def _answer(self, number: int, arrived_s: float) -> None:
        if self._is_cut:
            return
        answer = self._box.answer(number, int(arrived_s * 1e6))
        if answer.cut:
            self.close()
            return
        if answer.data:
            on_the_line_s = len(answer.data) * self._settings.character_s
            done_s = arrived_s + self._takes_s + answer.delay_s
            self._free_s = max(done_s, self._free_s + on_the_line_s)
            self._loop.call_at(self._free_s, self._hand_over, answer.data)

    def _hand_over(self, data: bytes) -> None:
        if not self._is_cut:
            with suppress(BlockingIOError):  # nobody reads: what does not fit is lost
                os.write(self._near, data)


def _event_loop() -> asyncio.AbstractEventLoop:
    """epoll counts in milliseconds; select in microseconds, as bytes take."""
    return asyncio.SelectorEventLoop(selectors.SelectSelector())


@asynccontextmanager
async def listening(box: CounterBox, settings: CounterSettings) -> AsyncIterator[str]:
    """Be at the far end of a new pty, in the running loop; yields its device."""
    line = CounterLine(box, settings)
    try:
        yield line.device
    finally:
        line.close()


@contextmanager
def in_a_thread(
    box: CounterBox, settings: CounterSettings, prepare: Callable[[], object] = lambda: None
) -> Iterator[str]:
    """Be at the far end of a new pty, in a thread that has called `prepare`; yields its device."""
    ready, device = threading.Event(), ""
    loop = _event_loop()
    ending = asyncio.Event()

    async def be() -> None:
        nonlocal device
        async with listening(box, settings) as device:
            ready.set()
            await ending.wait()

    def run() -> None:
        prepare()
        with asyncio.Runner(loop_factory=lambda: loop) as runner:
            runner.run(be())

    thread = threading.Thread(target=run, name="counter", daemon=True)
    thread.start()
    if not ready.wait(_START_TIMEOUT_S):
        raise SimRigError("The counter's line did not come up. Start the rig again.")
    try:
        yield device
    finally:
        loop.call_soon_threadsafe(ending.set)
        thread.join(_START_TIMEOUT_S)
