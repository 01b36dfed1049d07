"""Where kernel elements lie, and how much memory a polynomial can resolve."""

from itertools import combinations

import numpy as np
import pytest

from servo_bench.errors import ConfigError
from servo_bench.excitation.msequence import is_primitive, m_sequence, reciprocal
from servo_bench.kernels.shifts import (
    collision_free_memory,
    element_shifts,
    lag_sets,
    shifts_of,
)


@pytest.mark.parametrize("octal", ["103", "15341", "40473"])
@pytest.mark.parametrize("order", [1, 2, 3])
def test_a_product_of_delayed_chips_is_the_sequence_delayed(octal: str, order: int) -> None:
    chips = m_sequence(octal)
    sets = lag_sets(8, order)
    for lags, shift in zip(sets, shifts_of(octal, sets), strict=True):
        product = np.prod([np.roll(chips, lag) for lag in lags], axis=0)
        expected = np.ones_like(chips) if shift < 0 else np.roll(chips, shift)
        np.testing.assert_array_equal(product, expected)


def test_lags_that_cancel_have_no_shift() -> None:
    """f itself is such a set: u(t) u(t - i) ... = 1 for the powers of 13 (x^3 + x + 1)."""
    assert shifts_of("13", np.array([[0, 2, 3]])).tolist() == [-1]


def test_shifts_are_discrete_logs_to_the_root_of_the_reciprocal() -> None:
    """Arithmetic in GF(2^12) instead of the sequence's registers."""
    modulus = reciprocal(0o15341)
    power, powers = 1, []
    for _ in range(4095):
        powers.append(power)
        power <<= 1
        power ^= modulus if power >> 12 else 0
    log = {word: exponent for exponent, word in enumerate(powers)}
    for order in (1, 2, 3):
        expected = [
            log[int(np.bitwise_xor.reduce([powers[lag] for lag in lags]))]
            for lags in lag_sets(18, order)
        ]
        assert element_shifts("15341", 18, order).tolist() == expected


def test_a_cross_section_is_a_contiguous_run() -> None:
    sets = np.array([[0, 3, 7], [1, 4, 8], [2, 5, 9]])
    assert np.diff(shifts_of("40473", sets)).tolist() == [1, 1]


@pytest.mark.parametrize(
    ("octal", "order2", "order3"),
    [("15341", 31, 18), ("10353", 31, 18), ("40473", 44, 21), ("67101", 44, 21)],
)
def test_the_papers_polynomials_resolve_what_the_distance_rule_says(
    octal: str, order2: int, order3: int
) -> None:
    assert collision_free_memory(octal, 2) == order2
    assert collision_free_memory(octal, 3) == order3


@pytest.mark.parametrize(
    ("octal", "memory"),
    [("2327", 14), ("7243", 16), ("14227", 18), ("14711", 18), ("32445", 22), ("50523", 27)],
)
def test_the_best_polynomials_reach_their_memory(octal: str, memory: int) -> None:
    assert collision_free_memory(octal, 3) == memory


@pytest.mark.parametrize(
    ("octal", "order", "memory"),
    [("5657", 2, 37), ("6127", 3, 16), ("13677", 2, 45), ("12147", 3, 18)],
)
def test_koopmans_hamming_distances_are_met(octal: str, order: int, memory: int) -> None:
    """His longest message of distance 5 or 7 plus the degree: an independent exhaustive search."""
    assert collision_free_memory(octal, order) == memory


@pytest.mark.parametrize(
    ("n", "order2", "order3", "median3"),
    [
        (10, 26, 14, 11),
        (11, 37, 16, 12),
        (12, 45, 18, 14),
        pytest.param(13, 63, 22, 16, marks=pytest.mark.long),
    ],
)
def test_the_best_and_the_median_over_all_polynomials(
    n: int, order2: int, order3: int, median3: int
) -> None:
    octals = [f"{f:o}" for f in range(2**n + 1, 2 ** (n + 1), 2) if is_primitive(f)]
    assert max(collision_free_memory(octal, 2) for octal in octals) == order2
    memories = [collision_free_memory(octal, 3) for octal in octals]
    assert (max(memories), int(np.median(memories))) == (order3, median3)


@pytest.mark.parametrize("octal", ["2011", "3515", "15341"])
@pytest.mark.parametrize("order", [2, 3])
def test_the_limit_is_where_the_first_two_elements_meet(octal: str, order: int) -> None:
    limit = collision_free_memory(octal, order)
    for memory, apart in ((limit, True), (limit + 1, False)):
        shifts = [k for m in range(1, order + 1) for k in element_shifts(octal, memory, m)]
        assert (len(set(shifts)) == len(shifts) and -1 not in shifts) is apart


def test_lag_sets_are_all_combinations_in_order() -> None:
    assert [tuple(row) for row in lag_sets(6, 3)] == list(combinations(range(6), 3))
    assert lag_sets(2, 3).shape == (0, 3)


def test_a_polynomial_that_is_none_has_no_memory() -> None:
    with pytest.raises(ConfigError, match="not primitive"):
        collision_free_memory("15343", 3)
