"""Labels, the folded diagonals, and orders told apart by amplitudes and by inverse repeat."""

from itertools import combinations_with_replacement, permutations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import fft

from servo_bench.errors import FitError
from servo_bench.excitation.msequence import m_sequence
from servo_bench.excitation.sequences import inverse_repeat
from servo_bench.kernels.labels import Label, element_labels, folded_third_order
from servo_bench.kernels.own_response import sequence_response
from servo_bench.kernels.separation import extract_inverse_repeat, separate_amplitudes
from servo_bench.kernels.transform import m_synthesis, m_transform
from servo_bench.kernels.volterra import extract
from tests.truth import volterra_plants

Array = NDArray[np.float64]

MEMORY = 7


class System:
    """Symmetric kernels up to order 3 with all diagonals, drawn by a seed."""

    def __init__(self, seed: int) -> None:
        rng = np.random.default_rng(seed)
        self.g0 = float(rng.normal())
        self.g1 = rng.normal(size=MEMORY)
        raw2, raw3 = rng.normal(size=(MEMORY,) * 2), rng.normal(size=(MEMORY,) * 3)
        self.g2 = (raw2 + raw2.T) / 2
        self.g3 = sum(raw3.transpose(p) for p in permutations(range(3))) / 6

    def output(self, inputs: Array) -> Array:
        """In the periodic steady state of `inputs`."""
        x = np.stack([np.roll(inputs, lag) for lag in range(MEMORY)], axis=1)
        second = np.einsum("ti,tj,ij->t", x, x, self.g2)
        third = np.einsum("ti,tj,tk,ijk->t", x, x, x, self.g3, optimize=True)
        return self.g0 + x @ self.g1 + second + third


@pytest.mark.parametrize("octal", ["7", "45", "103", "15341", "40473", "400011"])
def test_the_fast_transform_is_the_circular_correlation(octal: str) -> None:
    chips = m_sequence(octal).astype(float)
    y = np.random.default_rng(1).normal(size=chips.size)
    expected = fft.irfft(np.conj(fft.rfft(chips)) * fft.rfft(y), chips.size)
    np.testing.assert_allclose(m_transform(y, octal), expected, atol=1e-9)
    forth = fft.irfft(fft.rfft(chips) * fft.rfft(y), chips.size)
    np.testing.assert_allclose(m_synthesis(y, octal), forth, atol=1e-9)


def test_all_orders_are_one_convolution_on_their_own_sequence() -> None:
    system, chips = System(2), m_sequence("15341").astype(float)
    y = system.output(chips)
    phi = m_transform(y, "15341") / chips.size
    centred = (phi - np.median(phi)) * chips.size / (chips.size + 1)
    rebuilt = sequence_response(centred, "15341")
    np.testing.assert_allclose(rebuilt - rebuilt.mean(), y - y.mean(), atol=1e-10)


def test_what_one_amplitude_measures_is_g1_with_the_folded_diagonals() -> None:
    system, amplitude = System(3), 1.7
    response = system.output(amplitude * m_sequence("2011"))
    kernels = extract(response, "2011", amplitude, MEMORY)
    folded = folded_third_order(system.g3)
    np.testing.assert_allclose(kernels.g1, system.g1 + amplitude**2 * folded, atol=1e-12)
    brute = [
        system.g3[i, i, i] + 3 * sum(system.g3[i, q, q] for q in range(MEMORY) if q != i)
        for i in range(MEMORY)
    ]
    np.testing.assert_allclose(folded, brute, atol=1e-12)
    constant = system.g0 + amplitude**2 * np.trace(system.g2)
    assert kernels.constant == pytest.approx(constant, abs=1e-11)


def test_two_amplitudes_tell_g1_from_the_folded_diagonals() -> None:
    system, levels = System(4), (0.8, 2.0)
    responses = np.stack([system.output(a * m_sequence("2011")) for a in levels])
    found = separate_amplitudes(responses, levels, "2011", MEMORY)
    ascending = np.all(np.diff(np.indices(system.g3.shape), axis=0) > 0, axis=0)
    np.testing.assert_allclose(found.g1, system.g1, atol=1e-11)
    np.testing.assert_allclose(found.folded, folded_third_order(system.g3), atol=1e-11)
    np.testing.assert_allclose(found.g2, np.triu(system.g2, 1), atol=1e-11)
    np.testing.assert_allclose(found.g3, np.where(ascending, system.g3, 0.0), atol=1e-11)
    assert found.g0 == pytest.approx(system.g0, abs=1e-11)
    assert found.condition < 100.0


