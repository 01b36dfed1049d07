"""What commands do to every signal that act a little late, now and then more and now less.

A drive takes a command over at the next tick of its own loop. Where the bench sends on that tick,
the wait is the same for all; where what it sends jitters beside it, every jump of the command comes
by chance up to a tick late, and the angle walks off by its height times that:

    d theta_k = -dr_k (t_k - mean),    t_k within a tick

No model foresees it. On an even time base, as simulations have, there is none.
"""

import numpy as np

from servo_bench.diagnosis.comparing.comparison import Comparison, taken
from servo_bench.diagnosis.comparing.rows import Array

TICK_S = 125e-6
"""Of a servo drive's velocity loop: 62.5 to 250 us."""
EVEN_S = 1e-6
"""Slots that differ by less are of one clock."""
WALKS = ("motor_position_rad", "load_angle_rad")


def lateness_rms(comparison: Comparison, seed: int = 0) -> Array:
    """Root mean square in every signal, in its unit, shape (signals,); zero where none is seen."""
    signals, rows = comparison.signals, comparison.source.rows
    late_s = lateness_s(comparison)
    if not late_s:
        return np.zeros(len(signals))
    rng = np.random.default_rng(seed)
    found = []
    for points in comparison.pieces:
        commands = rows.channel("velocity_command_rad_s")[points.piece.rows]
        jumps = np.nan_to_num(np.diff(commands, prepend=commands[:1]))
        walk = -np.cumsum(jumps * late_s * rng.standard_normal(commands.size))
        shown = {s.simulated: np.zeros(commands.size) for s in signals} | dict.fromkeys(WALKS, walk)
        found.append(taken(signals, shown, points, comparison.source))
    errors = np.concatenate(found, axis=1)
    for k, signal in enumerate(signals):
        if signal.level and np.isfinite(errors[k]).any():
            errors[k] -= np.nanmedian(errors[k])
    known = np.maximum(np.isfinite(errors).sum(axis=1), 1)
    return np.asarray(np.sqrt(np.nansum(errors**2, axis=1) / known))


def lateness_s(comparison: Comparison) -> float:
    """Standard deviation of a jump's lateness: of the slots' jitter, but within one tick."""
    rows = comparison.source.rows
    if comparison.block != "loop" or "velocity_command_rad_s" not in rows.recording:
        return 0.0
    lasted = rows.durations_s[rows.even]
    if not lasted.size:
        return 0.0
    jitter_s = 1.4826 * float(np.median(np.abs(lasted - np.median(lasted))))
    return min(jitter_s, TICK_S / np.sqrt(12.0)) if jitter_s > EVEN_S else 0.0
