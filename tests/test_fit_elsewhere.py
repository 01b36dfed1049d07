"""Fits of motors that a voltage drives, that a position loop holds, or whose output is locked.

Made by a second hand: a winding with its inductance, friction that holds, small explicit steps, a
loop of its own. And on measured data, where it is there, beside what those who measured say.
"""

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray
from typer.testing import CliRunner

from servo_bench.cli import app as cli
from servo_bench.diagnosis.comparing.comparison import Choice
from servo_bench.diagnosis.fitting.fit import Fit, fit
from servo_bench.diagnosis.fitting.foreign_start import starting_model
from servo_bench.errors import ConfigError, FitError
from servo_bench.recording.measured_writer import save_measured
from servo_bench.recording.plant import ForeignPlant, Pendulum, PositionLoop
from servo_bench.recording.recording import Recording
from sim_rig.model import Model
from sim_rig.settings import Nominal
from tests.foreign_files import measured
from tests.test_foreign_realdata import CYCLOIDAL, bam, cycloidal, undcmotor

FINE_S = 1e-4
OHM, TORQUE_CONSTANT, INERTIA, FRICTION, DAMPING = 2.0, 0.05, 2e-4, 4e-3, 1e-4
INDUCTANCE_H = 2e-4
PENDULUM = Pendulum(mass_kg=0.1, length_m=0.05)
WEIGHT_NM = 0.1 * 9.80665 * 0.05
GAIN_V_PER_RAD, LIMIT_V = 12.0, 6.0
DRIVEN = ("J", "coulomb.torque_nm", "viscous.damping_nm_s_per_rad")
HELD = ForeignPlant(
    name="held",
    pendulum=PENDULUM,
    torque_constant_nm_per_a=TORQUE_CONSTANT,
    resistance_ohm=OHM,
    position_loop=PositionLoop(proportional_gain_v_per_rad=GAIN_V_PER_RAD, voltage_limit_v=LIMIT_V),
)
"""What the map of a pendulum on a position loop tells."""


def motor(
    inputs: NDArray[np.float64],
    rows: int,
    seed: int,
    *,
    position: bool = False,
    weight: float = 0.0,
) -> dict[str, NDArray[np.float64]]:
    """Channels every `rows` fine steps; the input is a voltage, or a position for the loop."""
    angle, speed, current = 0.0, 0.0, 0.0
    inertia = INERTIA + (PENDULUM.mass_kg * PENDULUM.length_m**2 if weight else 0.0)
    shown = []
    for value in inputs.tolist():
        volts = value
        for step in range(rows):
            if position:
                volts = min(max(GAIN_V_PER_RAD * (value - angle), -LIMIT_V), LIMIT_V)
            if step == 0:
                shown.append((angle, speed, volts))
            steady = (volts - TORQUE_CONSTANT * speed) / OHM
            current = steady + (current - steady) * math.exp(-FINE_S * OHM / INDUCTANCE_H)
            torque = TORQUE_CONSTANT * current - DAMPING * speed - weight * math.sin(angle)
            free = speed + FINE_S * torque / inertia
            stop = FINE_S * FRICTION / inertia
            speed = math.copysign(max(abs(free) - stop, 0.0), free)
            angle += FINE_S * speed
    angles, speeds, volts_ = np.array(shown).T
    white = np.random.default_rng(seed).standard_normal(angles.size)
    return {
        "t_s": rows * FINE_S * np.arange(angles.size),
        "motor_position_rad": angles + 1e-4 * white,
        "motor_velocity_rad_s": speeds,
        "voltage_v": volts_,
    }


def by_voltage(plant: ForeignPlant, seed: int, *names: str) -> Recording:
    """Ten seconds of steps of voltage; only these channels, beside time and voltage."""
    rng = np.random.default_rng(seed)
    volts = np.repeat(rng.uniform(-6.0, 6.0, 100), 20)
    made = motor(volts, 50, seed)
    kept = {name: made[name] for name in ("t_s", "voltage_v", *names)}
    return Recording(kept, 5e-3, None, None, {}, plant=plant)


@pytest.mark.parametrize("name", ["motor_position_rad", "motor_velocity_rad_s"])
def test_a_voltage_and_a_winding_that_is_known(name: str) -> None:
    plant = ForeignPlant(name="known", torque_constant_nm_per_a=TORQUE_CONSTANT, resistance_ohm=OHM)
    recording = by_voltage(plant, 1, name)
    found = fit(recording, starting_model(recording), DRIVEN)
    assert found.converged, found.reason
    assert (found.block, found.window_s) == ("mechanics", 1.0)
    assert found["J"].value == pytest.approx(INERTIA, rel=0.03)
    assert found["coulomb.torque_nm"].value == pytest.approx(FRICTION, rel=0.1)
    assert found["viscous.damping_nm_s_per_rad"].value == pytest.approx(DAMPING, abs=5e-5)
    assert found.gain > 0.8


