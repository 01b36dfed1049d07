"""Fits of the model's own simulations: the numbers that made them must come out, and their errors.

One count of white noise in 65536 on both encoders; 400 slots of 8 ms. No tuning on these seeds: the
bounds are those of a normal deviate.
"""

import math

import numpy as np
import pytest

from servo_bench.diagnosis.fitting.fit import Fit, fit
from servo_bench.recording.recording import Recording
from sim_rig.model import Model, mechanics
from tests import fit_recordings as made

FREE = ("K_P", "gap", "coulomb.torque_nm")
TRUE = {
    "K_P": 1.1 * made.NOMINAL.proportional_gain_a_s_per_rad,
    "gap": 1.2 * made.NOMINAL.backlash_gap_rad,
    "coulomb.torque_nm": 6e-3,
}
SEEDS = 32


def truth() -> Model:
    nominal = made.nominal_with(proportional_gain_a_s_per_rad=1.1, backlash_gap_rad=1.2)
    return Model(nominal).with_effect("coulomb", torque_nm=TRUE["coulomb.torque_nm"])


def deviations(found: Fit, true: dict[str, float]) -> list[float]:
    """Error over standard error, number by number."""
    return [(found[k].value - value) / found[k].standard_error for k, value in true.items()]


def within(found: Fit, true: dict[str, float], most: float = 3.0) -> None:
    assert found.converged, found.reason
    assert np.abs(deviations(found, true)).max() < most, (found.estimates, true)


@pytest.mark.long
@pytest.mark.parametrize("channels", [("load_angle_rad",)])
def test_standard_errors_cover_the_truth_as_they_say(channels: tuple[str, ...]) -> None:
    """Two standard errors of 96 in all should hold 95 %; 88 % is three binomial deviations off."""
    scores = np.array(
        [
            deviations(
                fit(
                    made.recorded(truth(), seed, slots=400, channels=channels),
                    Model(made.NOMINAL),
                    FREE,
                ),
                TRUE,
            )
            for seed in range(SEEDS)
        ]
    )
    assert (np.abs(scores) < 2.0).mean() > 0.88
    assert (np.abs(scores) < 3.0).mean() > 0.97
    assert 0.6 < scores.std() < 1.4
    assert np.abs(scores.mean(axis=0)).max() < 4.0 / math.sqrt(SEEDS)


def test_without_noise_the_numbers_are_exact() -> None:
    recording = made.recorded(truth(), 1, noise_counts=0.0)
    found = fit(recording, Model(made.NOMINAL), FREE)
    for name, value in TRUE.items():
        assert found[name].value == pytest.approx(value, rel=2e-3)
    assert found.gain > 0.9


def test_the_fit_of_what_is_right_already_changes_nothing() -> None:
    found = fit(made.recorded(truth(), 5), truth(), FREE)
    within(found, TRUE)
    assert abs(found.gain) < 0.05


def test_holes_and_uneven_slots_cost_their_own_samples_only() -> None:
    whole = made.recorded(truth(), 3, jitter_s=1e-3)
    angle = np.array(whole["load_angle_rad"])
    angle[[120, 250, 251]] = np.nan
    holes = np.array([150, 151, 300])
    kept = np.setdiff1d(np.arange(len(whole)), holes)
    # What a skipped slot does: the command before it was held, and no sample came.
    held = np.array(whole["velocity_command_rad_s"])
    for hole in holes.tolist():
        held[hole] = held[hole - 1]
    asked_s = np.array(whole["asked_ns"]) * 1e-9
    done = truth().simulate(held, np.append(np.diff(asked_s), made.PERIOD_S))
    noise = 1e-4 * np.random.default_rng(9).standard_normal((2, held.size))
    recording = made.with_channels(
        whole,
        velocity_command_rad_s=held,
        load_angle_rad=done.load_angle_rad + noise[0] + 0.0 * angle,
        motor_position_rad=done.motor_angle_rad + noise[1],
        motor_torque_nm=0.03606 * done.motor_current_a,
    )
    within(fit(made.rows(recording, kept), Model(made.NOMINAL), FREE), TRUE, 3.5)


def test_a_phase_is_found_with_its_strength() -> None:
    true = Model(made.NOMINAL).with_effect("cogging", torque_nm=8e-3, order=12.0, phase_rad=2.5)
    start = Model(made.NOMINAL).with_effect("cogging", order=12.0)
    found = fit(made.recorded(true, 2), start, ("cogging.torque_nm", "cogging.phase_rad"))
    within(found, {"cogging.torque_nm": 8e-3, "cogging.phase_rad": 2.5})


def test_an_effect_that_is_not_there_ends_near_zero_and_says_so_or_is_within_its_error() -> None:
    found = fit(made.recorded(truth(), 4), truth(), ("viscous.damping_nm_s_per_rad",))
    estimate = found["viscous.damping_nm_s_per_rad"]
    assert abs(estimate.value) < 3.0 * estimate.standard_error
    assert (estimate.value == pytest.approx(0.0, abs=1e-12)) == any(
        "zero" in n for n in found.notes
    )


