"""M-sequences: the recurrence, the three properties, and the polynomials that are refused."""

import numpy as np
import pytest
from scipy import fft

from servo_bench.errors import ConfigError
from servo_bench.excitation.msequence import (
    degree,
    is_primitive,
    m_sequence,
    polynomial_from_octal,
    prime_factors,
    reciprocal,
)

POLYNOMIALS = ("7", "13", "103", "2011", "15341", "10353", "40473", "50523", "215657")


@pytest.mark.parametrize("octal", POLYNOMIALS)
def test_the_bits_obey_the_recurrence_of_the_polynomial(octal: str) -> None:
    bits = (m_sequence(octal) < 0).astype(int)
    coefficients = [int(bit) for bit in f"{int(octal, 8):b}"[::-1]]
    n = len(coefficients) - 1
    fed_back = sum(coefficients[i] * np.roll(bits, -i) for i in range(n)) % 2
    np.testing.assert_array_equal(np.roll(bits, -n), fed_back)


@pytest.mark.parametrize("octal", POLYNOMIALS)
def test_one_period_is_balanced_and_white(octal: str) -> None:
    chips = m_sequence(octal)
    n = degree(polynomial_from_octal(octal))
    assert chips.shape == (2**n - 1,)
    assert set(chips.tolist()) == {-1, 1}
    assert chips.sum(dtype=int) == -1
    correlation = fft.irfft(np.abs(fft.rfft(chips.astype(float))) ** 2, chips.size)
    np.testing.assert_allclose(correlation[1:], -1.0, atol=1e-6)


def test_every_word_but_zero_passes_through_the_register_once() -> None:
    bits = (m_sequence("15341") < 0).astype(int)
    words = sum(np.roll(bits, -i) << i for i in range(12))
    assert sorted(words) == list(range(1, 4096))


def test_a_period_cannot_be_changed_in_place() -> None:
    with pytest.raises(ValueError, match="read-only"):
        m_sequence("7")[0] = 0


@pytest.mark.parametrize(
    ("n", "count"), [(2, 1), (3, 2), (4, 2), (5, 6), (6, 6), (8, 16), (10, 60), (11, 176)]
)
def test_there_are_as_many_primitive_polynomials_as_euler_counts(n: int, count: int) -> None:
    """phi(2^n - 1) / n of them; a reducible or a short one let through would show."""
    found = {f for f in range(2**n, 2 ** (n + 1)) if is_primitive(f)}
    assert len(found) == count
    assert {reciprocal(f) for f in found} == found


def test_the_papers_polynomials_and_their_reciprocals_are_primitive() -> None:
    assert reciprocal(0o15341) == 0o10353
    assert reciprocal(0o40473) == 0o67101
    assert all(is_primitive(f) for f in (0o15341, 0o10353, 0o40473, 0o67101))


@pytest.mark.parametrize("n", range(2, 25))
def test_factors_are_prime_and_complete(n: int) -> None:
    rest = 2**n - 1
    for prime in prime_factors(rest):
        assert all(prime % divisor for divisor in range(2, int(prime**0.5) + 1))
        while rest % prime == 0:
            rest //= prime
    assert rest == 1


@pytest.mark.parametrize(
    ("octal", "says"),
    [
        ("", "is not a polynomial in octal"),
        ("15391", "only the digits 0 to 7"),
        ("-23", "only the digits 0 to 7"),
        ("3", "has degree 1: degrees 2 to 24"),
        ("200000011", "has degree 25: degrees 2 to 24"),
        ("15340", r"2 \(octal\) divides it.*degree 12 is 10123"),
        ("15343", r"3 \(octal\) divides it"),
        ("37", "irreducible but x has order 5, .* period 15. .* degree 4 is 23"),
    ],
)
def test_a_polynomial_that_cannot_be_played_is_refused(octal: str, says: str) -> None:
    with pytest.raises(ConfigError, match=says):
        m_sequence(octal)


def test_a_suggested_polynomial_can_be_played() -> None:
    with pytest.raises(ConfigError) as refused:
        m_sequence("20001")
    suggested = str(refused.value).removesuffix(".").split()[-1]
    assert m_sequence(suggested).size == 2**13 - 1
