"""Each estimator against a truth it can know, a dense computation, or a plant outside its class."""

from itertools import combinations

import numpy as np
import pytest
from numpy.typing import NDArray

from servo_bench.errors import ConfigError, FitError
from servo_bench.estimators.data import Predictor, Training, lagged, periodic_training
from servo_bench.estimators.decay_prior import DecayPrior
from servo_bench.estimators.elementary import (
    elementary_gradient,
    elementary_products,
    elementary_sums,
)
from servo_bench.estimators.figures import BAND_DEVIATIONS, posterior_figures
from servo_bench.estimators.greybox import GreyBox, SecondOrderPlay
from servo_bench.estimators.hybrid import Hybrid
from servo_bench.estimators.least_squares import LeastSquares
from servo_bench.estimators.play import FirPlay
from servo_bench.estimators.polynomial_prior import PolynomialPrior
from servo_bench.estimators.registry import ESTIMATORS, estimator
from servo_bench.estimators.regularised import MultilinearPosterior, RegularisedVolterra
from servo_bench.estimators.spectrum import Spectrum
from servo_bench.estimators.unseen import SAME, prediction_matrix, unseen_inputs
from servo_bench.excitation.msequence import m_sequence
from servo_bench.kernels.predict import vaf_percent
from servo_bench.kernels.terms import identifiable_terms
from servo_bench.kernels.volterra import extract
from tests.truth import volterra_plants
from tests.truth.volterra_plants import PLANTS, Plant

Array = NDArray[np.float64]

OCTAL = "2011"
RNG = np.random.default_rng


def period_of(plant: Plant, octal: str = "15341", noise: float = 0.0, seed: int = 1) -> Training:
    """One noisy steady-state period; `noise` relative to the output."""
    chips = m_sequence(octal).astype(float)
    clean = plant(np.tile(chips, 2))[chips.size :]
    noisy = clean + RNG(seed).normal(0.0, noise * clean.std(), clean.size)
    return periodic_training(noisy, octal, 1.0)


def fresh_vaf(predictor: Predictor, plant: Plant, amplitude: float = 1.0, seed: int = 9) -> float:
    """On random binary input, against the noise-free output."""
    inputs = amplitude * RNG(seed).choice([-1.0, 1.0], 1500)
    return vaf_percent(plant(inputs)[200:], predictor.predict(inputs)[200:])


@pytest.fixture(scope="module")
def paper_training() -> Training:
    return period_of(PLANTS["paper"], noise=0.1)


def test_elementary_sums_are_the_sums_over_all_sets() -> None:
    rng = RNG(1)
    rows, others = rng.normal(size=(5, 8)), rng.normal(size=(4, 8))
    weights, orders = rng.uniform(0.1, 1.0, (3, 8)), np.array([1, 3, 5])

    def brute(z: Array, order: int) -> float:
        return sum(float(np.prod(z[list(lags)])) for lags in combinations(range(8), order))

    expected = [
        sum(brute(w * row, m) for w, m in zip(weights, orders, strict=True)) for row in rows
    ]
    np.testing.assert_allclose(elementary_sums(rows, weights, orders), expected)
    table = elementary_products(rows, others, weights, orders)
    for i, row in enumerate(rows):
        np.testing.assert_allclose(table[i], elementary_sums(row * others, weights, orders))


def test_the_gradient_of_elementary_sums_is_their_slope() -> None:
    rng = RNG(2)
    rows, outer = rng.normal(size=(6, 7)), rng.normal(size=6)
    weights, orders = rng.uniform(0.1, 1.0, (2, 7)), np.array([2, 5])
    gradient = elementary_gradient(rows, weights, orders, outer)
    step = 1e-6
    for place in np.ndindex(2, 7):
        up, down = weights.copy(), weights.copy()
        up[place] *= np.exp(step)
        down[place] *= np.exp(-step)
        slope = outer @ (elementary_sums(rows, up, orders) - elementary_sums(rows, down, orders))
        assert gradient[place] == pytest.approx(slope / (2 * step), rel=1e-5, abs=1e-7)


