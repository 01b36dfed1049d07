"""Which trials a campaign asks. A trial keeps its seed, however many are asked beside it."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from servo_bench.errors import ConfigError
from tests.trials.drawing import CAN_BE_REMOVED, NUISANCES, PERIOD_S, SECONDS, Kind, Question
from tests.trials.limits import has_limit
from tests.trials.names import Channels
from tests.trials.seeds import BLOCK, BLOCKS, JUDGING_FROM, MULTIPLE_BLOCKS, PER_EFFECT
from tests.truth.catalogue import IN_THE_CATALOGUE, OUTSIDE_THE_CATALOGUE

EVERY_EFFECT = tuple(hiding.name for hiding in IN_THE_CATALOGUE)
ASKED = tuple(name for name in EVERY_EFFECT if name not in NUISANCES)
EVERY_OUTSIDER = tuple(hiding.name for hiding in OUTSIDE_THE_CATALOGUE)


@dataclass(frozen=True, slots=True)
class Campaign:
    """How many of what.

    `seeds` counts for each effect at its range's sizes and, where `multiples` are given, instead
    at each multiple of its limit; `outside` and `removed` go through their causes in turn.
    """

    effects: Sequence[str] = ASKED
    seeds: int = 10
    multiples: Sequence[float] = ()
    nulls: int = 0
    outside: int = 0
    pairs: int = 0
    removed: int = 0
    channels: Sequence[Channels] = ("all",)
    first_seed: int = JUDGING_FROM
    seconds: float = SECONDS
    period_s: float = PERIOD_S
    measured: bool = False
    wide: bool = False

    def questions(self) -> list[Question]:
        """All trials; ConfigError where a count does not fit into its block of seeds."""
        self._check()
        return [question for channels in self.channels for question in self._asked(channels)]

    def _asked(self, channels: Channels) -> Iterator[Question]:
        sizes: Sequence[float | None] = tuple(self.multiples) or (None,)
        for multiple in sizes:
            block = BLOCKS["one"] if multiple is None else MULTIPLE_BLOCKS[multiple]
            for effect in self.effects:
                if multiple is None or has_limit(effect, channels):
                    first = block + PER_EFFECT * EVERY_EFFECT.index(effect)
                    for k in range(self.seeds):
                        yield self._question("one", first + k, effect, multiple, channels)
        turns: tuple[tuple[Kind, int, Sequence[str | None]], ...] = (
            ("none", self.nulls, (None,)),
            ("outside", self.outside, EVERY_OUTSIDER),
            ("pair", self.pairs, (None,)),
            ("removed", self.removed, CAN_BE_REMOVED),
        )
        for kind, count, causes in turns:
            for k in range(count):
                cause = causes[k % len(causes)]
                yield self._question(kind, BLOCKS[kind] + k, cause, None, channels)

    def _question(
        self,
        kind: Kind,
        number: int,
        effect: str | None,
        multiple: float | None,
        channels: Channels,
    ) -> Question:
        return Question(
            seed=self.first_seed + number,
            kind=kind,
            effect=effect,
            multiple=multiple,
            channels=channels,
            seconds=self.seconds,
            period_s=self.period_s,
            measured=self.measured,
            wide=self.wide,
        )

    def _check(self) -> None:
        unknown = sorted(set(self.effects) - set(EVERY_EFFECT))
        if unknown:
            raise ConfigError(
                f"--effects {','.join(unknown)}: the truth has {', '.join(EVERY_EFFECT)}."
            )
        if set(self.multiples) - set(MULTIPLE_BLOCKS):
            allowed = ", ".join(f"{multiple:g}" for multiple in MULTIPLE_BLOCKS)
            raise ConfigError(
                f"--multiple: the limit is multiplied by {allowed}. Give one of them."
            )
        if not 0 <= self.seeds <= PER_EFFECT:
            raise ConfigError(f"--seeds {self.seeds}: an effect has {PER_EFFECT} seeds of its own.")
        counts = {"none": self.nulls, "outside": self.outside, "pair": self.pairs}
        for kind, count in {**counts, "removed": self.removed}.items():
            if not 0 <= count <= BLOCK:
                raise ConfigError(f"{count} trials of kind {kind}: there are seeds for {BLOCK}.")
