"""What is wrong with a recording before any model is blamed: wild samples, a coarse angle."""

import math
from dataclasses import replace

import numpy as np
import pytest

from servo_bench.diagnosis.comparing.allowance import allowed
from servo_bench.diagnosis.comparing.comparison import Comparison, compare
from servo_bench.diagnosis.comparing.evidence import SCALES, block_z
from servo_bench.diagnosis.reading.hygiene import (
    lattice,
    spoilt_words,
    wild_samples,
    without_spoilt_words,
)
from servo_bench.diagnosis.reading.orders import motor_lines, torque_waves
from sim_rig.model import Model
from tests.fit_recordings import NOMINAL, nominal_with, recorded, with_channels

MODEL = Model(NOMINAL)
GAP_RAD = NOMINAL.backlash_gap_rad
SLOTS = 900


def compared(model: Model, seed: int) -> Comparison:
    return compare(recorded(model, seed, slots=SLOTS), MODEL, scales=SCALES)


def test_a_rigid_shaft_in_counts_has_no_wild_samples() -> None:
    rigid = Model(nominal_with(backlash_gap_rad=0.0))
    seen = recorded(rigid.with_effect("current_limit", limit_per_a=0.6), 18, noise_counts=0.2)
    assert wild_samples(compare(seen, rigid, scales=SCALES), rigid, 0.0) == 0


@pytest.mark.parametrize(
    ("rows", "wrong_rad", "counted"), [(1, 0.1, 12), (3, 0.1, 36), (3, 0.01, 0), (7, 0.1, 0)]
)
def test_words_that_interference_spoils_are_counted(
    rows: int, wrong_rad: float, counted: int
) -> None:
    """12 bursts: not those that a gap can make, nor an angle that stays for longer than a burst."""
    run = recorded(MODEL, 19, slots=SLOTS)
    angle = np.array(run["load_angle_rad"])
    first = np.linspace(100, angle.size - 100, 12).astype(np.int64)
    for k in range(rows):
        angle[first + k] += wrong_rad
    seen = compare(with_channels(run, load_angle_rad=angle), MODEL, scales=SCALES)
    assert wild_samples(seen, MODEL, MODEL.nominal.backlash_gap_rad) == counted


@pytest.mark.parametrize("channel", ["load_angle_rad", "motor_position_rad"])
def test_a_word_that_no_motion_can_be_did_not_come(channel: str) -> None:
    run = recorded(MODEL.with_effect("gravity_imbalance", torque_nm=0.03), 19, slots=SLOTS)
    angle = np.array(run[channel])
    np.testing.assert_array_equal(without_spoilt_words(run, GAP_RAD)[channel], angle)
    spoilt = angle.copy()
    spoilt[300] += 2.0 * math.pi
    spoilt[500:503] -= 40.0
    spoilt[700:] += 1.0  # it stays: counts were lost, and that is another matter
    kept = without_spoilt_words(with_channels(run, **{channel: spoilt}), GAP_RAD)[channel]
    assert np.flatnonzero(np.isnan(kept)).tolist() == [300, 500, 501, 502]
    assert np.nanmax(np.abs(kept[:700] - angle[:700])) == 0.0
    counted = [spoilt_words(with_channels(run, **{channel: it}), GAP_RAD) for it in (angle, spoilt)]
    assert counted == [0, 4]


def test_a_recording_that_mostly_rests_loses_no_motion() -> None:
    played = np.zeros(6000)
    played[3000:3050] = np.repeat(np.random.default_rng(2).choice([-6.0, 6.0], 25), 2)
    run = recorded(MODEL, 19, played=played)
    kept = without_spoilt_words(run, 0.0)
    for channel in ("load_angle_rad", "motor_position_rad"):
        np.testing.assert_array_equal(kept[channel], run[channel])


def test_one_spoilt_word_moves_no_allowance() -> None:
    run = recorded(MODEL, 20, slots=SLOTS)
    spoilt = np.array(run["load_angle_rad"])
    spoilt[400] += 2.0 * math.pi
    wrong = without_spoilt_words(with_channels(run, load_angle_rad=spoilt), GAP_RAD)
    right, mended = (allowed(compare(one, MODEL, scales=SCALES)) for one in (run, wrong))
    np.testing.assert_allclose(mended, right, rtol=0.02)


def test_a_coarse_angle_is_measured_by_its_lattice() -> None:
    coarse = math.radians(0.06)
    found = lattice(compared(MODEL.with_effect("quantisation", count_rad=coarse), 14), MODEL)
    assert found is not None
    assert found.quantum_rad == pytest.approx(coarse, rel=1e-3)
    assert lattice(compared(MODEL, 14), MODEL) is None