def test_the_posterior_is_that_of_a_gaussian_process_with_its_matrix() -> None:
    """Mean and deviation, against the N + 1 by N + 1 system that it never builds."""
    memory, orders, noise = 6, (1, 2, 3, 5), 0.3
    spectrum = Spectrum("211")
    places = spectrum.lags(memory)
    weights = np.stack([0.6 ** (np.arange(memory) + 1.0) for _ in orders])
    response = RNG(3).normal(size=len(places))
    response -= response.mean()
    coefficients = spectrum.shifts_of(response)
    prior = DecayPrior(orders, weights, noise**2 / len(places))
    posterior = MultilinearPosterior(spectrum, 1.0, coefficients, 0.0, prior)
    inputs = RNG(4).choice([-1.0, 1.0], 40)
    rows = lagged(inputs, None, memory)
    order_array = np.array(orders)
    constant = elementary_products(places, places, weights, order_array).mean(axis=0)
    within = elementary_products(places, places, weights, order_array) - constant
    across = elementary_products(rows, places, weights, order_array)
    across = across - across.mean(axis=1, keepdims=True)
    dense = within + noise**2 * np.eye(len(places))
    np.testing.assert_allclose(
        posterior.predict(inputs), across @ np.linalg.solve(dense, response), atol=1e-10
    )
    own = elementary_sums(rows**2, weights, order_array)
    expected = own - np.sum(across * np.linalg.solve(dense, across.T).T, axis=1)
    np.testing.assert_allclose(posterior.standard_deviation(inputs) ** 2, expected, atol=1e-9)


def test_a_posterior_element_is_what_was_measured_where_noise_is_small() -> None:
    chips = m_sequence("15341").astype(float)
    x = np.stack([np.roll(chips, i) for i in range(5)], axis=1)
    clean = 0.3 + x @ np.array([1.0, 0.5, 0.25, 0.1, 0.05]) + 0.2 * x[:, 0] * x[:, 1] * x[:, 2]
    training = periodic_training(clean + RNG(1).normal(0.0, 1e-3, clean.size), "15341", 1.0)
    fitted = RegularisedVolterra(memory=10).fit(training)
    assert isinstance(fitted, MultilinearPosterior)
    mean, deviation = fitted.element(1)
    np.testing.assert_allclose(mean[:5], [1.0, 0.5, 0.25, 0.1, 0.05], atol=2e-4)
    assert np.all(deviation < 1e-3)
    assert fitted.element(3)[0][0] == pytest.approx(0.2, abs=2e-4)
    assert fitted.parameters["constant"].value == pytest.approx(0.3, abs=2e-4)
    assert fitted.parameters["noise"].value == pytest.approx(1e-3, rel=0.1)


@pytest.mark.long
def test_regularised_beats_the_papers_method_on_fresh_input(paper_training: Training) -> None:
    """Above 98.57, the ceiling of any kernels of order 3, at 20 dB."""
    plain = estimator("correlation").fit(paper_training)
    regularised = estimator("regularised").fit(paper_training)
    assert fresh_vaf(plain, PLANTS["paper"]) == pytest.approx(98.0, abs=0.4)
    assert fresh_vaf(regularised, PLANTS["paper"]) > 99.1


def test_a_play_is_found_and_carries_over_between_amplitudes(paper_training: Training) -> None:
    fitted = FirPlay().fit(paper_training)
    gap = fitted.parameters["radius_0"]
    assert gap.value == pytest.approx(0.4, abs=0.02)
    assert abs(gap.value - 0.4) < 5 * gap.standard_error
    for amplitude in (0.5, 1.0, 2.0):
        assert fresh_vaf(fitted, PLANTS["paper"], amplitude) > 99.85


