"""A drive that takes commands at its own ticks, under a clock that walks past them."""

import numpy as np
import pytest

from servo_bench.diagnosis.evidence import Evidence, evidence_of
from servo_bench.diagnosis.ticks import COARSE_S, MOST, ticks
from sim_rig.model import Model
from tests.fit_recordings import NOMINAL, PERIOD_S, commands, recorded

MODEL = Model(NOMINAL)
WALKING = MODEL.with_effect("clock_skew", skew_fraction=2e-5)
SEED, SLOTS, MEAN = 6, 900, 6


@pytest.fixture(scope="module")
def seen() -> Evidence:
    return evidence_of([recorded(MODEL, SEED, slots=SLOTS)], MODEL, block="loop")


def test_an_unknown_delay_moves_an_angle_by_velocity_times_delay(seen: Evidence) -> None:
    """x(t - d) = x(t) - d v(t): a mean velocity over slots of T changes by d/T of what the velocity
    does between its ends, in the windows that there are."""
    velocity = MODEL.simulate(commands(SEED, SLOTS), PERIOD_S).motor_velocity_rad_s
    between = np.abs(velocity[MEAN:] - velocity[:-MEAN])
    late_s = COARSE_S / np.sqrt(12.0)
    wanted = 1.4826 * float(np.median(between)) * late_s / (MEAN * PERIOD_S)
    found = dict(zip(seen.names, ticks(seen, WALKING), strict=True))
    assert found["motor velocity over 48 ms"] == pytest.approx(wanted, rel=0.3)
    assert (ticks(seen, WALKING) <= MOST * seen.allowed).all()


@pytest.mark.parametrize("delay_s", [0.0, 1e-4])
def test_where_no_clock_walks_the_delay_is_known(seen: Evidence, delay_s: float) -> None:
    late = MODEL.with_effect("transport_delay", delay_s=delay_s)
    np.testing.assert_array_equal(ticks(seen, late), 0.0)
