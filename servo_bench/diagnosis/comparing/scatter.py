"""Torque that scatters while the motor turns, and not where it rests.

A drive forms its velocity from an encoder's counts: a step q within a loop's period T makes
q / (sqrt(6) T) of noise in it, two roundings of q / sqrt(12) each, and K_P as much current. A motor
that rests on one count shows none of it, so the sensor's floor (`noise`) has none either, and the
motion does not answer it. How fine the counts within the drive are, and how quick its loop is, no
recording tells: the scatter is taken from what is left of the torque itself, where nothing is in it
that a cause would leave there, and no more than the counts that the drive tells could make.
"""

import math

import numpy as np

from servo_bench.diagnosis.comparing.allowance import FLOORS
from servo_bench.diagnosis.comparing.comparison import Comparison
from servo_bench.diagnosis.comparing.evidence import Evidence
from servo_bench.diagnosis.comparing.locking import after_edges, binned_share
from servo_bench.diagnosis.comparing.noise import COMMAND, quantum_of
from servo_bench.diagnosis.comparing.rows import EFFORTS, Array, Mask
from sim_rig.model import Model

MOTOR = "motor_position_rad"
QUICKEST_LOOP_S = 62.5e-6
LAGS, CHANCE = 8, 4.0
"""Rows over which noise remembers nothing, and deviations that chance may take."""
NOTHING = 0.03
"""Share of its variance that repeats with the motion or the commands, and still counts as none."""
FEWEST = 256


def scatter(whole: Evidence, model: Model) -> Array:
    """What every signal may miss more because torque scatters in motion, in its unit, shape
    (signals,): zero for all but a current or torque whose error is noise and nothing else."""
    seen = whole.fitted[0]
    found = np.zeros(len(seen.signals))
    if not seen.source.rows.has(MOTOR):
        return found
    errors = seen.errors(model)
    for k, signal in enumerate(seen.signals):
        known = np.isfinite(errors[k]) & seen.seen
        if signal.channel in EFFORTS and known.sum() >= FEWEST:
            left = np.where(known, errors[k] - np.mean(errors[k][known]), 0.0)
            if _is_noise(seen, left, known):
                size = 1.4826 * float(np.median(np.abs(left[known])))
                found[k] = FLOORS * min(size, most_of_counts(seen, model) * signal.factor)
    return found


def most_of_counts(seen: Comparison, model: Model) -> float:
    """Current noise (rms, A) that the motor's counts can make through the drive's gain."""
    quantum_rad = quantum_of(seen.source.rows.channel(MOTOR))
    velocity_rad_s = quantum_rad / (math.sqrt(6.0) * QUICKEST_LOOP_S)
    return float(model.nominal.proportional_gain_a_s_per_rad * velocity_rad_s)


def _is_noise(seen: Comparison, left: Array, known: Mask) -> bool:
    """Whether it neither remembers itself nor follows commands, velocity, or the torque."""
    if np.abs(_remembered(left, known)).max() > CHANCE:
        return False
    rows, at = seen.source.rows, np.concatenate([p.end for p in seen.pieces])
    commands = np.nan_to_num(rows.channel(COMMAND)[at])
    motion = np.gradient(rows.channel(MOTOR), rows.t_s)[at]
    torque = next(rows.channel(name) for name in EFFORTS if rows.has(name))[at]
    shares = [after_edges(np.diff(commands, prepend=commands[:1]), left, known)[1]]
    for by in (motion, torque - left):
        there = known & np.isfinite(by)
        shares.append(binned_share(by[there], left[there]))
    return max(shares) < NOTHING


def _remembered(left: Array, known: Mask) -> Array:
    """Correlation with itself 1 .. LAGS points later, over what chance makes; shape (LAGS,)."""
    power = float(np.mean(left[known] ** 2))
    both = [np.sum(known[lag:] & known[:-lag]) for lag in range(1, LAGS + 1)]
    products = [float(left[lag:] @ left[:-lag]) for lag in range(1, LAGS + 1)]
    return np.asarray(products) / (max(power, 1e-300) * np.sqrt(np.maximum(both, 1)))
