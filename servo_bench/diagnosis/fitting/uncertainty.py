"""Standard errors of fitted numbers, and what their correlation means, in words.

Residuals of a wrong model are coloured: a white-noise formula would be too sure of itself. The
block sandwich of an M-estimate adds up the scores g of whole blocks, shape (numbers,):

    cov = H^-1 (B/(B - P) sum_b g_b g_b') H^-1,   g_b = sum_b psi(e) s,   H = sum psi'(e) s s'

s the Jacobian's row, psi the derivative of the robust loss, B blocks, P numbers. Source: Huber,
Proc. 5th Berkeley Symp. (1967); Newey, West, Econometrica 55 (1987).
"""

import math
from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np

from servo_bench.diagnosis.comparing.rows import Array
from servo_bench.diagnosis.fitting.free import FreeParameter
from servo_bench.diagnosis.fitting.solver import KNEE, Solved

SAME = 0.95
"""Beyond this correlation two numbers are called inseparable."""
FLATTEST = 1e-10
"""Curvature along the least known direction, of the largest: below it there is only rounding."""
WELL_KNOWN = 0.1
"""A standard error below this share of the spread is knowledge, whatever the correlation."""
KNOWN_REMEDIES = {
    frozenset(("K_T", "J")): (
        "without a known torque or a known inertia: the motion shows K_T/J only. Hang a weight on "
        "an arm, or add a disc of known inertia, and fit both recordings"
    ),
    frozenset(("coulomb.torque_nm", "viscous.damping_nm_s_per_rad")): (
        "at one speed: play two amplitudes or more"
    ),
}


def covariance(solved: Solved) -> Array:
    """Covariance of the numbers, in spreads, shape (numbers, numbers)."""
    points, numbers = solved.group.size, solved.numbers.size
    residual, rows = solved.residual[:points], solved.jacobian[:points]
    beyond = 1.0 + (residual / KNEE) ** 2
    scores = rows * (residual / np.sqrt(beyond))[:, None]
    curvature = rows.T @ (rows * (beyond**-1.5)[:, None])
    _, place = np.unique(solved.group, return_inverse=True)
    blocks = int(place.max()) + 1
    sums = np.stack([np.bincount(place, column, blocks) for column in scores.T], axis=1)
    meat = sums.T @ sums * (blocks / max(blocks - numbers, 1))
    believed = solved.jacobian[points:]
    curvature += believed.T @ believed
    meat += believed.T @ believed
    inverse = _inverse(curvature)
    return np.asarray(inverse @ meat @ inverse)


def _inverse(matrix: Array) -> Array:
    """Inverse with unit diagonal before; directions that nothing tells of become very wide."""
    size = np.sqrt(np.diag(matrix))
    scale = np.where(size > 0.0, size, 1.0)
    scaled = matrix / np.outer(scale, scale)
    values, vectors = np.linalg.eigh(scaled)
    wide = np.maximum(values, FLATTEST * max(float(values[-1]), FLATTEST))
    return np.asarray((vectors / wide) @ vectors.T / np.outer(scale, scale))


def deviations_of(covariance_: Array) -> Array:
    """Standard errors, shape (numbers,); infinite where rounding left no variance."""
    variance = np.diag(covariance_)
    return np.sqrt(np.where(variance > 0.0, variance, np.inf))


def correlation(covariance_: Array) -> Array:
    """Correlation of the numbers, shape (numbers, numbers), ones on its diagonal."""
    deviation = deviations_of(covariance_)
    safe = np.where(np.isfinite(deviation), deviation, 1.0)
    found = covariance_ / np.outer(safe, safe)
    np.fill_diagonal(found, 1.0)
    return np.asarray(np.clip(found, -1.0, 1.0))


class Alike(NamedTuple):
    """What acts alike in a recording: a sentence for each pair or group, and the names in them."""

    sentences: tuple[str, ...]
    members: frozenset[str]


def inseparable(free: Sequence[FreeParameter], correlation_: Array, deviations: Array) -> Alike:
    """Pairs beyond `SAME`, and numbers that all others together imitate; deviations in spreads.

    Numbers that are well known in spite of it are called hard to tell apart, and no more.
    """
    sentences: list[str] = []
    members: set[str] = set()
    paired: set[int] = set()
    for a, b in combinations(range(len(free)), 2):
        size = float(correlation_[a, b])
        if abs(size) > SAME:
            lost = bool(max(deviations[a], deviations[b]) > WELL_KNOWN)
            sentences.append(_pair(free[a].symbol, free[b].symbol, size, lost=lost))
            paired |= {a, b}
            members |= {free[a].symbol, free[b].symbol} if lost else set()
    inverse = _inverse(correlation_)
    for k, one in enumerate(free):
        explained = math.sqrt(max(0.0, 1.0 - 1.0 / max(float(inverse[k, k]), 1.0)))
        if explained > SAME and k not in paired and deviations[k] > WELL_KNOWN:
            others = ", ".join(p.symbol for p in free if p is not one)
            sentences.append(
                f"{one.symbol} cannot be told from {others} together in this recording: "
                f"multiple correlation {explained:.3f}. Fix one of them."
            )
            members.add(one.symbol)
    return Alike(tuple(sentences), frozenset(members))


def _pair(one: str, other: str, size: float, *, lost: bool) -> str:
    remedy = KNOWN_REMEDIES.get(frozenset((one, other)), "in this recording: fix one of them")
    told = "cannot be told apart" if lost else "are hard to tell apart"
    return f"{one} and {other} {told} {remedy} (correlation {size:.3f})."
