"""Commands that are on their way while slots last unevenly, as recorded ones do."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.signal import residue

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


def test_a_slot_that_is_cut_keeps_its_command_and_no_more_places_of_the_queue() -> None:
    """Samples of several instants cut a slot; 20 commands of a millisecond are still but 20."""
    commands = np.random.default_rng(3).choice([-2.0, 0.0, 2.0], 400)
    delayed = Model(NOMINAL).with_effect("transport_delay", delay_s=19.9e-3)
    whole = delayed.simulate(commands, 1e-3)
    cut = delayed.simulate(np.repeat(commands, 5), 2e-4)
    np.testing.assert_allclose(cut.motor_angle_rad[::5], whole.motor_angle_rad, atol=1e-9)


def ramp_response_rad(t_s: NDArray[np.float64]) -> NDArray[np.float64]:
    """Motor angle after a unit step of the command, from G(s)'s poles; zero before it."""
    gain = NOMINAL.torque_constant_nm_per_a / NOMINAL.inertia_kg_m2
    proportional = gain * NOMINAL.proportional_gain_a_s_per_rad
    integral = gain * NOMINAL.integral_gain_a_per_rad
    shares, poles, _ = residue(
        [proportional, integral], np.polymul([1.0, proportional, integral], [1.0, 0.0, 0.0])
    )
    total = np.zeros(t_s.shape, np.complex128)
    seen = 0
    for share, pole in zip(shares, poles, strict=True):
        again = abs(pole) < 1e-9  # the double pole at zero: a step, then a ramp
        total += share * (t_s**seen if again else np.exp(pole * np.maximum(t_s, 0.0)))
        seen += again
    return np.where(t_s > 0.0, total.real, 0.0)


@pytest.mark.parametrize("skew", [-0.1, -2e-2, -1e-4])
def test_commands_ahead_of_the_samples_clock_act_when_they_are_due(skew: float) -> None:
    rng = np.random.default_rng(7)
    commands = rng.choice([-2.0, 2.0], 60)
    durations_s = np.rint(rng.normal(8e-3, 2e-4, 60) * 1e6) * 1e-6
    sampled_s = np.concatenate([[0.0], np.cumsum(durations_s)])[:-1]
    jumps = np.diff(commands, prepend=0.0)
    after_s = sampled_s[:, None] - sampled_s[None, :] * (1.0 + skew)
    expected = ramp_response_rad(after_s) @ jumps
    got = Model(NOMINAL).with_effect("clock_skew", skew_fraction=skew)
    shown = got.simulate(commands, durations_s).motor_angle_rad
    np.testing.assert_allclose(shown, expected, atol=2e-8)


def test_a_delay_and_a_lead_add_up() -> None:
    commands, durations_s = np.tile([2.0, -1.0, 0.5], 40), np.full(120, 8e-3)
    both = Model(NOMINAL).with_effect("clock_skew", skew_fraction=-1e-3)
    both = both.with_effect("transport_delay", delay_s=1e-3)
    sampled_s = 8e-3 * np.arange(120)
    jumps = np.diff(commands, prepend=0.0)
    expected = ramp_response_rad(sampled_s[:, None] - sampled_s * (1.0 - 1e-3) - 1e-3) @ jumps
    shown = both.simulate(commands, durations_s).motor_angle_rad
    np.testing.assert_allclose(shown, expected, atol=2e-8)
