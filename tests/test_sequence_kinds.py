"""The kinds of sequences: what each is by definition, and that all of them can be played."""

from itertools import combinations_with_replacement

import numpy as np
import pytest
from pydantic import TypeAdapter

from servo_bench.errors import ConfigError
from servo_bench.excitation.experiment import Experiment, Phase, experiment_from_table
from servo_bench.excitation.fields import field_sequence, first_primitive
from servo_bench.excitation.msequence import m_sequence
from servo_bench.excitation.sequences import (
    FieldSequence,
    InverseRepeat,
    MSequence,
    MultiAmplitude,
    RandomUniform,
    Sequence,
    inverse_repeat,
)

KINDS = [
    {"polynomial": "103", "amplitude_rad_s": 2.0},
    {"kind": "m-sequence", "polynomial": "103", "amplitude_rad_s": 2.0, "bias_rad_s": 0.5},
    {"kind": "random-binary", "seed": 1, "amplitude_rad_s": 2.0, "length": 50},
    {"kind": "random-uniform", "seed": 1, "amplitude_rad_s": 2.0, "length": 50},
    {"kind": "inverse-repeat", "polynomial": "103", "amplitude_rad_s": 2.0, "periods": 2},
    {"kind": "field", "field": 3, "degree": 4, "amplitude_rad_s": 2.0, "bias_rad_s": -0.25},
    {"kind": "multi-amplitude", "polynomial": "103", "amplitudes_rad_s": [2.0, 1.0, 0.5]},
]


