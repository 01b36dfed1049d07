"""The response that kernels predict from commands alone.

    y(t) = c0 + sum_i c1(i) u(t-i) + sum_{i<j} c2(i,j) u(t-i) u(t-j) + sum_{i<j<k} c3 u u u

with u = command / amplitude. Off +-1 (a standing axis has u = 0) the diagonals that binary input
cannot identify are missing, so the prediction is exact in form for +-1 only. Kernels of more levels
bring diagonals (i <= j <= k).
"""

import numpy as np
from numpy.typing import NDArray

from servo_bench.errors import FitError
from servo_bench.kernels.volterra import Kernels

Array = NDArray[np.float64]

BLOCK = 2048
"""Samples that are predicted at a time: their products of chips stay in the processor's cache."""


def predict(
    kernels: Kernels,
    inputs: NDArray[np.floating] | NDArray[np.integer],
    order: int = 3,
    *,
    history: NDArray[np.floating] | NDArray[np.integer] | None = None,
) -> Array:
    """The response to `inputs` (u, shape (n,)) with the kernels up to `order`; shape (n,).

    `history` is what was played before, newest last; what is not given, or is older than it
    reaches, was zero. FitError where kernels of that order were not measured.
    """
    if not 1 <= order <= kernels.order:
        raise FitError(
            f"a prediction of order {order} was asked for, but the kernels were measured up to "
            f"order {kernels.order}. Ask for at most that, or extract more orders."
        )
    past = np.zeros(kernels.memory)
    if history is not None and history.size:
        known = history[-past.size :]
        past[-known.size :] = known
    played = np.concatenate([past, np.asarray(inputs, np.float64)])
    lagged = np.lib.stride_tricks.sliding_window_view(played, kernels.memory)[1:, ::-1]
    starts = range(0, lagged.shape[0], BLOCK)
    blocks = [_polynomial(kernels, lagged[start : start + BLOCK], order) for start in starts]
    return np.concatenate([np.zeros(0), *blocks])


def _polynomial(kernels: Kernels, lagged: Array, order: int) -> Array:
    """The multilinear polynomial at each row of `lagged`, shape (n, M) -> (n,).

    Order 3 by its largest lag k: sum_k x_k [sum_j x_j (sum_i c3(i,j,k) x_i)], one matrix product
    for each k, of the columns below k alone.
    """
    x = np.ascontiguousarray(lagged)
    y: Array = kernels.constant + x @ kernels.c1
    if order >= 2:
        y += np.einsum("ti,ti->t", x @ kernels.c2, x)
    if order >= 3:
        diagonals = int(kernels.levels > 2)
        for k in range(2 * (1 - diagonals), kernels.memory):
            n = k + diagonals
            below = x[:, :n]
            y += x[:, k] * np.einsum("ti,ti->t", below @ kernels.c3[:n, :n, k], below)
    return y


def vaf_percent(measured: Array, predicted: Array) -> float:
    """Variance accounted for: 100 (1 - var(y - p) / var(y)). NaN where y does not vary."""
    variance = float(np.var(measured))
    if variance == 0.0:
        return float("nan")
    return 100.0 * (1.0 - float(np.var(measured - predicted)) / variance)
