"""Increments between means against means that are taken one by one."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from servo_bench.diagnosis.comparing.haar import haar_of

PERIOD_S, FIRST = 0.008, 5


def rows(count: int, seed: int) -> Any:
    """Times that jitter, some of them not known."""
    rng = np.random.default_rng(seed)
    t_s = PERIOD_S * (np.arange(count) + 0.1 * rng.random(count))
    timed = np.ones(count, bool)
    timed[[70, 71]] = False
    return SimpleNamespace(t_s=t_s, timed=timed)


@pytest.mark.parametrize("stride", [2, 6, 9])
def test_each_is_the_difference_of_two_means_over_their_distance(stride: int) -> None:
    given = rows(160, seed=1)
    rng = np.random.default_rng(2)
    came = rng.random(150) > 0.2
    values = np.where(came, rng.standard_normal(150), np.nan)
    haar = haar_of(given, FIRST, np.arange(FIRST, FIRST + 150), stride, came)
    found = haar.of(values)
    assert found.shape == (149,)
    told = 0
    for k in range(0, 149 - 2 * stride + 1, stride // 2):
        early, late = np.arange(k, k + stride), np.arange(k + stride, k + 2 * stride)
        over = slice(FIRST + k, FIRST + k + 2 * stride)
        few = min(came[early].sum(), came[late].sum()) < 0.5 * stride
        if few or not given.timed[over].all():
            assert np.isnan(found[k])
            continue
        t_s = [given.t_s[FIRST + at[came[at]]].mean() for at in (early, late)]
        means = [values[at[came[at]]].mean() for at in (early, late)]
        assert found[k] == pytest.approx((means[1] - means[0]) / (t_s[1] - t_s[0]), abs=1e-9)
        told += 1
    assert told > 20
    assert np.isnan(found).sum() == 149 - told


def test_a_ramp_has_its_slope_whatever_came() -> None:
    given = rows(100, seed=3)
    came = np.random.default_rng(4).random(100) > 0.3
    haar = haar_of(given, 0, np.arange(100), 6, came)
    found = haar.of(2.5 * given.t_s)
    np.testing.assert_allclose(found[np.isfinite(found)], 2.5, rtol=1e-9)


def test_what_is_too_short_has_none() -> None:
    given = rows(100, seed=3)
    few = haar_of(given, 0, np.arange(10), 6, np.ones(10, bool)).of(np.zeros(10))
    assert few.shape == (9,)
    assert np.isnan(few).all()
    empty = haar_of(given, 0, np.zeros(0, np.intp), 6, np.zeros(0, bool))
    assert empty.of(np.zeros(0)).size == 0
