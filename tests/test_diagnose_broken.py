"""An angle that stands while the axis turns, or jumps: told, whatever a robust fit passes over."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from servo_bench.diagnosis.judging.broken import Rig, broken
from servo_bench.diagnosis.judging.judgement import verdict_of
from servo_bench.diagnosis.searching.coasting import coasting
from servo_bench.diagnosis.searching.finding import find_causes
from servo_bench.recording.recording import Recording
from sim_rig.model import Model
from tests.fit_recordings import NOMINAL, PERIOD_S, STANDSTILL, recorded, with_channels

MODEL = Model(NOMINAL)
GAP_RAD = NOMINAL.backlash_gap_rad
LOAD, MOTOR, COMMAND = "load_angle_rad", "motor_position_rad", "velocity_command_rad_s"
TORQUE = "motor_torque_nm"
BREAKS = 400
Of = Callable[[Recording], Recording]


def told(recording: Recording) -> list[str]:
    return list(broken([recording], None, Rig(GAP_RAD)))


def alone(recording: Recording) -> Recording:
    """Its load's angle and commands."""
    nothing = np.full(len(recording), np.nan)
    return with_channels(recording, motor_position_rad=nothing, motor_torque_nm=nothing)


def stands(recording: Recording, channel: str, rows: slice, noise_rad: float = 0.0) -> Recording:
    angle = np.array(recording[channel])
    draw = np.random.default_rng(8).uniform(-1.0, 1.0, angle[rows].size)
    angle[rows] = angle[rows][0] + noise_rad * draw
    return with_channels(recording, **{channel: angle})


def jumps(recording: Recording, by_rad: float, row: int = BREAKS) -> Recording:
    angle = np.array(recording[LOAD])
    angle[row:] += by_rad
    return with_channels(recording, load_angle_rad=angle)


@pytest.mark.parametrize("channel", [LOAD, MOTOR])
@pytest.mark.parametrize("noise_rad", [0.0, 5e-4])
def test_an_angle_that_stands_is_told_with_its_time(channel: str, noise_rad: float) -> None:
    rows = slice(BREAKS, BREAKS + 150)
    (said,) = told(stands(recorded(MODEL, 3), channel, rows, noise_rad))
    assert said.startswith(f"The {channel.split('_', maxsplit=1)[0]}'s angle stood still for ")
    words = said.split()
    assert float(words[words.index("for") + 1]) == pytest.approx(149 * PERIOD_S, abs=0.03)
    assert float(words[words.index("from") + 1]) == pytest.approx(BREAKS * PERIOD_S, abs=0.03)


@pytest.mark.parametrize("of", [lambda run: run, alone], ids=["all", "load alone"])
@pytest.mark.parametrize("by_rad", [0.3, -0.3, 7.0])
def test_a_jump_is_told_with_its_size_and_its_time(of: Of, by_rad: float) -> None:
    (said,) = told(of(jumps(recorded(MODEL, 3), by_rad)))
    assert "jumped by" in said
    size, when = (float(said.split()[k]) for k in (5, 8))
    assert size == pytest.approx(by_rad, abs=3.0 * GAP_RAD + 0.1)
    assert when == pytest.approx(BREAKS * PERIOD_S, abs=1e-9)


RIGS = {
    "nominal": MODEL,
    "wide gap": MODEL.with_effect("backlash_width", change_rad=0.3 * GAP_RAD),
    "bouncing": coasting(MODEL, 700.0),
    "soft": MODEL.with_effect(
        "coupling_compliance",
        compliance_rad_per_nm=0.05,
        damping_s=1e-3,
        load_inertia_kg_m2=1e-4,
    ),
    "coarse": MODEL.with_effect("quantisation", count_rad=3e-3),
    "weak": MODEL.with_effect("current_limit", limit_per_a=0.3),
}


@pytest.mark.parametrize("rig", RIGS)
@pytest.mark.parametrize("of", [lambda run: run, alone], ids=["all", "load alone"])
def test_what_a_rig_does_is_no_break(rig: str, of: Of) -> None:
    assert told(of(recorded(RIGS[rig], 5))) == []


@pytest.mark.parametrize("stays_nm", [0.0, 0.02])
def test_a_torque_that_is_silent_is_told_with_its_time(stays_nm: float) -> None:
    run = recorded(MODEL, 3)
    torque = np.array(run[TORQUE])
    torque[BREAKS : BREAKS + 200] = stays_nm
    (said,) = told(with_channels(run, motor_torque_nm=torque))
    assert f"torque stays at {stays_nm:g} for 1.59 s" in said


