"""Which experiment tells the causes apart on this rig: predicted separation per minute.

Every cause is played on the nominal rig at the smallest size that is worth a name (`sizes`), and
its template t = z(with it) - z(without), whitened by what a right simulation may miss, is what the
experiment would show of it. What the numbers that every rig leaves open could imitate within their
bands is taken out (P), and what the rival could at its own best size:

    seen       |(1 - P) t_i|
    apart      |(1 - P) t_i| sqrt(1 - c_ij^2),     c_ij the cosine of the projected templates

Both grow with the square root of an experiment's length, so they are given per sqrt(minute). An
experiment is as good as the confusable pairs that it tells in a minute: each counts by its share of
five standard deviations, at most as one. (By the worst pair alone one cause decides that is seen by
accident: a deadband, where a bias is as small.) Classes that nothing on these channels splits (see
`classes`) are not counted as pairs.
"""

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import NamedTuple

import numpy as np

from servo_bench.diagnosis.candidates import Plan
from servo_bench.diagnosis.comparing.evidence import Evidence, evidence_of
from servo_bench.diagnosis.comparing.rows import Array
from servo_bench.diagnosis.searching.classes import class_of
from servo_bench.diagnosis.searching.hypotheses import Hypothesis, Trial, hypotheses
from servo_bench.diagnosis.searching.scales import Scales, band_of, scales_of
from servo_bench.diagnosis.searching.screening import quarter_rad
from servo_bench.diagnosis.searching.sizes import material_sizes
from servo_bench.diagnosis.searching.unknowns import Unknown, at_centres
from servo_bench.excitation.experiment import Experiment, Phase
from servo_bench.recording.recording import Recording
from sim_rig.effects import find_effect
from sim_rig.errors import SimRigError
from sim_rig.model import Model

JUDGED_S = 16.0
"""So much of an experiment is played to judge it; the rest is more of the same."""
COUNTS_PER_TURN = 65536
TORQUE_QUANTUM_NM = 6.4e-4
ORDERS = (6.0, 24.0)
NOISE_SEED = 7
SURE = 5.0
"""Standard deviations at which a pair counts as split."""
ALIKE = 0.05
"""Shares of the pairs that are told: what lies as near is equal."""
LEAST_SEEN = 1.0
"""Per sqrt(minute): what cannot be seen at all is told as such and not as a confusion."""


class Pair(NamedTuple):
    """Two causes, and how far apart, per sqrt(minute)."""

    one: str
    other: str
    apart: float


@dataclass(frozen=True, slots=True)
class Separation:
    """What one experiment tells: `seen` by effect, and every confusable pair, worst first."""

    plan: Plan
    seen: Mapping[str, float]
    pairs: tuple[Pair, ...]

    @property
    def worst(self) -> float:
        """Of the worst pair, per sqrt(minute); 0 where it tells no pair."""
        return self.pairs[0].apart if self.pairs else min(self.seen.values(), default=0.0)

    @property
    def told(self) -> float:
        """The experiment's figure: the share of its pairs that a minute tells, 0 to 1."""
        counted = self.pairs or (Pair("", "", self.worst),)
        return float(np.mean([min(pair.apart / SURE, 1.0) for pair in counted]))

    @property
    def unseen(self) -> tuple[str, ...]:
        """Effects that it does not show at the smallest size worth a name."""
        return tuple(name for name, size in self.seen.items() if size < LEAST_SEEN)

    @property
    def minutes_to_split(self) -> float:
        """How long until the worst pair is apart by five standard deviations; inf if never."""
        return (SURE / self.worst) ** 2 if self.worst > 0.0 else math.inf

    @property
    def split_in_a_minute(self) -> int:
        """How many of the pairs are apart by five standard deviations after one."""
        return sum(pair.apart >= SURE for pair in self.pairs)


