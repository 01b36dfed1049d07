"""What became of one fault scenario, and what a campaign of them comes to."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

from servo_bench.errors import BenchError
from tests.fault_scenarios import GOES_ON, Scenario

RIGHT_SHARE = 0.99


@dataclass(slots=True)
class Outcome:
    """What became of one scenario."""

    scenario: Scenario
    cause: str = ""
    text: str = ""
    told: list[str] = field(default_factory=list)
    hung: bool = False
    moving: bool = False
    readable: bool = True
    played: int = 0
    stop_s: float = 0.0
    fatal: tuple[str, str] | None = None

    def tell(self, kind: str, text: str, **data: Any) -> None:
        """The bench says something."""
        self.told.append(kind)
        if data.get("fatal") and self.fatal is None:
            self.fatal = kind, text

    def ended(self, error: BenchError | None) -> None:
        """The run has ended; the cause is what ended the trust in the rig, or the error."""
        if error is None:
            self.cause, self.text = GOES_ON, ""
            return
        self.cause, self.text = self.fatal or (type(error).__name__, str(error))

    @property
    def named(self) -> bool:
        """Whether the bench said anything of what happened, where something was to be seen."""
        if self.scenario.right == (GOES_ON,):
            return not self.scenario.names or bool(self.told) or self.cause != GOES_ON
        return self.cause != GOES_ON and bool(self.text)

    @property
    def flawless(self) -> bool:
        """Whether nothing is to be said against it."""
        return self.right and self.named and self.readable and not (self.hung or self.moving)

    @property
    def right(self) -> bool:
        """Whether it said the right thing."""
        if self.cause not in self.scenario.right:
            return False
        if self.cause == GOES_ON:
            return not self.scenario.names or self.scenario.names in self.told
        return self.scenario.names in self.text


def judged(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """The figures of a campaign."""
    total = len(outcomes)
    kinds: dict[str, Counter[str]] = {}
    for outcome in outcomes:
        counts = kinds.setdefault(outcome.scenario.kind, Counter())
        counts["runs"] += 1
        counts["right"] += outcome.right
        counts["goes on"] += outcome.cause == GOES_ON
    return {
        "scenarios": total,
        "hung": sum(outcome.hung for outcome in outcomes),
        "left_moving": sum(outcome.moving for outcome in outcomes),
        "unreadable": sum(not outcome.readable for outcome in outcomes),
        "unnamed": sum(not outcome.named for outcome in outcomes),
        "right": sum(outcome.right for outcome in outcomes),
        "right_share": sum(outcome.right for outcome in outcomes) / max(total, 1),
        "worst_stop_s": max((outcome.stop_s for outcome in outcomes), default=0.0),
        "kinds": {kind: dict(counts) for kind, counts in sorted(kinds.items())},
        "wrong": [asdict(outcome) for outcome in outcomes if not outcome.flawless][:50],
    }


def passes(figures: dict[str, Any]) -> bool:
    """Whether a campaign is as it must be."""
    flaws = ("hung", "left_moving", "unreadable", "unnamed")
    return not any(figures[flaw] for flaw in flaws) and figures["right_share"] >= RIGHT_SHARE
