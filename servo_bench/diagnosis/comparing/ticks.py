"""What a drive's own ticks do to commands whose clock walks past them.

A drive takes a command at the next tick of its velocity loop. As long as both go by one clock, that
is a delay like any other; where the commands' clock walks, the delay is a staircase of the loop's
period about the line that a skew makes of it:

    delay(t) = ceil((k t - phase) / T) T + phase       T  62.5 to 250 us in servo drives

Nobody knows its phase, and what it leaves is no sign of a wrong clock. This is what a simulation
with a clock that walks may miss more, and nothing on the others.
"""

import numpy as np

from servo_bench.diagnosis.comparing.evidence import Evidence, changed_by
from servo_bench.diagnosis.comparing.lateness import TICK_S
from servo_bench.diagnosis.comparing.rows import Array
from sim_rig.model import Model

COARSE_S = 2.0 * TICK_S
"""Of a drive whose loop is slow."""
MOST = 3.0
"""Of what a right simulation may miss anyway; where the clock takes the current past its samples
any amount: between two ticks they show a part of every jump, where the line shows none or all (of
all signals alike: the angles hardly change by that)."""


def ticks(whole: Evidence, model: Model) -> Array:
    """Robust change of every signal by a delay that is anywhere within a coarse tick, or within
    what the clock walks in the longest recording where that is less; at most `MOST` where the
    samples see no command early. Shape (signals,); zeros where no clock walks.
    """
    skew = model.effects.get("clock_skew")
    seconds = max(float(c.source.rows.durations_s.sum()) for c in whole.fitted)
    walks_s = float(skew.skew_fraction) * seconds if skew is not None else 0.0
    walked_s = abs(walks_s)
    if walked_s == 0.0:
        return np.zeros(len(whole.names))
    either_way_s = min(COARSE_S, walked_s) / np.sqrt(12.0)
    delay = model.effects.get("transport_delay")
    own_s = float(delay.delay_s) if delay is not None else 0.0
    delays_s = (max(own_s - either_way_s, 0.0), own_s + either_way_s)
    others = [model.with_effect("transport_delay", delay_s=late_s) for late_s in delays_s]
    changed = changed_by(whole, model, others)
    crosses = own_s + walks_s < 0.0
    return np.asarray(changed if crosses else np.minimum(changed, MOST * whole.allowed))
