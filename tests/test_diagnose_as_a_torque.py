"""A wave of the load's angle or a torque on the motor's shaft: which, where nothing tells of it."""

import numpy as np
import pytest

from servo_bench.diagnosis.comparing.evidence import Evidence, evidence_of
from servo_bench.diagnosis.reading.revolution import ECCENTRIC
from servo_bench.diagnosis.reading.subdivision import EFFECT as SUBDIVISION
from servo_bench.diagnosis.searching.as_a_torque import as_a_torque
from servo_bench.diagnosis.searching.seeking import Found, seek
from servo_bench.diagnosis.searching.unknowns import nuisances, widened
from sim_rig.model import Model
from tests.fit_recordings import NOMINAL, RUN, recorded

MODEL = Model(NOMINAL)
LOAD_ALONE = ("load_angle_rad",)
BEARING = {"torque_nm": 1.5e-3, "order": 1.0, "phase_rad": 0.7}
DETENT = {"second_torque_nm": 1e-3, "second_order": 24.0, "second_phase_rad": -1.0}


def with_wave(
    hidden: Model, effect: str, channels: tuple[str, ...] = LOAD_ALONE, **settings: float
) -> tuple[Evidence, Found]:
    """A fit of a wave to the rig's recording."""
    run = recorded(hidden, 41, slots=1500, channels=channels)
    seen = evidence_of([run], MODEL, block="loop")
    start = MODEL.with_effect(effect, **settings)
    own = widened(effect, tuple(k for k in settings if k != "line_order"), start, 1e-4)
    band = nuisances(0.05, NOMINAL.backlash_gap_rad)
    found = seek(seen, start, (*band, *own), iterations=4)
    return seen, found


def test_a_bearing_that_was_fitted_as_an_eccentric_track_is_a_torque_as_well() -> None:
    hidden = MODEL.with_effect("cogging", **BEARING)
    stiff = NOMINAL.torque_constant_nm_per_a * NOMINAL.integral_gain_a_per_rad
    seen, found = with_wave(hidden, ECCENTRIC, amplitude_rad=5e-4, phase_rad=0.3)
    amplitude = found.value(f"{ECCENTRIC}.amplitude_rad")
    assert amplitude == pytest.approx(BEARING["torque_nm"] / stiff, rel=0.3)
    torque = as_a_torque(seen, found, ECCENTRIC)
    assert torque is not None
    assert torque.size_nm == pytest.approx(BEARING["torque_nm"], rel=0.1)
    assert ECCENTRIC not in torque.found.model.effects


def test_a_second_torque_comes_beside_the_first() -> None:
    hidden = MODEL.with_effect("cogging", **BEARING, **DETENT)
    seen, found = with_wave(
        hidden, SUBDIVISION, amplitude_rad=1e-4, line_order=24.0, phase_rad=-1.0
    )
    both = found.model.with_effect("cogging", **BEARING)
    own = widened("cogging", ("torque_nm", "phase_rad"), both, BEARING["torque_nm"])
    found = seek(seen, both, (*found.unknowns, *own), iterations=3)
    torque = as_a_torque(seen, found, SUBDIVISION)
    assert torque is not None
    told = torque.found.model.effects["cogging"]
    assert told.torque_nm == pytest.approx(BEARING["torque_nm"], rel=0.1)
    assert torque.size_nm == pytest.approx(DETENT["second_torque_nm"], rel=0.1)
    assert told.second_order == 24.0
    assert told.second_phase_rad == pytest.approx(-1.0, abs=0.1)


def test_a_line_of_the_same_order_is_the_torque() -> None:
    """Two of one order in a model would be one, in two places."""
    hidden = MODEL.with_effect("cogging", **BEARING)
    seen, found = with_wave(hidden, ECCENTRIC, amplitude_rad=5e-4, phase_rad=0.3)
    start = found.model.with_effect("cogging", **{**BEARING, "torque_nm": 2e-4})
    found = seek(seen, start, found.unknowns, iterations=3)
    torque = as_a_torque(seen, found, ECCENTRIC)
    assert torque is not None
    told = torque.found.model.effects["cogging"]
    assert told.torque_nm == pytest.approx(BEARING["torque_nm"], rel=0.1)
    assert told.second_torque_nm == 0.0


def test_a_large_eccentric_track_is_none() -> None:
    """A torque turns the shaft the later the faster it passes."""
    hidden = MODEL.with_effect(ECCENTRIC, amplitude_rad=8e-3, phase_rad=0.5)
    seen, found = with_wave(hidden, ECCENTRIC, amplitude_rad=7e-3, phase_rad=0.3)
    assert as_a_torque(seen, found, ECCENTRIC) is None


def test_where_the_motor_tells_of_a_torque_it_is_not_asked() -> None:
    hidden = MODEL.with_effect("cogging", **BEARING)
    seen, found = with_wave(hidden, ECCENTRIC, RUN, amplitude_rad=5e-4, phase_rad=0.3)
    assert as_a_torque(seen, found, ECCENTRIC) is None


def test_no_shaft_has_a_torque_of_an_encoders_own_order() -> None:
    hidden = MODEL.with_effect(SUBDIVISION, amplitude_rad=5e-4, line_order=1024.0)
    seen, found = with_wave(
        hidden, SUBDIVISION, amplitude_rad=5e-4, line_order=1024.0, phase_rad=0.1
    )
    assert np.isfinite(found.cost)
    assert as_a_torque(seen, found, SUBDIVISION) is None
