"""Sequences of maximal length over GF(3) and GF(5): three and five levels.

    s_{t+n} = -(a_{n-1} s_{t+n-1} + ... + a_0 s_t)  (mod p)      x^n + a_{n-1} x^{n-1} + ... + a_0

with a primitive polynomial, written in its coefficients, highest power first ("12211" over GF(3)).
One period has p^n - 1 chips. Residues above p/2 count as negative, and the largest is scaled to
one: {-1, 0, 1} or {-1, -1/2, 0, 1/2, 1}. The mean is zero and u(t + N/2) = -u(t), so even
orders fall out of the odd ones as with an inverse-repeat sequence.

Zechner (1999) and Godfrey use them for what binary chips cannot show: u^2 is no constant.
The whole of field arithmetic that is needed is the order of x modulo a polynomial, thirty lines;
the package `galois` would bring tables and seconds of compilation for it.
"""

from functools import cache
from itertools import product

import numpy as np
from numpy.typing import NDArray

from servo_bench.errors import ConfigError
from servo_bench.excitation.msequence import prime_factors

FIELDS = (3, 5)
LARGEST_PERIOD = 2_000_000


@cache
def field_sequence(field: int, polynomial: str) -> NDArray[np.float64]:
    """One period, shape (p^n - 1,), levels within +-1, read-only.

    ConfigError where the digits are no primitive polynomial over that field.
    """
    coefficients = _checked(field, polynomial)
    feedback = np.array([-int(a) % field for a in polynomial[:0:-1]], np.int64)
    residues = _register(field, feedback, field ** (len(coefficients) - 1) - 1)
    chips = np.where(residues > field // 2, residues - field, residues) / (field // 2)
    chips.setflags(write=False)
    return np.asarray(chips)


@cache
def first_primitive(field: int, degree: int) -> str:
    """The primitive polynomial of that degree whose digits, read as a number, are the least."""
    if field not in FIELDS or degree < 2 or field**degree > LARGEST_PERIOD:
        raise ConfigError(
            f"a sequence over GF({field}) of degree {degree} was asked for: fields 3 and 5, with "
            f"degrees from 2 and periods up to {LARGEST_PERIOD} chips. Binary: use an m-sequence."
        )
    digits = product(range(field), repeat=degree)
    return next(
        "1" + "".join(map(str, rest)) for rest in digits if _is_primitive(field, (1, *rest))
    )


def _checked(field: int, polynomial: str) -> tuple[int, ...]:
    if field not in FIELDS:
        raise ConfigError(f"sequences over GF({field}) are not supported: use GF(3) or GF(5).")
    if not set(polynomial) <= set("01234"[:field]) or polynomial[:1] != "1":
        raise ConfigError(
            f"{polynomial!r} is no polynomial over GF({field}): write its coefficients, highest "
            f"power first, each 0 to {field - 1}, the first 1."
        )
    coefficients = tuple(int(digit) for digit in polynomial)
    degree = len(coefficients) - 1
    if degree < 2 or field**degree > LARGEST_PERIOD:
        raise ConfigError(
            f"polynomial {polynomial} over GF({field}) has degree {degree}: degrees from 2, and "
            f"periods up to {LARGEST_PERIOD} chips, are supported."
        )
    if not _is_primitive(field, coefficients):
        raise ConfigError(
            f"polynomial {polynomial} over GF({field}) is not primitive, so its sequence does not "
            f"reach the period {field**degree - 1}. One that is: {first_primitive(field, degree)}."
        )
    return coefficients


def _is_primitive(field: int, coefficients: tuple[int, ...]) -> bool:
    group = field ** (len(coefficients) - 1) - 1
    one = _power_of_x(field, coefficients, 0)
    return (
        coefficients[-1] != 0
        and _power_of_x(field, coefficients, group) == one
        and all(
            _power_of_x(field, coefficients, group // prime) != one
            for prime in prime_factors(group)
        )
    )


def _power_of_x(field: int, modulus: tuple[int, ...], exponent: int) -> tuple[int, ...]:
    """x^exponent modulo a monic polynomial, coefficients highest first, by squaring."""
    degree = len(modulus) - 1
    power = [0] * (degree - 1) + [1]
    for bit in f"{exponent:b}":
        power = _reduced(field, np.convolve(power, power).tolist(), modulus)
        if bit == "1":
            power = _reduced(field, [*power, 0], modulus)
    return tuple(power)


def _reduced(field: int, polynomial: list[int], modulus: tuple[int, ...]) -> list[int]:
    degree = len(modulus) - 1
    rest = [value % field for value in polynomial]
    for place in range(len(rest) - degree):
        factor = rest[place]
        for offset, coefficient in enumerate(modulus):
            rest[place + offset] = (rest[place + offset] - factor * coefficient) % field
    return rest[-degree:]


def _register(field: int, feedback: NDArray[np.int64], chips: int) -> NDArray[np.int64]:
    """The shift register from all ones, shape (chips,): s(t + n) = sum_i feedback[i] s(t + i).

    f(x)^q = f(x^q) for q = p^k, so the same recursion holds at q times its lags: with n q chips
    known, the next q come at once.
    """
    degree = feedback.size
    out = np.ones(max(chips, degree), np.int64)
    known, stride = degree, 1
    while known < chips:
        if known >= degree * stride * field:
            stride *= field
        fresh = min(stride, chips - known)
        begin = known - degree * stride
        total = np.zeros(fresh, np.int64)
        for i in np.flatnonzero(feedback):
            total += feedback[i] * out[begin + i * stride : begin + i * stride + fresh]
        out[known : known + fresh] = total % field
        known += fresh
    return out[:chips]
