"""What a drive's own ticks do to commands whose clock walks past them.

A drive takes a command at the next tick of its velocity loop. As long as both go by one clock, that
is a delay like any other; where the commands' clock walks, the delay is a staircase of the loop's
period about the line that a skew makes of it:

    delay(t) = ceil((k t - phase) / T) T + phase       T  62.5 to 250 us in servo drives

Nobody knows its phase, and what it leaves is no sign of a wrong clock. Where the staircase steps,
one command lasts longer by T, and the shaft stays v T ahead; on the line every command has a little
of that, and the way back and forth takes it away again. Of k/T steps a second, each with the speed
of some command (at 50e-6 one in five seconds), a mean velocity keeps

    v sqrt(k T/w), rms                    between two samples that are w apart
    v sqrt(2 k T/(3 w)), rms              between two means over w, one after the other

This is what a simulation with a clock that walks may miss more, and nothing on the others.
"""

import numpy as np

from servo_bench.diagnosis.comparing.evidence import Evidence, changed_by
from servo_bench.diagnosis.comparing.lateness import TICK_S
from servo_bench.diagnosis.comparing.noise import COMMAND
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
    changed = np.hypot(changed_by(whole, model, others), _steps(whole, walked_s, seconds))
    crosses = own_s + walks_s < 0.0
    return np.asarray(changed if crosses else np.minimum(changed, MOST * whole.allowed))


def _steps(whole: Evidence, walked_s: float, seconds: float) -> Array:
    """What the steps of a staircase leave of every mean velocity, rms, shape (signals,); none of
    what is measured between two shafts, which step alike."""
    seen = whole.fitted[0]
    rows, skew = seen.source.rows, walked_s / seconds
    commands_rad_s = rows.channel(COMMAND)[rows.seen]
    speed_rad_s = float(np.sqrt(np.nanmean(commands_rad_s**2)))
    left = np.zeros(len(seen.signals))
    for k, signal in enumerate(seen.signals):
        if signal.increments and not signal.less:
            share = 1.0 if signal.stride == 1 else 2.0 / 3.0
            per_s = skew * min(COARSE_S, walked_s) / (signal.stride * rows.period_s)
            left[k] = speed_rad_s * np.sqrt(share * per_s)
    return left
