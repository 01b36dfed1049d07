"""Rows in which the load rests on a face of its gap, and what is regular in its angle there.

    e = y - x - (what the simulation has of it)         y, x: the load's angle, the motor's

A load that is thrown through its gap spoils the cost of a fit by more than a wave of half a count
gains. Where it rests, its angle beside the motor's is known to a count or two: what is regular in
that, over thousands of rows, shows at a small part of one.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from servo_bench.diagnosis.comparing.comparison import Comparison
from servo_bench.diagnosis.comparing.noise import floor_of
from servo_bench.diagnosis.comparing.rows import Array, Mask
from sim_rig.model import Model

ON_A_FACE, BEYOND, TURNS = 0.9, 4.0, 8
"""Of half the way from face to face; deviations that count; and how often they are weighed."""
BLOCK_S, FEWEST = 0.25, 400
NOISIER = 3.0
"""How much more than the sensor at rest the rest may scatter."""


class Resting(NamedTuple):
    """Rows with the load on a face: its angle, its error beside the motor's, and the face, -1 or 1,
    each of shape (rows,).

    `known` are those rows among the piece's, which has `shown` in the simulation; `floor_rad` is
    the sensor's noise at rest.
    """

    angle: Array
    error: Array
    face: Array
    known: Mask
    shown: Mapping[str, Array]
    floor_rad: float
    rows_per_block: int


class Regular(NamedTuple):
    """Least squares of an error on columns: coefficients, shape (columns,), their covariance, and
    the robust deviation of what is left."""

    found: Array
    spread: Array
    scatter: float

    def deviations(self, column: int) -> float:
        """Standard errors by which a coefficient stands beyond zero, with its sign."""
        return float(self.found[column] / np.sqrt(max(self.spread[column, column], 1e-300)))


def resting(
    comparison: Comparison, model: Model, *, held_out: bool = False, fewest: int = FEWEST
) -> Resting | None:
    """Of the longest piece, rows that a fit may see or those that are `held_out`; None without both
    encoders, or with too few."""
    rows, piece = comparison.source.rows, comparison.longest
    if not (rows.has("load_angle_rad") and rows.has("motor_position_rad")):
        return None
    shown = {n: np.asarray(v) for n, v in comparison.source.play(model, piece).items()}
    angle, motor = (
        rows.channel(name)[piece.rows] for name in ("load_angle_rad", "motor_position_rad")
    )
    twist = shown["load_angle_rad"] - shown["motor_position_rad"]
    error = angle - motor - twist
    way = 0.5 * float(np.ptp(twist))
    place = (twist - 0.5 * (twist.max() + twist.min())) / max(way, 1e-12)
    asked = rows.held_out if held_out else rows.seen
    known = np.isfinite(error) & asked[piece.rows] & (np.abs(place) > ON_A_FACE)
    if known.sum() < fewest:
        return None
    return Resting(
        angle[known],
        error[known],
        np.sign(place[known]),
        known,
        shown,
        floor_of(rows, "load_angle_rad", increments=False),
        max(1, round(BLOCK_S / rows.period_s)),
    )


def regular(columns: Array, error: Array, rows_per_block: int) -> Regular:
    """What is regular in an error, shape (rows,), by columns of shape (rows, columns).

    Errors beyond a few deviations count for nothing (Tukey's biweight), for a load that bounced is
    somewhere else; the covariance is the block sandwich.
    """
    weight: Array = np.ones_like(error)
    found: Array = np.zeros(columns.shape[1])
    left, scatter = error, 0.0
    for _ in range(TURNS):
        root = np.sqrt(weight)
        found = np.asarray(
            np.linalg.lstsq(columns * root[:, None], error * root, rcond=None)[0], np.float64
        )
        left = error - columns @ found
        scatter = max(1.4826 * float(np.median(np.abs(left))), 1e-12)
        weight = np.maximum(1.0 - (left / (BEYOND * scatter)) ** 2, 0.0) ** 2
    inverse = np.linalg.pinv(columns.T @ (columns * weight[:, None]))
    rows = error.size // rows_per_block * rows_per_block
    pulls = (columns * (weight * left)[:, None])[:rows]
    blocks = pulls.reshape(-1, rows_per_block, columns.shape[1]).sum(axis=1)
    return Regular(found, inverse @ (blocks.T @ blocks) @ inverse, scatter)


def in_halves(columns: Array, error: Array, rows_per_block: int) -> Sequence[Regular]:
    """The same of the first half of the rows and of the second."""
    half = error.size // 2
    parts = (slice(half), slice(half, None))
    return [regular(columns[part], error[part], rows_per_block) for part in parts]