def test_the_jacobian_of_plays_is_their_slope() -> None:
    fitted = FirPlay(memory=6, plays=2).fit(period_of(PLANTS["paper"], OCTAL, 0.05))
    rows = lagged(RNG(5).normal(size=300), None, 6)
    output, jacobian = fitted.model.evaluated(rows, 10)
    vector, step = fitted.model.vector(), 1e-7
    for place in range(vector.size):
        moved = vector.copy()
        moved[place] += step
        slope = (fitted.model.moved_to(moved).evaluated(rows, 10)[0] - output) / step
        np.testing.assert_allclose(jacobian[:, place], slope, atol=1e-5)


def test_several_plays_fit_what_one_cannot() -> None:
    training = period_of(PLANTS["soft_play"], noise=0.01)
    one, six = (FirPlay(plays=count).fit(training) for count in (1, 6))
    assert fresh_vaf(six, PLANTS["soft_play"], 0.5) > fresh_vaf(one, PLANTS["soft_play"], 0.5) + 0.5
    assert fresh_vaf(six, PLANTS["soft_play"], 0.5) > 99.5


def test_the_grey_box_finds_the_numbers_of_the_paper(paper_training: Training) -> None:
    fitted = GreyBox().fit(paper_training)
    for name, truth in (
        ("natural_frequency_rad_s", 1.0),
        ("damping_ratio", 0.4),
        ("zero_gain", 1.0),
        ("half_gap", 0.4),
        ("gain", 1.0),
    ):
        found = fitted.parameters[name]
        assert found.value == pytest.approx(truth, abs=max(6 * found.standard_error, 0.01)), name
    inputs = RNG(1).choice([-1.0, 1.0], 600)
    assert np.all(fitted.standard_deviation(inputs)[100:] < 0.05)


def test_a_gap_is_measured_through_a_coarse_encoder() -> None:
    """Within 0.01 degree by counts of 0.036 degree, one period of degree 12."""
    chips = 150.0 * m_sequence("15341")
    angle = volterra_plants.servo_angle(np.tile(chips, 2), 1.5, 10_000)
    velocity = np.diff(angle)[chips.size :] / 0.008
    model = SecondOrderPlay(0.008, 62.5, 0.5, integrates=True)
    fitted = GreyBox(model).fit(periodic_training(velocity, "15341", 150.0))
    assert 2 * fitted.parameters["half_gap"].value == pytest.approx(1.5, abs=0.01)


@pytest.mark.long
def test_the_hybrid_mends_a_plant_outside_the_grey_box() -> None:
    plant = PLANTS["two_mass"]
    played = RNG(6).uniform(-2.0, 2.0, 1400)
    training = Training(played[200:].copy(), plant(played)[200:], played[:200].copy())
    fitted = Hybrid(residual=PolynomialPrior(memory=14, subset=250)).fit(training)
    hybrid, grey = fresh_vaf(fitted, plant, 1.5), fresh_vaf(fitted.structured, plant, 1.5)
    assert hybrid > grey > 98.0
    assert {"half_gap", "residual_noise"} <= fitted.parameters.keys()
    assert np.all(fitted.standard_deviation(played[:50]) > 0.0)


def test_the_polynomial_prior_learns_diagonals_and_knows_where_it_has_not_been() -> None:
    rng = RNG(7)
    played = rng.uniform(-1.0, 1.0, 700)
    rows = lagged(played, None, 3)
    clean = 1.0 + rows @ np.array([1.0, 0.5, 0.2]) + 0.4 * rows[:, 0] ** 3 + 0.3 * rows[:, 1] ** 2
    noisy = clean + rng.normal(0.0, 0.02, clean.size)
    fitted = PolynomialPrior(memory=4, subset=250).fit(Training(played, noisy, np.zeros(0)))
    test = rng.uniform(-1.0, 1.0, 300)
    seen = lagged(test, None, 3)
    truth = 1.0 + seen @ np.array([1.0, 0.5, 0.2]) + 0.4 * seen[:, 0] ** 3 + 0.3 * seen[:, 1] ** 2
    error, deviation = fitted.predict(test) - truth, fitted.standard_deviation(test)
    assert vaf_percent(truth, fitted.predict(test)) > 99.8
    assert 0.4 < np.sqrt(np.mean(error**2) / np.mean(deviation**2)) < 2.5
    assert fitted.parameters["noise"].value == pytest.approx(0.02, rel=0.3)
    assert fitted.standard_deviation(3.0 * test).mean() > 3 * deviation.mean()


