"""What brakes a light load, found where it is asked for: at the end of the step, not before it.

    tau = f(w'),   w' the load's velocity after a step under tau,   f falling, w' rising with tau

Friction that stops a load within a step would throw it back, taken at the velocity before: then the
load gains what it should lose. So where the load turns under what was predicted, tau is sought
between that and what the turned load is braked with, by false position, Illinois' way (Dowell,
Jarratt, BIT 11 (1971) 168). A load whose friction does not turn it back goes on as predicted.
"""

ATTEMPTS, HELD = 12, 0.01
"""Torques that are tried at most; and how near f(w') is to tau at the end, of what is left between
the two, so that a sharp sign change takes most attempts."""


def nearer(  # noqa: PLR0917 - compiled, and compiled calls name nothing
    low: float, low_by: float, high: float, high_by: float, kept: float, tried: float, by: float
) -> tuple[float, float, float, float, float, float]:
    """The bracket (low, low_by, high, high_by, kept) with the torque that was tried in it, which
    missed f by so much, and the torque to be tried next.

    `by` has the sign of `low_by` where `tried` lies on that side. An end that is kept twice counts
    for half, so that both come nearer; `kept` is 1 where it was the high one, -1 the low one.
    """
    if low_by * by > 0.0:
        low, low_by = tried, by
        high_by *= 0.5 if kept > 0.0 else 1.0
        kept = 1.0
    else:
        high, high_by = tried, by
        low_by *= 0.5 if kept < 0.0 else 1.0
        kept = -1.0
    return low, low_by, high, high_by, kept, low + (high - low) * low_by / (low_by - high_by)
