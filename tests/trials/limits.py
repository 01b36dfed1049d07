"""How small a cause can be seen at best: fixed before any campaign, from the truth alone.

limits.json holds for each cause and for both sets of channels the size, in the catalogue's units,
at which the block sandwich finds it nine times in ten at a false alarm of 1e-3; `measuring.py`
says how it was computed, and from which seeds. Trials hide multiples of it.
"""

import json
from collections.abc import Mapping
from functools import cache
from pathlib import Path

from servo_bench.errors import ConfigError
from tests.trials.names import Channels

LIMITS = Path(__file__).with_name("limits.json")


@cache
def limits(channels: Channels) -> Mapping[str, float | None]:
    """Cause and size; None for one that its range does not reach."""
    found: dict[str, float | None] = json.loads(LIMITS.read_text())["limits"][channels]
    return found


def has_limit(effect: str, channels: Channels) -> bool:
    """Whether multiples of a limit can be hidden."""
    return limits(channels).get(effect) is not None


def smallest_detectable(effect: str, channels: Channels) -> float:
    """The size, in the catalogue's unit; ConfigError where these channels do not show the cause."""
    size = limits(channels).get(effect)
    if size is None:
        raise ConfigError(
            f"no limit is known for {effect} with {channels} channels: nothing in its range shows. "
            "Hide it at its range's sizes: leave --multiple away."
        )
    return size
