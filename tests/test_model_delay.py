"""Commands that are on their way while slots last unevenly, as recorded ones do."""

import numpy as np
import pytest

from servo_bench.rig import load_rig
from sim_rig.model import Model

NOMINAL = load_rig("rigs/paper.toml").nominal_values()


@pytest.mark.parametrize("seed", range(6))
def test_a_delay_on_uneven_slots_is_the_same_commands_at_later_times(seed: int) -> None:
    rng = np.random.default_rng(seed)
    commands = rng.choice([-2.0, 2.0], 200)
    durations_s = np.rint(rng.normal(8e-3, 2e-4, 200) * 1e6) * 1e-6
    delay_s = 1e-3
    delayed = Model(NOMINAL).with_effect("transport_delay", delay_s=delay_s)
    got = delayed.simulate(commands, durations_s)
    # the same by hand: every slot in two, the old command held through its first millisecond
    halves = np.column_stack([np.full(200, delay_s), durations_s - delay_s]).ravel()
    held = np.column_stack([np.concatenate([[0.0], commands[:-1]]), commands]).ravel()
    expected = Model(NOMINAL).simulate(held, halves)
    np.testing.assert_allclose(
        got.motor_angle_rad[1:], expected.motor_angle_rad[::2][1:], atol=1e-9
    )
