"""The counter box without its line: a count, an index, and what ordered faults make of them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sim_rig.counter.framings import FAULT, FRAMINGS, INDEX_SEEN, State
from sim_rig.counter.orders import Order, parse
from sim_rig.counter.settings import CounterSettings
from sim_rig.errors import RigSettingsError
from sim_rig.settings import RigSettings

Look = Callable[[int], int]
"""The encoder's count, running on over revolutions, at a time in us of this host's clock."""
_SEED = 0xC0


@dataclass(frozen=True, slots=True)
class Answer:
    """Bytes on their way out, how long they are held up, and whether the line is cut instead."""

    data: bytes
    delay_s: float = 0.0
    cut: bool = False


class CounterBox:
    """Counts what `look` sees; `is_enabled` says whether the drive is, which faults wait for."""

    def __init__(
        self,
        settings: CounterSettings,
        look: Look,
        is_enabled: Callable[[], bool],
        orders: Sequence[Order] = (),
        seed: int = 0,
    ) -> None:
        self.framing = FRAMINGS[settings.framing]
        self._settings = settings
        self._look = look
        self._is_enabled = is_enabled
        self._orders = orders
        self._seed = seed
        self._revolutions: int | None = None
        self._index_number = 0
        self._index = 0
        self._rearm()

    def _rearm(self) -> None:
        self._random = np.random.default_rng([self._seed, _SEED])
        self._request = 0
        self._stuck: State | None = None
        self._jumped_at: int | None = None

    def answer(self, number: int, time_us: int) -> Answer:
        """The answer to a request whose last byte came at `time_us`."""
        state = self._state(time_us)
        if not self._is_enabled():
            self._rearm()
            return Answer(self.framing.answer(number, state))
        request, self._request = self._request, self._request + 1
        draws = self._random.random(len(self._orders))
        hits = {
            order.kind: order
            for order, draw in zip(self._orders, draws, strict=True)
            if order.hits(request) and draw < order.rate
        }
        data = self.framing.answer(number, self._distorted(state, hits))
        if "counter-damaged" in hits:
            data = self._damaged(data)
        if "counter-lost" in hits:
            data = b""
        late = hits.get("counter-late")
        return Answer(data, late.delay_ms * 1e-3 if late else 0.0, "counter-unplugged" in hits)

    def _state(self, time_us: int) -> State:
        counts = self._look(time_us)
        self._count_index(counts)
        preset, modulus = self._settings.preset, self._settings.modulus
        return State(
            (counts + preset) % modulus,
            INDEX_SEEN if self._index_number else 0,
            self._index_number,
            (self._index + preset) % modulus,
        )

    def _count_index(self, counts: int) -> None:
        """The index lies at count 0 of every revolution, and is passed between two counts."""
        per_revolution = self._settings.counts_per_revolution
        before, now = self._revolutions, counts // per_revolution
        self._revolutions = now
        if before is None or now == before:
            return
        self._index_number += abs(now - before)
        self._index = (now if now > before else now + 1) * per_revolution

    def _distorted(self, state: State, hits: dict[str, Order]) -> State:
        jump = hits.get("counter-jump")
        if jump is not None:
            state = self._jumped(state, jump.counts)
        if "counter-stuck" in hits:
            self._stuck = state = self._stuck or state
        if "counter-fault" in hits:
            state = replace(state, status=state.status | FAULT)
        return state

    def _jumped(self, state: State, counts: int) -> State:
        """Counts were lost: the count is off, and every index that is latched from now on."""
        if self._jumped_at is None:
            self._jumped_at = self._index_number
        modulus = self._settings.modulus
        off = counts if self._index_number != self._jumped_at else 0
        return replace(
            state,
            position=(state.position + counts) % modulus,
            index=(state.index + off) % modulus,
        )

    def _damaged(self, data: bytes) -> bytes:
        place = int(self._random.integers(1, len(data)))
        bit = 1 << int(self._random.integers(0, 7))
        return data[:place] + bytes((data[place] ^ bit,)) + data[place + 1 :]


def box_of(settings: RigSettings, look: Look, is_enabled: Callable[[], bool]) -> CounterBox:
    """The counter of a rig that has one, with its faults. RigSettingsError where it has none."""
    if settings.counter is None:
        raise RigSettingsError("this rig has no serial counter.")
    orders = [parse(line) for line in settings.counter_faults]
    return CounterBox(settings.counter, look, is_enabled, orders, settings.seed)
