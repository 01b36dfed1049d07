"""A channel that is counted the other way, or read at another time, is told in words."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lsim

from servo_bench.diagnosis.comparing.allowance import SCALES
from servo_bench.diagnosis.comparing.comparison import compare
from servo_bench.diagnosis.comparing.low_pass import low_passed
from servo_bench.diagnosis.comparing.rows import Array
from servo_bench.diagnosis.concluding import conclude
from servo_bench.diagnosis.judging.sensors import misread
from servo_bench.diagnosis.reading.channels import rows_ahead, wrap_steps
from servo_bench.recording.recording import Recording
from sim_rig.model import Model
from tests.fit_recordings import NOMINAL, PERIOD_S, recorded

MODEL = Model(NOMINAL)
RUBBING = MODEL.with_effect("coulomb", torque_nm=0.01)
SLOTS = 500


def logged(seed: int, rig: Model = RUBBING, slots: int = SLOTS) -> Recording:
    """What a logger has of a rig that rubs more than its file says."""
    played = np.random.default_rng(seed).uniform(-4.0, 4.0, slots)
    run = recorded(rig, seed, played=played)
    names = ("velocity_command_rad_s", "motor_position_rad", "motor_torque_nm", "load_angle_rad")
    channels = {"t_s": PERIOD_S * np.arange(slots), **{name: run[name] for name in names}}
    return replace(run, channels=channels)


def with_channel(recording: Recording, name: str, values: Array) -> Recording:
    return replace(recording, channels={**recording.channels, name: values})


def told(recording: Recording, rig: Model = RUBBING) -> list[str]:
    return list(misread(compare(recording, MODEL, scales=SCALES), MODEL, rig))


def late(values: Array, rows: int) -> Array:
    return np.concatenate([np.full(rows, values[0]), values[:-rows]])


def test_channels_that_are_the_rigs_own_are_not_spoken_of() -> None:
    assert told(logged(41)) == []


@pytest.mark.parametrize("scale", [-1.0, 0.1, 2.0])
def test_an_angle_of_another_size_or_sign_is_told(scale: float) -> None:
    run = logged(42)
    (sentence,) = told(with_channel(run, "load_angle_rad", scale * run["load_angle_rad"]))
    assert sentence.startswith("The load's angle moves")
    assert float(sentence.split()[4]) == pytest.approx(scale, rel=0.12)


@pytest.mark.parametrize("scale", [2.0 * np.pi / 60.0, -1.0])
def test_a_command_in_another_unit_is_not_told_as_two_wrong_encoders(scale: float) -> None:
    run = logged(42)
    command = np.asarray(run["velocity_command_rad_s"]) / scale
    (sentence,) = told(with_channel(run, "velocity_command_rad_s", command))
    assert sentence.startswith("Motor and load move")
    assert "command's unit" in sentence
    assert float(sentence.split()[4]) == pytest.approx(scale, rel=0.15)


@pytest.mark.parametrize("scale", [-1.0, 0.1, 10.0])
def test_a_torque_of_another_size_or_sign_is_told(scale: float) -> None:
    run = logged(42)
    (sentence,) = told(with_channel(run, "motor_torque_nm", scale * run["motor_torque_nm"]))
    assert sentence.startswith("The drive's torque is")
    assert float(sentence.split()[4]) == pytest.approx(scale, rel=0.2)


def test_a_torque_that_says_nothing_is_told() -> None:
    run = logged(42)
    (sentence,) = told(with_channel(run, "motor_torque_nm", np.full(SLOTS, 0.02)))
    assert sentence.startswith("The drive's torque stays at 0.02 N m")


@pytest.mark.parametrize("rig", [MODEL, RUBBING], ids=["nominal", "rubbing"])
def test_angles_that_are_exchanged_are_told(rig: Model) -> None:
    run = logged(42, rig)
    other = with_channel(run, "motor_position_rad", run["load_angle_rad"])
    (sentence,) = told(with_channel(other, "load_angle_rad", run["motor_position_rad"]), rig)
    assert "exchange the two channels" in sentence


@pytest.mark.parametrize("weight_nm", [0.02, 0.043])
def test_a_load_that_hangs_in_its_gap_is_not_exchanged(weight_nm: float) -> None:
    heavy = MODEL.with_effect("gravity_imbalance", torque_nm=weight_nm, phase_rad=1.0)
    assert not any("exchange" in sentence for sentence in told(logged(42, heavy)))


@pytest.mark.parametrize(
    ("channel", "role", "rows"),
    [
        ("load_angle_rad", "load_sampled", 1),
        pytest.param(*("motor_position_rad", "motor_sampled", 2), marks=pytest.mark.long),
        pytest.param(*("motor_torque_nm", "current_sampled", 3), marks=pytest.mark.long),
    ],
)
def test_a_channel_that_comes_late_is_told_and_the_map_can_say_so(
    channel: str, role: str, rows: int
) -> None:
    run = logged(43)
    behind = with_channel(run, channel, late(np.asarray(run[channel]), rows))
    (sentence,) = told(behind)
    assert f'role = "{role}", value = {-8 * rows}, unit = "ms"' in sentence
    said = with_channel(behind, f"{role}_s", np.full(SLOTS, -rows * PERIOD_S))
    if role == "motor_sampled":
        said = with_channel(said, "current_sampled_s", np.zeros(SLOTS))
    assert told(said) == []
    seen = compare(said, RUBBING)
    left = seen.rms(seen.errors(RUBBING), seen.seen) / [signal.floor for signal in seen.signals]
    assert left.max() < 2.0


def test_a_rig_whose_drive_answers_late_for_all_of_its_own_is_right_as_it_was_told() -> None:
    run = logged(44)
    for channel in ("motor_position_rad", "motor_torque_nm", "load_angle_rad"):
        run = with_channel(run, channel, late(np.asarray(run[channel]), 1))
    for role in ("motor_sampled_s", "load_sampled_s"):
        run = with_channel(run, role, np.full(SLOTS, -PERIOD_S))
    assert told(run) == []


@pytest.mark.parametrize(
    ("tau_s", "delay_s"),
    [(2e-3, 1.3e-4), pytest.param(*(20e-3, 1.1e-3), marks=pytest.mark.long)],
)
def test_a_current_that_is_told_as_an_average_is_told_so_and_the_map_can_say_it(
    tau_s: float, delay_s: float
) -> None:
    rig = RUBBING.with_effect("transport_delay", delay_s=delay_s)
    run = logged(45, rig)
    fine, step_s = 256, PERIOD_S / 256
    played = np.repeat(np.asarray(run["velocity_command_rad_s"]), fine)
    current_a = rig.simulate(played, step_s).motor_current_a
    _, passed, _ = lsim(([1.0], [tau_s, 1.0]), current_a, step_s * np.arange(current_a.size))
    torque_nm = NOMINAL.torque_constant_nm_per_a * passed[::fine]
    behind = with_channel(run, "motor_torque_nm", torque_nm)
    (sentence,) = told(behind, rig)
    assert 'role = "current_filtered"' in sentence
    assert float(sentence.split("low pass of ")[1].split()[0]) == pytest.approx(
        1e3 * tau_s, rel=0.1
    )
    said = with_channel(behind, "current_filtered_s", np.full(SLOTS, tau_s))
    assert told(said, rig) == []
    seen = compare(said, rig)
    left = seen.rms(seen.errors(rig), seen.seen) / [signal.floor for signal in seen.signals]
    assert left.max() < 2.0


def test_a_low_pass_answers_a_jump_and_a_ramp_as_its_equation_says() -> None:
    """u = 0, from 0.1 s on 1 + 5 (t - 0.1): y by the variation of constants."""
    tau_s = 0.03
    t_s = np.concatenate(([0.0, 0.1, 0.1 + 1e-9], np.sort(np.linspace(0.101, 0.4, 60) ** 1.5)))
    t_s = np.unique(t_s[(t_s <= 0.1 + 1e-9) | (t_s > 0.101)])
    since_s = np.maximum(t_s - 0.1, 0.0)
    values = np.where(t_s > 0.1, 1.0 + 5.0 * since_s, 0.0)
    expected = (1.0 - 5.0 * tau_s) * (1.0 - np.exp(-since_s / tau_s)) + 5.0 * since_s
    np.testing.assert_allclose(low_passed(t_s, values, tau_s), expected, atol=1e-7)


@pytest.mark.parametrize(("scale", "slots"), [(-1.0, 3 * SLOTS), (180.0 / np.pi, SLOTS)])
def test_a_diagnosis_ends_at_once_where_an_angle_is_not_the_rigs(scale: float, slots: int) -> None:
    """Laws bent to a wrong map had taken twenty minutes, and the verdict said nothing of it."""
    run = logged(44, slots=slots)
    wrong = with_channel(run, "motor_position_rad", scale * run["motor_position_rad"])
    begun = list[str]()
    verdict = conclude([wrong], model=MODEL, report=begun.append).verdict
    assert verdict.verdict == "unknown"
    assert "The motor's angle moves" in verdict.sentence
    assert verdict.next_run.startswith("Mend the map or the rig's file")
    assert begun == ["base fit"]


@pytest.mark.parametrize("channel", ["load_angle_rad", "motor_position_rad"])
@pytest.mark.parametrize("turn_rad", [2.0 * np.pi, 1.5])
def test_an_angle_that_is_told_within_a_turn_only_is_told(channel: str, turn_rad: float) -> None:
    run = logged(45, slots=3 * SLOTS)
    tilted = np.asarray(run[channel]) + 2.0 * np.arange(3 * SLOTS) * PERIOD_S
    (sentence,) = told(with_channel(run, channel, np.mod(tilted, turn_rad)))
    assert "within a turn only" in sentence
    assert float(sentence.split()[6]) == pytest.approx(turn_rad, rel=0.02)


def test_spoilt_words_and_lost_counts_are_no_wraps() -> None:
    angle = np.array(logged(45)["load_angle_rad"])
    assert wrap_steps(angle).size == 0
    spoilt, lost, away = angle.copy(), angle.copy(), angle.copy()
    spoilt[50::50] += 6.0
    lost[200:] += 6.0
    for first in (100, 200, 300):
        away[first : first + 20] += 6.0
    assert wrap_steps(spoilt).size == 0
    assert wrap_steps(away).size == 0
    assert wrap_steps(lost).size == 0


@pytest.mark.parametrize("rows", [1, 3])
@pytest.mark.parametrize("rig", [MODEL, RUBBING], ids=["nominal", "rubbing"])
def test_commands_that_are_logged_late_are_told(rig: Model, rows: int) -> None:
    run = logged(46, rig)
    behind = late(np.asarray(run["velocity_command_rad_s"]), rows)
    (sentence,) = told(with_channel(run, "velocity_command_rad_s", behind), rig)
    assert f"The motion comes {rows} row" in sentence


@pytest.mark.parametrize("channel", ["load_angle_rad", "motor_position_rad"])
def test_one_angle_that_was_read_after_its_row_is_not_a_late_command(channel: str) -> None:
    run = logged(46)
    values = np.asarray(run[channel])
    early = with_channel(run, channel, np.append(values[1:], values[-1]))
    (sentence,) = told(early)
    assert "sampled 8 ms after its row's time" in sentence


@pytest.mark.parametrize(
    "rig",
    [
        MODEL.with_effect("inertia_error", error_fraction=-0.4),
        MODEL.with_effect("proportional_gain_error", error_fraction=0.5),
        MODEL.with_effect("transport_delay", delay_s=8e-3),
        MODEL.with_effect("clock_skew", skew_fraction=-1e-4),
    ],
    ids=["light", "stiff", "late", "ahead"],
)
def test_a_quick_rig_is_not_ahead_of_its_commands(rig: Model) -> None:
    assert rows_ahead(compare(logged(47, rig), MODEL, scales=SCALES), MODEL) == 0