def ranked(found: Sequence[Separation]) -> tuple[Separation, ...]:
    """Best first, by what they tell, and of equals by their worst pair; pairs that none of them
    splits are left out of all."""
    best: dict[tuple[str, str], float] = {}
    for one in found:
        for pair in one.pairs:
            key = (pair.one, pair.other)
            best[key] = max(best.get(key, 0.0), pair.apart)
    counted = [
        replace(
            one,
            pairs=tuple(p for p in one.pairs if best[p.one, p.other] >= LEAST_SEEN) or one.pairs,
        )
        for one in found
    ]
    return tuple(sorted(counted, key=lambda one: (-round(one.told / ALIKE), -one.worst)))


def separation(
    plan: Plan,
    model: Model,
    *,
    only: Collection[str] = (),
    pairs: Collection[frozenset[str]] = (),
    sizes: Mapping[str, Mapping[str, float]],
) -> Separation:
    """How far one experiment tells the effects apart on this rig.

    `only` narrows the effects and `pairs` the pairs that count; `sizes` gives settings of effects
    that are known (from a verdict). Raises FitError or ConfigError as `evidence_of`.
    """
    recording = foreseen(plan.experiment, model)
    evidence = evidence_of([recording], model)
    scales = _scales(recording, model)
    band = band_of(scales, model)
    centre = at_centres(model, band)
    templates = _templates(evidence, centre, band, scales, only, sizes)
    minutes = min(JUDGED_S, plan.experiment.schedule().duration_s) / 60.0
    per = 1.0 / math.sqrt(minutes)
    seen = {name: per * _size(several) for name, several in templates.items()}
    told = [
        Pair(
            a, b, per * min(_apart(templates[a], templates[b]), _apart(templates[b], templates[a]))
        )
        for a, b in _confusable(tuple(templates), pairs)
    ]
    told.sort(key=lambda pair: pair.apart)
    return Separation(plan, seen, tuple(told))