def test_least_squares_is_correlation_where_both_are_exact() -> None:
    rng = RNG(8)
    chips = m_sequence(OCTAL).astype(float)
    terms = identifiable_terms(5, 3, 2)
    rows = np.stack([np.roll(chips, i) for i in range(5)], axis=1)
    values = rng.normal(size=len(terms))
    response = sum(
        v * np.prod(rows[:, list(t)], axis=1) for v, t in zip(values, terms, strict=True)
    )
    training = periodic_training(np.asarray(response), OCTAL, 1.0)
    fitted = LeastSquares(memory=5).fit(training)
    np.testing.assert_allclose(fitted.values, values, atol=1e-10)
    kernels = extract(training.response, OCTAL, 1.0, 5)
    inputs = rng.choice([-1.0, 1.0], 80)
    np.testing.assert_allclose(
        fitted.predict(inputs),
        estimator("correlation", 5).fit(training).predict(inputs),
        atol=1e-10,
    )
    assert fitted.parameters["c_0_3"].value == pytest.approx(kernels.c2[0, 3])


def test_terms_follow_the_number_of_levels() -> None:
    assert identifiable_terms(2, 3, 2) == ((), (0,), (1,), (0, 1))
    assert (0, 0, 1) in identifiable_terms(2, 3, 3)
    assert (0, 0, 0) not in identifiable_terms(2, 3, 3)
    assert (0, 0, 0) in identifiable_terms(2, 3, 4)


@pytest.mark.parametrize(
    ("name", "memory"),
    [("correlation", 8), ("least-squares", 8), ("regularised", 12), ("play", 12)],
)
def test_the_deviation_covers_the_error_that_noise_makes(name: str, memory: int) -> None:
    """A truth inside the class: a filter 0.5^i, noise of 30 %."""

    def plant(inputs: NDArray[np.floating]) -> Array:
        return lagged(np.asarray(inputs, np.float64), None, 12) @ (0.5 ** np.arange(12.0))

    fitted = estimator(name, memory).fit(period_of(plant, OCTAL, noise=0.3))
    inputs = RNG(10).choice([-1.0, 1.0], 600)
    error = (fitted.predict(inputs) - plant(inputs))[200:]
    deviation = fitted.standard_deviation(inputs)[200:]
    assert 0.3 < np.sqrt(np.mean(error**2) / np.mean(deviation**2)) < 3.0


@pytest.mark.parametrize("name", sorted(ESTIMATORS))
def test_every_estimator_keeps_its_contract(name: str) -> None:
    training = period_of(PLANTS["paper"], OCTAL, noise=0.02)
    chosen = estimator(name, 8)
    if isinstance(chosen, Hybrid):
        chosen = Hybrid(residual=PolynomialPrior(memory=8, subset=250))
    fitted = chosen.fit(training)
    inputs = RNG(11).choice([-1.0, 1.0], 300)
    whole = fitted.predict(inputs)
    assert whole.shape == fitted.standard_deviation(inputs).shape == (300,)
    np.testing.assert_allclose(fitted.predict(inputs[200:], inputs[:200]), whole[200:], atol=1e-6)
    assert np.all(fitted.standard_deviation(inputs) >= 0.0)
    assert all(np.isfinite(parameter.value) for parameter in fitted.parameters.values())
    assert fresh_vaf(fitted, PLANTS["paper"]) > 80.0


def test_the_matrix_marks_what_was_seen(paper_training: Training) -> None:
    fitted = {"play": FirPlay(memory=20).fit(paper_training)}
    inputs = unseen_inputs(3, polynomial="15341", samples=500)
    matrix = prediction_matrix(fitted, PLANTS["paper"], inputs, paper_training)
    assert matrix.inputs[0] == SAME
    assert matrix.seen == (True, *(False for _ in inputs))
    assert matrix.vaf_percent.shape == (1, 9)
    assert "other m-sequence" in matrix.numbers()["play"]
    assert matrix.vaf_percent[0, 1:].min() > 99.5