@pytest.mark.parametrize("channels", [made.RUN, ("load_angle_rad",)])
def test_torque_constant_and_inertia_are_called_inseparable(channels: tuple[str, ...]) -> None:
    """With the drive's own current too: K_T i = J dw/dt knows K_T/J alone."""
    true = Model(made.nominal_with(inertia_kg_m2=1.2))
    found = fit(made.recorded(true, 6, channels=channels), Model(made.NOMINAL), ("K_T", "J"))
    assert found.correlation[0, 1] > 0.95
    (note,) = found.notes
    assert note.startswith("K_T and J cannot be told apart without a known torque")
    assert found["J"].standard_error > 0.1 * found["J"].value
    ratio = found["J"].value / found["K_T"].value
    assert ratio == pytest.approx(1.2 * 2.5e-4 / 0.03606, rel=2e-3)


def test_a_known_torque_parts_them() -> None:
    """Friction that the model knows beforehand is a torque that somebody measured."""
    found = fit(made.recorded(truth(), 8), truth(), ("K_T", "J"))
    within(found, {"K_T": 0.03606, "J": 2.5e-4})
    assert found["K_T"].standard_error < 0.01 * found["K_T"].value


def test_with_one_of_them_known_the_other_is_found() -> None:
    true = Model(made.nominal_with(inertia_kg_m2=1.2))
    within(fit(made.recorded(true, 7), Model(made.NOMINAL), ("J",)), {"J": 1.2 * 2.5e-4})


def test_the_prior_counts_where_the_recording_is_silent_and_nowhere_else() -> None:
    model, pair = Model(made.NOMINAL), ("K_T", "J")
    recording = made.recorded(model, 8)
    alone, believed = fit(recording, model, pair), fit(recording, model, pair, prior=True)
    assert believed["K_T"].standard_error < 0.5 * alone["K_T"].standard_error
    assert believed["K_T"].value == pytest.approx(0.03606, rel=0.02)
    within(fit(made.recorded(truth(), 8), model, FREE, prior=True), TRUE, 3.5)


def current_driven(seed: int, model: Model) -> Recording:
    """Current in, motor angle out, at 1 kHz: an open axis whose position drifts."""
    rng = np.random.default_rng(seed)
    t_s = np.arange(8000) * 1e-3
    current = 0.5 * np.sin(2.0 * math.pi * 1.0 * t_s) + 0.3 * np.sin(2.0 * math.pi * 3.3 * t_s)
    motion = mechanics(model, np.diff(t_s), current, velocity_rad_s=-10.0)
    quantum = math.tau / made.COUNTS
    angle = np.rint(motion.angle_rad / quantum + rng.standard_normal(t_s.size)) * quantum
    return Recording(
        channels={"t_s": t_s, "current_a": current, "motor_position_rad": angle},
        period_s=1e-3,
        experiment=None,
        rig=None,
        provenance={},
    )


def test_mechanics_are_fitted_in_windows_from_the_measured_state() -> None:
    true = Model(made.nominal_with(inertia_kg_m2=1.3)).with_effect("coulomb", torque_nm=5e-3)
    recording = current_driven(1, true)
    found = fit(recording, Model(made.NOMINAL), ("J", "coulomb.torque_nm"))
    assert (found.block, found.window_s) == ("mechanics", 1.0)
    within(found, {"J": 1.3 * 2.5e-4, "coulomb.torque_nm": 5e-3}, 4.0)
    assert found["J"].standard_error < 0.01 * found["J"].value


@pytest.mark.parametrize("window_s", [None, 1.0])
def test_the_transmission_is_fitted_alone(window_s: float | None) -> None:
    recording = made.recorded(truth(), 11, period_s=0.002, slots=2000)
    found = fit(recording, Model(made.NOMINAL), ("gap",), block="transmission", window_s=window_s)
    assert found.block == "transmission"
    assert found["gap"].value == pytest.approx(TRUE["gap"], rel=0.01)


def test_the_controller_is_fitted_alone() -> None:
    recording = made.recorded(truth(), 12, period_s=0.002, slots=1500, noise_counts=0.05)
    found = fit(recording, Model(made.NOMINAL), ("K_P", "K_I"), block="controller")
    assert found["K_P"].value == pytest.approx(TRUE["K_P"], rel=0.02)
    assert found["K_I"].value == pytest.approx(made.NOMINAL.integral_gain_a_per_rad, rel=0.02)


def test_another_recording_can_judge() -> None:
    first, second = made.recorded(truth(), 13), made.recorded(truth(), 14)
    found = fit(first, Model(made.NOMINAL), FREE, held_out=second)
    own = fit(first, Model(made.NOMINAL), FREE)
    assert found.estimates == own.estimates
    assert found.gain > 0.8
    assert found.signals[0].held_out_before != own.signals[0].held_out_before
