"""Extraction and prediction against multilinear systems that are summed by brute force."""

from collections.abc import Iterator
from itertools import combinations

import numpy as np
import pytest
from numpy.typing import NDArray

from servo_bench.errors import FitError
from servo_bench.excitation.msequence import m_sequence
from servo_bench.kernels.comparison import compare
from servo_bench.kernels.correlate import cross_correlation
from servo_bench.kernels.predict import BLOCK, predict, vaf_percent
from servo_bench.kernels.volterra import Kernels, extract

Array = NDArray[np.float64]
Terms = dict[tuple[int, ...], float]


def random_terms(memory: int, seed: int) -> Terms:
    """A coefficient for every set of up to three lags, the empty set included."""
    rng = np.random.default_rng(seed)
    return {
        lags: float(rng.normal())
        for order in range(4)
        for lags in combinations(range(memory), order)
    }


def summed(terms: Terms, inputs: Array, *, circular: bool) -> Array:
    """Every term written out: coefficient times the product of its delayed inputs."""
    output = np.zeros(inputs.size)
    for lags, coefficient in terms.items():
        product = np.ones(inputs.size)
        for lag in lags:
            delayed = np.roll(inputs, lag)
            delayed[:lag] = delayed[:lag] if circular else 0.0
            product = product * delayed
        output += coefficient * product
    return output


def measured_terms(kernels: Kernels) -> Iterator[tuple[tuple[int, ...], float]]:
    """The same terms as `extract` found them."""
    yield (), kernels.constant
    for array in (kernels.c1, kernels.c2, kernels.c3):
        for lags in combinations(range(kernels.memory), array.ndim):
            yield lags, float(array[lags])


@pytest.mark.parametrize(("polynomial", "memory"), [("15341", 12), ("15341", 18), ("40473", 21)])
def test_a_full_system_of_order_3_is_found_exactly(polynomial: str, memory: int) -> None:
    terms = random_terms(memory, seed=memory)
    chips = m_sequence(polynomial).astype(float)
    kernels = extract(summed(terms, chips, circular=True), polynomial, 1.0, memory)
    for lags, coefficient in measured_terms(kernels):
        assert coefficient == pytest.approx(terms[lags], abs=1e-12), lags
    assert kernels.scatter < 1e-12
    assert kernels.standard_error is None


def test_an_offset_changes_the_constant_and_nothing_else() -> None:
    response = summed(random_terms(10, 1), m_sequence("15341").astype(float), circular=True)
    plain, lifted = (extract(y, "15341", 1.0, 10) for y in (response, response + 5.0))
    assert lifted.constant - plain.constant == pytest.approx(5.0, abs=1e-12)
    np.testing.assert_allclose(lifted.c1, plain.c1, atol=1e-12)
    np.testing.assert_allclose(lifted.c3, plain.c3, atol=1e-12)


def test_the_transform_is_the_sum_that_defines_it() -> None:
    rng = np.random.default_rng(2)
    response = rng.normal(size=63)
    chips = m_sequence("103").astype(float)
    expected = [np.mean(np.roll(chips, k) * response) for k in range(63)]
    np.testing.assert_allclose(cross_correlation(response, "103"), expected, atol=1e-14)


def test_the_other_sign_convention_flips_the_even_orders_alone() -> None:
    """Played with bit 1 as +1, u becomes -u: c1 and c3 change their sign, c2 does not.

    Relative to the linear kernel, which a reader's sign fixes, the even orders flip.
    """
    terms = random_terms(8, 3)
    chips = m_sequence("15341").astype(float)
    right = extract(summed(terms, chips, circular=True), "15341", 1.0, 8)
    flipped = extract(-summed(terms, -chips, circular=True), "15341", 1.0, 8)
    np.testing.assert_allclose(flipped.c1, right.c1, atol=1e-12)
    np.testing.assert_allclose(flipped.c2, -right.c2, atol=1e-12)
    np.testing.assert_allclose(flipped.c3, right.c3, atol=1e-12)