@pytest.mark.long
def test_figures_hold_a_band_sections_and_energies(paper_training: Training) -> None:
    posterior = RegularisedVolterra().fit(paper_training)
    assert isinstance(posterior, MultilinearPosterior)
    variance = float(np.var(paper_training.response))
    figures = posterior_figures(posterior, variance, 0.5)
    assert np.all(figures.g1_low <= figures.g1)
    assert np.all(figures.g1 <= figures.g1_high)
    assert np.all(np.isnan(np.diag(figures.g2)))
    section = figures.g3_section(2)
    np.testing.assert_array_equal(section, section.T)
    energies = figures.energies
    assert energies.linear_percent == pytest.approx(94.4, abs=1.0)
    assert 2.5 < energies.odd_percent < 6.0
    assert energies.even_percent < 0.5
    assert abs(energies.rest_percent) < 3.0
    plain = extract(paper_training.response, "15341", 1.0, 18)
    width = 2.0 * BAND_DEVIATIONS * plain.scatter / plain.amplitude
    assert (figures.g1_high - figures.g1_low).mean() < width
    np.testing.assert_allclose(figures.g1[: plain.memory], plain.g1, atol=width)


def broken(**changes: Array) -> dict[str, Array]:
    parts = {"inputs": np.ones(50), "response": np.ones(50), "history": np.zeros(5)}
    return {**parts, **changes}


@pytest.mark.parametrize(
    ("parts", "says"),
    [
        (broken(response=np.ones(49)), r"shape \(50,\) and the response \(49,\)"),
        (broken(response=np.full(50, np.nan)), "50 of 50 samples of the response are not numbers"),
        (broken(history=np.array([np.inf])), "1 of 1 samples of the history"),
    ],
)
def test_a_training_with_holes_is_refused(parts: dict[str, Array], says: str) -> None:
    with pytest.raises(FitError, match=says):
        Training(**parts)


def test_less_than_a_period_is_refused() -> None:
    with pytest.raises(FitError, match=r"\(4000,\): 15341 has periods of 4095 samples"):
        periodic_training(np.zeros(4000), "15341", 1.0)


def test_an_angle_is_refused_before_anything_is_fitted() -> None:
    chips = 150.0 * m_sequence("15341")
    angle = volterra_plants.servo_angle(np.tile(chips, 2), 1.5, 10_000)
    with pytest.raises(FitError, match=r"an angle .a velocity summed up. or a drift"):
        periodic_training(angle[-chips.size :], "15341", 150.0)


def test_a_reducible_polynomial_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"15343 .octal. is not primitive"):
        periodic_training(np.zeros(4095), "15343", 1.0)


def test_what_an_estimator_cannot_do_it_says() -> None:
    played = RNG(12).uniform(-1.0, 1.0, 200)
    training = Training(played, played.copy(), np.zeros(0))
    with pytest.raises(FitError, match="needs whole periods of a binary M-sequence"):
        estimator("correlation").fit(training)
    with pytest.raises(FitError, match="cannot be fitted to 200 samples"):
        LeastSquares(memory=14).fit(training)
    with pytest.raises(FitError, match="takes more than its memory"):
        PolynomialPrior(memory=300).fit(training)
    with pytest.raises(FitError, match="cannot fix 303 unknowns"):
        FirPlay(memory=300).fit(training)
    with pytest.raises(FitError, match="the response is constant"):
        RegularisedVolterra().fit(Training(played, np.ones(200), np.zeros(0)))
    with pytest.raises(ConfigError, match="no estimator 'magic': choose one of correlation"):
        estimator("magic")


def test_colliding_terms_are_refused_not_split() -> None:
    training = period_of(PLANTS["paper"], "2011")
    with pytest.raises(FitError, match="terms are sums of others on this input"):
        LeastSquares(memory=15).fit(training)
    with pytest.raises(FitError, match="beyond what 2011 can resolve"):
        estimator("correlation", 15).fit(training)
