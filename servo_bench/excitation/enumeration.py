"""Every primitive polynomial of a degree, and how much kernel memory each can resolve.

Enumeration: decimating one M-sequence by every d coprime to 2^n - 1 gives all of them, one for each
coset {d 2^i}; Berlekamp and Massey's algorithm reads the polynomial off 2 n bits.

Collisions: elements of up to `order` lags within memory M share no shift exactly where f has no
multiple of weight <= 2 order and degree < M. Found by stamping the words x^i mod f of every sum of
up to `order` lags, one lag at a time, until a word is met again (Koopman's Hamming-distance length
plus n; the same for f and its reciprocal). On inverse-repeat input only the odd orders can meet.

Alias score: the share of order 5 and 7 that falls on the shifts of the elements measured, each
element weighted with prod exp(-lag / decay): the distance rule does not see those orders.

These are loops over bits and tables (up to 27 594 polynomials, 10^5 words each), hence numba.
"""

from functools import cache

import numba
import numpy as np
from numpy.typing import NDArray

from servo_bench.errors import ConfigError
from servo_bench.excitation.msequence import is_primitive, prime_factors

Words = NDArray[np.int64]

SEARCHED_DEGREES = range(5, 21)
LONGEST_MEMORY = 1024
ALIAS_LAGS_ORDER_5 = 24
ALIAS_LAGS_ORDER_7 = 15
"""Lags beyond weigh too little to be worth their millions of elements."""


@cache
def primitive_polynomials(degree: int) -> Words:
    """All of them, ascending, shape (phi(2^n - 1) / n,). ConfigError outside degrees 5 to 20."""
    if degree not in SEARCHED_DEGREES:
        raise ConfigError(
            f"polynomials of degree {degree} cannot be searched: degrees {SEARCHED_DEGREES[0]} to "
            f"{SEARCHED_DEGREES[-1]} are (2^n - 1 chips)."
        )
    first = next(f for f in range(2**degree + 1, 2 ** (degree + 1), 2) if is_primitive(f))
    primes = np.array(prime_factors(2**degree - 1), np.int64)
    found = np.sort(_decimated(first, degree, primes))
    found.setflags(write=False)
    return np.asarray(found)


def collision_free_memories(
    polynomials: Words, degree: int, order: int, *, inverse_repeat: bool = False
) -> NDArray[np.int64]:
    """M_max of each polynomial, shape (polynomials,), for orders up to 2 or 3."""
    return np.asarray(_memories(polynomials, degree, order, inverse_repeat))


def alias_scores(
    polynomials: Words, degree: int, memory: int, *, order: int = 3, inverse_repeat: bool = False
) -> NDArray[np.float64]:
    """Percent of the weighted orders 5 and 7 that alias into elements up to `order`, each.

    The decay is a sixth of the memory: at its end an element weighs e^-6 per lag.
    """
    return np.asarray(_scores(polynomials, degree, memory, order, inverse_repeat))


