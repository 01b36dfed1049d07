"""A second look at a Jacobian along its own axes, so that what cannot be told apart shows.

Two numbers that act alike (K_T and J) have columns that should be parallel. Secants through
impacts differ by chance, and that chance would be taken for knowledge: standard errors far too
small. So the model is simulated along the eigenvectors of the first curvature, where the common
direction is measured by itself, and the Jacobian is put together again from these slopes:

    J D = S,   D = C^-1 V N,   J = S N^-1 V' C

C column norms of the first Jacobian, V eigenvectors of its scaled curvature, N such that the
largest component of every direction is one; S the secants along the columns of D. Once is enough,
and a second time would look along rounding.
"""

import numpy as np

from servo_bench.diagnosis.comparing.rows import Array
from servo_bench.diagnosis.fitting.solver import STEPS, Problem, Solved

SHORTEST = 0.1
"""Of a step: where a bound leaves less room than this, the first slope is kept."""


def sharpened(problem: Problem, solved: Solved) -> Solved:
    """The same solution with a Jacobian that knows what it cannot tell apart."""
    numbers, sigma, step = solved.numbers, solved.sigma, STEPS[-1]
    jacobian, here = solved.jacobian, solved.residual
    if numbers.size == 1:
        return solved
    size = np.linalg.norm(jacobian, axis=0)
    size = np.where(size > 0.0, size, 1.0)
    _, axes = np.linalg.eigh((jacobian / size).T @ (jacobian / size))
    directions = axes / size[:, None]
    largest = np.abs(directions).max(axis=0)
    directions = directions / largest
    reach = [_room(problem, numbers, d, step) for d in directions.T]
    ends = [numbers + t * d for t, d in zip(reach, directions.T, strict=True)]
    slopes = jacobian @ directions
    for k, (end, errors) in enumerate(zip(ends, problem.errors(ends), strict=True)):
        slope = problem.residual(end, errors, sigma) - here
        if abs(reach[k]) > SHORTEST * step and np.isfinite(slope).all():
            slopes[:, k] = slope / reach[k]
    sharp = (slopes * largest) @ axes.T * size
    return solved._replace(jacobian=sharp, simulations=problem.simulations)


def _room(problem: Problem, numbers: Array, direction: Array, step: float) -> float:
    """A step along the direction, or against it, as far as the bounds allow."""

    def upto(sense: float) -> float:
        ahead = sense * direction
        to = np.where(ahead > 0.0, problem.high - numbers, problem.low - numbers)
        moving = ahead != 0.0
        return float(min(step, np.min(to[moving] / ahead[moving], initial=np.inf)))

    forwards, backwards = upto(1.0), upto(-1.0)
    return forwards if forwards >= backwards else -backwards
