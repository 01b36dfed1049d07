"""Enumeration, collision-free memory, alias score and choice, against tables and brute force."""

from itertools import combinations

import numpy as np
import pytest

from servo_bench.errors import ConfigError
from servo_bench.excitation.enumeration import (
    alias_scores,
    collision_free_memories,
    primitive_polynomials,
)
from servo_bench.excitation.msequence import is_primitive, prime_factors
from servo_bench.excitation.search import search
from servo_bench.kernels.shifts import collision_free_memory


@pytest.mark.parametrize("degree", [5, 6, 7, 8, 9, 10, 11])
def test_every_primitive_polynomial_is_found_once(degree: int) -> None:
    expected = [f for f in range(2**degree, 2 ** (degree + 1)) if is_primitive(f)]
    assert primitive_polynomials(degree).tolist() == expected


@pytest.mark.parametrize("degree", [12, 14, 16, 18, 19, 20])
def test_there_are_as_many_as_euler_counts(degree: int) -> None:
    group = 2**degree - 1
    coprime = group
    for prime in prime_factors(group):
        coprime = coprime // prime * (prime - 1)
    found = primitive_polynomials(degree)
    assert found.size == coprime // degree
    assert np.all(np.diff(found) > 0)
    assert all(is_primitive(int(f)) for f in found[:: max(found.size // 20, 1)])


@pytest.mark.parametrize(
    ("degree", "order2", "order3", "median3", "inverse_repeat"),
    [
        (10, 26, 14, 11, 15),
        (11, 37, 16, 12, 18),
        (12, 45, 18, 14, 19),
        (13, 63, 22, 16, 24),
        (14, 83, 27, 18, 27),
        (15, 109, 31, 21, 31),
        (16, 135, 34, 24, 35),
        (17, 181, 43, 27, 43),
        (18, 225, 49, 31, 49),
        pytest.param(*(20, 391, 68, 41, 68), marks=pytest.mark.nightly),
    ],
)
def test_the_best_of_a_degree_reach_what_an_independent_search_found(
    degree: int, order2: int, order3: int, median3: int, inverse_repeat: int
) -> None:
    every = primitive_polynomials(degree)
    third = collision_free_memories(every, degree, 3)
    assert collision_free_memories(every, degree, 2).max() == order2
    assert (third.max(), int(np.median(third))) == (order3, median3)
    odd = collision_free_memories(every, degree, 3, inverse_repeat=True)
    assert odd.max() == inverse_repeat
    assert np.all(odd >= third)


@pytest.mark.parametrize(
    ("octal", "order2", "order3"),
    [("15341", 31, 18), ("40473", 44, 21), ("50523", None, 27), ("5210623", None, 68)],
)
def test_known_polynomials(octal: str, order2: int | None, order3: int) -> None:
    f = np.array([int(octal, 8)])
    degree = len(f"{f[0]:b}") - 1
    assert collision_free_memories(f, degree, 3) == [order3]
    assert order2 is None or collision_free_memories(f, degree, 2) == [order2]


def test_both_ways_to_the_memory_agree() -> None:
    """Stamped words of powers of x, and shifts read from the sequence itself."""
    every = primitive_polynomials(9)
    for order in (2, 3):
        expected = [collision_free_memory(f"{f:o}", order) for f in every.tolist()]
        assert collision_free_memories(every, 9, order).tolist() == expected


def test_the_alias_score_is_the_weight_of_the_sets_that_land_on_elements() -> None:
    f, degree, memory = 0o2327, 10, 8
    words, word = [], 1
    for _ in range(memory):
        words.append(word)
        word <<= 1
        word ^= f if word >> degree else 0

    def sums(order: int) -> list[tuple[int, float]]:
        found = []
        for lags in combinations(range(memory), order):
            total = 0
            for lag in lags:
                total ^= words[lag]
            found.append((total, float(np.exp(-6.0 * sum(lags) / memory))))
        return found

    taken = {word for order in (1, 2, 3) for word, _ in sums(order)}
    high = [pair for order in (5, 7) for pair in sums(order)]
    expected = 100.0 * sum(w for word, w in high if word in taken) / sum(w for _, w in high)
    assert alias_scores(np.array([f]), degree, memory)[0] == pytest.approx(expected)


def test_a_search_lists_what_reaches_the_memory_best_first() -> None:
    found = search(14, 21)
    assert (found.chips, found.primitives, found.largest_memory) == (16383, 756, 27)
    scores = [candidate.alias_percent for candidate in found.candidates]
    assert scores == sorted(scores)
    assert all(c.memory_order3 >= 21 for c in found.candidates)
    assert found.recommended == found.candidates[0]
    memories = collision_free_memories(primitive_polynomials(14), 14, 3)
    assert found.reaching == int(np.count_nonzero(memories >= 21))


def test_inverse_repeat_reaches_further() -> None:
    found = search(12, 19, inverse_repeat=True)
    assert found.recommended.memory_inverse_repeat == 19
    with pytest.raises(ConfigError, match=r"no primitive .* 19 samples: the best reaches 18"):
        search(12, 19)


@pytest.mark.parametrize(
    ("degree", "memory", "order", "says"),
    [
        (4, 3, 3, "degrees 5 to 20"),
        (21, 3, 3, "degrees 5 to 20"),
        (12, 46, 2, "the best reaches 45 .octal 13677"),
        (12, 10, 4, "orders 2 and 3"),
        (12, 0, 3, "memories from 1"),
    ],
)
def test_what_cannot_be_searched_is_refused(
    degree: int, memory: int, order: int, says: str
) -> None:
    with pytest.raises(ConfigError, match=says):
        search(degree, memory, order)
