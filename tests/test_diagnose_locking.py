"""The model-free picture: an error made of one thing is found to be locked to that, and to noise
nothing is."""

import numpy as np
import pytest

from servo_bench.diagnosis.comparing.locking import (
    AFTER_ROWS,
    ORDERS,
    after_edges,
    beyond_chance,
    binned,
    binned_share,
    drift_share,
    line_shares,
)

ROWS = 4000
RNG = np.random.default_rng(5)
NOISE = RNG.standard_normal(ROWS)
VELOCITY = RNG.uniform(-5.0, 5.0, ROWS)
ANGLE = np.cumsum(VELOCITY + 1.0) * 0.008
TIME = np.arange(ROWS, dtype=np.float64) * 0.008
JUMPS = np.diff(RNG.choice([-3.0, 0.0, 3.0], ROWS), prepend=0.0)


def every_share(error: np.ndarray) -> dict[str, float]:
    return {
        "velocity": binned_share(VELOCITY, error),
        "position": float(line_shares(ANGLE, error).max()),
        "edge": after_edges(JUMPS, error, np.ones(ROWS, np.bool_))[1],
        "drift": drift_share(TIME, error),
    }


@pytest.mark.parametrize(
    ("where", "pure"),
    [
        ("velocity", np.sign(VELOCITY)),
        ("position", np.sin(12.0 * ANGLE + 1.0)),
        ("edge", np.convolve(JUMPS, np.exp(-np.arange(8) / 3.0))[:ROWS]),
        ("drift", TIME / TIME[-1]),
    ],
)
def test_what_makes_the_error_explains_it_in_proportion(where: str, pure: np.ndarray) -> None:
    error = pure / pure.std() + 0.5 * NOISE
    shares = every_share(error)
    assert max(shares, key=lambda name: shares[name]) == where
    assert shares[where] == pytest.approx(1.0 / 1.25, abs=0.06)


def test_noise_is_locked_to_nothing() -> None:
    assert max(every_share(NOISE).values()) < 0.02


def test_a_line_has_its_order_and_flips_with_the_direction() -> None:
    wave = np.cos(7.0 * ANGLE)
    assert ORDERS[line_shares(ANGLE, wave).argmax()] == 7.0
    turned = wave * np.sign(VELOCITY)
    assert line_shares(ANGLE, turned).max() < 0.05
    assert line_shares(ANGLE, turned, np.sign(VELOCITY)).max() == pytest.approx(1.0, abs=0.01)


def test_an_order_that_never_came_round_is_not_claimed() -> None:
    short = 0.1 * ANGLE / np.ptp(ANGLE)
    error = np.sin(3.0 * short)
    shares = line_shares(short, error)
    assert (shares[:60] == 0.0).all()
    assert drift_share(TIME, error) > shares.max()


def test_the_answer_to_an_edge_is_recovered() -> None:
    truth = np.concatenate((np.linspace(1.0, 0.0, 10), np.zeros(AFTER_ROWS - 10)))
    answer, share = after_edges(JUMPS, np.convolve(JUMPS, truth)[:ROWS], np.ones(ROWS, np.bool_))
    np.testing.assert_allclose(answer, truth, atol=1e-6)
    assert share == pytest.approx(1.0)


def test_shares_do_not_depend_on_the_unit() -> None:
    error = np.sign(VELOCITY) + NOISE
    for name, share in every_share(error).items():
        assert every_share(1e-6 * error)[name] == pytest.approx(share, abs=1e-9)


def test_bins_keep_the_mean() -> None:
    found = binned(VELOCITY, NOISE)
    assert found.mean.mean() == pytest.approx(NOISE.mean())
    assert (np.diff(found.at) > 0.0).all()


@pytest.mark.parametrize(
    ("explained", "total", "numbers", "points"),
    [(1.0, 0.0, 1.0, 10), (1.0, 2.0, 10.0, 10), (0.1, 1.0, 5.0, 10)],
)
def test_no_share_where_chance_explains_as_much(
    explained: float, total: float, numbers: float, points: int
) -> None:
    assert beyond_chance(explained, total, numbers, points) == 0.0
