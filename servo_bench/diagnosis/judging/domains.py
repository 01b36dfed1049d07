"""In which domain a signature shows: velocity, position, time after an edge, or slow drift.

For each, the share of the residual's variance that its mean there explains. Position is asked
three times: as it is (cogging, encoders), times the direction of turning (friction, gaps), and
times the current (torque ripple).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from servo_bench.diagnosis.judging.signature import PERIOD_S, Signature

Array = NDArray[np.float64]

VELOCITY_BINS = 40
AFTER_EDGE_SAMPLES = 32
ORDERS: NDArray[np.int64] = np.array([*range(1, 141), 256, 512, 1024, 2048, 4096])
"""Periods in a revolution that are looked for: what motors have, and lines of encoders."""
DOMAINS = (
    "velocity",
    "position",
    "position x direction",
    "position x current",
    "after an edge",
    "drift",
)


class Binned(NamedTuple):
    """Mean and scatter of a residual at a velocity; arrays of shape (bins,)."""

    velocity_rad_s: Array
    mean: Array
    scatter: Array


class Lines(NamedTuple):
    """Shares of the variance, 0 to 1, in a line of each of ORDERS; shape (channels, orders)."""

    plain: Array
    by_direction: Array
    by_current: Array


class AfterEdge(NamedTuple):
    """What changed since an edge of the command, in the edge's direction; shape (samples,)."""

    time_s: Array
    load_rad: Array
    velocity_rad_s: Array
    current_a: Array


class Domains(NamedTuple):
    """A signature in all domains; `shares` by domain, then in the order of CHANNELS."""

    velocity: Binned
    lines: Lines
    after_edge: AfterEdge
    shares: dict[str, tuple[float, float, float]]


def domains(signature: Signature) -> Domains:
    """Everything at once. The binned residual is the current's, or the load's where it has none."""
    plain = signature.plain
    load_lines = _lines(plain.true_load_angle_rad, signature, signature.channels[:2])
    current_lines = _lines(plain.motor_angle_rad, signature, signature.channels[2:])
    lines = Lines(*(np.vstack(pair) for pair in zip(load_lines, current_lines, strict=True)))
    by_channel = np.array(
        [
            [_velocity_share(signature, residual) for residual in signature.channels],
            *(shares.max(axis=1) for shares in lines),
            [_edge_share(signature, residual) for residual in signature.channels],
            [_drift_share(residual) for residual in signature.channels],
        ]
    )
    has_current = bool(np.any(signature.current_a))
    return Domains(
        by_velocity(signature, signature.current_a if has_current else signature.load_rad),
        lines,
        after_edges(signature),
        {
            name: (float(a), float(b), float(c))
            for name, (a, b, c) in zip(DOMAINS, by_channel, strict=True)
        },
    )


def by_velocity(signature: Signature, residual: Array) -> Binned:
    """The residual in bins of the motor's velocity that hold as many samples each."""
    velocity = signature.plain.motor_velocity_rad_s
    rows = _bins(signature)
    return Binned(
        np.array([velocity[row].mean() for row in rows]),
        np.array([residual[row].mean() for row in rows]),
        np.array([residual[row].std() for row in rows]),
    )


def _bins(signature: Signature) -> list[NDArray[np.intp]]:
    return np.array_split(np.argsort(signature.plain.motor_velocity_rad_s), VELOCITY_BINS)


def _lines(angle_rad: Array, signature: Signature, residuals: Sequence[Array]) -> Lines:
    centred = np.stack([residual - residual.mean() for residual in residuals])
    weights = (
        np.ones(angle_rad.size),
        np.sign(signature.plain.motor_velocity_rad_s),
        signature.plain.motor_current_a,
    )
    shares = np.zeros((len(weights), len(residuals), ORDERS.size))
    for k, order in enumerate(ORDERS.tolist()):
        wave = np.exp(1j * order * angle_rad)
        for w, weight in enumerate(weights):
            shares[w, :, k] = _fitted_share(np.stack((wave.real, wave.imag)) * weight, centred)
    return Lines(*shares)


def _fitted_share(terms: Array, centred: Array) -> Array:
    """Of the variance of each row, what a sum of the terms explains; zero for an empty row."""
    terms = terms - terms.mean(axis=1, keepdims=True)
    seen = terms @ centred.T
    explained = (seen * np.linalg.lstsq(terms @ terms.T, seen, rcond=None)[0]).sum(axis=0)
    total = (centred**2).sum(axis=1)
    share: Array = np.divide(explained, total, out=np.zeros_like(total), where=total > 0.0)
    return share


def after_edges(signature: Signature) -> AfterEdge:
    """Averages over all edges that have the whole time before the next one."""
    edges, jumps = _edges(signature, AFTER_EDGE_SAMPLES)
    rows = edges[:, None] + np.arange(AFTER_EDGE_SAMPLES)
    side = np.sign(jumps)[:, None]

    def average(residual: Array) -> Array:
        mean: Array = (side * (residual[rows] - residual[edges][:, None])).mean(axis=0)
        return mean

    time_s: Array = np.arange(AFTER_EDGE_SAMPLES, dtype=np.float64) * PERIOD_S
    return AfterEdge(
        time_s,
        *(average(signature.load_rad), average(signature.velocity_rad_s)),
        average(signature.current_a),
    )


def _edges(signature: Signature, free: int) -> tuple[NDArray[np.intp], Array]:
    """The samples at which the command changes and then holds for `free` samples, and by what."""
    jumps = np.diff(signature.commands_rad_s)
    edges = np.flatnonzero(jumps) + 1
    ends = np.append(edges[1:], signature.commands_rad_s.size)
    kept = edges[ends - edges >= free]
    return kept, jumps[kept - 1]


def _explained(residual: Array, foretold: Array) -> float:
    variance = float(residual.var())
    return max(0.0, 1.0 - float((residual - foretold).var()) / variance) if variance > 0.0 else 0.0


def _velocity_share(signature: Signature, residual: Array) -> float:
    foretold = np.empty_like(residual)
    for row in _bins(signature):
        foretold[row] = residual[row].mean()
    return _explained(residual, foretold)


def _edge_share(signature: Signature, residual: Array) -> float:
    """By the time since the last edge, in proportion to its jump and to the jump's sign."""
    edges, jumps = _edges(signature, 1)
    sample = np.arange(residual.size)
    last = np.searchsorted(edges, sample, side="right") - 1
    since = np.where(last >= 0, sample - edges[last], -1)
    foretold = np.full(residual.size, residual.mean())
    for k in range(AFTER_EDGE_SAMPLES):
        rows = np.flatnonzero(since == k)
        jump = jumps[last[rows]]
        terms = np.stack((np.ones(rows.size), jump, np.sign(jump)), axis=1)
        foretold[rows] = terms @ np.linalg.lstsq(terms, residual[rows], rcond=None)[0]
    return _explained(residual, foretold)


def _drift_share(residual: Array) -> float:
    time = np.linspace(-1.0, 1.0, residual.size)
    return _explained(residual, float(time @ residual / (time @ time)) * time)
