"""M-sequences and the primitive polynomials over GF(2) that make them.

A polynomial is written in octal, highest power first, as in the literature: 15341 is
x^12 + x^11 + x^9 + x^7 + x^6 + x^5 + 1. Inside it is an int whose bit i is the coefficient f_i.
It is the characteristic polynomial of the bits s, and the sequence is their sign:

    s_{t+n} = sum_{i<n} f_i s_{t+i}  (mod 2)        u_t = 1 - 2 s_t

so bit 0 is +1 and bit 1 is -1. One period has N = 2^n - 1 chips, sum(u) = -1, and
sum_t u_t u_{t+k} = -1 for every k that is no multiple of N. The register starts with ones.
"""

from functools import cache

import numpy as np
from numpy.typing import NDArray

from servo_bench.errors import ConfigError

DEGREES = range(2, 25)
"""Degrees that are accepted: N = 3 to 16 777 215 chips."""


@cache
def m_sequence(polynomial_octal: str) -> NDArray[np.int8]:
    """One period of the M-sequence, shape (2^n - 1,), each +1 or -1, read-only.

    Raises ConfigError where the polynomial is not octal, not of degree 2 to 24, or not primitive.
    """
    polynomial = checked_polynomial(polynomial_octal)
    n = degree(polynomial)
    chips = (1 - 2 * _bits(polynomial, 2**n - 1)).astype(np.int8)
    chips.setflags(write=False)
    return chips


def _bits(polynomial: int, length: int) -> NDArray[np.int8]:
    """The first bits of the sequence, from a register of ones.

    Over GF(2) f(x)^h = f(x^h) for every power of two h, so the bits also obey the recurrence with
    all its distances stretched by h: h of them follow at once from the n h before them.
    """
    n = degree(polynomial)
    taps = [i for i in range(n) if polynomial >> i & 1]
    bits = np.ones(max(length, n), np.int8)
    known = n
    while known < length:
        stretch = 1 << ((known // n).bit_length() - 1)
        new = min(stretch, length - known)
        first = known - n * stretch
        bits[known : known + new] = np.bitwise_xor.reduce(
            [bits[first + i * stretch : first + i * stretch + new] for i in taps]
        )
        known += new
    return bits[:length]


def checked_polynomial(polynomial_octal: str) -> int:
    """The primitive polynomial that the octal digits name; ConfigError where they name none."""
    polynomial = polynomial_from_octal(polynomial_octal)
    n = degree(polynomial)
    if n not in DEGREES:
        raise ConfigError(
            f"polynomial {polynomial_octal} (octal) has degree {n}: degrees {DEGREES[0]} to "
            f"{DEGREES[-1]} are supported. Use one of those, for example "
            f"{_suggestion(min(max(n, DEGREES[0]), DEGREES[-1]))}."
        )
    if not is_primitive(polynomial):
        raise ConfigError(
            f"polynomial {polynomial_octal} (octal) is not primitive: {_why_not(polynomial)}, so "
            f"its sequence does not reach the period {2**n - 1}. A primitive polynomial of degree "
            f"{n} is {_suggestion(n)}."
        )
    return polynomial


def polynomial_from_octal(text: str) -> int:
    """Octal digits, highest power first, as an int; ConfigError where they are not octal."""
    if not text or not set(text) <= set("01234567"):
        raise ConfigError(
            f"{text!r} is not a polynomial in octal: only the digits 0 to 7 are allowed, highest "
            f"power first. Write it as in 15341 for x^12+x^11+x^9+x^7+x^6+x^5+1."
        )
    return int(text, 8)


def degree(polynomial: int) -> int:
    """The highest power with a coefficient of one; -1 for the zero polynomial."""
    return polynomial.bit_length() - 1


def reciprocal(polynomial: int) -> int:
    """x^n f(1/x): the coefficients in reverse. Primitive exactly where f is."""
    return int(f"{polynomial:b}"[::-1], 2)


@cache
def is_primitive(polynomial: int) -> bool:
    """Whether x has the order 2^n - 1 modulo f, which only primitive polynomials reach.

    (Lidl and Niederreiter, Introduction to finite fields, theorem 3.16.) Any degree from 1 on.
    """
    if degree(polynomial) < 1 or not polynomial & 1:
        return False
    group = 2 ** degree(polynomial) - 1
    return _power_of_x(group, polynomial) == 1 and all(
        _power_of_x(group // prime, polynomial) != 1 for prime in prime_factors(group)
    )


def prime_factors(number: int) -> list[int]:
    """The distinct primes that divide `number`, ascending, by trial division."""
    found, divisor = [], 2
    while divisor * divisor <= number:
        if number % divisor == 0:
            found.append(divisor)
            while number % divisor == 0:
                number //= divisor
        divisor += 1
    return [*found, number] if number > 1 else found


def _why_not(polynomial: int) -> str:
    """The factor, or where there is none the order, that keeps f from being primitive."""
    half = range(2, 2 << (degree(polynomial) // 2))
    factor = next((f for f in half if remainder(polynomial, f) == 0), None)
    if factor is not None:
        return f"{factor:o} (octal) divides it"
    order = 2 ** degree(polynomial) - 1
    for prime in prime_factors(order):
        while order % prime == 0 and _power_of_x(order // prime, polynomial) == 1:
            order //= prime
    return f"it is irreducible but x has order {order}"


def _suggestion(n: int) -> str:
    return next(f"{f:o}" for f in range(2**n + 1, 2 ** (n + 1), 2) if is_primitive(f))


def remainder(dividend: int, divisor: int) -> int:
    """The remainder of polynomial division over GF(2)."""
    while (shift := degree(dividend) - degree(divisor)) >= 0:
        dividend ^= divisor << shift
    return dividend


def _power_of_x(exponent: int, modulus: int) -> int:
    """x^exponent modulo a polynomial, by squaring."""
    result = 1
    for bit in f"{exponent:b}":
        result = remainder(_square(result), modulus)
        if bit == "1":
            result = remainder(result << 1, modulus)
    return result


def _square(polynomial: int) -> int:
    """Squaring over GF(2) spreads the coefficients: (sum f_i x^i)^2 = sum f_i x^2i."""
    return int("0".join(f"{polynomial:b}"), 2)
