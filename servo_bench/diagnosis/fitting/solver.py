"""Robust least squares with steps as wide as what is not known: scipy's trust region, our Jacobian.

Impacts and a rigid play ripple the error, so that derivatives over small differences point
anywhere. Differences begin half a spread wide and shrink to a third and a ninth of that; within a
stage they are one batch of simulations over the cores. Each stage weighs every signal by its floor
or, where that is more, by the robust deviation that its error still has: what no model explains
is no reason to trust a signal less noisy than it is wrong.

    minimise  sum rho(e / sigma),    rho(x) = 2 k^2 (sqrt(1 + (x/k)^2) - 1),   k = 2
"""

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from servo_bench.diagnosis.comparing.comparison import Comparison
from servo_bench.diagnosis.comparing.rows import Array
from servo_bench.diagnosis.fitting.free import FreeParameter
from servo_bench.errors import FitError
from sim_rig.errors import SimRigError
from sim_rig.model import Model

STEPS = (0.5, 0.5 / 3.0, 0.5 / 9.0)
"""Widths of the differences, in spreads, stage by stage."""
KNEE = 2.0
"""Errors beyond so many floors count by their size, not their square."""
COARSENESS = (4.0, 2.0, 1.0)
"""How many times longer the simulation's own steps are in each stage; the last one is exact."""
MOST_ITERATIONS = 15
"""In each stage."""
TOLERANCES = (1e-2, 1e-3, 1e-5)
"""When a stage ends: relative change of the cost, and ten times that of the numbers."""


class Progress(NamedTuple):
    """Where a fit is: `stage` of `stages`, simulations so far, and the cost per point."""

    stage: int
    stages: int
    iteration: int
    simulations: int
    cost: float


Report = Callable[[Progress], None]


class Solved(NamedTuple):
    """`numbers` in spreads; `jacobian` and `residual` of the whitened points at them.

    `errors` (signals, points of the comparison), `sigma` (signals,), `jacobian` (points, numbers),
    `residual` (points,), `group` (points,); prior rows come last and have no group.
    """

    numbers: Array
    jacobian: Array
    residual: Array
    group: NDArray[np.int64]
    errors: Array
    sigma: Array
    iterations: int
    simulations: int
    settled: bool
    cost_before: float
    cost_after: float


class Problem:
    """A comparison, a model, and what is free in it: residuals and Jacobians by number."""

    def __init__(
        self,
        comparison: Comparison,
        model: Model,
        free: tuple[FreeParameter, ...],
        *,
        prior: bool = False,
    ) -> None:
        self.comparison, self.model, self.free, self.prior = comparison, model, free, prior
        self.spreads = np.array([p.spread for p in free])
        self.low = np.array([p.low for p in free]) / self.spreads
        self.high = np.array([p.high for p in free]) / self.spreads
        self.known = np.isfinite(comparison.measured) & comparison.seen
        self.simulations = 0

    def at(self, numbers: Array, coarseness: float = 1.0) -> Model:
        """The model with these numbers, in spreads, and with steps so many times longer."""
        model = replace(self.model, longest_step_s=coarseness * self.model.longest_step_s)
        for parameter, value in zip(self.free, numbers * self.spreads, strict=True):
            model = parameter.put(model, float(value))
        return model

    def errors(self, rows: list[Array], coarseness: float = 1.0) -> list[Array]:
        """Errors, shape (signals, points), for many sets of numbers at once; NaN where none."""
        lost = np.full_like(self.comparison.measured, np.nan)
        found = [lost] * len(rows)
        models: list[tuple[int, Model]] = []
        for k, numbers in enumerate(rows):
            try:
                models.append((k, self.at(numbers, coarseness)))
            except SimRigError:
                continue
        self.simulations += len(models)
        played = self.comparison.errors_of([model for _, model in models])
        for (k, _), errors in zip(models, played, strict=True):
            found[k] = errors
        return found

    def whitened(self, errors: Array, sigma: Array) -> Array:
        """Known, seen points over their deviation, one long row."""
        weights = self._weights()
        row: Array = (errors * weights / sigma[:, None])[self.known]
        return row

    def sigma(self, errors: Array) -> Array:
        """What each signal is weighed by, shape (signals,): floor, or robust deviation."""
        weighed = errors * self._weights()
        floors = [signal.floor for signal in self.comparison.signals]
        robust = [
            1.4826 * float(np.median(np.abs(row[known]))) if known.any() else 0.0
            for row, known in zip(weighed, self.known, strict=True)
        ]
        return np.maximum(floors, robust)

    def surprises(self, numbers: Array) -> Array:
        """Prior residuals, shape (numbers,), or none."""
        if not self.prior:
            return np.empty(0)
        values = numbers * self.spreads
        return np.array([p.surprise(float(v)) for p, v in zip(self.free, values, strict=True)])

    def residual(self, numbers: Array, errors: Array, sigma: Array) -> Array:
        """Whitened points and, after them, the prior's."""
        return np.append(self.whitened(errors, sigma), self.surprises(numbers))

    def jacobian(
        self, numbers: Array, base: Array, sigma: Array, step: float, coarseness: float = 1.0
    ) -> Array:
        """Secants of the whitened points, and of the prior, one batch; base: errors there."""
        ends = self._ends(numbers, step)
        played = self.errors(ends, coarseness)
        columns = []
        here = self.residual(numbers, base, sigma)
        for k, (end, errors) in enumerate(zip(ends, played, strict=True)):
            slope = (self.residual(end, errors, sigma) - here) / (end[k] - numbers[k])
            columns.append(slope if np.isfinite(slope).all() else np.zeros_like(slope))
        return np.stack(columns, axis=1)

    def _ends(self, numbers: Array, step: float) -> list[Array]:
        """Each number moved, upwards unless its bound is there."""
        ends = []
        for k in range(numbers.size):
            end = numbers.copy()
            up = numbers[k] + step <= self.high[k]
            end[k] = numbers[k] + step if up else max(numbers[k] - step, self.low[k])
            ends.append(end)
        return ends

    def _weights(self) -> Array:
        increments = np.array([signal.increments for signal in self.comparison.signals])
        return np.where(increments[:, None], self.comparison.weight, 1.0)


