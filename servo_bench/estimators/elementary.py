"""Sums of products of different lags, the multilinear terms of every order at once.

    e_m(z) = sum over all sets of m lags of prod z_i        (elementary symmetric polynomial)

With z_i = lambda_i u_i u'_i it is the covariance that elements of order m with independent
coefficients of variance prod lambda_i give to two inputs. By recursion over the lags it costs
m operations for each lag instead of one for each of the C(M, m) elements.

These loops run once for every step of a fit over thousands of samples, or for every pair of them
in a prediction, and have no form in array operations that does not pass m M arrays through memory;
hence numba (30 times faster).
"""

import numba
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

TILE = 256


@numba.njit(cache=True)
def elementary_sums(lags: Array, weights: Array, orders: NDArray[np.int64]) -> Array:
    """sum_a e_(orders[a])(weights[a] lags[t]) for every t; (n, M), (orders, M) -> (n,)."""
    result = np.zeros(lags.shape[0])
    e = np.empty(orders.max() + 1)
    for t in range(lags.shape[0]):
        for a in range(orders.size):
            _recursion(e, lags[t], weights[a], orders[a])
            result[t] += e[orders[a]]
    return result


@numba.njit(cache=True)
def elementary_gradient(
    lags: Array, weights: Array, orders: NDArray[np.int64], outer: Array
) -> Array:
    """d/d log weights of sum_t outer[t] elementary_sums[t]; shape (orders, M).

    d e_m / d z_i = e_(m-1) without lag i, and e_j without i = e_j - z_i e_(j-1) without i.
    """
    gradient = np.zeros(weights.shape)
    e = np.empty(orders.max() + 1)
    for t in range(lags.shape[0]):
        for a in range(orders.size):
            _recursion(e, lags[t], weights[a], orders[a])
            for i in range(lags.shape[1]):
                z = weights[a, i] * lags[t, i]
                without = 1.0
                for j in range(1, orders[a]):
                    without = e[j] - z * without
                gradient[a, i] += outer[t] * z * without
    return gradient


@numba.njit(cache=True)
def _recursion(e: Array, lags: Array, weights: Array, order: int) -> None:
    e[: order + 1] = 0.0
    e[0] = 1.0
    for i in range(lags.size):
        z = weights[i] * lags[i]
        for j in range(order, 0, -1):
            e[j] += z * e[j - 1]


def elementary_products(
    left: Array, right: Array, weights: Array, orders: NDArray[np.int64]
) -> Array:
    """sum_a e_(orders[a])(weights[a] left[t] right[s]) for all t and s; shape (n, k)."""
    return np.asarray(_products(left, np.ascontiguousarray(right.T), weights, orders))


@numba.njit(cache=True)
def _products(left: Array, right: Array, weights: Array, orders: NDArray[np.int64]) -> Array:
    """The recursion for TILE columns at a time, whose sums stay in the first-level cache."""
    total = np.zeros((left.shape[0], right.shape[1]))
    e = np.empty((orders.max() + 1, TILE))
    for begin in range(0, right.shape[1], TILE):
        width = min(TILE, right.shape[1] - begin)
        for t in range(left.shape[0]):
            for a in range(orders.size):
                e[1 : orders[a] + 1] = 0.0
                e[0] = 1.0
                for i in range(left.shape[1]):
                    z = weights[a, i] * left[t, i] * right[i, begin : begin + width]
                    for j in range(min(orders[a], i + 1), 0, -1):
                        high, low = e[j], e[j - 1]
                        for s in range(width):
                            high[s] += z[s] * low[s]
                for s in range(width):
                    total[t, begin + s] += e[orders[a], s]
    return total
