"""Kernels of three and five levels against a system that is known in closed form."""

from itertools import combinations_with_replacement, permutations

import numpy as np
import pytest
from numpy.typing import NDArray

from servo_bench.errors import FitError
from servo_bench.excitation.fields import field_sequence, first_primitive
from servo_bench.kernels.levels import extract_levels, level_memory
from servo_bench.kernels.predict import predict
from servo_bench.kernels.volterra import Kernels

Array = NDArray[np.float64]
MEMORY, AMPLITUDE = 4, 1.7


class System:
    """Symmetric kernels drawn at random, and the response to any commands by brute force."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        self.g0 = 0.3
        self.g: dict[tuple[int, ...], float] = {
            lags: float(rng.normal())
            for order in (1, 2, 3)
            for lags in combinations_with_replacement(range(MEMORY), order)
        }

    def output(self, commands: Array) -> Array:
        rows = [np.roll(commands, lag) for lag in range(MEMORY)]
        total = np.full(commands.size, self.g0)
        for lags, value in self.g.items():
            total += value * len(set(permutations(lags))) * np.prod([rows[i] for i in lags], axis=0)
        return total


def _chips(field: int) -> tuple[Array, str]:
    polynomial = first_primitive(field, 6 if field == 3 else 4)
    return field_sequence(field, polynomial), polynomial


def _kernels(field: int, response: Array) -> Kernels:
    chips, polynomial = _chips(field)
    return extract_levels(response, chips, polynomial, AMPLITUDE, MEMORY)


def test_five_levels_identify_every_element() -> None:
    system = System(1)
    kernels = _kernels(5, system.output(AMPLITUDE * _chips(5)[0]))
    assert kernels.constant == pytest.approx(system.g0, abs=1e-10)
    for lag in range(MEMORY):
        assert kernels.g1[lag] == pytest.approx(system.g[(lag,)], abs=1e-10)
    for i, j in combinations_with_replacement(range(MEMORY), 2):
        assert kernels.g2(j, i) == pytest.approx(system.g[(i, j)], abs=1e-10)
    for lags in combinations_with_replacement(range(MEMORY), 3):
        for i, j, k in permutations(lags):
            assert kernels.g3(i, j, k) == pytest.approx(system.g[lags], abs=1e-10)


def test_three_levels_identify_all_but_the_cubes_which_stand_with_g1() -> None:
    system = System(2)
    kernels = _kernels(3, system.output(AMPLITUDE * _chips(3)[0]))
    for lag in range(MEMORY):
        folded = system.g[(lag,)] + AMPLITUDE**2 * system.g[(lag,) * 3]
        assert kernels.g1[lag] == pytest.approx(folded, abs=1e-10)
        assert np.isnan(kernels.g3(lag, lag, lag))
        assert kernels.g2(lag, lag) == pytest.approx(system.g[(lag, lag)], abs=1e-10)
    assert kernels.g3(2, 1, 1) == pytest.approx(system.g[(1, 1, 2)], abs=1e-10)


@pytest.mark.parametrize("field", [3, 5])
def test_predictions_are_exact_on_levels_that_were_played(field: int) -> None:
    system = System(3)
    kernels = _kernels(field, system.output(AMPLITUDE * _chips(field)[0]))
    fresh = np.random.default_rng(4).choice(np.unique(_chips(field)[0]), 200)
    expected = system.output(AMPLITUDE * fresh)[MEMORY:]
    np.testing.assert_allclose(predict(kernels, fresh)[MEMORY:], expected, atol=1e-9)


def test_energies_are_those_of_random_binary_input() -> None:
    system = System(5)
    kernels = _kernels(5, system.output(AMPLITUDE * _chips(5)[0]))
    every = 2 * ((np.arange(1 << MEMORY)[:, None] >> np.arange(MEMORY)) & 1) - 1.0
    outputs = np.array([predict(kernels, word[-1:], history=word[:-1])[0] for word in every])
    assert kernels.energies.sum() == pytest.approx(outputs.var(), rel=1e-9)


@pytest.mark.parametrize("field", [3, 5])
def test_the_standard_error_is_the_spread_of_the_estimate(field: int) -> None:
    system, noise, periods = System(6), 0.5, 4
    chips, _ = _chips(field)
    clean = system.output(AMPLITUDE * chips)
    rng = np.random.default_rng(7)
    noisy = [clean + rng.normal(0.0, noise, (periods, chips.size)) for _ in range(40)]
    found = [_kernels(field, draws) for draws in noisy]
    spread = float(np.sqrt(np.mean(np.var([k.c1 for k in found], axis=0, ddof=1))))
    told = [k.standard_error for k in found if k.standard_error is not None]
    assert np.mean(told) == pytest.approx(spread, rel=0.15)
    assert np.mean([k.scatter for k in found]) == pytest.approx(spread, rel=0.2)


def test_a_memory_in_which_products_depend_is_refused_with_the_longest_that_serves() -> None:
    chips, polynomial = _chips(3)
    longest = level_memory(3, polynomial)
    response = np.roll(chips, 1)
    assert extract_levels(response, chips, polynomial, 1.0, longest).memory == longest
    with pytest.raises(FitError, match=f"a memory of 1 to {longest}"):
        extract_levels(response, chips, polynomial, 1.0, longest + 1)


@pytest.mark.parametrize("response", [np.zeros(727), np.full(728, np.nan)])
def test_what_is_no_whole_period_of_numbers_is_refused(response: Array) -> None:
    with pytest.raises(FitError, match="Cut it to whole periods"):
        _kernels(3, response)
