"""The gain: what a simulation misses of data that no fit saw, before, after, and without causes.

    before           the nominal model, with the commands that were sent
    after            the extended one, with the commands that were heard
    without_causes   the better of two that have none: every rig's own numbers fitted alone, and the
                     extended model with its causes taken out

What lies between the last two is the causes' doing. The rest of the way is what every rig has
beside its drawing: a little friction and lag, a load that coasts in its gap.
"""

from collections.abc import Collection

import numpy as np

from servo_bench.diagnosis.comparing.comparison import Comparison, compare
from servo_bench.diagnosis.comparing.rounding import floor_of
from servo_bench.diagnosis.comparing.rows import Mask
from servo_bench.diagnosis.judging.verdict import ErrorFigures
from servo_bench.diagnosis.searching.finding import Finding
from sim_rig.errors import SimRigError
from sim_rig.model import Model

LOST = "missed_samples"
"""A cause that is no model's but the commands': without it the drive heard what was sent."""


def error_figures(finding: Finding, model: Model, causes: Collection[str]) -> ErrorFigures | None:
    """rms of the first signal that came on the held-out recording, else on the recording's
    validation; None where none did."""
    judge = finding.held_out or finding.recordings[0]
    whole = finding.held_out is not None
    comparison, sent = (
        compare(one, model, finding.whole.fitted[0].block) for one in (judge, finding.told)
    )
    where = comparison.seen | comparison.held_out if whole else comparison.held_out
    came = np.isfinite(np.where(where, comparison.measured, np.nan)).any(axis=1)
    if not came.any():
        return None
    number = int(np.argmax(came))
    before = _rms(sent, finding.nominal, where, number)
    after = _rms(comparison, model, where, number)
    first, period_s = comparison.signals[number], comparison.source.rows.period_s
    floor = floor_of(first, finding.quantum_rad, period_s)
    explainable = before**2 - floor**2
    share = (before**2 - after**2) / explainable if explainable > 0.0 else 0.0
    return ErrorFigures(
        before=before,
        after=after,
        without_causes=_without(
            finding, sent if LOST in causes else comparison, where, number, causes
        )
        if causes
        else None,
        noise_floor=floor,
        share_explained=float(np.clip(share, 0.0, 1.0)),
        signal=first.name,
        unit=first.unit,
    )


def _without(
    finding: Finding, comparison: Comparison, where: Mask, number: int, causes: Collection[str]
) -> float:
    fitted = _rms(comparison, finding.base.model, where, number)
    try:
        less = finding.final.model.without(*causes)
        return min(fitted, _rms(comparison, less, where, number))
    except SimRigError:  # what is left makes no rig
        return fitted


def _rms(comparison: Comparison, model: Model, where: Mask, number: int) -> float:
    return float(comparison.rms(comparison.errors_of([model])[0], where)[number])
