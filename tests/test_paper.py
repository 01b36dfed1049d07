"""The paper's simulation: the plant against the textbook, the VAF against an independent study."""

import json

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from servo_bench.benchmark import kernels as benchmark
from servo_bench.kernels.paper_simulation import (
    MEMORY,
    PaperResult,
    plant_output,
    simulate_paper,
)


@pytest.fixture(scope="module")
def result() -> PaperResult:
    return simulate_paper()


def test_with_the_zero_the_kernels_explain_what_the_study_says(result: PaperResult) -> None:
    numbers = result.numbers()["simulation"]["zero"]
    assert numbers["order1_fresh"] == pytest.approx(95.3, abs=0.3)
    assert numbers["order3_same"] == pytest.approx(98.8, abs=0.3)
    assert numbers["order3_fresh"] == pytest.approx(98.2, abs=0.3)


def test_without_the_zero_the_kernels_explain_what_the_study_says(result: PaperResult) -> None:
    numbers = result.numbers()["simulation"]["no_zero"]
    assert numbers["order1_fresh"] == pytest.approx(89.8, abs=0.5)
    assert numbers["order3_same"] == pytest.approx(96.6, abs=0.5)
    assert numbers["order3_fresh"] == pytest.approx(95.0, abs=0.5)


def test_a_play_is_odd_and_the_hold_has_no_feedthrough(result: PaperResult) -> None:
    for plant in (result.zero, result.no_zero):
        shares = plant.kernels.energies / np.var(plant.period.measured)
        assert shares[2] < 0.005
        assert shares[3] > 0.03
        assert abs(plant.kernels.c1[0]) < 1e-3
        assert np.abs(plant.kernels.c3[0]).max() < 0.02


def test_the_numbers_are_json_and_name_their_draws(result: PaperResult) -> None:
    numbers = json.loads(json.dumps(result.numbers()))
    assert numbers["memory"] == MEMORY == 18
    assert numbers["polynomial"] == "15341"
    assert len(numbers["seeds"]) == result.zero.fresh_order3_percent.size


def test_the_draws_are_fixed_by_their_seeds() -> None:
    once, again = (simulate_paper((5,)).numbers() for _ in range(2))
    assert once == again
    other = simulate_paper((6,)).numbers()
    assert (
        other["simulation"]["zero"]["order3_fresh"] != (once["simulation"]["zero"]["order3_fresh"])
    )


@pytest.mark.parametrize("zero", [True, False])
def test_the_plant_is_the_differential_equation_behind_a_play(zero: bool) -> None:
    """An adaptive integrator and a play fed on a far finer grid, one chip after the other."""
    chips = np.random.default_rng(3).choice([-1.0, 1.0], 60)
    state, y, expected = np.zeros(2), 0.0, []
    weights = np.array([1.0, 0.8 if zero else 0.0])
    for chip in chips:
        expected.append(y)
        solved = solve_ivp(
            lambda _, x, u=chip: [x[1], u - x[0] - 0.8 * x[1]],
            (0.0, 0.5),
            state,
            t_eval=np.linspace(0.0, 0.5, 401),
            rtol=1e-10,
            atol=1e-12,
        )
        state = solved.y[:, -1]
        for x in weights @ solved.y:
            y = min(max(y, x - 0.4), x + 0.4)
    np.testing.assert_allclose(plant_output(chips, zero=zero), expected, atol=2e-4)


@pytest.mark.long
def test_the_benchmark_measures_what_it_says() -> None:
    numbers = json.loads(json.dumps(benchmark.measure(seed=1)))
    assert numbers["samples"] == 16383
    assert numbers["elements"] == 21 + 210 + 1330
    for memory in (21, 32):
        measured = numbers[f"prediction_memory_{memory}"]
        assert measured["largest_difference"] < 1e-11
        assert measured["prediction_s"] > 0.0
    assert numbers["paper"]["simulation"].keys() == {"zero", "no_zero"}
