"""A cause that no simulation is needed to see: it is read off the data, with its numbers."""

from collections.abc import Mapping
from typing import NamedTuple


class Reading(NamedTuple):
    """An effect, its settings in SI, the standard errors of those that have one, and a sentence on
    what was seen."""

    effect: str
    settings: Mapping[str, float]
    errors: Mapping[str, float]
    sentence: str
