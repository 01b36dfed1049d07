"""The plants that estimators are judged on: laws that each obeys, and what keeps them apart."""

import numpy as np
import pytest

from servo_bench.kernels.paper_simulation import plant_output
from tests.truth.volterra_plants import (
    PLANTS,
    Plant,
    drawn_two_mass,
    output_lag,
    paper,
    servo_angle,
    two_mass,
)

ALL = {**PLANTS, "drawn": drawn_two_mass(3)}
BINARY = np.random.default_rng(1).choice([-1.0, 1.0], 600)


@pytest.mark.parametrize("zero", [True, False])
def test_the_papers_plants_are_those_of_the_benchs_own_simulation(zero: bool) -> None:
    mine = PLANTS["paper" if zero else "paper_no_zero"](BINARY)
    np.testing.assert_allclose(mine, plant_output(BINARY, zero=zero), atol=5e-4)


@pytest.mark.parametrize("name", sorted(ALL))
def test_every_plant_is_odd_causal_and_at_rest_without_input(name: str) -> None:
    plant: Plant = ALL[name]
    whole = plant(BINARY)
    np.testing.assert_allclose(plant(-BINARY), -whole, atol=1e-9)
    np.testing.assert_allclose(plant(BINARY[:200]), whole[:200], atol=1e-12)
    assert not plant(np.zeros(50)).any()
    assert whole[0] == 0.0


@pytest.mark.parametrize("name", sorted(ALL))
def test_a_gap_hides_what_is_smaller_than_it(name: str) -> None:
    """At a tenth of the gap nothing passes; far above it the output follows."""
    plant: Plant = ALL[name]
    quiet, loud = plant(0.02 * BINARY), plant(50.0 * BINARY)
    assert np.abs(quiet).max() < 0.005
    assert np.std(loud) > 15.0


def test_a_load_is_never_further_from_its_driver_than_the_gap_and_what_it_compresses() -> None:
    """Held at one, G settles at one: the play rests at 0.6, the second mass near it or beyond."""
    held = np.ones(400)
    assert paper(held)[-1] == pytest.approx(paper(held).max(), abs=1e-9)
    assert output_lag(held)[-1] == pytest.approx(paper(held)[-1], abs=1e-6)
    assert abs(two_mass(held)[-1] - 1.0) < 0.45


def test_seeds_draw_different_plants_and_the_same_again() -> None:
    one, again, other = (drawn_two_mass(seed)(BINARY) for seed in (1, 1, 2))
    np.testing.assert_array_equal(one, again)
    assert np.std(one - other) > 0.01


def test_an_encoder_counts_an_angle_that_trails_by_half_the_gap() -> None:
    """At a constant velocity the load is half a gap behind the sum of the commands."""
    angle = servo_angle(np.full(500, 100.0), 1.5, 10_000)
    ideal = 100.0 * 0.008 * np.arange(501)
    assert ideal[-1] - angle[-1] == pytest.approx(0.75, abs=0.04)
    counts = angle / 0.036
    np.testing.assert_allclose(counts, np.rint(counts), atol=1e-6)
