"""Pairs the answers of one node with the SYNCs that asked for them.

A TPDO does not say which SYNC it answers. What is known: answers come in the order asked, none
comes before its ask, some come late, some never. So

1.  as soon as there are as many answers as open asks, they are paired one to one, in order: this
    is every undisturbed cycle, and the end of every late burst;
2.  as long as answers are missing, nothing is paired, because nothing can be told;
3.  when the oldest open ask is older than the timeout, an answer is lost. Of the time since, the
    moment with the fewest answers missing (the last such) is the one at which the node had
    caught up best; the answers of that moment are paired newest first, each with the latest
    free ask not younger than itself. Asks that this leaves over before the last pair, and those
    older than the timeout, are lost;
4.  an answer that comes when no ask is open was not asked for.

Exact for late answers as long as none comes later than the timeout, and for lost ones as long as
the others come before the next ask. Where both meet in one cycle no rule on counts can tell.
"""

from collections import deque
from typing import Generic, NamedTuple, TypeVar

Payload = TypeVar("Payload")


class Settled(NamedTuple, Generic[Payload]):
    """What became of one ask; `payload` and `received_ns` are None where the answer was lost."""

    slot: int
    asked_ns: int
    received_ns: int | None
    payload: Payload | None


class Matcher(Generic[Payload]):
    """One stream of asks and answers. Every ask settles exactly once, in the order asked.

    `settled` is a queue: whoever reads it takes from its left.
    """

    __slots__ = (
        "_answers",
        "_asks",
        "_best_answers",
        "_best_asks",
        "_timeout_ns",
        "settled",
    )

    def __init__(self, timeout_ns: int) -> None:
        self._timeout_ns = timeout_ns
        self._asks: list[tuple[int, int]] = []
        self._answers: list[tuple[int, Payload]] = []
        self._best_asks = 0
        self._best_answers = 0
        self.settled: deque[Settled[Payload]] = deque()

    @property
    def missing(self) -> int:
        """How many answers are still to come."""
        return len(self._asks) - len(self._answers)

    def ask(self, slot: int, asked_ns: int) -> None:
        """Note that a SYNC has asked; slots ascend."""
        if self._asks:
            self._note_moment()
        self._asks.append((slot, asked_ns))

    def answer(self, payload: Payload, received_ns: int) -> bool:
        """Take an answer; False where nobody asked for it, which leaves everything as it was."""
        asks, answers = self._asks, self._answers
        if not asks:
            return False
        if len(asks) == 1:  # the undisturbed cycle
            slot, asked_ns = asks.pop()
            self.settled.append(Settled(slot, asked_ns, received_ns, payload))
            return True
        answers.append((received_ns, payload))
        if len(answers) == len(asks):
            self._settle(len(asks), dict(enumerate(answers)))
            answers.clear()
        return True

    def give_up(self, now_ns: int) -> None:
        """Settle what has been open for longer than the timeout.

        To be called only when everything that has arrived has been taken.
        """
        while self._asks and now_ns - self._asks[0][1] > self._timeout_ns:
            self._note_moment()
            self._align(now_ns)

    def _note_moment(self) -> None:
        """Remember the moment with the fewest answers missing, the last of equals."""
        asks, answers = len(self._asks), len(self._answers)
        if self._best_asks == 0 or asks - answers <= self._best_asks - self._best_answers:
            self._best_asks, self._best_answers = asks, answers

    def _align(self, now_ns: int) -> None:
        """Pair newest first at the best moment, and settle everything up to the last pair."""
        asks, considered = self._asks, self._best_answers
        pairs: dict[int, tuple[int, Payload]] = {}
        place = self._best_asks - 1
        for answer in reversed(self._answers[:considered]):
            while asks[place][1] > answer[0]:
                place -= 1
            pairs[place] = answer
            place -= 1
        settles = max(pairs, default=-1) + 1
        while settles < len(asks) and now_ns - asks[settles][1] > self._timeout_ns:
            if len(self._answers) > considered:
                break  # later answers are there: they have a say in the next round
            settles += 1
        del self._answers[:considered]
        self._settle(max(settles, 1), pairs)
        if self._answers and len(self._answers) == len(asks):
            self._settle(len(asks), dict(enumerate(self._answers)))
            self._answers.clear()

    def _settle(self, count: int, pairs: dict[int, tuple[int, Payload]]) -> None:
        for place, (slot, asked_ns) in enumerate(self._asks[:count]):
            received_ns, payload = pairs.get(place, (None, None))
            self.settled.append(Settled(slot, asked_ns, received_ns, payload))
        del self._asks[:count]
        self._best_asks = self._best_answers = 0
