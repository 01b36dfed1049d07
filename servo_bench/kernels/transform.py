"""The fast M-transform: circular correlation with an M-sequence by a Walsh-Hadamard transform.

Every delay of the sequence is a linear form of the register's bits,

    s(t - k) = <a(k), w(t)> mod 2        a(k) = coefficients of x^-k mod f,   w(t) = register

so with y scattered to Y[w(t)] = y(t), Y[0] = 0 (Cohn and Lempel, 1977),

    N phi(k) = sum_t u(t - k) y(t) = WHT(Y)[a(k)]

Two permutation tables of N words and n 2^n additions, no multiplication, whatever the factors of
N are: FFTs of length N suffer where N is prime (n = 13, 17, 19). The transform goes four stages of
additions at a time over blocks that stay in the cache; numba, for numpy would pass the whole array
through memory for each of the n stages.
"""

from functools import cache

import numba
import numpy as np
from numpy.typing import NDArray

from servo_bench.excitation.msequence import checked_polynomial, degree
from servo_bench.kernels.shifts import registers

Array = NDArray[np.float64]
Table = NDArray[np.int32]

CACHED_LOG2 = 13
"""Blocks of 2^13 doubles, 64 kB, stay in the second-level cache."""


@cache
def permutations(polynomial: str) -> tuple[Table, Table]:
    """w(t) and a(k), each of shape (N,), read-only. ConfigError if not primitive."""
    f = checked_polynomial(polynomial)
    forms = _inverse_powers(f, degree(f))
    forms.setflags(write=False)
    return registers(polynomial), forms


def m_transform(response: Array, polynomial: str) -> Array:
    """N phi of one period, sum_t u(t - k) y(t), shape (N,) -> (N,)."""
    words, forms = permutations(polynomial)
    return np.asarray(_transform(np.ascontiguousarray(response, np.float64), words, forms))


def m_synthesis(coefficients: Array, polynomial: str) -> Array:
    """The transpose: sum_k u(t - k) c(k), shape (N,) -> (N,)."""
    words, forms = permutations(polynomial)
    return np.asarray(_transform(np.ascontiguousarray(coefficients, np.float64), forms, words))


@numba.njit(cache=True)
def _inverse_powers(f: int, n: int) -> Table:
    forms = np.empty((1 << n) - 1, np.int32)
    word = 1
    for k in range(forms.size):
        forms[k] = word
        if word & 1:
            word ^= f
        word >>= 1
    return forms


@numba.njit(cache=True)
def _transform(values: Array, into: Table, out_of: Table) -> Array:
    spread = np.empty(values.size + 1)
    spread[0] = 0.0
    for t in range(values.size):
        spread[into[t]] = values[t]
    _walsh_hadamard(spread)
    result = np.empty(values.size)
    for k in range(values.size):
        result[k] = spread[out_of[k]]
    return result


@numba.njit(cache=True)
def _walsh_hadamard(x: Array) -> None:
    """In place, any power of two from 4 on: block by block, then across the blocks."""
    size = x.size
    block = min(size, 1 << CACHED_LOG2)
    for start in range(0, size, block):
        _stages(x[start : start + block], 1)
    _stages(x, block)


@numba.njit(cache=True)
def _stages(x: Array, half: int) -> None:
    """All stages from butterflies of distance `half` on, two at a time."""
    size = x.size
    while 4 * half <= size:
        for start in range(0, size, 4 * half):
            a, b = x[start : start + half], x[start + half : start + 2 * half]
            c, d = x[start + 2 * half : start + 3 * half], x[start + 3 * half : start + 4 * half]
            for i in range(half):
                s, t = a[i] + b[i], a[i] - b[i]
                u, v = c[i] + d[i], c[i] - d[i]
                a[i], b[i] = s + u, t + v
                c[i], d[i] = s - u, t - v
        half *= 4
    if 2 * half <= size:
        for start in range(0, size, 2 * half):
            a, b = x[start : start + half], x[start + half : start + 2 * half]
            for i in range(half):
                a[i], b[i] = a[i] + b[i], a[i] - b[i]