@pytest.mark.parametrize("quantum_rad", [2.55385e-3, 2.59231e-3, 2.74615e-3])
def test_where_a_multiple_lies_better_in_the_bins_the_lattice_is_told(quantum_rad: float) -> None:
    coarse = MODEL.with_effect("quantisation", count_rad=quantum_rad)
    found = lattice(compare(recorded(coarse, 31, slots=1000), MODEL, scales=SCALES), MODEL)
    assert found is not None
    assert found.quantum_rad == pytest.approx(quantum_rad, rel=1e-4)


def test_a_lattice_is_as_far_from_its_quantum_as_it_says() -> None:
    off = []
    for seed, quantum_rad in enumerate(np.geomspace(3.4e-4, 1.5e-3, 12).tolist(), 900):
        coarse = MODEL.with_effect("quantisation", count_rad=quantum_rad)
        found = lattice(compare(recorded(coarse, seed, slots=2000), MODEL, scales=SCALES), MODEL)
        assert found is not None
        off.append((found.quantum_rad - quantum_rad) / found.standard_error_rad)
    assert np.abs(off).max() < 3.5
    assert 0.5 < np.sqrt(np.mean(np.square(off))) < 1.5


def test_a_lattice_is_found_in_noise_of_a_third_of_its_quantum() -> None:
    quantum_rad = 3.5e-4
    noisy = with_channels(
        (clean := recorded(MODEL, 16, slots=2500, noise_counts=0.0)),
        load_angle_rad=_coarse(np.array(clean["load_angle_rad"]), quantum_rad, 0.3 * quantum_rad),
    )
    found = lattice(compare(noisy, MODEL, scales=SCALES), MODEL)
    assert found is not None
    assert found.quantum_rad == pytest.approx(quantum_rad, rel=1e-3)


def test_a_lattice_is_found_beneath_the_counts_of_an_encoder_without_noise() -> None:
    """Of 4.17 of its counts: every step is of four or five of them, and none of one."""
    quantum_rad, count_rad = 4e-4, math.tau / 65536
    clean = recorded(MODEL, 20, slots=2500, noise_counts=0.0)
    angle = np.rint(_coarse(np.array(clean["load_angle_rad"]), quantum_rad, 0.0) / count_rad)
    twice = with_channels(clean, load_angle_rad=angle * count_rad)
    found = lattice(compare(twice, MODEL, scales=SCALES), MODEL)
    assert found is not None
    assert found.quantum_rad == pytest.approx(quantum_rad, rel=1e-3)


@pytest.mark.parametrize("counts", [2.1, 2.3, 2.6, 3.3])
def test_a_lattice_of_little_more_than_two_counts_is_found(counts: float) -> None:
    """Where no line of the counts themselves, nor of the histogram's bins, is taken for one."""
    count_rad = math.tau / 65536
    clean = recorded(MODEL, 21, slots=2500, noise_counts=0.0)
    angle = np.array(clean["load_angle_rad"]) + 0.3 * count_rad * np.sin(
        np.arange(clean["slot"].size)
    )
    counted = np.rint(_coarse(angle, counts * count_rad, 0.0) / count_rad) * count_rad
    found = lattice(
        compare(with_channels(clean, load_angle_rad=counted), MODEL, scales=SCALES), MODEL
    )
    assert found is not None
    assert found.quantum_rad == pytest.approx(counts * count_rad, rel=1e-3)


@pytest.mark.parametrize("counts", [65536, 200000, 240000, 250000, 262144, 300000])
@pytest.mark.parametrize("noise_rad", [6e-5, 1.7e-4])
def test_no_lattice_stands_in_noise_on_the_counts_alone(counts: int, noise_rad: float) -> None:
    """Nor where the histogram's bins are nearly as wide as the counts."""
    clean = recorded(MODEL, 22, slots=2000, noise_counts=0.0)
    white = noise_rad * np.random.default_rng(16).standard_normal(clean["slot"].size)
    counted = np.rint((np.array(clean["load_angle_rad"]) + white) * counts / math.tau)
    seen = with_channels(clean, load_angle_rad=counted * math.tau / counts)
    assert lattice(compare(seen, MODEL, scales=SCALES), MODEL) is None


def test_a_spike_beyond_all_travel_takes_no_memory() -> None:
    clean = recorded(MODEL, 23, slots=400)
    angle = np.array(clean["load_angle_rad"])
    angle[100] = 4e5
    assert lattice(compare(with_channels(clean, load_angle_rad=angle), MODEL), MODEL) is None


def test_a_lattice_is_found_beside_a_word_that_was_spoilt() -> None:
    coarse = MODEL.with_effect("quantisation", count_rad=1e-3)
    angle = np.array(recorded(coarse, 14, slots=SLOTS)["load_angle_rad"])
    angle[100] = 4e5
    run = with_channels(recorded(coarse, 14, slots=SLOTS), load_angle_rad=angle)
    found = lattice(compare(run, MODEL, scales=SCALES), MODEL)
    assert found is not None
    assert found.quantum_rad == pytest.approx(1e-3, rel=1e-3)