def test_symmetric_kernels_rebuild_the_response_on_other_binary_input() -> None:
    """g2 and g3 with their factorials, summed over all ordered lags, and g1 at its amplitude."""
    amplitude, memory = 2.5, 6
    terms = random_terms(memory, 4)
    kernels = extract(
        summed(terms, m_sequence("2011").astype(float), circular=True), "2011", amplitude, memory
    )
    signs = np.random.default_rng(5).choice([-1.0, 1.0], 300)
    command = amplitude * np.stack([np.roll(signs, lag) for lag in range(memory)], axis=1)
    g2 = np.nan_to_num(kernels.g2_matrix)
    g3 = np.nan_to_num(np.stack([kernels.g3_section(k) for k in range(memory)], axis=2))
    rebuilt = (
        kernels.constant
        + command @ kernels.g1
        + np.einsum("ti,tj,ij->t", command, command, g2)
        + np.einsum("ti,tj,tk,ijk->t", command, command, command, g3, optimize=True)
    )
    np.testing.assert_allclose(rebuilt, summed(terms, signs, circular=True), atol=1e-10)
    np.testing.assert_allclose(g3, g3.transpose(2, 0, 1), atol=1e-15)
    assert kernels.g3(4, 0, 2) == pytest.approx(terms[0, 2, 4] / (6.0 * amplitude**3))
    assert kernels.g2(3, 1) == pytest.approx(terms[1, 3] / (2.0 * amplitude**2))


def test_what_binary_input_cannot_identify_is_nan() -> None:
    kernels = extract(np.random.default_rng(6).normal(size=4095), "15341", 1.0, 5)
    section = kernels.g3_section(1)
    unknown = np.eye(5, dtype=bool)
    unknown[1, :] = unknown[:, 1] = True
    np.testing.assert_array_equal(np.isnan(section), unknown)
    np.testing.assert_array_equal(np.isnan(kernels.g2_matrix), np.eye(5, dtype=bool))
    assert np.isnan(kernels.g3(2, 2, 3))


def test_energies_are_the_variances_of_random_binary_input() -> None:
    terms = random_terms(7, 7)
    chips = m_sequence("15341").astype(float)
    kernels = extract(summed(terms, chips, circular=True), "15341", 1.0, 7)
    signs = np.array(np.meshgrid(*[[-1.0, 1.0]] * 7)).reshape(7, -1)  # all 128, so exact
    for order in (1, 2, 3):
        output = sum(
            coefficient * np.prod(signs[list(lags)], axis=0)
            for lags, coefficient in terms.items()
            if len(lags) == order
        )
        assert kernels.energies[order] == pytest.approx(float(np.var(output)))


def test_the_standard_error_is_the_scatter_of_repeated_measurements() -> None:
    rng = np.random.default_rng(8)
    noise, periods = 0.3, 4
    clean = summed(random_terms(6, 8), m_sequence("2011").astype(float), circular=True)
    drawn = [
        extract(clean + rng.normal(0.0, noise, (periods, clean.size)), "2011", 1.0, 6)
        for _ in range(40)
    ]
    found = np.std([[*k.c1, *k.c2[np.triu_indices(6, 1)]] for k in drawn], axis=0).mean()
    told = np.mean([k.standard_error for k in drawn if k.standard_error is not None])
    assert told == pytest.approx(noise / np.sqrt(periods * 1023), rel=0.02)
    assert found == pytest.approx(told, rel=0.1)
    assert np.mean([k.scatter for k in drawn]) == pytest.approx(told, rel=0.1)
    assert drawn[0].periods == periods


