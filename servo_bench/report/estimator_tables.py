"""The tables of several estimators: measured data, and inputs that were never played."""

import math
from dataclasses import dataclass

from servo_bench.estimators.study import GREY_BOX, MEASURED, Fit, Study
from servo_bench.kernels.labels import Label
from servo_bench.report.wording import DEG, Row, percent, quantity

WORST_SHOWN = -99.0
"""Below, a prediction is worse than none, and how much says nothing."""


@dataclass(frozen=True, slots=True)
class EstimatorRow:
    """One estimator on measured data; `remark` says why it has no figures, or what it is for."""

    name: str
    remark: str
    same: str
    fresh: str
    deviation: str
    best: bool


@dataclass(frozen=True, slots=True)
class SimulatedTable:
    """VAF against the grey box: column heads, and a name with its cells for each estimator."""

    inputs: tuple[str, ...]
    rows: tuple[tuple[str, tuple[str, ...]], ...]


def estimator_rows(study: Study) -> list[EstimatorRow]:
    """Every estimator, and the grey box of the simulated table where it was not asked for."""
    rows = [_row(fit, fit.refused, best=fit is study.best) for fit in study.fits]
    reference = study.reference
    if reference is not None and reference not in study.fits:
        rows.append(_row(reference, "fitted for the table below, to the first samples", best=False))
    return rows


def simulated_table(study: Study) -> SimulatedTable | None:
    """None where there is no grey box to compare with."""
    matrix = study.simulated
    if matrix is None:
        return None
    rows = [
        (name, tuple(_cell(float(value)) for value in values))
        for name, values in zip(matrix.estimators, matrix.vaf_percent, strict=True)
    ]
    return SimulatedTable(matrix.inputs, tuple(rows))


def trust_sentence(study: Study) -> str:
    """How far to trust the simulated columns."""
    reference = study.reference
    if reference is None or not math.isfinite(reference.vaf_fresh_percent):
        return "How well the grey box fits data that it never saw is not known."
    return (
        f"Trust it as far as the grey box: it predicts the measured validation to "
        f"{percent(reference.vaf_fresh_percent)} VAF."
    )


def label_rows(study: Study) -> list[Row]:
    """How many elements of g1, g2 and g3 carry each label."""
    words = {
        Label.IDENTIFIABLE: "elements that stand alone",
        Label.SUM_ONLY: "elements known as a sum only",
        Label.ALIASED: "elements aliased",
    }
    return [Row(name, str(study.labels.count(label))) for label, name in words.items()]


def judged_words() -> str:
    """What the columns of measured data were taken over."""
    return f"over the first {MEASURED} samples at most"


def _row(fit: Fit, remark: str, *, best: bool) -> EstimatorRow:
    name = "grey box" if fit.name == GREY_BOX else fit.name
    if fit.predictor is None:
        return EstimatorRow(name, f"not fitted: {remark}", "-", "-", "-", best=False)
    return EstimatorRow(
        name,
        remark,
        percent(fit.vaf_same_percent),
        percent(fit.vaf_fresh_percent),
        quantity(fit.deviation_rad_s, DEG, "deg/s", 2),
        best,
    )


def _cell(value: float) -> str:
    if not math.isfinite(value):
        return "fails"
    return f"{value:.1f}" if value > WORST_SHOWN else "< −99"
