"""One Gauss-Newton step of a search: where numbers are put, secants there, and the step itself.

Secants, and points that are scattered, are played in coarse steps always: a difference of two says
the same, and what is taken is weighed in the steps that were asked for.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from servo_bench.diagnosis.comparing.evidence import KNEE, Errors, Evidence
from servo_bench.diagnosis.comparing.rows import Array
from servo_bench.diagnosis.searching.unknowns import Unknown, put_all
from sim_rig.errors import SimRigError
from sim_rig.model import Model

TRIED = (1.0, 0.4, 0.1)
"""Shares of a Gauss-Newton step that are tried at once."""


def surprise(unknowns: Sequence[Unknown], values: Array) -> float:
    """Sum of squared deviations from what was believed."""
    return float(
        sum(((v - u.centre) / u.deviation) ** 2 for u, v in zip(unknowns, values, strict=True))
    )


def within(unknowns: Sequence[Unknown], values: Array) -> Array:
    """The numbers put back into their bounds, angles into a turn."""
    low, high = _bounds(unknowns)
    circular = np.array([u.circular for u in unknowns])
    clipped = np.clip(values, low, high)
    return np.where(circular, (clipped + np.pi) % (2.0 * np.pi) - np.pi, clipped)


def _bounds(unknowns: Sequence[Unknown]) -> tuple[Array, Array]:
    return np.array([u.low for u in unknowns]), np.array([u.high for u in unknowns])


class Point(NamedTuple):
    """Numbers, and what they leave."""

    values: Array
    errors: Errors
    cost: float


class Place(NamedTuple):
    """Where numbers are put, and what they are compared with."""

    evidence: Evidence
    model: Model
    unknowns: tuple[Unknown, ...]
    coarse: bool

    def errors(self, rows: Sequence[Array]) -> list[Errors]:
        """For many sets of values, one batch; a set that makes no model counts as run away."""
        models, lost = [], []
        for values in rows:
            try:
                models.append(put_all(self.model, self.unknowns, list(values)))
                lost.append(False)
            except SimRigError:
                models.append(self.model)
                lost.append(True)
        found = self.evidence.seen(models, coarse=self.coarse)
        for errors, gone in zip(found, lost, strict=True):
            if gone:
                errors.rows = np.full_like(errors.rows, np.inf)
        return found

    def lowest(self, rows: Sequence[Array], sigma: Array) -> Point:
        """The best of many sets of values, one batch."""
        played = self.errors(rows)
        costs = [
            e.cost(sigma) + surprise(self.unknowns, x) for e, x in zip(played, rows, strict=True)
        ]
        best = int(np.argmin(costs))
        return Point(rows[best], played[best], costs[best])

    def along(self, values: Array, step: Array, sigma: Array) -> Point:
        """The best of a step's shares."""
        return self.lowest([within(self.unknowns, values + s * step) for s in TRIED], sigma)

    def jacobian(
        self,
        values: Array,
        errors: Errors,
        sigma: Array,
        width: float,
        which: Sequence[int] | None = None,
    ) -> Array:
        """Secants of the whitened points from `errors`, those of `values`; (points, numbers), of
        all numbers or of `which`."""
        numbers = range(len(self.unknowns)) if which is None else which
        ends = []
        for k in numbers:
            unknown, end = self.unknowns[k], values.copy()
            step = width * unknown.step
            end[k] = values[k] + step
            if end[k] > unknown.high:
                end[k] = max(values[k] - step, unknown.low)
            ends.append(end)
        if self.coarse:
            played = self.errors(ends)
        else:
            errors, *played = self._replace(coarse=True).errors([values, *ends])
        here = errors.white(sigma)
        columns = []
        for k, end, there in zip(numbers, ends, played, strict=True):
            moved = end[k] - values[k]
            usable = moved != 0.0 and not there.ran_away
            columns.append((there.white(sigma) - here) / moved if usable else np.zeros_like(here))
        return np.stack(columns, axis=1) if columns else np.zeros((here.size, 0))


def gauss_newton_step(
    jacobian: Array, white: Array, unknowns: Sequence[Unknown], values: Array
) -> Array:
    """The robust Gauss-Newton step that stays within the bounds."""
    weight = 1.0 / np.sqrt(1.0 + (white / KNEE) ** 2)
    precision = np.array([u.deviation**-2.0 for u in unknowns])
    centre = np.array([u.centre for u in unknowns])
    gram = jacobian.T @ (jacobian * weight[:, None]) + np.diag(precision)
    pull = -jacobian.T @ (white * weight) - precision * (values - centre)
    low, high = (bound - values for bound in _bounds(unknowns))
    step = np.zeros(values.size)
    free = np.ones(values.size, np.bool_)
    for _ in range(values.size + 1):
        rest = pull[free] - gram[np.ix_(free, ~free)] @ step[~free]
        step[free] = _solved(gram[np.ix_(free, free)], rest)
        beyond = free & ((step < low) | (step > high))
        if not beyond.any():
            break
        step[beyond] = np.clip(step[beyond], low[beyond], high[beyond])
        free &= ~beyond
    return np.clip(step, low, high)


def _solved(gram: Array, pull: Array) -> Array:
    """With unit diagonal and a trace of ridge: columns may be parallel or empty."""
    if not pull.size:
        return pull
    size = np.sqrt(np.diag(gram))
    size = np.where(size > 0.0, size, 1.0)
    scaled = gram / np.outer(size, size) + 1e-6 * np.eye(pull.size)
    return np.asarray(np.linalg.solve(scaled, pull / size) / size)