def test_behind_a_gear_an_ampere_makes_more_and_the_inertia_is_that_of_the_axis() -> None:
    told = {"torque_constant_nm_per_a": TORQUE_CONSTANT, "resistance_ohm": OHM}
    straight = by_voltage(ForeignPlant(name="straight", **told), 1, "motor_velocity_rad_s")
    slow = {**straight.channels, "motor_velocity_rad_s": straight["motor_velocity_rad_s"] / 5.0}
    geared = ForeignPlant(name="geared", gear_ratio=5.0, **told)
    behind = starting_model(replace(straight, channels=slow, plant=geared)).nominal
    before = starting_model(straight).nominal
    assert behind.torque_constant_nm_per_a == pytest.approx(5.0 * TORQUE_CONSTANT)
    assert behind.inertia_kg_m2 == pytest.approx(25.0 * before.inertia_kg_m2)


def test_without_a_resistance_torques_are_volts_and_back_emf_is_damping() -> None:
    recording = by_voltage(ForeignPlant(name="unknown"), 2, "motor_velocity_rad_s")
    found = fit(recording, starting_model(recording), DRIVEN)
    per_volt = TORQUE_CONSTANT / OHM
    damping = (TORQUE_CONSTANT**2 / OHM + DAMPING) / per_volt
    assert found["J"].value == pytest.approx(INERTIA / per_volt, rel=0.03)
    assert found["coulomb.torque_nm"].value == pytest.approx(FRICTION / per_volt, rel=0.1)
    assert found["viscous.damping_nm_s_per_rad"].value == pytest.approx(damping, rel=0.02)


@cache
def held_pendulum() -> Recording:
    """Twelve seconds of a position loop that swings a weight."""
    t_s = np.arange(2400) * 5e-3
    command = 0.8 * np.sin(math.pi * t_s) + 0.5 * np.sin(3.4 * math.pi * t_s)
    made = motor(command, 50, 3, position=True, weight=WEIGHT_NM)
    kept = {n: made[n] for n in ("t_s", "motor_position_rad", "voltage_v")}
    channels = {**kept, "position_command_rad": command}
    return Recording(channels, 5e-3, None, None, {}, plant=HELD)


@pytest.mark.parametrize("block", ["loop", "mechanics"])
def test_a_position_loop_that_holds_a_pendulum(block: Choice) -> None:
    """With and without its loop, the same numbers; the weight that is told is the scale."""
    recording = held_pendulum()
    found = fit(
        recording, starting_model(recording), ("J", "K_T", "coulomb.torque_nm"), block=block
    )
    assert found.converged, found.reason
    assert found.block == block
    whole = INERTIA + PENDULUM.mass_kg * PENDULUM.length_m**2
    assert found["J"].value == pytest.approx(whole, rel=0.03)
    assert found["K_T"].value == pytest.approx(TORQUE_CONSTANT, rel=0.02)
    assert found["coulomb.torque_nm"].value == pytest.approx(FRICTION, rel=0.15)


def test_the_loops_own_gain_can_be_fitted() -> None:
    recording = held_pendulum()
    start = starting_model(recording)
    wrong = Nominal(TORQUE_CONSTANT, start.nominal.inertia_kg_m2, 1e-6, 4.5)
    free = ("J", "K_I", "coulomb.torque_nm")
    found = fit(recording, Model(wrong, start.effects), free, block="loop")
    assert found["K_I"].value == pytest.approx(GAIN_V_PER_RAD / OHM, rel=0.05)


GAP_RAD, STIFFNESS, GEAR_FRICTION_NM = 0.03, 800.0, 0.8


def locked(seed: int, runs: int = 3) -> Recording:
    """Slow ramps of torque against a locked output: a spring, then friction that holds, then a gap.

    The gap's flank moves only where torque exceeds friction, and then until the face's own spring
    balances the rest.
    """
    ramp = np.concatenate(
        [np.linspace(0, 4, 250), np.linspace(4, -4, 500), np.linspace(-4, 0, 250)]
    )
    angles, torques, numbers = [], [], []
    for run in range(runs):
        flank = 0.0
        for torque in ramp:
            # where the face's force would balance torque less friction, either way
            low, high = (rest_rad(torque + sign * GEAR_FRICTION_NM) for sign in (-1.0, 1.0))
            flank = min(max(flank, low), high)
            angles.append(flank + torque / STIFFNESS)
            torques.append(torque)
            numbers.append(run)
    white = np.random.default_rng(seed).standard_normal(len(angles))
    channels = {
        "t_s": 0.02 * np.arange(len(angles)),
        "run": np.array(numbers),
        "torque_nm": np.array(torques),
        "motor_position_rad": 0.4 + np.array(angles) + 5e-5 * white,
    }
    plant = ForeignPlant(name="locked", output_locked=True)
    return Recording(channels, 0.02, None, None, {}, plant=plant)


def rest_rad(torque_nm: float) -> float:
    """Where the flank lies under a torque without friction: in its gap, or against a stiff face."""
    return 0.5 * GAP_RAD * math.tanh(torque_nm / 0.2) + torque_nm / 1e5


