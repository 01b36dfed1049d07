"""Which effects could explain an error: finite templates against it, the nuisances solved along.

    template   t = z(base with the trial) - z(base),          whitened as the error z(base) is
    gain       max over a of  F(z) - F(z + a t + N d),        by weighted least squares

N the nuisances' secants, d their change under what is believed of them: one
that stands at its bound, because it stood in for the cause, comes back from there. Templates are of
finite size, because limits and gaps have no slope at zero; a saturates, a in [0.3, 1.5] (an effect
with a phase spans two templates, and is linear enough to be taken whole).

What is steep (a resonance, a clock that walks until commands cross the samples) has no templates
worth the name: a tells that something of the kind is there, and nothing of its size. Its searches
start from trials at their own size (see `approaching`).
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import lsq_linear

from servo_bench.diagnosis.comparing.evidence import KNEE, Errors, Evidence
from servo_bench.diagnosis.comparing.rows import Array
from servo_bench.diagnosis.searching.hypotheses import Hypothesis, Trial
from servo_bench.diagnosis.searching.seeking import Found
from servo_bench.diagnosis.searching.sizes import REACH, STEEP
from servo_bench.diagnosis.searching.unknowns import Unknown
from sim_rig.errors import SimRigError
from sim_rig.model import Model

SMALLEST = 0.1
"""Of a trial's size, where it is beyond nothing that a template points to."""
QUARTER, RIDGE = np.pi / 2.0, 1e-6
AT_BOUND = 0.02
"""Nearer to a bound than this share of the band is at it."""
SECOND_ORDER = frozenset({"misalignment"})
"""Its error goes with the square of its strength, and turns twice as its phase turns once."""


class Screened(NamedTuple):
    """One hypothesis at its best trial. `gain` is a share of the base's cost, 0 to 1; `tried` are
    trials at their own size, where a search starts better than at those of a template."""

    hypothesis: Hypothesis
    trial: Trial
    gain: float
    tried: tuple[Trial, ...] = ()


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
    solvers: dict[str, Beside] = {}
    steep: dict[str, list[Trial]] = {}
    for hypothesis, pair in usable:
        if hypothesis.effect not in solvers:
            solvers[hypothesis.effect] = Beside(base, hypothesis.effect)
        errors = [next(played) for _ in pair]
        gain, amounts = solvers[hypothesis.effect].gain(errors)
        one = pair[0]
        if hypothesis.effect in STEEP and np.isfinite(gain):
            steep.setdefault(hypothesis.effect, []).append(one)
        waves = len(pair) == 2
        trial = (at_phase if waves else towards)(one, base.model, amounts)
        best = found.get(hypothesis.effect)
        if best is None or gain > best.gain:
            found[hypothesis.effect] = Screened(hypothesis, trial, gain)
    for effect, each in steep.items():
        found[effect] = found[effect]._replace(tried=tuple(each))
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
            found.append((_turned(trial, 0.0), _turned(trial, quarter_rad(trial.effect))))
    return found


def quarter_rad(effect: str) -> float:
    """What turns an effect's error by a quarter of its period: two so far apart span every phase.

    Two that are half a period apart are one and its negative, and span one.
    """
    return QUARTER / 2.0 if effect in SECOND_ORDER else QUARTER


def _turned(trial: Trial, phase_rad: float) -> Trial:
    settings = {**trial.settings, "phase_rad": float(phase_rad)}
    return replace(trial, settings=settings)


def towards(trial: Trial, model: Model, amounts: Array) -> Trial:
    """So much of the way from what a model has of the effect already to the trial; of its sign."""
    strength = next(iter(trial.settings))
    params = model.effects.get(trial.effect)
    now = float(getattr(params, strength)) if params is not None else 0.0
    tried = float(trial.settings[strength])
    return trial.times(max((now + float(amounts[0]) * (tried - now)) / tried, SMALLEST))


def at_phase(trial: Trial, model: Model, amounts: Array) -> Trial:
    """The trial at the phase and size that two amounts, at 0 and a quarter, make of what a model
    has of the wave already: each is so much of the way from there to its own trial."""
    power = 2 if trial.effect in SECOND_ORDER else 1
    strength = next(iter(trial.settings))
    tried = float(trial.settings[strength]) ** power
    params = model.effects.get(trial.effect)
    alike = params is not None and _is_of_one_order(params, trial, strength)
    now = _wave(params, strength, power) / tried if alike else 0j
    made = now + amounts[0] * (1.0 - now) + amounts[1] * (1j - now)
    scaled = trial.times(float(np.clip(abs(made) ** (1.0 / power), 0.02, 20.0)))
    settings = {**scaled.settings, "phase_rad": float(np.angle(made)) / power}
    return replace(scaled, settings=settings)


