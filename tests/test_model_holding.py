"""A light load that is braked hard: it is carried, and stands, and its brake never drives it."""

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from sim_rig.effects import catalogue
from sim_rig.model import Model, transmission
from sim_rig.model.holding import ATTEMPTS, HELD, nearer
from sim_rig.model.page import page_text
from sim_rig.settings import Nominal
from tests.test_model_page import loaded

GAP_RAD, INERTIA_KG_M2 = math.radians(1.5), 2.5e-4
NOMINAL = Nominal(0.03606, INERTIA_KG_M2, 0.97, 69.0, GAP_RAD)
BRAKE_NM, FACE_RAD_PER_NM = 0.013, 0.015
TURNS_S, PERIOD_S = 0.1, 1e-3


def braked(mass_kg_m2: float, transition_rad_s: float, step_s: float) -> Model:
    """A load that its brake stops within microseconds, from any speed of the motor."""
    model = Model(NOMINAL, longest_step_s=step_s).with_effect(
        "contact",
        compliance_rad_per_nm=FACE_RAD_PER_NM,
        damping_s=1e-4,
        load_inertia_kg_m2=mass_kg_m2,
    )
    return model.with_effect("load_friction", torque_nm=BRAKE_NM, transition_rad_s=transition_rad_s)


def there_and_back() -> tuple[np.ndarray, np.ndarray]:
    """Angle and velocity of a motor that swings, slowly where it turns: a sine of 2 rad/s."""
    times_s = np.arange(round(3.0 * TURNS_S / PERIOD_S) + 1) * PERIOD_S
    rate = math.pi / TURNS_S
    return 2.0 / rate * (1.0 - np.cos(rate * times_s)), 2.0 * np.sin(rate * times_s)


@pytest.mark.parametrize("step_s", [2e-4, 5e-5])
@pytest.mark.parametrize("mass_kg_m2", [3e-6, 3e-7])
@pytest.mark.parametrize("transition_rad_s", [0.01, 0.1])
def test_it_follows_by_the_gap_and_what_the_brake_bends_and_stands_in_between(
    mass_kg_m2: float, transition_rad_s: float, step_s: float
) -> None:
    """A brake that the load cannot outrun leaves it where the motor brought it: half a gap and c T
    behind, and there until the motor has come as far on the other side."""
    angle, velocity = there_and_back()
    load = transmission(
        braked(mass_kg_m2, transition_rad_s, step_s),
        np.full(angle.size - 1, PERIOD_S),
        angle,
        velocity,
    )
    behind = 0.5 * GAP_RAD + FACE_RAD_PER_NM * BRAKE_NM
    expected, at = np.empty_like(angle), 0.0
    for k, motor in enumerate(angle):
        at = min(max(at, motor - behind), motor + behind)
        expected[k] = at
    # where the motor turns the face lets go of it, and a smoothed brake lets it creep meanwhile
    bent = FACE_RAD_PER_NM * BRAKE_NM
    np.testing.assert_allclose(load, expected, atol=0.6 * bent + 5e-3 * transition_rad_s, rtol=0.0)
    fastest = np.abs(velocity) > 1.9
    lag = (angle - load)[fastest] * np.sign(velocity[fastest])
    np.testing.assert_allclose(lag - 0.5 * GAP_RAD, bent, rtol=0.1)


@pytest.mark.parametrize("mass_kg_m2", [3e-6, 3e-7])
def test_its_motor_is_moved_as_in_steps_that_follow_the_brake(mass_kg_m2: float) -> None:
    commands = np.random.default_rng(5).uniform(-3.0, 3.0, 60)
    coarse, fine = (
        braked(mass_kg_m2, 0.1, step_s).simulate(commands, 0.008) for step_s in (2e-4, 1e-6)
    )
    apart = coarse.motor_velocity_rad_s - fine.motor_velocity_rad_s
    assert np.std(apart) < 0.01 * np.std(fine.motor_velocity_rad_s)


@given(
    brake=st.floats(1e-4, 1.0),
    pushed=st.floats(-0.98, 0.98),
    sharp=st.floats(0.5, 1e4),
    bend=st.floats(0.2, 5.0),
)
def test_a_brake_that_holds_is_found(
    brake: float, pushed: float, sharp: float, bend: float
) -> None:
    """tau = -T tanh(s w), w = (tau/T + p)^b: whatever the slopes, tau stays between the two first,
    and is nearer to what holds than both."""

    def missed(torque: float) -> float:
        free = (torque + pushed * brake) / brake
        speed = math.copysign(abs(free) ** bend, free)
        return -brake * math.tanh(sharp * speed) - torque

    low, high = -brake, brake
    low_by, high_by, kept = missed(low), missed(high), 0.0
    tried, by = high, high_by
    for _ in range(ATTEMPTS - 3):
        bracket = nearer(low, low_by, high, high_by, kept, tried, by)
        low, low_by, high, high_by, kept, tried = bracket
        assert min(low, high) <= tried <= max(low, high)
        by = missed(tried)
        if abs(by) <= HELD * abs(high - low):
            break
    assert abs(by) < max(HELD * 2.0 * brake, min(abs(missed(-brake)), abs(missed(brake))))


COUNTING = '''
"""counting: as many steps as it is asked to take on.

tau = 0
"""
from typing import NamedTuple
from sim_rig.effects.effect import Effect, LogUniform, Port
from typing import Annotated


class Params(NamedTuple):
    """Zero switches it off."""

    torque_nm: Annotated[float, LogUniform(1e-3, 1.0)] = 0.0


class Memory(NamedTuple):
    """Steps."""

    step_count: float = 0.0


def law(s, z, p):
    """None."""
    return 0.0 * p.torque_nm


def advance(s, z, p, dt_s):
    """One more."""
    return Memory(z.step_count + 1.0)


EFFECT = Effect(
    port=Port.LOAD_TORQUE, params=Params, law=law, memory=Memory, advance=advance,
    sample={"torque_nm": 1.0}, shows="", confused_with=(), source="",
)
'''


def test_what_a_load_s_torque_remembers_is_taken_on_once_a_step(tmp_path: Path) -> None:
    """However often it is asked what brakes the load."""
    counting = loaded(tmp_path / "counting.py", COUNTING)
    names = ("contact", "load_friction")
    page = page_text({**{name: catalogue()[name] for name in names}, "counting": counting})
    asked = "counting_new_step_count = "
    taken_on = "counting_z_step_count = counting_new_step_count"
    assert page.count(asked) > 1
    assert page.count(taken_on) == 1
    assert page.index(taken_on) > page.rindex(asked)