def test_a_locked_output_shows_gap_spring_and_friction() -> None:
    recording = locked(1)
    free = ("gap", "coupling_compliance.compliance_rad_per_nm", "coulomb.torque_nm")
    found = fit(recording, starting_model(recording), free)
    assert found.converged, found.reason
    assert (found.block, found.signals[0].name) == ("transmission", "twist")
    assert found["gap"].value == pytest.approx(GAP_RAD, rel=0.1)
    assert found["coulomb.torque_nm"].value == pytest.approx(GEAR_FRICTION_NM, rel=0.2)
    compliance = found["coupling_compliance.compliance_rad_per_nm"].value
    assert compliance == pytest.approx(1.0 / STIFFNESS, rel=0.3)
    assert found.gain > 0.4


def test_what_a_locked_output_cannot_show_is_said() -> None:
    recording = locked(1)
    start = starting_model(recording)
    with pytest.raises(ConfigError, match="the output was locked"):
        fit(recording, start, ("gap",), block="mechanics")
    one_way = Recording(
        {**recording.channels, "torque_nm": np.abs(recording["torque_nm"])},
        *(recording.period_s, None, None, {}),
        plant=recording.plant,
    )
    with pytest.raises(FitError, match="a gap shows where torque reverses"):
        fit(one_way, start, ("gap",))


def test_a_position_loop_needs_the_position() -> None:
    recording = held_pendulum()
    kept = {n: v for n, v in recording.channels.items() if n != "motor_position_rad"}
    kept["motor_velocity_rad_s"] = np.gradient(recording["motor_position_rad"], recording["t_s"])
    blind = Recording(kept, recording.period_s, None, None, {}, plant=recording.plant)
    with pytest.raises(FitError, match="Map motor_position"):
        fit(blind, starting_model(recording), ("J",), block="loop")


def test_the_command_starts_from_the_recording_alone(tmp_path: object) -> None:
    path = f"{tmp_path}/driven.mcap"
    plant = ForeignPlant(name="u", torque_constant_nm_per_a=TORQUE_CONSTANT, resistance_ohm=OHM)
    save_measured(by_voltage(plant, 4, "motor_velocity_rad_s"), path)
    done = CliRunner().invoke(cli.app, ["fit", path, "--free", ",".join(DRIVEN)])
    assert done.exit_code == 0, done.output
    assert "mechanics, windows of 1 s" in done.output


@pytest.mark.long
def test_measured_a_small_motor_by_its_voltage() -> None:
    """Their own models, of first and second order, and their static curve: other experiments."""
    recording = undcmotor("prbs_open_exp")
    found = fit(recording, starting_model(recording), DRIVEN)
    assert found.converged, found.reason
    alpha_deg_s_per_v, tau_s = np.loadtxt(
        measured("undcmotor/DCmotor_fo_model_pbrs.csv"), delimiter=",", skiprows=1
    )
    damping = found["viscous.damping_nm_s_per_rad"].value
    _, slower_s, _ = np.loadtxt(
        measured("undcmotor/DCmotor_so_model_pbrs.csv"), delimiter=",", skiprows=1
    )
    assert slower_s < found["J"].value / damping < tau_s
    assert math.degrees(1.0 / damping) == pytest.approx(alpha_deg_s_per_v, rel=0.05)
    curve = np.loadtxt(
        measured("undcmotor/DCmotor_static_gain_response.csv"), delimiter=",", skiprows=1
    )
    dead = np.abs(curve[np.abs(curve[:, 1]) < 1.0, 0]).max()
    assert found["coulomb.torque_nm"].value == pytest.approx(dead, rel=0.15)
    assert found.gain > 0.9


def driven_pendulum(block: Choice) -> Fit:
    recording = bam("10h29m47")
    return fit(recording, starting_model(recording), ("K_T", *DRIVEN), block=block)


def test_measured_a_pendulum_by_its_voltage_and_by_its_loop() -> None:
    """The weight that was hung on is the scale: two blocks, one torque per volt, and an inertia
    that is the weight's and some of the motor's."""
    hung = 0.49 * 0.1**2
    by_block = [driven_pendulum("mechanics"), driven_pendulum("loop")]
    for found in by_block:
        assert hung < found["J"].value < 2.0 * hung
        assert found["coulomb.torque_nm"].value > 0.0
        assert (
            found.signal("motor velocity").held_out_after
            < 0.7 * found.signal("motor velocity").held_out_before
        )
    first, second = (found["K_T"].value for found in by_block)
    assert first == pytest.approx(second, rel=0.1)


@pytest.mark.parametrize(("name", "play_deg"), CYCLOIDAL.items())
def test_measured_the_play_of_a_locked_gear(name: str, play_deg: float) -> None:
    recording = cycloidal(name)
    free = (
        *("gap", "coupling_compliance.compliance_rad_per_nm"),
        *("coulomb.torque_nm", "asymmetric_friction.difference_torque_nm"),
    )
    found = fit(recording, starting_model(recording), free)
    assert math.degrees(found["gap"].value) == pytest.approx(play_deg, rel=0.15)
    assert found.gain > 0.3
