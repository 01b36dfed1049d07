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
from tests.test_fit_elsewhere import (
    FINE_S,
    GAIN_V_PER_RAD,
    HELD,
    LIMIT_V,
    WEIGHT_NM,
    motor,
)

SECONDS = 10.0


def run_of(rows: int, seed: int) -> Recording:
    """Goal and position alone, every so many fine steps."""
    period_s = rows * FINE_S
    t_s = np.arange(round(SECONDS / period_s)) * period_s
    first, second = np.random.default_rng(seed).uniform(0.4, 0.9, 2)
    goal = first * np.sin(math.pi * t_s) + second * np.sin(3.4 * math.pi * t_s + seed)
    made = motor(goal, rows, seed, position=True, weight=WEIGHT_NM)
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