@pytest.mark.parametrize(("field", "degree"), [(3, 2), (3, 5), (3, 8), (5, 2), (5, 3), (5, 5)])
def test_a_field_sequence_has_all_words_no_mean_and_a_mirrored_half(
    field: int, degree: int
) -> None:
    chips = field_sequence(field, first_primitive(field, degree))
    period = field**degree - 1
    assert chips.shape == (period,)
    assert chips.max() == 1.0 == -chips.min()
    assert np.unique(chips).size == field
    assert chips.sum() == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_array_equal(np.roll(chips, -(period // 2)), -chips)
    windows = np.stack([np.roll(chips, -i) for i in range(degree)], axis=1)
    assert len(np.unique(windows, axis=0)) == period


def test_a_field_sequence_obeys_its_polynomial() -> None:
    polynomial = first_primitive(5, 4)
    residues = np.rint(field_sequence(5, polynomial) * 2).astype(int) % 5
    digits = [int(digit) for digit in polynomial]
    recurrence = sum(a * np.roll(residues, -(4 - i)) for i, a in enumerate(digits))
    assert not np.any(recurrence % 5)


def test_five_levels_tell_every_element_of_order_3_apart() -> None:
    """Persistently exciting: the columns of all products of up to three lags are independent."""
    chips = field_sequence(5, first_primitive(5, 5))
    lags = np.stack([np.roll(chips, i) for i in range(5)], axis=1)
    terms = [t for m in range(4) for t in combinations_with_replacement(range(5), m)]
    columns = np.stack([np.prod(lags[:, list(t)], axis=1) for t in terms], axis=1)
    assert np.linalg.matrix_rank(columns) == len(terms)


@pytest.mark.parametrize("octal", ["13", "103", "2011"])
def test_inverse_repeat_is_mirrored_and_white_on_its_odd_lags(octal: str) -> None:
    chips = inverse_repeat(octal).astype(int)
    half = chips.size // 2
    np.testing.assert_array_equal(chips[half:], -chips[:half])
    np.testing.assert_array_equal(chips[:half:2], m_sequence(octal)[::2])
    products = [int(chips @ np.roll(chips, k)) for k in range(1, half)]
    assert {abs(product) for product in products} == {2}


@pytest.mark.parametrize("table", KINDS, ids=lambda table: str(table.get("kind", "bare")))
def test_every_kind_survives_its_own_table_and_stays_within_its_amplitude(
    table: dict[str, object],
) -> None:
    adapter = TypeAdapter(Sequence)
    sequence = adapter.validate_python(table)
    assert adapter.validate_python(sequence.model_dump(mode="json")) == sequence
    velocity = sequence.velocity_rad_s()
    assert velocity.shape == sequence.chips().shape
    assert np.abs(velocity - sequence.bias_rad_s).max() <= 2.0 + 1e-12


def test_amplitudes_follow_one_another_each_led_in() -> None:
    levels = MultiAmplitude(
        kind="multi-amplitude", polynomial="103", amplitudes_rad_s=(0.5, 2.0), settling=20
    )
    velocity, period = levels.velocity_rad_s(), m_sequence("103")
    for start, amplitude in zip(levels.period_starts(), (0.5, 2.0), strict=True):
        np.testing.assert_allclose(velocity[start : start + 63], amplitude * period)
        np.testing.assert_allclose(velocity[start - 20 : start], amplitude * period[-20:])
    assert velocity.size == 2 * (20 + 63)


@pytest.mark.parametrize("table", KINDS, ids=lambda table: str(table.get("kind", "bare")))
def test_every_kind_can_be_played_as_validation(table: dict[str, object]) -> None:
    experiment = experiment_from_table(_experiment(KINDS[0], table), "test")
    schedule = experiment.schedule()
    played = schedule.velocity_rad_s[schedule.slots_of(Phase.VALIDATION)]
    np.testing.assert_array_equal(played, experiment.validation.velocity_rad_s())


@pytest.mark.parametrize("table", [KINDS[1], *KINDS[4:]], ids=lambda t: str(t["kind"]))
def test_what_repeats_can_be_identified_with_and_is_led_in(table: dict[str, object]) -> None:
    experiment = experiment_from_table(_experiment(table, KINDS[2]), "test")
    schedule = experiment.schedule()
    played = experiment.identification.velocity_rad_s()
    lead_in = schedule.velocity_rad_s[schedule.slots_of(Phase.LEAD_IN)]
    np.testing.assert_allclose(lead_in, played[-20:])
    again = Experiment.model_validate(experiment.model_dump(mode="json"))
    assert again == experiment


def test_random_input_cannot_identify() -> None:
    with pytest.raises(ConfigError, match="random-binary"):
        experiment_from_table(_experiment(KINDS[2], KINDS[2]), "test")


@pytest.mark.parametrize("kind", KINDS[2:4], ids=lambda kind: str(kind["kind"]))
def test_a_negative_seed_is_refused(kind: dict[str, object]) -> None:
    with pytest.raises(ConfigError, match=r"validation\..*seed.* got -1"):
        experiment_from_table(_experiment(KINDS[0], {**kind, "seed": -1}), "test")


def _experiment(
    identification: dict[str, object], validation: dict[str, object]
) -> dict[str, object]:
    return {
        "name": "played",
        "rig": "none",
        "period_s": 0.008,
        "memory": 5,
        "lead_in": 20,
        "identification": identification,
        "validation": validation,
    }


def test_random_levels_are_drawn_by_their_seed() -> None:
    one, two = (
        RandomUniform(kind="random-uniform", seed=s, amplitude_rad_s=1.0, length=1000)
        for s in (1, 2)
    )
    np.testing.assert_array_equal(one.chips(), one.chips())
    assert not np.array_equal(one.chips(), two.chips())
    assert one.chips().std() == pytest.approx(1 / np.sqrt(3), rel=0.05)


def test_a_bias_moves_the_middle() -> None:
    sequence = MSequence(polynomial="103", amplitude_rad_s=2.0, bias_rad_s=0.5)
    assert set(sequence.velocity_rad_s().tolist()) == {2.5, -1.5}


@pytest.mark.parametrize(
    ("field", "polynomial", "says"),
    [
        (7, "11", "use GF.3. or GF.5."),
        (3, "1a1", "each 0 to 2"),
        (3, "211", "the first 1"),
        (3, "11", "degrees from 2"),
        (3, "1" + "0" * 20 + "1", "periods up to"),
        (3, "101", r"not primitive.*period 8. One that is: 112"),
        (5, "100", "not primitive"),
    ],
)
def test_a_polynomial_that_is_none_over_its_field_is_refused(
    field: int, polynomial: str, says: str
) -> None:
    with pytest.raises(ConfigError, match=says):
        field_sequence(field, polynomial)


def test_a_field_sequence_without_degree_or_polynomial_is_refused() -> None:
    bare = FieldSequence(kind="field", field=3, amplitude_rad_s=1.0)
    with pytest.raises(ConfigError, match="degrees from 2"):
        bare.chips()


def test_a_reducible_polynomial_is_refused_in_every_binary_kind() -> None:
    for sequence in (
        InverseRepeat(kind="inverse-repeat", polynomial="15343", amplitude_rad_s=1.0),
        MultiAmplitude(kind="multi-amplitude", polynomial="15343", amplitudes_rad_s=(1.0, 2.0)),
    ):
        with pytest.raises(ConfigError, match=r"15343 .octal. is not primitive"):
            sequence.velocity_rad_s()
