"""A sensor's low pass: what a drive tells of its current or torque is often an average.

    tau dy/dt = u - y,  y = u at the beginning

u is straight between the instants at which it is known, which lie close where it jumps. Over a step
of length h the answer is exact,

    y(h) = a y + (1 - a) u + (1 - (1 - a) tau/h) (u(h) - u),    a = exp(-h/tau)

and steps are joined by twos, fours, and so on, until nothing of what was before is left.
"""

import numpy as np

from servo_bench.diagnosis.comparing.rows import Array

FORGOTTEN = 1e-12
"""Of a value, that is nothing any more."""


def low_passed(t_s: Array, values: Array, tau_s: float) -> Array:
    """The filtered signal at the same instants (rising, s), of shape (instants,); tau_s > 0."""
    steps_s = np.maximum(np.diff(t_s), 1e-12)
    kept = np.exp(-steps_s / tau_s)
    slope = 1.0 + np.expm1(-steps_s / tau_s) * tau_s / steps_s
    added = (1.0 - kept) * values[:-1] + slope * (values[1:] - values[:-1])
    kept, added = np.append(0.0, kept), np.append(values[:1], added)
    joined = 1
    while joined < kept.size and kept[joined:].max() > FORGOTTEN:
        added[joined:] += kept[joined:] * added[:-joined]
        kept[joined:] *= kept[:-joined].copy()
        joined *= 2
    return added