def foreseen(experiment: Experiment, model: Model) -> Recording:
    """What the nominal rig would record of an experiment's beginning, with its encoders' steps.

    Its last quarter is called validation, so that it can be compared as a recording is.
    """
    schedule = experiment.schedule()
    first = schedule.slots_of(Phase.IDENTIFICATION).start
    rows = slice(first, min(first + round(JUDGED_S / schedule.period_s), schedule.slots))
    command = schedule.velocity_rad_s[rows]
    done = model.simulate(command, schedule.period_s)
    noise = np.random.default_rng(NOISE_SEED).standard_normal(command.size)
    step = 2.0 * np.pi / COUNTS_PER_TURN
    torque = done.motor_current_a * model.nominal.torque_constant_nm_per_a
    phase = np.full(command.size, int(Phase.IDENTIFICATION), np.uint32)
    phase[3 * command.size // 4 :] = int(Phase.VALIDATION)
    slot = np.arange(command.size, dtype=np.int64)
    return Recording(
        channels={
            "slot": slot,
            "phase": phase,
            "asked_ns": np.rint(slot * schedule.period_s * 1e9).astype(np.int64),
            "velocity_command_rad_s": command.copy(),
            "motor_position_rad": np.floor(done.motor_angle_rad / step) * step,
            "load_angle_rad": np.floor(done.load_angle_rad / step + noise) * step,
            "motor_torque_nm": np.rint(torque / TORQUE_QUANTUM_NM) * TORQUE_QUANTUM_NM,
        },
        period_s=schedule.period_s,
        experiment=None,
        rig=None,
        provenance={"source": "foreseen"},
    )


def _scales(recording: Recording, model: Model) -> Scales:
    commands = np.array(recording["velocity_command_rad_s"], np.float64)
    return scales_of(model, commands, recording.period_s)


def _templates(  # noqa: PLR0917 - where, what, and how large
    evidence: Evidence,
    base: Model,
    band: Sequence[Unknown],
    scales: Scales,
    only: Collection[str],
    sizes: Mapping[str, Mapping[str, float]],
) -> dict[str, Array]:
    """Projected templates by effect, shape (templates, points): two where the phase is free."""
    tried = list(_tried(base, scales, only, sizes))
    moved = [u.put(base, u.centre + 0.5 * (u.high - u.centre)) for u in band]
    models = [base, *moved, *(model for _, model in tried)]
    errors = evidence.seen(models)
    sigma = evidence.allowed
    here = errors[0].white(sigma)
    secants = np.stack([e.white(sigma) - here for e in errors[1 : 1 + len(moved)]], axis=1)
    steps = np.array([0.5 * (u.high - u.centre) / u.deviation for u in band])
    free = [_Free(secants[:, k] / steps[k], u.effect) for k, u in enumerate(band)]
    found: dict[str, list[Array]] = {}
    for (name, _), there in zip(tried, errors[1 + len(moved) :], strict=True):
        if there.ran_away:
            continue
        found.setdefault(name, []).append(_left(there.white(sigma) - here, free, name))
    return {name: np.stack(rows) for name, rows in found.items()}


class _Free(NamedTuple):
    """What a number that every rig leaves open changes, for one deviation of what is believed."""

    secant: Array
    effect: str


def _left(template: Array, free: Sequence[_Free], effect: str) -> Array:
    """What the open numbers cannot imitate within their bands; the effect's own does not count."""
    columns = np.stack([f.secant for f in free if f.effect != effect], axis=1)
    gram = columns.T @ columns + np.eye(columns.shape[1])
    return np.asarray(template - columns @ np.linalg.solve(gram, columns.T @ template))


def _basis(columns: Array) -> Array:
    """Orthonormal columns that span what is not negligible of these."""
    sizes = np.linalg.norm(columns, axis=0)
    columns = columns[:, sizes > 0.0] / sizes[sizes > 0.0]
    vectors, values, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(vectors[:, values > 1e-6])


def _tried(
    base: Model,
    scales: Scales,
    only: Collection[str],
    sizes: Mapping[str, Mapping[str, float]],
) -> Iterator[tuple[str, Model]]:
    smallest = material_sizes(scales)
    for hypothesis in hypotheses(
        scales, motor_orders=ORDERS, load_orders=(1024.0,), only=tuple(only)
    ):
        for trial in _at_smallest(hypothesis, smallest, sizes):
            try:
                yield hypothesis.effect, trial.on(base)
            except SimRigError:
                continue


def _at_smallest(
    hypothesis: Hypothesis, smallest: Mapping[str, float], sizes: Mapping[str, Mapping[str, float]]
) -> Iterator[Trial]:
    """The first trial, at the smallest size worth a name, or as a verdict has it; at two phases."""
    first = min(hypothesis.trials, key=lambda t: t.size)
    least = smallest.get(hypothesis.effect, 0.0)
    trial = first.times(least / first.size) if least > 0.0 and first.size > 0.0 else first
    known = sizes.get(hypothesis.effect)
    if known is not None:
        strength = find_effect(hypothesis.effect).strengths[0]
        trial = Trial(hypothesis.effect, dict(known), abs(known.get(strength, 1.0)), first.beside)
    if "phase_rad" not in hypothesis.free:
        yield trial
        return
    phase = float(trial.settings.get("phase_rad", 0.0))
    for turned in (phase, phase + quarter_rad(hypothesis.effect)):
        settings = {**trial.settings, "phase_rad": turned}
        yield replace(trial, settings=settings)


def _size(several: Array) -> float:
    """rms over the phases."""
    return float(np.sqrt(np.mean(np.sum(several**2, axis=1))))


def _apart(one: Array, other: Array) -> float:
    """What is left of a template after the other, at its best size and phase, is taken out."""
    basis = _basis(other.T) if np.any(other) else np.zeros((other.shape[1], 0))
    left = one - (one @ basis) @ basis.T
    return _size(left)


def _confusable(
    names: Sequence[str], wanted: Collection[frozenset[str]]
) -> Iterator[tuple[str, str]]:
    """Pairs that an effect's file declares, or exactly those that are wanted."""
    for a, b in combinations(names, 2):
        if wanted:
            if frozenset({a, b}) in wanted:
                yield a, b
            continue
        declared = b in find_effect(a).confused_with or a in find_effect(b).confused_with
        if declared and b not in class_of(a):
            yield a, b
