"""What a simulation may miss and still be right: beyond it something is wrong, named or not.

`ALLOWED` are shares of every signal's rms, about 1.5 times the worst but one of 40 nulls of an
independent plant with its own friction, contact and digital loop (seeds 1300-1339 of tests/truth).
"""

from collections.abc import Mapping, Sequence

import numpy as np

from servo_bench.diagnosis.comparing.comparison import Comparison
from servo_bench.diagnosis.comparing.lateness import lateness_rms
from servo_bench.diagnosis.comparing.rows import Array

FLOORS, LATE = 2.5, 3.0
"""A signal within so many sensor floors is right, whatever its share; and within so many times what
commands do that act late by chance."""
ALLOWED: Mapping[str, Sequence[float]] = {
    "twist": (0.10, 0.13, 0.20, 0.25),
    "motor": (0.006, 0.0036, 0.0012, 0.0009),
    "load": (0.04, 0.025, 0.007, 0.0025),
    "twist angle": (0.08,),
    "load angle": (1.0,),
    "motor angle": (1.0,),
    "effort": (0.017,),
}
"""Robust deviation over the signal's own rms, from the quickest scale to the slowest."""
BETWEEN_FACES, FACES_PERCENT = "twist angle", (2.0, 98.0)
"""An angle between two encoders, whose zeros are anywhere: it is told from between its faces."""
SCALES = (1, 6, 36, 216)
"""Points over whose means angles are compared."""
ROW_S = 0.008
"""Of the recordings on which the shares were found."""


def allowed(comparison: Comparison) -> Array:
    """For every signal, in its unit, shape (signals,)."""
    found = []
    late, point_s = lateness_rms(comparison), min(_point_s(comparison), ROW_S)
    for signal, row, chance in zip(comparison.signals, comparison.measured, late, strict=True):
        kind = _kind(signal.name, signal.increments)
        share = _share(kind, signal.stride * point_s)
        known = row[np.isfinite(row) & comparison.seen]
        if kind == BETWEEN_FACES and known.size:
            known = known - 0.5 * np.sum(np.percentile(known, FACES_PERCENT))
        rms = float(np.sqrt(np.mean(known**2))) if known.size else 0.0
        found.append(np.linalg.norm([FLOORS * signal.floor, share * rms, LATE * chance]))
    return np.array(found)


def _point_s(comparison: Comparison) -> float:
    """From a point that is compared to the next; a piece that is too short for one has none."""
    rows = np.concatenate([piece.end - piece.start for piece in comparison.pieces])
    return float(rows[0]) * comparison.source.rows.period_s


def _share(kind: str, scale_s: float) -> float:
    """At increments over such a time, between those that were found; slower rows than theirs count
    as theirs."""
    times, shares = np.log(ROW_S * np.array(SCALES)), np.log(ALLOWED[kind])
    return float(np.exp(np.interp(np.log(scale_s), times[: shares.size], shares)))


def _kind(name: str, increments: bool) -> str:
    if not increments:
        return name if name in ALLOWED else "effort"
    return next((k for k in ("twist", "motor", "load") if name.startswith(k)), "load")
