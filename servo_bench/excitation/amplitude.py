"""How large a velocity shows the backlash, and keeps orders above 3 small.

An excursion of one period, V dt, beside the full width W of the gap decides (measured on the
simulated experiment, wn dt = 0.5, zeta = 0.4, velocity kernels):

    V dt / W      0.11    0.25    0.53    0.8     1.1     1.65    3       >= 8
    order 3, %    24      18      8       5       3.3     1.9     0.8     <= 0.1
    orders >= 5,% 35      15      7       4.5     3.4     2       1       0.5

so 0.5 <= V dt / W <= 1.7: above, the backlash is invisible (order 3 below 2 %), below, orders from
5 on exceed 7 %. A loop of another bandwidth wn lets excursions through that grow with the square
root of its time, so the range is scaled by sqrt(wn dt / 0.5); that scaling is a rule of thumb.
"""

import math
from dataclasses import dataclass

from servo_bench.errors import ConfigError

LEAST_EXCURSION, LARGEST_EXCURSION = 0.5, 1.7
MARGIN = 0.95
"""Of a rig's limit, that what is recommended may use."""
MEASURED_AT = 0.5
"""wn dt of the table."""

FASTEST_LOOP = 1.0
"""wn dt beyond which the loop follows within a period and the scaling ends."""


@dataclass(frozen=True, slots=True)
class AmplitudeAdvice:
    """The range of velocity amplitudes, what it is held back by, and the sentences that say so.

    `most_rad_s` is 0 where the rig's limits leave no room.
    """

    least_rad_s: float
    most_rad_s: float
    travel_rad: float
    sentences: tuple[str, ...]

    @property
    def possible(self) -> bool:
        """Whether any amplitude shows the backlash within the limits."""
        return self.least_rad_s <= self.most_rad_s

    @property
    def recommended_rad_s(self) -> float:
        """The geometric middle of the range, or the largest that the limits allow."""
        if not self.possible:
            return self.most_rad_s
        return math.sqrt(self.least_rad_s * self.most_rad_s)


def advise_amplitude(
    *,
    backlash_gap_rad: float,
    period_s: float,
    bandwidth_rad_s: float,
    peak_travel_periods: float,
    travel_limit_rad: float = math.inf,
    velocity_limit_rad_s: float = math.inf,
) -> AmplitudeAdvice:
    """The amplitudes to play.

    `backlash_gap_rad` is the full width; `bandwidth_rad_s` the loop's natural frequency;
    `peak_travel_periods` how far the sequence takes an ideal axis, in amplitudes times periods
    (`Schedule.peak_travel_rad` over amplitude and period). ConfigError for what is not positive.
    """
    given = {
        "backlash_gap_rad": backlash_gap_rad,
        "period_s": period_s,
        "bandwidth_rad_s": bandwidth_rad_s,
        "travel_limit_rad": travel_limit_rad,
        "velocity_limit_rad_s": velocity_limit_rad_s,
    }
    for name, value in given.items():
        if not value > 0.0:
            raise ConfigError(f"{name} is {value}: it must be above zero.")
    scale = math.sqrt(min(bandwidth_rad_s * period_s, FASTEST_LOOP) / MEASURED_AT)
    unit = scale * backlash_gap_rad / period_s
    least, wanted = LEAST_EXCURSION * unit, LARGEST_EXCURSION * unit
    by_travel = travel_limit_rad / (max(peak_travel_periods, 1.0) * period_s)
    most = min(wanted, by_travel, velocity_limit_rad_s)
    return AmplitudeAdvice(
        least_rad_s=least,
        most_rad_s=most,
        travel_rad=min(most, wanted) * peak_travel_periods * period_s,
        sentences=tuple(_sentences(least, wanted, by_travel, velocity_limit_rad_s)),
    )


def _sentences(least: float, wanted: float, by_travel: float, by_velocity: float) -> list[str]:
    degrees = math.degrees
    said = [
        f"From {degrees(least):.3g} to {degrees(wanted):.3g} deg/s the backlash shows in order 3 "
        f"(2 to 8 % of the response) and orders above stay below 7 %."
    ]
    for limit, name, remedy in (
        (by_travel, "travel", "a sequence that wanders less, or a shorter period"),
        (by_velocity, "velocity", "a longer period"),
    ):
        if limit < least:
            said.append(
                f"The rig's {name} limit allows only {degrees(limit):.3g} deg/s: too little to see "
                f"this backlash well. Take {remedy}, or raise the limit if the rig allows it."
            )
        elif limit < wanted:
            said.append(f"The rig's {name} limit caps it at {degrees(limit):.3g} deg/s.")
    return said
