"""Where a fit starts: the model's own values, and for a phase beside nothing, the best of eight.

An effect of strength zero has no phase, and from the wrong one its strength would be pushed below
zero. So where both are free, eight phases are tried with a strength of one spread.
"""

import math

import numpy as np

from servo_bench.diagnosis.comparing.rows import Array
from servo_bench.diagnosis.fitting.free import FreeParameter, strength_beside
from servo_bench.diagnosis.fitting.solver import Problem, cost
from sim_rig.effects import find_effect

PHASES = 8


def starting_numbers(problem: Problem) -> Array:
    """Shape (numbers,), in spreads."""
    starts = np.array([p.of(problem.model) for p in problem.free])
    values: Array = starts / problem.spreads
    for k, parameter in enumerate(problem.free):
        strength = _strength_of(problem, parameter)
        if strength is not None and values[strength] == 0.0:
            values = _best_phase(problem, values, k, strength)
    return values


def _strength_of(problem: Problem, phase: FreeParameter) -> int | None:
    if not phase.circular or phase.effect is None:
        return None
    field = strength_beside(phase, find_effect(phase.effect))
    names = [p.name for p in problem.free]
    name = f"{phase.effect}.{field}"
    return names.index(name) if name in names else None


def _best_phase(problem: Problem, values: Array, phase: int, strength: int) -> Array:
    trials = []
    for angle in np.arange(PHASES) * (2.0 * math.pi / PHASES):
        trial = values.copy()
        trial[strength], trial[phase] = 1.0, angle / problem.spreads[phase]
        trials.append(trial)
    played = problem.errors([values, *trials])
    sigma = problem.sigma(played[0])
    costs = [cost(problem.whitened(errors, sigma)) for errors in played[1:]]
    return trials[int(np.argmin(np.nan_to_num(costs, nan=math.inf)))]
