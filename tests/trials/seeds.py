"""Which seeds are whose. A campaign judges on seeds that no threshold has seen.

    below DEVELOPMENT_BELOW    development, calibration, limits, tests
    between the two            rehearsals: campaigns whose first seed is one of development
    from JUDGING_FROM on       campaigns that are published

A campaign gives every group of trials a block of its own, so that a trial keeps its seed whatever
else is run beside it.
"""

from typing import Final

DEVELOPMENT_BELOW: Final = 2000
JUDGING_FROM: Final = 900_000

PER_EFFECT: Final = 100
"""Seeds that one effect may use in a block."""

BLOCKS: Final = {"one": 0, "none": 40_000, "outside": 50_000, "pair": 60_000, "removed": 70_000}
MULTIPLE_BLOCKS: Final = {2.0: 10_000, 4.0: 20_000, 8.0: 30_000}
BLOCK: Final = 10_000
