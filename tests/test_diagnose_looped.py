"""Runs of a position loop whose gain is known, and nothing that drives the motor recorded.

As hobby servos are logged: goal and position, each run as fast as its logger was that day. Made by
the second hand of test_fit_elsewhere.
"""

import math
from dataclasses import replace

import numpy as np
import pytest

from servo_bench.diagnosis.concluding import conclude
from servo_bench.diagnosis.elsewhere import is_open
from servo_bench.diagnosis.fitting.foreign_channels import with_voltage
from servo_bench.errors import ConfigError
from servo_bench.recording.plant import ForeignPlant, PositionLoop
from servo_bench.recording.recording import Recording
from tests import test_fit_elsewhere
from tests.test_fit_elsewhere import (
    FINE_S,
    GAIN_V_PER_RAD,
    HELD,
    LIMIT_V,
    WEIGHT_NM,
    motor,
)

SECONDS = 10.0


def run_of(rows: int, seed: int, weight: float = WEIGHT_NM) -> Recording:
    """Goal and position alone, every so many fine steps."""
    period_s = rows * FINE_S
    t_s = np.arange(round(SECONDS / period_s)) * period_s
    first, second = np.random.default_rng(seed).uniform(0.4, 0.9, 2)
    goal = first * np.sin(math.pi * t_s) + second * np.sin(3.4 * math.pi * t_s + seed)
    made = motor(goal, rows, seed, position=True, weight=weight)
    channels = {**{n: made[n] for n in ("t_s", "motor_position_rad")}, "position_command_rad": goal}
    return Recording(channels, period_s, None, None, {}, plant=HELD)


@pytest.mark.long
def test_weight_and_friction_show_in_the_goal_and_the_position_alone() -> None:
    """At two rates: a logger's period is no part of the rig."""
    recordings = [run_of(50, 1), run_of(70, 3)]
    assert all(is_open(one) for one in recordings)
    verdict = conclude(recordings).verdict
    assert set(verdict.names) == {"gravity_imbalance", "coulomb"}
    found = {c.effect: c.parameters["torque_nm"].value for c in verdict.causes}
    assert found["gravity_imbalance"] == pytest.approx(WEIGHT_NM, rel=0.1)
    assert verdict.error is not None
    assert verdict.error.after < 0.5 * verdict.error.before


@pytest.mark.long
def test_a_motion_that_the_loop_does_not_explain_is_not_called_plain() -> None:
    """A torque turns the shaft that nobody recorded, as much as its goal does."""
    t_s, rng = 0.02 * np.arange(700), np.random.default_rng(3)

    def wave(hz: tuple[float, ...]) -> np.ndarray:
        parts = [
            0.4 * np.sin(math.tau * f * t_s + p)
            for f, p in zip(hz, rng.uniform(0, 6, 3), strict=True)
        ]
        return np.asarray(np.sum(parts, axis=0))

    goal, pushed_nm = wave((0.31, 0.52, 0.83)), 4.0 * wave((0.23, 0.47, 0.71))
    angle, speed, angles = 0.0, 0.0, []
    for now, torque in zip(goal, pushed_nm, strict=True):
        angles.append(angle)
        for _ in range(20):
            speed += 1e-3 * (5.0 * (now - angle) - 0.5 * speed + torque) / 0.2
            angle += 1e-3 * speed
    channels = {
        "t_s": t_s,
        "position_command_rad": goal,
        "motor_position_rad": np.array(angles) + 1e-3 * rng.standard_normal(t_s.size),
    }
    loop = PositionLoop(proportional_gain_v_per_rad=5.0)
    plant = ForeignPlant(name="pushed", inertia_kg_m2=0.2, position_loop=loop)
    pushed = Recording(channels, 0.02, None, None, {}, plant=plant)
    verdict = conclude([pushed], only=("transport_delay",)).verdict
    assert (verdict.verdict, verdict.causes) == ("unknown", ())
    assert "explains the motion" in verdict.sentence
    assert "nothing that touches the shaft" in verdict.next_run


@pytest.mark.long
def test_a_loop_without_weight_and_friction_is_plain(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its winding's inductance alone is not in the model, and is not called unexplained."""
    monkeypatch.setattr(test_fit_elsewhere, "FRICTION", 0.0)
    made = run_of(50, 1, weight=0.0)
    plain = replace(made, plant=HELD.model_copy(update={"pendulum": None}))
    assert conclude([plain]).verdict.verdict == "none"


def test_a_goal_without_a_gain_is_no_loop() -> None:
    recording = run_of(50, 1)
    unknown = Recording(
        recording.channels, recording.period_s, None, None, {}, plant=ForeignPlant(name="unknown")
    )
    assert not is_open(unknown)
    with pytest.raises(ConfigError, match="says nothing of its rig"):
        conclude([unknown])


def test_the_voltage_of_a_loop_is_its_gain_times_what_it_is_off_within_its_limit() -> None:
    recording = run_of(50, 1)
    off = recording["position_command_rad"] - recording["motor_position_rad"]
    told = with_voltage(recording)["voltage_v"]
    within = np.abs(GAIN_V_PER_RAD * off) < LIMIT_V
    np.testing.assert_allclose(told[within], GAIN_V_PER_RAD * off[within])
    assert np.abs(told).max() <= LIMIT_V
    free = PositionLoop(proportional_gain_v_per_rad=GAIN_V_PER_RAD)
    unlimited = replace(recording, plant=HELD.model_copy(update={"position_loop": free}))
    np.testing.assert_allclose(with_voltage(unlimited)["voltage_v"], GAIN_V_PER_RAD * off)
    measured = replace(recording, channels={**recording.channels, "voltage_v": 2.0 * told})
    assert with_voltage(measured) is measured