@pytest.mark.parametrize("quantum_nm", [0.0, 5e-3, 0.05])
def test_a_torque_in_coarse_steps_or_at_its_limit_is_not_silent(quantum_nm: float) -> None:
    """Up to a twentieth of what the largest commands take, and cut off at a tenth of it."""
    run = recorded(MODEL.with_effect("current_limit", limit_per_a=0.3), 3)
    torque = np.asarray(run[TORQUE])
    coarse = np.rint(torque / quantum_nm) * quantum_nm if quantum_nm else np.clip(torque, -0.1, 0.1)
    assert told(with_channels(run, motor_torque_nm=coarse)) == []


def test_a_spoilt_word_and_another_size_are_no_jumps() -> None:
    run = recorded(MODEL, 3)
    angle = np.array(run[LOAD])
    angle[BREAKS : BREAKS + 3] += 20.0
    assert told(with_channels(run, load_angle_rad=angle)) == []
    assert told(with_channels(run, motor_position_rad=np.degrees(run[MOTOR]))) == []


@pytest.mark.parametrize("speed_rad_s", [6.0, 150.0, 400.0])
def test_a_fast_start_out_of_a_rest_is_no_stand(speed_rad_s: float) -> None:
    """A row's angle is taken before its own command acts."""
    run = recorded(MODEL, 3)
    command = speed_rad_s * np.sign(run[COMMAND])
    angle = PERIOD_S * (np.cumsum(command) - command)
    channels = {COMMAND: command, LOAD: angle, MOTOR: angle}
    assert told(with_channels(run, **channels)) == []
    assert told(alone(with_channels(run, **channels))) == []


def test_slots_that_were_skipped_are_no_jump() -> None:
    """The command before them was held, and the angle went on."""
    run = recorded(MODEL, 3, played=np.where(np.arange(700) < 100, 0.0, 6.0))
    kept = np.delete(np.arange(700), np.arange(400, 412))
    less = replace(run, channels={name: run[name][kept] for name in run.channels})
    assert told(alone(less)) == []
    assert told(less) == []


def test_who_rests_when_told_to_does_not_stand() -> None:
    played = np.concatenate([np.zeros(STANDSTILL), np.full(150, 3.0), np.zeros(400)])
    assert told(recorded(MODEL, 3, played=played)) == []


def test_commands_below_a_deadband_that_was_found_ask_for_nothing() -> None:
    """Without it the axis stands, and nobody knows why."""
    played = np.concatenate([np.zeros(STANDSTILL), np.full(300, 1.0), np.full(300, 4.0)])
    run = recorded(MODEL.with_effect("command_deadband", deadband_rad_s=2.0), 3, played=played)
    assert list(broken([run], None, Rig(GAP_RAD, 2.0))) == []
    assert len(told(run)) == len((LOAD, MOTOR))


def test_a_soft_loop_that_friction_holds_does_not_stand() -> None:
    """Its integral has to grow to K_T K_I e = 15 mN m, here over 1.4 rad."""
    soft = replace(NOMINAL, integral_gain_a_per_rad=0.3, proportional_gain_a_s_per_rad=0.01)
    rig = Model(soft).with_effect("coulomb", torque_nm=0.015, transition_rad_s=1e-4)
    played = np.concatenate([np.zeros(STANDSTILL), np.full(500, 0.5), np.full(200, 5.0)])
    run = recorded(rig, 3, played=played)
    stiff = soft.torque_constant_nm_per_a * soft.integral_gain_a_per_rad
    assert list(broken([run], None, Rig(GAP_RAD, held_rad=0.015 / stiff))) == []
    assert told(run)


def test_commands_that_are_no_numbers_ask_for_nothing() -> None:
    run = recorded(MODEL, 3)
    command = np.array(run[COMMAND])
    command[::50] = np.inf
    assert told(with_channels(run, velocity_command_rad_s=command)) == []


def test_it_says_which_recording() -> None:
    good, bad = recorded(MODEL, 3), jumps(recorded(MODEL, 4), 1.0)
    (said,) = broken([good, bad], None, Rig(GAP_RAD))
    assert "in recording 2" in said
    (said,) = broken([good], bad, Rig(GAP_RAD))
    assert "in the held-out recording" in said


def test_a_recording_without_angles_or_with_few_is_asked_nothing() -> None:
    run = recorded(MODEL, 3)
    nothing = np.full(len(run), np.nan)
    assert told(with_channels(run, load_angle_rad=nothing, motor_position_rad=nothing)) == []


@pytest.mark.long
def test_the_verdict_is_unknown_and_says_why() -> None:
    """Half of the rows stand: fitted by the rest, nothing of the model is wrong."""
    run = stands(recorded(MODEL, 6, slots=900), LOAD, slice(BREAKS, None))
    verdict = verdict_of(find_causes([run], MODEL, only=("misalignment",)))
    assert verdict.verdict == "unknown"
    assert "The load's angle stood still" in verdict.sentence
