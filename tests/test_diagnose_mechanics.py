"""Motors from elsewhere whose torques are known, because they were made up here.

A current drives a rotor over its magnets; a speed loop keeps it turning. Angle and current are
logged at 1 kHz, and the angle has noise.
"""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from servo_bench.diagnosis.concluding import conclude
from servo_bench.diagnosis.elsewhere.weak import weak_rows
from servo_bench.diagnosis.fitting.foreign_channels import Motion, stretches
from servo_bench.diagnosis.judging.verdict import Verdict
from servo_bench.recording.plant import ForeignPlant
from servo_bench.recording.recording import Recording

PER_AMPERE, FINE, SAMPLES = 5000.0, 10, 24_000
"""Acceleration in rad/s2 a ampere, steps between two samples, and samples."""
LINES = {12: 0.04, 18: 0.044, 24: 0.019, 36: 0.015, 72: 0.196, 144: 0.02}
"""Order and amperes: those that a direct drive has been measured to have."""
PLACES = ("", "second_", "third_")


def turned(lines: dict[int, float], friction_a: float, seed: int, ripple: float = 0.0) -> Verdict:
    """The verdict on a rotor that a loop turns at changing speeds about one revolution a second, or
    with a ripple of its torque 24 times a revolution, both ways."""
    rng = np.random.default_rng(seed)
    orders, sizes = np.array(list(lines), np.float64), np.array(list(lines.values()))
    phases = rng.uniform(-np.pi, np.pi, orders.size)
    wanted = np.repeat(rng.uniform(3.0, 9.0, SAMPLES // 500 + 1), 500)[:SAMPLES]
    if ripple:
        wanted *= np.repeat(rng.choice([-1.0, 1.0], SAMPLES // 500 + 1), 500)[:SAMPLES]
    speed, angle, held, step_s = 6.0, 0.0, 0.0, 1e-3 / FINE
    angles, currents = np.empty(SAMPLES), np.empty(SAMPLES)
    for k in range(SAMPLES):
        for fine in range(FINE):
            error = wanted[k] - speed
            held += step_s * 0.4 * error
            current = 0.02 * error + held
            if fine == 0:
                angles[k], currents[k] = angle, current
            torque = current * (1.0 + ripple * np.sin(24.0 * angle))
            torque -= friction_a * np.tanh(speed / 0.05)
            torque -= float(sizes @ np.sin(orders * angle + phases))
            speed += step_s * PER_AMPERE * torque
            angle += step_s * speed
    channels = {
        "t_s": 1e-3 * np.arange(SAMPLES),
        "current_a": currents,
        "motor_position_rad": angles + 3e-5 * rng.normal(size=SAMPLES),
    }
    return conclude(
        [Recording(channels, 1e-3, None, None, {}, plant=ForeignPlant(name="rotor"))]
    ).verdict


def told_at(period_s: float, seed: int) -> Recording:
    """A rotor of 100 rad/s2 a ampere under steps of current, without friction; exact but noise."""
    rng = np.random.default_rng(seed)
    slots, held = round(12.0 / period_s), round(0.1 / period_s)
    current = np.repeat(rng.choice([-1.0, -0.5, 0.5, 1.0], slots // held + 1), held)[:slots]
    speed = 100.0 * period_s * (np.cumsum(current) - current)
    angle = period_s * (np.cumsum(speed) - speed) + 50.0 * period_s**2 * np.cumsum(current)
    channels = {
        "t_s": period_s * np.arange(slots),
        "current_a": current,
        "motor_position_rad": angle + 1e-6 * rng.normal(size=slots),
        "motor_velocity_rad_s": speed + 1e-4 * rng.normal(size=slots),
    }
    return Recording(channels, period_s, None, None, {}, plant=ForeignPlant(name="rotor"))


@pytest.mark.parametrize("motion", ["motor_velocity_rad_s", "motor_position_rad"])
@pytest.mark.parametrize("periods_s", [(1e-3, 2e-3), (2e-3, 1e-3)])
def test_recordings_of_two_rates_tell_one_acceleration(
    periods_s: tuple[float, float], motion: Motion
) -> None:
    every = [told_at(period_s, 3 + k) for k, period_s in enumerate(periods_s)]
    parts = [s for k, one in enumerate(every) for s in stretches(one, k, motion, "current_a")]
    rows = weak_rows(parts, motion)
    current = rows.column(lambda stretch: stretch.effort)
    for record in (0, 1):
        of_it = rows.record == record
        per_ampere = rows.left[of_it] @ current[of_it] / (current[of_it] @ current[of_it])
        assert per_ampere == pytest.approx(100.0, rel=0.05)


def test_an_effort_that_never_changes_is_told() -> None:
    one = told_at(1e-3, 3)
    dead = replace(one, channels={**one.channels, "current_a": np.zeros(len(one))})
    verdict = conclude([dead]).verdict
    assert verdict.verdict == "unknown"
    assert "never change" in verdict.sentence


def test_what_nothing_explains_is_to_be_played_once_more(monkeypatch: pytest.MonkeyPatch) -> None:
    lost = Verdict(verdict="unknown", sentence="Something is missing.")
    judged = SimpleNamespace(verdict=lost, shown=None)
    monkeypatch.setattr("servo_bench.diagnosis.concluding.judge_open", lambda *_, **__: judged)
    assert "once more as it is" in conclude([told_at(1e-3, 3)]).verdict.next_run


@pytest.mark.long
def test_all_lines_of_a_rotor_are_its_cogging_and_the_strongest_comes_first() -> None:
    """Three have names, the others a note; none is called a ripple of the torque."""
    verdict = turned(LINES, 0.08, seed=15)
    assert set(verdict.names) == {"cogging", "coulomb"}
    found = next(c for c in verdict.causes if c.effect == "cogging").parameters
    told = [(found[f"{p}order"].value, found[f"{p}torque_nm"].value) for p in PLACES]
    assert [order for order, _ in told] == [72.0, 18.0, 12.0]
    assert [size for _, size in told] == pytest.approx([0.196, 0.044, 0.04], rel=0.1)
    note = next(n for n in verdict.notes if "further lines" in n)
    assert all(f"{order} (" in note for order in (24, 36, 144))


@pytest.mark.long
def test_a_rotor_without_magnets_has_no_lines() -> None:
    verdict = turned({72: 0.0}, 0.08, seed=4)
    assert not {"cogging", "torque_ripple"} & set(verdict.names)


@pytest.mark.long
def test_a_ripple_of_the_torque_has_its_own_name() -> None:
    verdict = turned({72: 0.02}, 0.3, seed=5, ripple=0.1)
    assert set(verdict.names) >= {"torque_ripple", "coulomb"}


def ramped(friction_a: float, viscous_a_s: float, seed: int) -> Verdict:
    """A motor whose speed goes slowly up and down: its current goes into what it rubs on."""
    rng = np.random.default_rng(seed)
    t_s = 0.01 * np.arange(8_000)
    velocity = 4.0 * np.interp(t_s % 40.0, [0.0, 10.0, 30.0, 40.0], [0.0, 1.0, -1.0, 0.0])
    current = friction_a * np.sign(velocity) + viscous_a_s * velocity + 0.05
    channels = {
        "t_s": t_s,
        "current_a": current + 0.03 * rng.normal(size=t_s.size),
        "motor_position_rad": np.cumsum(velocity) * 0.01 + 5e-4 * rng.normal(size=t_s.size),
    }
    return conclude(
        [Recording(channels, 1e-2, None, None, {}, plant=ForeignPlant(name="ramp"))]
    ).verdict


def test_friction_shows_where_an_acceleration_does_not() -> None:
    """A slow ramp tells what a motor rubs by its current, and its inertia not at all."""
    verdict = ramped(0.3, 0.02, seed=1)
    found = {c.effect: c.parameters for c in verdict.causes}
    assert set(found) == {"coulomb", "viscous"}
    assert found["coulomb"]["torque_nm"].value == pytest.approx(0.3, rel=0.05)
    assert found["coulomb"]["torque_nm"].unit == "A"
    assert found["viscous"]["damping_nm_s_per_rad"].value == pytest.approx(0.02, rel=0.1)
    assert verdict.error is not None
    assert (verdict.error.signal, verdict.error.unit) == ("current", "A")
    assert verdict.error.after < 2.0 * verdict.error.noise_floor
    assert "acceleration_per_effort" not in verdict.nuisances


def test_a_slow_ramp_without_friction_has_none() -> None:
    assert ramped(0.0, 0.0, seed=2).causes == ()
