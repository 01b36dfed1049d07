"""Where the searches for a steep effect begin: its trials, each gone a little way to its valley.

A resonance, a face that bounces or a clock that walks has many valleys, and which one a trial is in
its own cost does not tell: the base's numbers stand where they stood in for what is missing, and
the trial that mends least then looks best. A few Gauss-Newton steps tell, by secants of the trial's
own numbers where it is and for all others those that the base's search ended with. Many trials take
a step, the better share of them the next, and the searches begin where the last few came to.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from servo_bench.diagnosis.comparing.evidence import Evidence
from servo_bench.diagnosis.comparing.rows import Array
from servo_bench.diagnosis.searching.hypotheses import Hypothesis, Trial
from servo_bench.diagnosis.searching.seeking import Found
from servo_bench.diagnosis.searching.stepping import Place, Point, gauss_newton_step, within
from servo_bench.diagnosis.searching.unknowns import Unknown, merged, put_all
from sim_rig.errors import SimRigError
from sim_rig.model import Model

KEPT = (24, 8, 3)
"""Of the trials, those that come nearest after each step."""
WIDTH = 0.25
"""Of a number's step: how wide the differences are."""


class Start(NamedTuple):
    """Where a search begins, and what it frees."""

    model: Model
    unknowns: tuple[Unknown, ...]


class _Walk(NamedTuple):
    """A trial on its way; `secants`, those of the base's search, with room for its own numbers'."""

    place: Place
    at: Point
    secants: Array
    own: tuple[int, ...]


def approached(
    evidence: Evidence, base: Found, hypothesis: Hypothesis, trials: Sequence[Trial]
) -> tuple[Start, ...]:
    """The best starts of a search beside the base, at most `KEPT` at last, the nearest first."""
    walks = [w for t in trials if (w := _begun(evidence, base, hypothesis, t)) is not None]
    for kept in KEPT:
        walks = [_stepped(walk, base.sigma) for walk in walks]
        walks = sorted(walks, key=lambda walk: walk.at.cost)[:kept]
    return tuple(
        Start(put_all(w.place.model, w.place.unknowns, list(w.at.values)), w.place.unknowns)
        for w in walks
    )


def _begun(evidence: Evidence, base: Found, hypothesis: Hypothesis, trial: Trial) -> _Walk | None:
    """A trial as it is; None where it makes no rig."""
    try:
        model = trial.on(base.model)
    except SimRigError:
        return None
    unknowns = merged(base.unknowns, hypothesis.unknowns(base.model, trial))
    place = Place(evidence, model, unknowns, coarse=True)
    at = place.lowest([within(unknowns, np.array([u.of(model) for u in unknowns]))], base.sigma)
    old = {u.name: k for k, u in enumerate(base.unknowns) if u in unknowns}
    secants = np.zeros((base.jacobian.shape[0], len(unknowns)))
    for k, unknown in enumerate(unknowns):
        if unknown.name in old:
            secants[:, k] = base.jacobian[:, old[unknown.name]]
    own = tuple(k for k, u in enumerate(unknowns) if u.name not in old)
    return _Walk(place, at, secants, own)


def _stepped(walk: _Walk, sigma: Array) -> _Walk:
    """One step on, where that leads down."""
    place, at = walk.place, walk.at
    walk.secants[:, walk.own] = place.jacobian(at.values, at.errors, sigma, WIDTH, walk.own)
    step = gauss_newton_step(walk.secants, at.errors.white(sigma), place.unknowns, at.values)
    end = place.along(at.values, step, sigma)
    return walk._replace(at=min(at, end, key=lambda point: point.cost))