@pytest.mark.parametrize(
    ("levels", "says"),
    [
        ((1.0, 1.0), "two or more different amplitudes"),
        ((1.0, 1.0001), "too many or too close"),
        ((1.0,), "two or more different amplitudes"),
        ((1.0, 1.1, 1.2, 1.3, 1.4, 1.5), "Spread them over a factor of two"),
    ],
)
def test_amplitudes_that_separate_nothing_are_refused(levels: tuple[float, ...], says: str) -> None:
    with pytest.raises(FitError, match=says):
        separate_amplitudes(np.zeros((len(levels), 1023)), levels, "2011", 3)


def test_inverse_repeat_finds_the_same_kernels() -> None:
    system, amplitude = System(5), 1.3
    response = system.output(amplitude * inverse_repeat("2011"))
    mirrored = extract_inverse_repeat(np.stack([response, response]), "2011", amplitude, MEMORY)
    plain = extract(system.output(amplitude * m_sequence("2011")), "2011", amplitude, MEMORY)
    for name in ("c1", "c2", "c3", "constant"):
        np.testing.assert_allclose(getattr(mirrored, name), getattr(plain, name), atol=1e-11)
    assert mirrored.periods == 2
    assert mirrored.standard_error == pytest.approx(0.0, abs=1e-12)


def test_inverse_repeat_keeps_an_even_distortion_out_of_the_odd_orders() -> None:
    """A quartic term aliases into odd elements of a plain sequence, and not of this one."""
    chips = inverse_repeat("103").astype(float)
    x = np.stack([np.roll(chips, lag) for lag in range(6)], axis=1)
    kernels = extract_inverse_repeat(
        x[:, 0] + 3.0 * np.prod(x[:, [0, 1, 3, 5]], axis=1), "103", 1.0, 4
    )
    np.testing.assert_allclose(kernels.c1, [1.0, 0.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(kernels.c3, 0.0, atol=1e-12)


def test_a_half_period_of_inverse_repeat_is_refused() -> None:
    with pytest.raises(FitError, match="inverse-repeat period of 2011 has 2046 samples"):
        extract_inverse_repeat(np.zeros(1023), "2011", 1.0, 3)


@pytest.mark.parametrize(("octal", "memory", "aliased"), [("15341", 18, False), ("103", 8, True)])
def test_labels_say_aliased_exactly_where_columns_are_equal(
    octal: str, memory: int, aliased: bool
) -> None:
    labels = element_labels(octal, memory)
    assert (labels.count(Label.ALIASED) > 0) is aliased
    chips = m_sequence(octal)
    products: dict[bytes, list[tuple[int, ...]]] = {}
    for order in (1, 2, 3):
        for lags in combinations_with_replacement(range(min(memory, 8)), order):
            if len(set(lags)) == order:
                column = np.prod([np.roll(chips, lag) for lag in lags], axis=0)
                products.setdefault(column.tobytes(), []).append(lags)
    for group in products.values():
        for lags in group:
            label = (labels.order1, labels.order2, labels.order3)[len(lags) - 1][lags]
            assert (label == Label.ALIASED) == (len(group) > 1)


def test_labels_of_diagonals_are_sums_and_a_second_amplitude_frees_g1() -> None:
    one, two = (element_labels("15341", 10, amplitudes=k) for k in (1, 2))
    assert set(one.order1.tolist()) == {Label.SUM_ONLY}
    assert set(two.order1.tolist()) == {Label.IDENTIFIABLE}
    for labels in (one, two):
        assert set(np.diag(labels.order2).tolist()) == {Label.SUM_ONLY}
        assert labels.order3[3, 3, 5] == labels.order3[5, 3, 3] == Label.SUM_ONLY
        assert labels.order3[1, 2, 3] == labels.order3[3, 1, 2] == Label.IDENTIFIABLE
    assert one.count(Label.IDENTIFIABLE) == 45 + 120
    assert one.count(Label.SUM_ONLY) == 10 + 10 + 100


def test_inverse_repeat_labels_need_only_their_own_parity() -> None:
    plain = element_labels("103", 8)
    mirrored = element_labels("103", 8, inverse_repeat=True)
    assert mirrored.count(Label.ALIASED) < plain.count(Label.ALIASED)


def test_an_angle_is_refused_where_a_velocity_is_expected() -> None:
    chips = 150.0 * m_sequence("15341")
    angle = volterra_plants.servo_angle(np.tile(chips, 2), 1.5, 10_000)
    velocity = np.diff(angle) / 0.008
    kernels = extract(velocity[-chips.size :], "15341", 150.0, 18)
    assert np.abs(kernels.c1[12:]).max() < 0.1 * np.abs(kernels.c1).max()
    with pytest.raises(FitError, match=r"does not forget.*increments of the angle"):
        extract(angle[-chips.size :], "15341", 150.0, 18)