@pytest.mark.parametrize("length", [1, 50, BLOCK, BLOCK + 3])
def test_predictions_are_the_sums_written_out(length: int) -> None:
    terms = random_terms(6, 9)
    kernels = extract(
        summed(terms, m_sequence("2011").astype(float), circular=True), "2011", 1.0, 6
    )
    inputs = np.random.default_rng(10).uniform(-1.0, 1.0, length + 9)
    for order in (1, 2, 3):
        kept = {lags: value for lags, value in terms.items() if len(lags) <= order}
        expected = summed(kept, inputs, circular=False)
        np.testing.assert_allclose(predict(kernels, inputs, order), expected, atol=1e-11)
        np.testing.assert_allclose(
            predict(kernels, inputs[9:], order, history=inputs[:9]), expected[9:], atol=1e-11
        )


def test_a_short_history_is_preceded_by_rest() -> None:
    kernels = extract(np.random.default_rng(11).normal(size=1023), "2011", 1.0, 6)
    inputs = np.random.default_rng(12).choice([-1.0, 1.0], 20)
    np.testing.assert_allclose(
        predict(kernels, inputs[2:], history=inputs[:2]), predict(kernels, inputs)[2:], atol=1e-14
    )
    assert predict(kernels, np.zeros(0)).shape == (0,)


def test_a_memory_of_one_sample_is_a_gain() -> None:
    chips = m_sequence("2011").astype(float)
    kernels = extract(3.0 + 2.0 * chips, "2011", 4.0, 1)
    assert kernels.g1 == pytest.approx([0.5])
    np.testing.assert_allclose(predict(kernels, chips), 3.0 + 2.0 * chips)


def test_kernels_reproduce_the_period_they_came_from() -> None:
    terms = random_terms(9, 13)
    chips = m_sequence("15341").astype(float)
    response = summed(terms, chips, circular=True)
    compared = compare(extract(response, "15341", 1.0, 9), response, chips, chips)
    assert compared.vaf_order3_percent == pytest.approx(100.0)
    assert compared.vaf_order1_percent < 50.0


def test_vaf_knows_a_perfect_a_useless_and_a_senseless_prediction() -> None:
    y = np.random.default_rng(14).normal(size=1000)
    assert vaf_percent(y, y + 7.0) == pytest.approx(100.0)
    assert vaf_percent(y, np.zeros(1000)) == pytest.approx(0.0)
    assert vaf_percent(y, -y) == pytest.approx(-300.0)
    assert np.isnan(vaf_percent(np.ones(3), y[:3]))


@pytest.mark.parametrize(
    ("shape", "memory", "order", "says"),
    [
        ((4095,), 19, 3, "from 19 samples on, .* at most 18, a lower order, or a polynomial"),
        ((4095,), 32, 2, "at most 31"),
        ((4095,), 0, 3, "give at least 1"),
        ((4095,), 10, 4, r"order 4 were asked for: orders \(1, 2, 3\)"),
        ((4000,), 10, 3, r"\(4000,\): 15341 has periods of 4095 samples"),
        ((2, 2, 4095), 10, 3, "Cut the response to whole periods"),
    ],
)
def test_what_cannot_be_extracted_is_refused(
    shape: tuple[int, ...], memory: int, order: int, says: str
) -> None:
    with pytest.raises(FitError, match=says):
        extract(np.zeros(shape), "15341", 1.0, memory, order)


def test_holes_in_the_response_are_refused() -> None:
    response = np.zeros(4095)
    response[7] = np.nan
    with pytest.raises(FitError, match="1 samples of the response are not numbers"):
        extract(response, "15341", 1.0, 10)


def test_a_sequence_without_an_empty_shift_has_no_baseline() -> None:
    with pytest.raises(FitError, match="no shift of 7 is empty"):
        extract(np.zeros(3), "7", 1.0, 3, 1)


def test_an_order_that_was_not_measured_is_not_predicted() -> None:
    kernels = extract(np.random.default_rng(15).normal(size=4095), "15341", 1.0, 25, order=2)
    assert not kernels.c3.any()
    with pytest.raises(FitError, match="measured up to order 2"):
        predict(kernels, np.ones(5), 3)
