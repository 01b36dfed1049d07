"""The motion of a load between two faces: one step is its two halves, and faces never pull."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from sim_rig.model.contact import meet, piece_of, sprung, swung

MASSES_PER_KG_M2 = 1.0 / 5e-6 + 1.0 / 2.45e-4
STIFFNESS_NM_PER_RAD, GAP_RAD = 500.0, 0.0262


def played(
    x: float, v: float, a: float, damping_s: float, h: float, *, slope: float = 0.1
) -> tuple[float, float]:
    spring = sprung(MASSES_PER_KG_M2, STIFFNESS_NM_PER_RAD, damping_s)
    delta, square, soft = spring
    piece = piece_of(soft, h)
    return meet(
        *(x, v, a, damping_s, slope, *spring, GAP_RAD, h, piece), *swung(delta, square, piece)
    )


def states(seed: int, count: int) -> list[tuple[float, float, float, float, float]]:
    """(x, v, a, damping time, h) about a face: pressed in, let go, before it, far away."""
    rng = np.random.default_rng(seed)
    found = []
    for _ in range(count):
        side = rng.choice([-1.0, 1.0])
        pressed = rng.choice([-1.0, 1.0]) * 10.0 ** rng.uniform(-8.0, -4.0)
        speed = rng.normal() * 10.0 ** rng.uniform(-4.0, 0.0)
        found.append(
            (
                *(side * (0.5 * GAP_RAD + pressed), speed, 1e3 * rng.normal()),
                *(10.0 ** rng.uniform(-6.0, -3.0), 10.0 ** rng.uniform(-6.0, -4.0)),
            )
        )
    # let go so that Newton's step meets the zero of the force exactly
    found.append((0.0131077719280508, -0.013480147995182231, -640.206, 5e-4, 1.25e-5))
    return found


def test_a_step_is_its_two_parts() -> None:
    rng = np.random.default_rng(4)
    for x, v, a, damping_s, h in states(3, 500):
        part = rng.uniform(0.1, 0.9) * h
        halfway = played(x, v, a, damping_s, part)
        expected = played(*halfway, a, damping_s, h - part)
        np.testing.assert_allclose(played(x, v, a, damping_s, h), expected, rtol=0, atol=2e-9)


def test_faces_push_and_never_pull() -> None:
    """What the face adds to the velocity points away from it; a slope, which is taken where
    the face is left, is no force and does so over a whole blow."""
    for x, v, a, damping_s, h in states(5, 500):
        side = math.copysign(1.0, x)
        _, end = played(x, v, a, damping_s, h, slope=0.0)
        assert side * (end - v - a * h) <= 1e-9


@pytest.mark.parametrize("damping_s", [0.0, 1e-4])
def test_impact_keeps_energy_without_damping_and_loses_it_with(damping_s: float) -> None:
    speed = 2.0
    _, end = played(0.0, speed, 0.0, damping_s, 0.01, slope=0.0)
    assert end < 0.0
    assert (abs(end) == pytest.approx(speed, rel=1e-9)) == (damping_s == 0.0)


@pytest.mark.parametrize("exponent", [1.0, 1.5])
@pytest.mark.parametrize("speed", [0.05, 1.0, 5.0])
def test_a_face_gives_back_what_one_of_hunt_and_crossley_does(
    exponent: float, speed: float
) -> None:
    """k p^n (1 + chi p') of any n, and a slope of 2/3 chi: J. Appl. Mech. 42 (1975)."""
    chi = 0.3

    def motion(t: float, y: tuple[float, float]) -> tuple[float, float]:
        force = 1e3 * max(y[0], 0.0) ** exponent * (1.0 + chi * y[1])
        return y[1], -MASSES_PER_KG_M2 * force

    done = solve_ivp(motion, (0.0, 0.1), (0.0, speed), "LSODA", rtol=1e-9, atol=1e-13)
    _, leaves = done.y[:, -1]
    _, end = played(0.5 * GAP_RAD, speed, 0.0, 0.0, 2e-3, slope=2.0 / 3.0 * chi)
    assert end == pytest.approx(leaves, rel=0.03)


@pytest.mark.parametrize(("speed", "slope"), [(1e-3, 0.2), (2.0, 0.2), (2.0, 2.0)])
def test_what_a_slope_takes_is_of_what_damping_leaves(speed: float, slope: float) -> None:
    face_rad = 0.5 * GAP_RAD
    alone, both = (played(face_rad, speed, 0.0, 1e-4, 5e-3, slope=one)[1] for one in (0.0, slope))
    assert -speed < both < 0.0
    assert both == pytest.approx(alone / (1.0 + slope * abs(alone)), rel=1e-9)
