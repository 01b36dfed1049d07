"""What a drive's own ticks do to commands whose clock walks past them.

A drive takes a command at the next tick of its velocity loop. As long as both go by one clock, that
is a delay like any other; where the commands' clock walks, the delay is a staircase of the loop's
period about the line that a skew makes of it:

    delay(t) = ceil((k t - phase) / T) T + phase       T  62.5 to 250 us in servo drives

Nobody knows its phase, and what it leaves is no sign of a wrong clock. This is what a simulation
with a clock that walks may miss more, and nothing on the others.
"""

import numpy as np

from servo_bench.diagnosis.evidence import Evidence
from servo_bench.diagnosis.rows import Array
from sim_rig.model import Model

COARSE_S = 250e-6
EITHER_WAY_S = COARSE_S / np.sqrt(12.0)
"""Deviation of what is anywhere within a coarse tick."""
MOST = 3.0
"""Of what a right simulation may miss anyway."""


def ticks(whole: Evidence, model: Model) -> Array:
    """Robust change of every signal by so much more and less delay, the larger of the two, within
    `MOST`. Shape (signals,); zeros where no clock walks.
    """
    found = np.zeros(len(whole.names))
    if "clock_skew" not in model.effects:
        return found
    here, *there = whole.seen([model, *(_late(model, late_s) for late_s in _either_way(model))])
    for errors in there:
        changed = np.abs(errors.rows - here.rows)
        known = np.isfinite(changed).any(axis=1)
        found[known] = np.maximum(found[known], 1.4826 * np.nanmedian(changed[known], axis=1))
    return np.asarray(np.minimum(found, MOST * whole.allowed))


def _either_way(model: Model) -> tuple[float, float]:
    """Delays about the model's own, none below zero."""
    delay = model.effects.get("transport_delay")
    own_s = float(delay.delay_s) if delay is not None else 0.0
    return max(own_s - EITHER_WAY_S, 0.0), own_s + EITHER_WAY_S


def _late(model: Model, delay_s: float) -> Model:
    return model.with_effect("transport_delay", delay_s=delay_s)