def test_an_angle_that_is_but_partly_on_a_lattice_has_none() -> None:
    """A third of the rows, as chips of equal size leave it: of one that an encoder makes this noise
    leaves nine tenths."""
    clean, quantum_rad, noise_rad = recorded(MODEL, 17, slots=2500, noise_counts=0.0), 1.5e-3, 1e-4
    angle = np.array(clean["load_angle_rad"])
    angle[::3] = np.rint(angle[::3] / quantum_rad) * quantum_rad
    everywhere = _coarse(np.array(clean["load_angle_rad"]), quantum_rad, noise_rad)
    partly, all_of_it = (
        compare(with_channels(clean, load_angle_rad=a), MODEL, scales=SCALES)
        for a in (_noisy(angle, noise_rad), everywhere)
    )
    assert lattice(partly, MODEL) is None
    assert lattice(all_of_it, MODEL) is not None


def _coarse(angle_rad: np.ndarray, quantum_rad: float, noise_rad: float) -> np.ndarray:
    """A coarse encoder's angle with white noise that came after it."""
    return _noisy(np.rint(angle_rad / quantum_rad) * quantum_rad, noise_rad)


def _noisy(angle_rad: np.ndarray, noise_rad: float) -> np.ndarray:
    """With white noise, in counts of a finer encoder."""
    white = noise_rad * np.random.default_rng(16).standard_normal(angle_rad.size)
    count_rad = math.tau / 65536
    return np.rint((angle_rad + white) / count_rad) * count_rad


@pytest.mark.parametrize("order", [12.0, 24.0])
def test_a_torque_line_is_found_at_its_order(order: float) -> None:
    lines = motor_lines(
        compared(MODEL.with_effect("cogging", torque_nm=0.01, order=order), 15), MODEL
    )
    assert lines.torque[0].order == pytest.approx(order, abs=0.2)


@pytest.mark.parametrize("paused_at", [300, 860])
def test_a_torque_line_is_sought_in_the_piece_whose_shaft_it_is(paused_at: int) -> None:
    """A logger pauses: of what comes before and after, the longer part tells."""
    run = recorded(MODEL.with_effect("cogging", torque_nm=0.01, order=12.0), 15, slots=SLOTS)
    kept = {n: v for n, v in run.channels.items() if n not in ("slot", "phase", "asked_ns")}
    t_s = run.period_s * np.arange(len(run))
    t_s[paused_at:] += 0.5
    paused = compare(replace(run, channels={**kept, "t_s": t_s}), MODEL, scales=SCALES)
    assert len(paused.pieces) == 2
    assert motor_lines(paused, MODEL).torque[0].order == pytest.approx(12.0, abs=0.2)
    (wave,) = torque_waves(paused, MODEL, (12.0,))
    assert wave.torque_nm == pytest.approx(0.01, rel=0.25)


def test_strong_waves_of_three_orders_are_told_apart_by_size_and_phase() -> None:
    hidden = {24.0: (0.02, 0.6), 12.0: (0.01, -1.1), 8.0: (0.004, 2.5)}
    table: dict[str, float] = {}
    for which, (order, (torque_nm, phase_rad)) in zip(
        ("", "second_", "third_"), hidden.items(), strict=True
    ):
        table |= {
            f"{which}torque_nm": torque_nm,
            f"{which}order": order,
            f"{which}phase_rad": phase_rad,
        }
    seen = compared(MODEL.with_effect("cogging", **table), 15)
    found = [line.order for line in motor_lines(seen, MODEL).torque]
    assert sorted(found) == pytest.approx([8.0, 12.0, 24.0], abs=0.3)
    for wave in torque_waves(seen, MODEL, tuple(hidden)):
        torque_nm, phase_rad = hidden[wave.order]
        apart = abs(
            np.exp(1j * wave.phase_rad) * wave.torque_nm / torque_nm - np.exp(1j * phase_rad)
        )
        assert apart < 0.25


def test_the_advantage_of_nothing_over_itself_is_none() -> None:
    costs = np.random.default_rng(1).uniform(1.0, 2.0, 50)
    assert block_z(costs, costs) == 0.0


def test_an_advantage_that_every_block_has_is_beyond_chance() -> None:
    costs = np.random.default_rng(1).uniform(1.0, 2.0, 50)
    assert block_z(costs, costs + 1.0) > 10.0
    assert block_z(np.ones(50), np.full(50, 2.0)) > 10.0
    assert block_z(np.full(50, 2.0), np.ones(50)) < -10.0
