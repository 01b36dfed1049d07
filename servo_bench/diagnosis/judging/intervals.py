"""How sure a fitted number is, and how small a cause could have been found.

Intervals come from the block sandwich, because errors of a wrong model hang together, and from what
the laws themselves may miss (`quantities`).
"""

from collections.abc import Iterator, Sequence

import numpy as np

from servo_bench.diagnosis.comparing.rows import Array
from servo_bench.diagnosis.fitting.free import unit_of
from servo_bench.diagnosis.judging.verdict import Cause, Limit, Quantity
from servo_bench.diagnosis.searching.finding import Finding
from servo_bench.diagnosis.searching.gate import WARMS
from servo_bench.diagnosis.searching.scales import Scales
from servo_bench.diagnosis.searching.seeking import Found
from servo_bench.diagnosis.searching.sizes import material_sizes
from servo_bench.diagnosis.searching.unknowns import Unknown
from sim_rig.effects import find_effect

SPREAD, OWN_SHARE, KIND_SHARE = 2.0, 0.02, 0.35
"""Set on 43 named causes of development seeds of tests/truth, of which 95 % were covered; a quarter
of the kind's size covered 89 % of some 180 in later campaigns, and missed a damping by 10 %."""
WARMING_SHARE = 0.5
"""Of what warms a recording tells the slope, size over time constant, and no more if it is short.
Bearings and magnets take 300 to 1800 s: a logarithm that scatters by a half about 600 s."""
DETECTION = np.sqrt(20.9)
"""Standard deviations of a size that is seen nine times in ten at a false alarm of 1e-3 (df 1)."""


def quantities(found: Found, scales: Scales) -> dict[str, Quantity]:
    """Every fitted number with its interval, by its name.

    The sandwich tells what noise and this record leave open, as if the laws were exact. They are
    not: a standard error is `SPREAD` sandwiches, a share of the number's own size, and a share of
    what every rig has of its kind beside its drawing (`material_sizes`), in quadrature.
    """
    kinds = material_sizes(scales)
    numbers = {}
    for unknown, value, deviation in zip(
        found.unknowns, found.values, standard_errors(found), strict=True
    ):
        widest = 1e6 * max(abs(float(value)), unknown.step)
        reached = min(float(deviation), widest) if np.isfinite(deviation) else widest
        strength = find_effect(unknown.effect).strengths[0]
        kind = kinds.get(unknown.effect, 0.0) if unknown.field == strength else 0.0
        own = 1.0 if unknown.circular else float(value)
        slow = unknown.effect in WARMS and unknown.field == strength
        share = WARMING_SHARE if slow else OWN_SHARE
        error = float(np.linalg.norm([SPREAD * reached, share * own, KIND_SHARE * kind]))
        least, most = _meaningful(unknown)
        numbers[unknown.name] = Quantity(
            value=float(value),
            unit=unit_of(unknown.field),
            ci95=(max(float(value) - 1.96 * error, least), min(float(value) + 1.96 * error, most)),
            standard_error=error,
        )
    return numbers


def _meaningful(unknown: Unknown) -> tuple[float, float]:
    """Between which a number has a meaning: no friction is negative."""
    prior = next(p.prior for p in find_effect(unknown.effect).parameters if p.name == unknown.field)
    return max(prior.least, prior.above), prior.most


def names_of(found: Found) -> list[str]:
    """Of the open numbers, in order."""
    return [u.name for u in found.unknowns]


def standard_errors(found: Found) -> Array:
    """Block sandwich, shape (numbers,); see `uncertainty`."""
    white = found.errors.white(found.sigma)
    beyond = 1.0 + (white / 2.0) ** 2
    rows = found.jacobian
    curvature = rows.T @ (rows * (beyond**-1.5)[:, None])
    precision = _believed(found)
    group = np.tile(found.errors.group, found.errors.rows.shape[0])
    blocks = int(group.max(initial=0)) + 1
    scores = rows * (white / np.sqrt(beyond))[:, None]
    sums = np.stack([np.bincount(group, column, blocks) for column in scores.T], axis=1)
    meat = sums.T @ sums * (blocks / max(blocks - len(found.unknowns), 1))
    inverse = _inverse(curvature + precision)
    return np.sqrt(np.maximum(np.diag(inverse @ (meat + precision) @ inverse), 0.0))


def _inverse(matrix: Array) -> Array:
    size = np.sqrt(np.maximum(np.diag(matrix), 0.0))
    size = np.where(size > 0.0, size, 1.0)  # what changes nothing has no curvature
    scaled = matrix / np.outer(size, size)
    values, vectors = np.linalg.eigh(scaled)
    wide = np.maximum(values, 1e-10 * max(float(values[-1]), 1e-10))
    return np.asarray((vectors / wide) @ vectors.T / np.outer(size, size))


def cramer_rao(found: Found) -> Array:
    """Least standard deviations at the errors that are left, were they independent, of an estimate
    that believes the same of every rig; (numbers,). Source: Van Trees, Detection, Estimation, and
    Modulation Theory I (1968), sec. 2.4."""
    information = found.jacobian.T @ found.jacobian + _believed(found)
    return np.sqrt(np.maximum(np.diag(_inverse(information)), 0.0))


def _believed(found: Found) -> Array:
    """Information of what is believed of every rig, before any data; none of a cause."""
    return np.diag([u.deviation**-2.0 for u in found.unknowns])


def limits_of(finding: Finding, causes: Sequence[Cause]) -> Iterator[Limit]:
    """For each fitted cause the smallest size that is found nine times in ten and worth a name on
    this rig, and the bound beside what the sandwich of the data alone reaches."""
    names = names_of(finding.final)
    worth = material_sizes(finding.scales)
    bound, reached = cramer_rao(finding.final), standard_errors(finding.final)
    for cause in causes:
        strength = find_effect(cause.effect).strengths[0]
        name = f"{cause.effect}.{strength}"
        if name not in names:
            continue
        k = names.index(name)
        yield Limit(
            effect=cause.effect,
            parameter=strength,
            unit=unit_of(strength),
            detectable=max(float(DETECTION * reached[k]), worth.get(cause.effect, 0.0)),
            cramer_rao=float(bound[k]),
            ratio=float(reached[k] / bound[k]) if bound[k] > 0.0 else None,
        )