@numba.njit(cache=True)
def _decimated(first: int, degree: int, primes: Words) -> Words:
    chips = (1 << degree) - 1
    bits = np.empty(chips, np.uint8)
    register = 1
    for t in range(chips):
        bits[t] = register & 1
        parity = register & first & chips
        parity ^= parity >> 16
        parity ^= parity >> 8
        parity ^= parity >> 4
        parity ^= parity >> 2
        parity ^= parity >> 1
        register = (register >> 1) | ((parity & 1) << (degree - 1))
    found = np.empty(chips // degree + 1, np.int64)
    count = 0
    window = np.empty(2 * degree, np.uint8)
    for d in range(1, chips, 2):
        coprime = True
        for prime in primes:
            coprime = coprime and d % prime != 0
        rotated = d
        for _ in range(degree - 1):
            rotated = ((rotated << 1) & chips) | (rotated >> (degree - 1))
            if rotated < d:
                coprime = False
                break
        if coprime:
            place = 0
            for t in range(2 * degree):
                window[t] = bits[place]
                place = (place + d) % chips
            found[count] = _shortest_register(window, degree)
            count += 1
    return found[:count].copy()


@numba.njit(cache=True)
def _shortest_register(bits: NDArray[np.uint8], degree: int) -> int:
    """Berlekamp and Massey over GF(2); the connection polynomial reversed, highest bit first."""
    connection, before, length, gap = 1, 1, 0, 1
    for t in range(bits.size):
        discrepancy = 0
        for i in range(length + 1):
            discrepancy ^= ((connection >> i) & 1) & bits[t - i]
        if discrepancy == 0:
            gap += 1
        elif 2 * length <= t:
            connection, before = connection ^ (before << gap), connection
            length, gap = t + 1 - length, 1
        else:
            connection ^= before << gap
            gap += 1
    characteristic = 0
    for i in range(degree + 1):
        characteristic |= ((connection >> i) & 1) << (degree - i)
    return characteristic


@numba.njit(cache=True)
def _powers(polynomial: int, degree: int, count: int) -> Words:
    words = np.empty(count, np.int64)
    word = 1
    for i in range(count):
        words[i] = word
        word <<= 1
        if word >> degree:
            word ^= polynomial
    return words


@numba.njit(cache=True)
def _memories(
    polynomials: Words, degree: int, order: int, inverse_repeat: bool
) -> NDArray[np.int64]:
    stamp = np.full(1 << degree, -1, np.int32)
    memories = np.empty(polynomials.size, np.int64)
    for index in range(polynomials.size):
        words = _powers(polynomials[index], degree, min((1 << degree) - 1, LONGEST_MEMORY))
        memories[index] = _memory(words, order, inverse_repeat, stamp, index)
    return memories


@numba.njit(cache=True)
def _memory(words: Words, order: int, odd: bool, stamp: NDArray[np.int32], mark: int) -> int:
    """Adds lag after lag until a sum of up to `order` words has been seen, or one is 0: a product
    of chips that never changes lies on no shift, whatever else does."""
    stamp[0] = mark
    for memory in range(words.size):
        w = words[memory]
        if stamp[w] == mark:
            return memory
        stamp[w] = mark
        for j in range(memory if order >= 2 else 0):
            pair = w ^ words[j]
            if not odd:
                if stamp[pair] == mark:
                    return memory
                stamp[pair] = mark
            for i in range(j if order >= 3 else 0):
                triple = pair ^ words[i]
                if stamp[triple] == mark:
                    return memory
                stamp[triple] = mark
    return words.size


@numba.njit(cache=True)
def _scores(
    polynomials: Words, degree: int, memory: int, order: int, odd: bool
) -> NDArray[np.float64]:
    stamp = np.full(1 << degree, -1, np.int32)
    scores = np.empty(polynomials.size)
    weights = np.exp(-np.arange(memory) * 6.0 / memory)
    for index in range(polynomials.size):
        words = _powers(polynomials[index], degree, memory)
        for k in range(memory):
            stamp[words[k]] = index
            for j in range(k):
                if order >= 2 and not odd:
                    stamp[words[k] ^ words[j]] = index
                for i in range(j if order >= 3 else 0):
                    stamp[words[k] ^ words[j] ^ words[i]] = index
        hit, total = _aliased(words[:ALIAS_LAGS_ORDER_5], weights, stamp, index, 5)
        hit7, total7 = _aliased(words[:ALIAS_LAGS_ORDER_7], weights, stamp, index, 7)
        scores[index] = 100.0 * (hit + hit7) / max(total + total7, 1e-300)
    return scores


@numba.njit(cache=True)
def _aliased(
    words: Words, weights: NDArray[np.float64], stamp: NDArray[np.int32], mark: int, order: int
) -> tuple[float, float]:
    """Weight of the sets of `order` lags whose word is stamped, and of all, in one odometer."""
    hit, total = 0.0, 0.0
    if words.size < order:
        return hit, total
    lag = np.arange(order)
    sums = np.zeros(order + 1, np.int64)
    products = np.ones(order + 1)
    changed = 0
    while True:
        for place in range(changed, order):
            sums[place + 1] = sums[place] ^ words[lag[place]]
            products[place + 1] = products[place] * weights[lag[place]]
        total += products[order]
        if stamp[sums[order]] == mark:
            hit += products[order]
        changed = order - 1
        while changed >= 0 and lag[changed] == words.size - order + changed:
            changed -= 1
        if changed < 0:
            return hit, total
        lag[changed] += 1
        for place in range(changed + 1, order):
            lag[place] = lag[place - 1] + 1
