"""Whether the load's angle gives way to the motor's torque slowly, read off what it says.

An encoder's bracket, a glued magnet, a rubber element or a belt creeps: what is read goes on moving
for a while under a torque that stays. No effect of the catalogue does so, all of which act within
milliseconds. It is looked for where the load rests on a face (see `resting`), beside what else is
regular there:

    e = c_0 T + k T_tau + drift + what a gap and two waves may be wrong by + v

T        the simulated motor's torque, which a face or a shaft gives way to at once
T_tau    that, through a first-order low pass of time constant tau; k is what it gives, rad/N m

Bounces hide so little from a fit's cost: half a count is enough here.
"""

from typing import NamedTuple

import numpy as np
from scipy.signal import lfilter

from servo_bench.diagnosis.comparing.comparison import Comparison
from servo_bench.diagnosis.comparing.rows import Array
from servo_bench.diagnosis.reading.resting import (
    NOISIER,
    Regular,
    Resting,
    in_halves,
    regular,
    resting,
)
from servo_bench.diagnosis.reading.revolution import beside, waves_of
from sim_rig.model import Model

TIMES_S = (0.2, 0.28, 0.4, 0.56, 0.8, 1.1, 1.6)
CLEARLY, IN_HALVES = 20.0, 4.0
"""Standard errors beyond zero: of all, and of each half, with one sign. Of rigs
without it they were 1 to 7 at these times and once 16, alike at all of them; of those with it, of
half a count and more, 30 and 108."""
LEAST = 0.3
"""Of the sensor's noise at rest, for the deviation of what creeps."""
FURTHER, FURTHER_LEAST = 13.0, 0.5
"""The same two of what gives way as a face does and then further: rest of a face's own law mostly
comes back. On 50 recordings without creep, 16 of them of a third plant, it was 11 at most that way
beside the plain fit, of a third of the noise; of creep of 0.6 and 0.7 of the noise 13.6 and 17,
where a coupling that was absorbed had a part of the first."""


class Creep(NamedTuple):
    """What the load's angle gives, how slowly, its rms in the angle, and how clearly.

    Under torques that are short beside `time_s` only the rate is known, k / tau.
    """

    compliance_rad_per_nm: float
    time_s: float
    rms_rad: float
    deviations: float

    @property
    def rate_rad_s_per_nm(self) -> float:
        """How fast it gives way at first."""
        return abs(self.compliance_rad_per_nm) / self.time_s


def creep(comparison: Comparison, model: Model) -> Creep | None:
    """The time constant at which it is clearest; None without both encoders, or where it is not."""
    rests = resting(comparison, model)
    if rests is None:
        return None
    period_s = comparison.source.rows.period_s
    torque_nm = model.nominal.torque_constant_nm_per_a * rests.shown["current_a"]
    others = _others(rests, torque_nm)
    tried = [_tried(rests, others, torque_nm, tau, period_s) for tau in TIMES_S]
    found, whole, columns = max(tried, key=lambda one: abs(one[0].deviations))
    further = -found.deviations > FURTHER and found.rms_rad > FURTHER_LEAST * rests.floor_rad
    clearly = abs(found.deviations) > CLEARLY and found.rms_rad > LEAST * rests.floor_rad
    if not (clearly or further):
        return None
    halves = in_halves(columns, rests.error, rests.rows_per_block)
    both = [half.deviations(0) * np.sign(found.deviations) for half in halves]
    if min(both) < IN_HALVES or whole.scatter > NOISIER * rests.floor_rad:
        return None
    return found


def _tried(
    rests: Resting, others: Array, torque_nm: Array, time_s: float, period_s: float
) -> tuple[Creep, Regular, Array]:
    slow = _low_passed(torque_nm, time_s, period_s)[rests.known]
    columns = np.column_stack([slow, others])
    whole = regular(columns, rests.error, rests.rows_per_block)
    rms_rad = abs(float(whole.found[0])) * float(np.std(slow))
    return Creep(float(whole.found[0]), time_s, rms_rad, whole.deviations(0)), whole, columns


def _others(rests: Resting, torque_nm: Array) -> Array:
    """What is regular without creep: at once, once or twice a revolution, or with time."""
    drift = np.linspace(-1.0, 1.0, rests.known.size)[rests.known]
    waves = waves_of(rests.angle)
    return np.column_stack([torque_nm[rests.known], drift, *waves, *beside(rests)])


def _low_passed(values: Array, time_s: float, period_s: float) -> Array:
    kept = float(np.exp(-period_s / time_s))
    return np.asarray(lfilter([1.0 - kept], [1.0, -kept], values))
