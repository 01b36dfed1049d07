"""Seals hide what they are told to hide, show it only when opened, and play the same every time."""

import math
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from servo_bench.excitation.experiment import Experiment, MSequence, Phase
from tests.truth.catalogue import BY_NAME, IN_THE_CATALOGUE, OUTSIDE_THE_CATALOGUE
from tests.truth.effects import NONE
from tests.truth.hidden import Kind, draw, hide, nothing, record
from tests.truth.rigs import PAPER, drawn
from tests.truth.trying import PERIOD_S, VELOCITY_RAD_S

KINDS: tuple[Kind, ...] = ("gap", "one", "none", "outside", "pair")
INSIDE, OUTSIDE = ({h.name for h in t} for t in (IN_THE_CATALOGUE, OUTSIDE_THE_CATALOGUE))

SLOW = Experiment(
    name="slow",
    rig="none",
    period_s=0.5,
    memory=1,
    lead_in=1,
    standstill_s=0.0,
    identification=MSequence(polynomial="13", amplitude_rad_s=0.2, periods=2),
    validation=MSequence(polynomial="13", amplitude_rad_s=0.2),
)

QUICK = Experiment(
    name="quick",
    rig="none",
    period_s=PERIOD_S,
    memory=18,
    lead_in=32,
    standstill_s=2.0,
    identification=MSequence(polynomial="211", amplitude_rad_s=VELOCITY_RAD_S),
    validation=MSequence(polynomial="211", amplitude_rad_s=VELOCITY_RAD_S, length=64),
)


@pytest.mark.parametrize("seed", range(4))
def test_a_recording_holds_the_gap_that_was_sealed(seed: int) -> None:
    sealed = draw(seed)
    recording = record(sealed, SLOW, PAPER)
    twists_rad = recording["motor_position_rad"] - recording["load_angle_rad"]
    turned = twists_rad[1:]
    gap_rad = turned[turned > 0].mean() - turned[turned < 0].mean()
    assert gap_rad == pytest.approx(sealed.open().backlash_gap_rad(PAPER), rel=0.03)


def test_gaps_are_wrong_by_ten_to_forty_percent_both_ways() -> None:
    factors = np.array([draw(seed).open().gap_factor for seed in range(200)])
    errors = np.abs(factors - 1.0)
    assert errors.min() >= 0.1
    assert errors.max() <= 0.4
    assert 60 < np.count_nonzero(factors > 1.0) < 140
    assert np.unique(factors).size == factors.size


@pytest.mark.parametrize(
    ("kind", "names", "number"),
    [("one", INSIDE, 1), ("outside", OUTSIDE, 1), ("pair", INSIDE, 2), ("none", set(), 0)],
)
def test_every_kind_draws_its_own(kind: Kind, names: set[str], number: int) -> None:
    causes = [draw(seed, kind).open().causes for seed in range(600)]
    assert {len(found) for found in causes} == {number}
    counted = Counter(name for found in causes for name in found)
    assert set(counted) == names


def test_a_strength_is_drawn_from_its_range() -> None:
    for seed in range(300):
        for one in draw(seed, "one").open().drawn:
            hiding = BY_NAME[one.name]
            assert hiding.low <= abs(one.size) <= hiding.high
            assert one.size > 0.0 or hiding.signed
            assert set(one.fields) == {*hiding.phases, *hiding.choices}


def test_of_a_pair_nobody_takes_one_for_the_other_and_both_are_set_in_full() -> None:
    for seed in range(300):
        truth = draw(seed, "pair").open()
        accepted = truth.accepted
        assert accepted[0].isdisjoint(accepted[1])
        both = truth.effects(PAPER, VELOCITY_RAD_S)
        for name, strength in truth.strengths(PAPER, VELOCITY_RAD_S).items():
            assert getattr(both, BY_NAME[name].strength) == strength


def test_names_can_be_narrowed() -> None:
    among = ("cogging", "gravity")
    causes = {draw(seed, "one", among=among).open().causes[0] for seed in range(20)}
    assert causes == set(among)
    with pytest.raises(ValueError, match=r"give names of tests\.truth\.catalogue"):
        draw(1, "pair", among=("cogging",))
    with pytest.raises(ValueError, match="no second effect goes with"):
        draw(1, "pair", among=("asymmetric_friction", "load_torque"))


def test_effects_can_be_hidden_at_a_given_size() -> None:
    truth = hide(3, {"cogging": 5e-3, "backlash_width": -0.1}).open()
    effects = truth.effects(PAPER, VELOCITY_RAD_S)
    assert effects.cogging_nm == 5e-3
    assert effects.backlash_error_rad == -0.1 * PAPER.backlash_gap_rad
    assert truth.gap_factor == 0.9
    assert hide(3, {"cogging": 0.0}).open().effects(PAPER, VELOCITY_RAD_S) == NONE
    with pytest.raises(ValueError, match="no effect is called"):
        hide(3, {"coging": 1.0})


