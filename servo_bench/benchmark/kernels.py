"""How long the kernels' numerics take beside plain numpy in the same run, and how good they are."""

from collections.abc import Callable
from math import comb
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from servo_bench.excitation.msequence import m_sequence
from servo_bench.kernels.correlate import cross_correlation
from servo_bench.kernels.paper_simulation import simulate_paper
from servo_bench.kernels.predict import predict
from servo_bench.kernels.shifts import ORDERS
from servo_bench.kernels.volterra import Kernels, extract

Array = NDArray[np.float64]

POLYNOMIAL = "40473"
MEMORY = 21
LONG_POLYNOMIAL = "215657"
LONG_MEMORY = 32
REPEATS = 7


def measure(seed: int) -> dict[str, Any]:
    """Medians of seven runs in seconds, and the VAF of the paper's simulation in percent.

    The reference is one BLAS product over all triples of lags and one einsum. `seed` draws
    responses and inputs.
    """
    rng = np.random.default_rng(seed)
    response = rng.normal(size=m_sequence(POLYNOMIAL).size)
    inputs = rng.choice(np.array([-1.0, 1.0]), response.size)
    kernels = extract(response, POLYNOMIAL, 1.0, MEMORY)
    long = extract(
        rng.normal(size=m_sequence(LONG_POLYNOMIAL).size), LONG_POLYNOMIAL, 1.0, LONG_MEMORY
    )
    return {
        "samples": response.size,
        "transform_s": _median_s(lambda: cross_correlation(response, POLYNOMIAL)),
        "extraction_s": _median_s(lambda: extract(response, POLYNOMIAL, 1.0, MEMORY)),
        "elements": sum(comb(MEMORY, order) for order in ORDERS),
        f"prediction_memory_{MEMORY}": _against_reference(kernels, inputs),
        f"prediction_memory_{LONG_MEMORY}": _against_reference(long, inputs),
        "paper": simulate_paper().numbers(),
        "seed": seed,
    }


def _against_reference(kernels: Kernels, inputs: Array) -> dict[str, float]:
    ours_s = _median_s(lambda: predict(kernels, inputs))
    reference_s = _median_s(lambda: reference_prediction(kernels, inputs), repeats=3)
    difference = predict(kernels, inputs) - reference_prediction(kernels, inputs)
    return {
        "prediction_s": ours_s,
        "reference_s": reference_s,
        "times_faster": reference_s / ours_s,
        "largest_difference": float(np.abs(difference).max()),
    }


def reference_prediction(kernels: Kernels, inputs: Array) -> Array:
    """The order-3 prediction from rest in plain numpy: the sums over all triples of lags."""
    lagged = np.zeros((inputs.size, kernels.memory))
    for lag in range(kernels.memory):
        lagged[lag:, lag] = inputs[: inputs.size - lag]
    pairs = kernels.c2 + np.tensordot(lagged, kernels.c3, axes=1)
    higher = np.einsum("tij,ti,tj->t", pairs, lagged, lagged)
    prediction: Array = kernels.constant + lagged @ kernels.c1 + higher
    return prediction


def _median_s(run: Callable[[], object], repeats: int = REPEATS) -> float:
    run()
    times = []
    for _ in range(repeats):
        began = perf_counter()
        run()
        times.append(perf_counter() - began)
    return float(np.median(times))
