"""Which effects could explain an error: finite templates against it, the nuisances solved along.

    template   t = z(base with the trial) - z(base),          whitened as the error z(base) is
    gain       max over a of  F(z) - F(z + a t + N d),        by weighted least squares

N the nuisances' secants, d their change under what is believed of them. Templates are of finite
size, because limits and gaps have no slope at zero; a saturates, a in [0.3, 1.5] (an effect with a
phase spans two templates, and is linear enough to be taken whole).
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from servo_bench.diagnosis.evidence import KNEE, Errors, Evidence
from servo_bench.diagnosis.hypotheses import Hypothesis, Trial
from servo_bench.diagnosis.rows import Array
from servo_bench.diagnosis.seeking import Found
from servo_bench.diagnosis.unknowns import Unknown
from sim_rig.errors import SimRigError
from sim_rig.model import Model

LEAST, MOST = 0.3, 1.5
QUARTER = np.pi / 2.0
AT_BOUND = 0.02
"""Nearer to a bound than this share of the band is at it."""


class Screened(NamedTuple):
    """One hypothesis at its best trial. `gain` is a share of the base's cost, 0 to 1."""

    hypothesis: Hypothesis
    trial: Trial
    gain: float


def screen(
    evidence: Evidence, base: Found, hypotheses: Sequence[Hypothesis]
) -> tuple[Screened, ...]:
    """All of them, the most promising first."""
    usable: list[tuple[Hypothesis, tuple[Trial, ...]]] = []
    models: list[Model] = []
    for hypothesis in hypotheses:
        for pair in _phased(hypothesis):
            try:
                models += [trial.on(base.model) for trial in pair]
                usable.append((hypothesis, pair))
            except SimRigError:
                continue
    played = iter(evidence.seen(models))
    found: dict[str, Screened] = {}
    solvers: dict[str, _Projected] = {}
    for hypothesis, pair in usable:
        solver = solvers.setdefault(hypothesis.effect, _Projected(base, hypothesis.effect))
        gain, amounts = solver.gain([next(played) for _ in pair])
        trial = _at_phase(pair[0], amounts) if len(pair) == 2 else pair[0].times(float(amounts[0]))
        best = found.get(hypothesis.effect)
        if best is None or gain > best.gain:
            found[hypothesis.effect] = Screened(hypothesis, trial, gain)
    return tuple(sorted(found.values(), key=lambda s: -s.gain))


def _phased(hypothesis: Hypothesis) -> list[tuple[Trial, ...]]:
    """Each trial alone; without its phase, at two a quarter apart, or at eight beside a vehicle.

    Beside a vehicle, which changes more than the effect does, two templates would only cancel.
    """
    if "phase_rad" not in hypothesis.free:
        return [(trial,) for trial in hypothesis.trials]
    found: list[tuple[Trial, ...]] = []
    for trial in hypothesis.trials:
        if "phase_rad" in trial.settings:
            found.append((trial,))
        elif trial.beside:
            found += [(_turned(trial, phase),) for phase in np.arange(8) * (np.pi / 4.0)]
        else:
            found.append((_turned(trial, 0.0), _turned(trial, QUARTER)))
    return found


def _turned(trial: Trial, phase_rad: float) -> Trial:
    settings = {**trial.settings, "phase_rad": float(phase_rad)}
    return replace(trial, settings=settings)


def _at_phase(trial: Trial, amounts: Array) -> Trial:
    """The trial at the phase and size that two amounts, at 0 and a quarter, make."""
    size = float(np.hypot(*amounts))
    phase = float(np.arctan2(amounts[1], amounts[0]))
    scaled = trial.times(float(np.clip(size, 0.02, 20.0)))
    settings = {**scaled.settings, "phase_rad": phase}
    return replace(scaled, settings=settings)


class _Projected:
    """The base's error with its nuisances ready to be solved along.

    A nuisance that stands at its bound cannot move on, and that of the effect in question is what
    is asked: neither is solved along.
    """

    def __init__(self, base: Found, effect: str) -> None:
        self.sigma = base.sigma
        self.white = base.errors.white(base.sigma)
        self.weight = 1.0 / np.sqrt(1.0 + (self.white / KNEE) ** 2)
        self.total = base.errors.cost(base.sigma)
        free = np.array(
            [_moves(u, v, effect) for u, v in zip(base.unknowns, base.values, strict=True)]
        )
        precision = np.array([u.deviation**-2.0 for u in base.unknowns])[free]
        centre = np.array([u.centre for u in base.unknowns])[free]
        jacobian = base.jacobian[:, free]
        self.weighted = jacobian * self.weight[:, None]
        gram = jacobian.T @ self.weighted + np.diag(precision)
        self.size = np.sqrt(np.maximum(np.diag(gram), 1e-300))
        scaled = gram / np.outer(self.size, self.size)
        self.factor = np.linalg.inv(scaled + 1e-6 * np.eye(self.size.size))
        self.pull = -(self.weighted.T @ self.white) - precision * (base.values[free] - centre)

    def _solved(self, right: Array) -> Array:
        return np.asarray(self.factor @ (right / self.size) / self.size)

    def gain(self, errors: Sequence[Errors]) -> tuple[float, Array]:
        """Share of the cost that the templates take, at most 1, and how much of each."""
        gained, amounts = self._gained(errors)
        return min(gained, 1.0), amounts

    def _gained(self, errors: Sequence[Errors]) -> tuple[float, Array]:
        none = -np.inf, np.ones(len(errors))
        if any(e.ran_away for e in errors):
            return none
        t = np.stack([e.white(self.sigma) - self.white for e in errors], axis=1)
        cross = self.weighted.T @ t
        along = np.stack([self._solved(c) for c in cross.T], axis=1)
        curvature = t.T @ (t * self.weight[:, None]) - cross.T @ along
        pull = -(t.T @ (self.white * self.weight)) - along.T @ self.pull
        if len(errors) == 1:
            c = float(curvature[0, 0])
            if c <= 0.0:
                return none
            amount = float(np.clip(pull[0] / c, LEAST, MOST))
            gained = 2.0 * amount * float(pull[0]) - amount**2 * c
            return gained / self.total, np.array([amount])
        ridge = 1e-9 * max(float(np.trace(curvature)), 1e-300)
        amounts = np.linalg.solve(curvature + ridge * np.eye(2), pull)
        return float(pull @ amounts) / self.total, amounts


def _moves(unknown: Unknown, value: float, effect: str) -> bool:
    """Whether a nuisance can still follow."""
    if unknown.effect == effect:
        return False
    room = AT_BOUND * (unknown.high - unknown.low)
    return bool(unknown.low + room < value < unknown.high - room) or unknown.circular
