"""How well an equation foretells blocks that had no part in its coefficients.

Blocks are in FOLDS parts: whole records where there are enough, else stretches of time. A part's
errors come from coefficients of the others. Costs are pseudo-Huber sums of errors over their
scatter at that speed, block by block; an effect's evidence is the mean of its blocks' gains over
the standard error of that mean.
"""

import numpy as np
from numpy.typing import NDArray

from servo_bench.diagnosis.elsewhere import gate
from servo_bench.diagnosis.elsewhere.equation import (
    Design,
    electric_of,
    solve,
    usual_torques,
    weights,
)
from servo_bench.diagnosis.elsewhere.terms import Electric
from servo_bench.diagnosis.elsewhere.weak import WeakRows
from servo_bench.diagnosis.fitting.foreign_channels import Array

HUBER = 3.0


def fitted(now: Design) -> tuple[Array, Array, Electric]:
    """Coefficients, weights and the electric torque.

    Weights are told by what the usual torques leave too, else a missing one would hide itself.
    """
    usual = usual_torques(now.rows, inverse=now.inverse)
    matrix = np.concatenate([now.matrix, usual], axis=1)
    weight = np.ones(now.target.size)
    for _ in range(3):
        errors = now.target - matrix @ solve(matrix, now.target, weight)
        weight = weights(now.rows, errors)
    coefficients = solve(now.matrix, now.target, weight)
    return coefficients, weight, electric_of(now, coefficients)


def folds_of(rows: WeakRows) -> NDArray[np.int64]:
    """The part to which each row belongs."""
    records = np.unique(rows.record)
    if records.size >= gate.FOLDS:
        return np.searchsorted(records, rows.record) % gate.FOLDS
    count = int(rows.block.max(initial=0)) + 1
    return (rows.block * gate.FOLDS) // max(count, 1)


def held_errors(now: Design, weight: Array, folds: NDArray[np.int64]) -> Array:
    """Errors of every row by coefficients that did not see its part, over their scatter."""
    matrix, left = now.matrix * weight[:, None], now.target * weight
    errors = np.zeros(left.size)
    ones = np.ones(left.size)
    for part in np.unique(folds):
        here = folds == part
        errors[here] = left[here] - matrix[here] @ solve(matrix[~here], left[~here], ones[~here])
    return errors


def block_costs(errors: Array, rows: WeakRows) -> Array:
    """Pseudo-Huber sums, block by block."""
    cost = 2.0 * HUBER**2 * (np.sqrt(1.0 + (errors / HUBER) ** 2) - 1.0)
    return np.asarray(np.bincount(rows.block, cost), dtype=np.float64)


def compared(better: Array, worse: Array) -> tuple[float, float]:
    """(z, share) of the gain from `worse` to `better`.

    z is the larger of two: of the gain, and of the gain over what both cost, block by block, in
    which a violent block proves no more than a quiet one.
    """
    gain = worse - better
    there = worse + better > 0.0
    usual = float(np.median(worse[there])) if there.any() else 1.0
    relative = gain[there] / (worse + better + usual)[there]
    z = max(_z(gain), _z(relative))
    return z, float(gain.sum()) / max(float(worse.sum()), 1e-300)


def _z(values: Array) -> float:
    """Mean over its standard error; zero where there is none."""
    spread = float(values.std(ddof=1)) / np.sqrt(values.size) if values.size > 1 else 0.0
    return float(values.mean()) / spread if spread > 0.0 else 0.0