def _is_of_one_order(params: Any, trial: Trial, strength: str) -> bool:
    """Whether a wave is the trial's but for size and phase: another order's is no way to it."""
    free = {strength, "phase_rad"}
    told = {name: value for name, value in trial.settings.items() if name not in free}
    return all(float(getattr(params, name)) == float(value) for name, value in told.items())


def _wave(params: Any, strength: str, power: int) -> complex:
    size, phase_rad = float(getattr(params, strength)), float(params.phase_rad)
    return complex(size**power * np.exp(1j * power * phase_rad))


class Beside:
    """The base's error with its nuisances ready to be solved along.

    One that stands at its bound only comes back from there, through its band; the others move
    freely, because what a template has too much of they take off again. That of the effect in
    question is what is asked, and stays.
    """

    def __init__(self, base: Found, effect: str) -> None:
        self.sigma = base.sigma
        self.white = base.errors.white(base.sigma)
        self.weight = 1.0 / np.sqrt(1.0 + (self.white / KNEE) ** 2)
        self.total = base.errors.cost(base.sigma)
        which = [k for k, u in enumerate(base.unknowns) if u.effect != effect and u.low < u.high]
        moving = [base.unknowns[k] for k in which]
        values = base.values[which]
        stuck = [_at_bound(u, v) for u, v in zip(moving, values, strict=True)]
        at_low, at_high = np.array(stuck, np.bool_).reshape(-1, 2).T
        band = np.array([u.high - u.low for u in moving])
        self.low = np.where(at_low, 0.0, np.where(at_high, -band, -np.inf))
        self.high = np.where(at_high, 0.0, np.where(at_low, band, np.inf))
        precision = np.array([u.deviation**-2.0 for u in moving])
        centre = np.array([u.centre for u in moving])
        jacobian = base.jacobian[:, which]
        self.weighted = jacobian * self.weight[:, None]
        self.gram = jacobian.T @ self.weighted + np.diag(precision)
        self.pull = -(self.weighted.T @ self.white) - precision * (values - centre)
        self.alone = self._gained(self.gram, self.pull, self.low, self.high)[0]

    def gain(self, errors: Sequence[Errors]) -> tuple[float, Array]:
        """Share of the cost that the templates take, at most 1, and how much of each.

        One alone saturates within `REACH`; two make a phase, and are taken whole.
        """
        if any(e.ran_away for e in errors):
            return -np.inf, np.ones(len(errors))
        t = np.stack([e.white(self.sigma) - self.white for e in errors], axis=1)
        cross, own = self.weighted.T @ t, t.T @ (t * self.weight[:, None])
        gram = np.block([[self.gram, cross], [cross.T, own]])
        pull = np.append(self.pull, -(t.T @ (self.white * self.weight)))
        least, most = REACH if len(errors) == 1 else (-np.inf, np.inf)
        low = np.append(self.low, np.full(len(errors), least))
        high = np.append(self.high, np.full(len(errors), most))
        gained, step = self._gained(gram, pull, low, high)
        return min((gained - self.alone) / self.total, 1.0), step[-len(errors) :]

    @staticmethod
    def _gained(gram: Array, pull: Array, low: Array, high: Array) -> tuple[float, Array]:
        """How far the cost falls where it is least in the box, and where that is."""
        size = np.sqrt(np.maximum(np.diag(gram), 1e-300))
        root = np.linalg.cholesky(gram / np.outer(size, size) + RIDGE * np.eye(size.size))
        wanted = np.linalg.solve(root, pull / size)
        found = lsq_linear(root.T, wanted, (low * size, high * size), method="bvls")
        step = np.asarray(found.x) / size
        return float(2.0 * pull @ step - step @ gram @ step), step


def _at_bound(unknown: Unknown, value: float) -> tuple[bool, bool]:
    """Whether a nuisance stands at its lower one, and at its upper one."""
    band = unknown.high - unknown.low
    room = AT_BOUND * (band if np.isfinite(band) else unknown.step)
    return value <= unknown.low + room, value >= unknown.high - room