def test_what_the_command_sizes_needs_a_command() -> None:
    sealed = hide(3, {"current_limit": 2.0})
    limits = [sealed.plant(PAPER, v).effects.current_limit_per_a for v in (2.0, 4.0)]
    assert limits[0] == 2.0 * limits[1]
    with pytest.raises(ValueError, match="play an experiment that moves the axis"):
        sealed.plant(PAPER, 0.0)


def test_nothing_hides_nothing() -> None:
    opened = nothing(5).open()
    assert (opened.causes, opened.gap_factor) == ((), 1.0)
    assert opened.effects(PAPER, VELOCITY_RAD_S) == NONE


@pytest.mark.parametrize("kind", KINDS)
def test_a_seal_does_not_show_what_it_hides(kind: Kind) -> None:
    sealed = draw(7, kind)
    truth = sealed.open()
    shown = repr(sealed) + str(sealed) + repr(record(sealed, SLOW, PAPER).provenance)
    for one in truth.drawn:
        assert one.name not in shown
        assert f"{one.size:.3f}" not in shown


def test_a_seal_wants_a_gap_to_scale() -> None:
    no_gap = replace(PAPER, backlash_gap_rad=0.0)
    with pytest.raises(ValueError, match="give the nominal rig a gap above zero"):
        draw(1).plant(no_gap)
    assert draw(1, "none").plant(no_gap).outputs().load_angle_rad == 0.0


def test_a_recording_follows_its_schedule() -> None:
    schedule = QUICK.schedule()
    recording = record(draw(1), QUICK, PAPER)
    assert len(recording) == schedule.slots
    assert np.array_equal(recording["slot"], np.arange(schedule.slots))
    assert np.array_equal(recording["phase"], schedule.phase)
    assert np.array_equal(recording["chip"], schedule.chip)
    assert np.array_equal(recording["velocity_command_rad_s"], schedule.velocity_rad_s)
    assert np.all(np.diff(recording["asked_ns"]) == round(PERIOD_S * 1e9))
    assert recording.rig is None


def test_the_load_encoder_is_quantised_and_noisy() -> None:
    recording = record(nothing(1), QUICK, PAPER)
    counts = recording["load_angle_counts"]
    assert np.allclose(recording["load_angle_rad"], counts * math.tau / 65536)
    standstill = counts[QUICK.schedule().slots_of(Phase.STANDSTILL)]
    # White noise of one count and rounding: sqrt(1 + 1/12) = 1.04, here of 250 samples.
    assert standstill.std() == pytest.approx(1.04, rel=0.2)


@pytest.mark.parametrize("kind", KINDS)
def test_the_same_seal_plays_the_same_recording(kind: Kind) -> None:
    first, again, other = (record(draw(seed, kind), QUICK, PAPER) for seed in (1, 1, 2))
    assert all(np.array_equal(first[name], again[name]) for name in first.channels)
    assert not np.array_equal(first["load_angle_counts"], other["load_angle_counts"])


def test_rigs_are_drawn_within_their_ranges_and_differ() -> None:
    rigs = [drawn(seed) for seed in range(100)]
    for rig in rigs:
        per_inertia = rig.torque_constant_nm_per_a / rig.inertia_kg_m2
        wn = math.sqrt(rig.integral_gain_a_per_rad * per_inertia)
        zeta = rig.proportional_gain_a_s_per_rad * per_inertia / (2.0 * wn)
        assert 62.5 <= wn <= 100.0
        assert 0.4 <= zeta <= 0.8
        assert 1e-4 <= rig.inertia_kg_m2 <= 5e-4
        assert math.radians(0.5) <= rig.backlash_gap_rad <= math.radians(2.0)
    assert len(set(rigs)) == 100
    assert drawn(3) == rigs[3]


@pytest.mark.parametrize("seed", range(40))
def test_whatever_is_hidden_on_whatever_rig_it_plays(seed: int) -> None:
    rig = drawn(seed)
    kind: Kind = ("one", "outside", "pair", "one")[seed % 4]
    recording = record(draw(seed, kind), QUICK, rig)
    for channel in ("motor_position_rad", "motor_torque_nm", "load_angle_rad"):
        assert np.isfinite(recording[channel]).all()
    assert np.abs(recording["motor_torque_nm"]).max() < 2.0
    assert recording["motor_position_rad"].std() > 1e-3
