"""Prediction of input that no fit saw, estimator by estimator: the only figures that judge.

Agreement on the identification period is kept as a column of its own and marked as what it is:
with as many elements as samples it nears 100 % for any kernels.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from servo_bench.estimators.data import Array, Predictor, Training
from servo_bench.excitation.msequence import checked_polynomial, m_sequence, reciprocal
from servo_bench.kernels.predict import vaf_percent

Plant = Callable[[Array], Array]
"""Inputs from rest to noise-free outputs, (n,) -> (n,)."""

SAME = "same period"
SETTLING = 200
SAMPLES = 2000
SINE_RAD_PER_SAMPLE = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class UnseenInput:
    """A name for people, and the inputs, shape (n,); the first SETTLING are not judged."""

    name: str
    inputs: Array


@dataclass(frozen=True, slots=True, eq=False)
class PredictionMatrix:
    """VAF in percent, shape (estimators, inputs); `seen` columns (True) judge nothing."""

    estimators: tuple[str, ...]
    inputs: tuple[str, ...]
    seen: tuple[bool, ...]
    vaf_percent: Array

    def numbers(self) -> dict[str, Any]:
        """Estimator -> input -> VAF, ready for JSON; None where it is not finite."""
        return {
            name: {
                column: round(float(value), 4) if np.isfinite(value) else None
                for column, value in zip(self.inputs, row, strict=True)
            }
            for name, row in zip(self.estimators, self.vaf_percent, strict=True)
        }


def unseen_inputs(
    seed: int, amplitude: float = 1.0, polynomial: str | None = None, samples: int = SAMPLES
) -> tuple[UnseenInput, ...]:
    """Random binary at A, A/2 and 2A, uniform over +-A and +-2A, sines of A and 2A.

    Each has `samples` inputs after SETTLING. With `polynomial` (of the identification) also the
    M-sequence of its reciprocal: a whole period, or as much of it as other `samples` ask for.
    """
    rng = np.random.default_rng(seed)
    count = samples + SETTLING
    signs = np.array([-1.0, 1.0])
    sine = np.sin(SINE_RAD_PER_SAMPLE * np.arange(count) + rng.uniform(0.0, 2.0 * np.pi))
    shapes = [
        ("binary", rng.choice(signs, count)),
        ("binary half", 0.5 * rng.choice(signs, count)),
        ("binary double", 2.0 * rng.choice(signs, count)),
        ("uniform", rng.uniform(-1.0, 1.0, count)),
        ("uniform double", rng.uniform(-2.0, 2.0, count)),
        ("sine", sine),
        ("sine double", 2.0 * sine),
    ]
    if polynomial is not None:
        chips = _other_sequence(polynomial)
        length = chips.size if samples == SAMPLES else min(chips.size, samples)
        shapes.insert(0, ("other m-sequence", np.resize(chips, length + SETTLING)))
    return tuple(UnseenInput(name, amplitude * inputs) for name, inputs in shapes)


def _other_sequence(polynomial: str) -> Array:
    """The reciprocal's: primitive where f is, and the same chips read backwards."""
    return m_sequence(f"{reciprocal(checked_polynomial(polynomial)):o}").astype(np.float64)


def prediction_matrix(
    predictors: Mapping[str, Predictor],
    plant: Plant,
    inputs: tuple[UnseenInput, ...],
    training: Training | None = None,
) -> PredictionMatrix:
    """Every predictor on every input, against the plant's noise-free output.

    With `training` the first column is the agreement on what the fit saw.
    """
    outputs = [plant(item.inputs)[SETTLING:] for item in inputs]
    rows = []
    for predictor in predictors.values():
        row = [
            vaf_percent(output, predictor.predict(item.inputs)[SETTLING:])
            for item, output in zip(inputs, outputs, strict=True)
        ]
        if training is not None:
            same = predictor.predict(training.inputs, training.history)
            row.insert(0, vaf_percent(training.response, same))
        rows.append(row)
    seen = (training is not None,) if training is not None else ()
    return PredictionMatrix(
        estimators=tuple(predictors),
        inputs=(*((SAME,) if seen else ()), *(item.name for item in inputs)),
        seen=(*seen, *(False for _ in inputs)),
        vaf_percent=np.array(rows),
    )