def cost(residual: Array) -> float:
    """The robust cost per point."""
    return float(np.mean(2.0 * KNEE**2 * (np.sqrt(1.0 + (residual / KNEE) ** 2) - 1.0)))


def solve(problem: Problem, start: Array, report: Report | None = None) -> Solved:
    """Fit from `start`, in spreads. FitError where the model cannot be simulated there."""
    stages = _Stages(problem, report)
    numbers = np.clip(start, problem.low, problem.high)
    settled = False
    for stage, step in enumerate(STEPS):
        numbers, settled = stages.run(stage, step, numbers)
    errors = stages.errors(numbers)
    sigma = stages.sigma
    before = problem.whitened(stages.errors(start), sigma)
    jacobian = problem.jacobian(numbers, errors, sigma, STEPS[-1])
    residual = problem.residual(numbers, errors, sigma)
    group = np.broadcast_to(problem.comparison.group, problem.known.shape)[problem.known]
    return Solved(
        numbers=numbers,
        jacobian=jacobian,
        residual=residual,
        group=group,
        errors=errors,
        sigma=sigma,
        iterations=stages.iterations,
        simulations=problem.simulations,
        settled=settled,
        cost_before=cost(before),
        cost_after=cost(problem.whitened(errors, sigma)),
    )


class _Stages:
    """Stage after stage of scipy's least_squares, with the last simulation kept."""

    def __init__(self, problem: Problem, report: Report | None) -> None:
        self.problem, self.report = problem, report
        self.iterations, self.stage, self.coarseness = 0, 0, 1.0
        self._at, self._errors = np.empty(0), np.empty(0)
        self.sigma = np.empty(0)

    def errors(self, numbers: Array) -> Array:
        """Errors there; simulated once."""
        key = np.append(numbers, self.coarseness)
        if not np.array_equal(key, self._at):
            self._at, self._errors = key, self.problem.errors([numbers], self.coarseness)[0]
        return self._errors

    def _begin(self, start: Array, coarseness: float) -> Array:
        """Errors at a stage's start; in fine steps where coarse ones run away."""
        self.coarseness = coarseness
        errors = self.errors(start)
        if not np.isfinite(errors[self.problem.known]).all():
            self.coarseness = 1.0
            errors = self.errors(start)
        if not np.isfinite(errors[self.problem.known]).all():
            raise FitError(
                "the model cannot be simulated with the values that the fit starts from: it runs "
                "away, or an effect makes no sense there. Start from another model."
            )
        return errors

    def run(self, stage: int, step: float, start: Array) -> tuple[Array, bool]:
        """One stage: where it ended, and whether it settled."""
        problem, self.stage = self.problem, stage
        sigma = self.sigma = problem.sigma(self._begin(start, COARSENESS[stage]))

        def residual(numbers: Array) -> Array:
            return problem.residual(numbers, self.errors(numbers), sigma)

        def jacobian(numbers: Array) -> Array:
            self.iterations += 1
            errors = self.errors(numbers)
            found = problem.jacobian(numbers, errors, sigma, step, self.coarseness)
            self._tell(cost(problem.whitened(errors, sigma)))
            return found

        found = least_squares(
            residual,
            start,
            jac=jacobian,
            bounds=(problem.low, problem.high),
            loss="soft_l1",
            f_scale=KNEE,
            ftol=TOLERANCES[stage],
            xtol=0.1 * TOLERANCES[stage],
            gtol=None,
            max_nfev=MOST_ITERATIONS,
        )
        return np.asarray(found.x, np.float64), found.status > 0

    def _tell(self, now: float) -> None:
        if self.report is not None:
            self.report(
                Progress(self.stage + 1, len(STEPS), self.iterations, self.problem.simulations, now)
            )
