"""The hybrid: a structured model, and regularised Volterra kernels on what it leaves over.

The structure carries over between amplitudes, the kernels mend it where the training was.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from servo_bench.estimators.data import Array, Estimator, Parameter, Predictor, Training
from servo_bench.estimators.greybox import GreyBox
from servo_bench.estimators.polynomial_prior import PolynomialPrior


@dataclass(frozen=True, slots=True)
class Hybrid:
    """Two estimators, the second for the residual of the first."""

    structured: Estimator = field(default_factory=GreyBox)
    residual: Estimator = field(default_factory=PolynomialPrior)

    def fit(self, training: Training) -> "HybridFit":
        """FitError where either cannot be fitted."""
        structured = self.structured.fit(training)
        explained = structured.predict(training.inputs, training.history)
        left = training.with_response(training.response - explained)
        return HybridFit(structured, self.residual.fit(left))


@dataclass(frozen=True, slots=True, eq=False)
class HybridFit:
    """Both predictors; they add."""

    structured: Predictor
    residual: Predictor

    @property
    def parameters(self) -> Mapping[str, Parameter]:
        """The structured model's, and the residual's as `residual_...`."""
        residual = {f"residual_{name}": value for name, value in self.residual.parameters.items()}
        return {**self.structured.parameters, **residual}

    def predict(self, inputs: Array, history: Array | None = None) -> Array:
        """The sum of both."""
        return self.structured.predict(inputs, history) + self.residual.predict(inputs, history)

    def standard_deviation(self, inputs: Array, history: Array | None = None) -> Array:
        """Both taken as independent."""
        parts = (self.structured, self.residual)
        return np.asarray(np.hypot(*(p.standard_deviation(inputs, history) for p in parts)))
