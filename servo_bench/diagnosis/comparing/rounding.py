"""What a load's angle that is told in coarse steps hides of its motion.

An encoder that rounds to a quantum q is off by anything within it, and no simulation tells by
how much: q / sqrt(12) a sample, as any other noise. At rest nothing of it is seen, because
the same step is told again and again, so that the sensor's floor (`noise`) does not have it.
"""

import numpy as np

from servo_bench.diagnosis.comparing.allowance import FLOORS
from servo_bench.diagnosis.comparing.comparison import Signal
from servo_bench.diagnosis.comparing.evidence import Evidence
from servo_bench.diagnosis.comparing.rows import Array

ROUNDED = "load_angle_rad"


def rounding(whole: Evidence, quantum_rad: float) -> Array:
    """What every signal may miss more where the load's angle has this quantum, in its unit; shape
    (signals,)."""
    seen = whole.fitted[0]
    period_s = seen.source.rows.period_s
    return FLOORS * np.array([rounding_of(s, quantum_rad, period_s) for s in seen.signals])


def floor_of(signal: Signal, quantum_rad: float, period_s: float) -> float:
    """One standard deviation that the sensor leaves, with this rounding, in the signal's unit."""
    return float(np.hypot(signal.floor, rounding_of(signal, quantum_rad, period_s)))


def rounding_of(signal: Signal, quantum_rad: float, period_s: float) -> float:
    """One standard deviation, in the signal's unit. An increment between means of n points has two
    ends, each of n samples, and goes over n periods."""
    if signal.channel != ROUNDED:
        return 0.0
    sample_rad = quantum_rad / np.sqrt(12.0)
    if not signal.increments:
        return float(sample_rad)
    return float(np.sqrt(2.0) * sample_rad / period_s / signal.stride**1.5)
