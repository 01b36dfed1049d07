"""A trial's question: from a seed, what is hidden, in which rig, and what is played.

    Question(seed=7)                                   one effect of the truth's catalogue
    Question(seed=7, kind="none")                      nothing: it must be told so
    Question(seed=7, kind="outside")                   a cause that the diagnoser lacks
    Question(seed=7, kind="pair")                      two at once
    Question(seed=7, kind="removed")                   one, whose names the diagnoser may not use
    Question(seed=7, effect="cogging", multiple=4.0)   so many times the limit of limits.json
    Question(seed=7, wide=True)                        in a rig and a run unlike all the others'

A question is a value: the same one draws the same trial wherever and whenever it is asked.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np

from servo_bench.errors import ConfigError
from tests.trials.excitation import Plan, plan, wide_plan
from tests.trials.limits import smallest_detectable
from tests.trials.names import Channels, right_names
from tests.truth import hidden
from tests.truth.catalogue import BY_NAME, IN_THE_CATALOGUE, OUTSIDE_THE_CATALOGUE
from tests.truth.hidden import Sealed
from tests.truth.rigs import PAPER, NominalRig, drawn, drawn_widely

Kind = Literal["one", "none", "outside", "pair", "removed"]
Bus = Literal["canopen", "modbus-rtu", "modbus-tcp", "serial-counter"]
"""What a trial over the wire is recorded through; with a serial counter the drive is on CANopen."""

SECONDS, PERIOD_S = 44.0, 0.008
PAPER_SHARE = 0.2
"""Of the trials, on the paper's own rig."""

NUISANCES = ("contact_stiffness", "contact_damping")
"""Asked only where they are named, and hidden in no pair: no rig's file states what a face gives
and gives back, so that there is nothing for a verdict to correct, and below some 5 kHz of logging
they are fitted as nuisances. Until 2026-11-25 they were asked, and in 0 of 34 trials a face had a
name, though the block sandwich sees most of their range (limits.json)."""
CAN_BE_REMOVED = tuple(h.name for h in IN_THE_CATALOGUE if not h.also and h.name not in NUISANCES)
"""Causes that act alone and have a name: with a companion left to be named, or where none is ever
asked, "unknown" would not be the answer."""


@dataclass(frozen=True)
class Question:
    """One trial. `effect` narrows the draw; `multiple` sets its size instead of its range's.
    `measured` ones are handed over as another bench would, without a run's phases; those over a
    `wire` are recorded through `bus`; a `wide` one draws its rig, its commands and its period from
    far more than the others do."""

    seed: int
    kind: Kind = "one"
    effect: str | None = None
    multiple: float | None = None
    channels: Channels = "all"
    seconds: float = SECONDS
    period_s: float = PERIOD_S
    wire: bool = False
    measured: bool = False
    bus: Bus = "canopen"
    wide: bool = False

    def __post_init__(self) -> None:
        """Raises ConfigError for a question that cannot be asked."""
        table = {"one": IN_THE_CATALOGUE, "outside": OUTSIDE_THE_CATALOGUE}.get(self.kind, ())
        allowed = CAN_BE_REMOVED if self.kind == "removed" else tuple(h.name for h in table)
        if self.effect is not None and self.effect not in allowed:
            raise ConfigError(
                f"kind {self.kind!r} cannot hide {self.effect!r}: it hides "
                f"{', '.join(allowed) or 'what the seed says'}. Leave --effect away, or name one."
            )
        if self.multiple is not None and (self.kind != "one" or self.effect is None or self.wire):
            raise ConfigError(
                f"multiple = {self.multiple:g}: limits are those of one named effect, recorded "
                "without a wire. Give kind one and --effect NAME."
            )
        if self.wide and (self.wire or self.period_s != PERIOD_S or self.multiple is not None):
            raise ConfigError(
                "a wide trial draws its own period and rig, which no wire was set up for and no "
                "limit was computed on: leave --wire, --period-s and --multiple away."
            )
        if self.wire and self.measured:
            raise ConfigError(
                "what is recorded over the wire is a run of this bench: leave --wire or --measured "
                "away."
            )
        if self.bus != "canopen" and not self.wire:
            raise ConfigError(
                f"bus = {self.bus!r}: what is not recorded over the wire has none. Give --wire too."
            )
        if self.wire and (self.period_s != PERIOD_S or self.effect is not None):
            raise ConfigError(
                "on the wire the seed alone says what is hidden, and the period is "
                f"{PERIOD_S} s: leave --effect and --period-s away."
            )

    @cached_property
    def nominal(self) -> NominalRig:
        """The rig's nominal values."""
        if self.wide:
            return drawn_widely(self.seed)
        paper = np.random.default_rng((self.seed, 11)).random() < PAPER_SHARE
        return PAPER if paper else drawn(self.seed)

    @cached_property
    def plan(self) -> Plan:
        """What is played."""
        rng = np.random.default_rng((self.seed, 12))
        if self.wide:
            return wide_plan(rng, self.seconds)
        return plan(rng, self.nominal, self.seconds, self.period_s)

    def sealed(self) -> Sealed:
        """What is hidden."""
        if self.multiple is not None and self.effect is not None:
            return hidden.hide(self.seed, {self.effect: self._multiplied(self.effect)})
        return hidden.draw(self.seed, self._drawn_kind(), among=self._among())

    def without(self, sealed: Sealed) -> tuple[str, ...]:
        """The effects that the diagnoser may not use; the hider's knowledge of what to take."""
        if self.kind != "removed":
            return ()
        taken = (right_names(cause, self.channels) for cause in sealed.open().causes)
        return tuple(sorted(frozenset().union(*taken)))

    def numbers(self) -> dict[str, Any]:
        """The question for JSON; `Question(**numbers)` is the same one."""
        return asdict(self)

    @property
    def label(self) -> str:
        """A few words for progress."""
        size = "" if self.multiple is None else f" x{self.multiple:g}"
        return f"{self.kind} {self.effect or ''}{size} {self.seed}".replace("  ", " ")

    def _multiplied(self, effect: str) -> float:
        """So many times the limit, within the range: past a threshold, twice is another machine."""
        hiding, limit = BY_NAME[effect], smallest_detectable(effect, self.channels)
        size = min((self.multiple or 0.0) * limit, max(hiding.high, limit))
        negative = np.random.default_rng((self.seed, 13)).random() < 0.5
        return -size if hiding.signed and negative else size

    def _drawn_kind(self) -> Literal["one", "none", "outside", "pair"]:
        return "one" if self.kind == "removed" else self.kind

    def _among(self) -> tuple[str, ...] | None:
        if self.effect is not None:
            return (self.effect,)
        if self.kind == "pair":
            able = tuple(h.name for h in IN_THE_CATALOGUE if h.name not in NUISANCES)
            return tuple(n for n in able if n in hidden.ON_THE_WIRE) if self.wire else able
        if self.wire and self.kind == "one":
            return hidden.ON_THE_WIRE
        if self.kind == "removed":
            kept = CAN_BE_REMOVED
            return tuple(n for n in kept if n in hidden.ON_THE_WIRE) if self.wire else kept
        return None


def question_from(numbers: Mapping[str, Any]) -> Question:
    """A question that was written as JSON."""
    return Question(**numbers)
