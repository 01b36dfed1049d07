"""Two gains that are wrong do what one does, where nothing but the load is seen."""

import numpy as np
import pytest

from servo_bench.diagnosis.comparing.evidence import Evidence, evidence_of
from servo_bench.diagnosis.searching.contenders import faced
from servo_bench.diagnosis.searching.hypotheses import Hypothesis
from servo_bench.diagnosis.searching.joint import Named, own_unknowns
from servo_bench.diagnosis.searching.one_gain import as_one_gain, one_that_does, products
from servo_bench.diagnosis.searching.seeking import seek
from servo_bench.diagnosis.searching.unknowns import Unknown, nuisances
from sim_rig.model import Model
from tests.fit_recordings import NOMINAL, recorded

MODEL = Model(NOMINAL)
TORQUE, K_P, K_I = "torque_constant_error", "proportional_gain_error", "integral_gain_error"
ONE = 0.08
BAND = nuisances(0.05, NOMINAL.backlash_gap_rad)


def wrong(**errors: float) -> Model:
    model = MODEL
    for effect, error in errors.items():
        model = model.with_effect(effect, error_fraction=error)
    return model


@pytest.mark.parametrize(
    ("one", "two"),
    [
        ({K_I: ONE}, {TORQUE: ONE, K_P: 1.0 / (1.0 + ONE) - 1.0}),
        ({K_P: ONE}, {TORQUE: ONE, K_I: 1.0 / (1.0 + ONE) - 1.0}),
        ({TORQUE: ONE}, {K_P: ONE, K_I: ONE}),
        ({TORQUE: ONE}, {"inertia_error": 1.0 / (1.0 + ONE) - 1.0}),
    ],
)
def test_one_gain_moves_the_load_as_two_do(one: dict[str, float], two: dict[str, float]) -> None:
    """The loop is K_T K_P / J and K_T K_I / J; a rig without friction shows nothing else."""
    ways = [np.asarray(recorded(wrong(**w), 5, slots=400)["load_angle_rad"]) for w in (one, two)]
    assert np.ptp(ways[0]) > 0.1
    np.testing.assert_allclose(*ways, rtol=0, atol=2e-9)
    np.testing.assert_allclose(products(wrong(**one)), products(wrong(**two)), rtol=1e-12)
    told = one_that_does(wrong(**two))
    assert told is not None
    assert told[0] == next(iter(one))
    assert told[1] == pytest.approx(ONE)


def test_no_one_gain_does_what_two_of_a_kind_do() -> None:
    assert one_that_does(wrong(**{TORQUE: 0.05, K_P: 0.05})) is None
    assert one_that_does(wrong(**{K_P: 0.08, K_I: -0.08})) is None


def causes(seen: Evidence, model: Model, *effects: str) -> list[Named]:
    free = [Unknown(effect, "error_fraction", -0.5, 0.5, step=0.02) for effect in effects]
    found = seek(seen, model, (*BAND, *free), iterations=1)
    base = seek(seen, MODEL, BAND, iterations=1)
    hypothesis = [Hypothesis(effect, (), ("error_fraction",)) for effect in effects]
    played = faced(seen, base, [(found, one) for one in hypothesis])
    return [Named(c.effect, played, c, own_unknowns(c, c.effect)) for c in played.contenders]


@pytest.mark.parametrize("known", [False, True], ids=["load alone", "torque known"])
def test_of_one_cause_and_two_that_do_the_same_one_is_told(known: bool) -> None:
    channels = ("load_angle_rad", *(("motor_torque_nm",) if known else ()))
    run = recorded(wrong(**{K_I: ONE}), 6, slots=900, channels=channels)
    seen = evidence_of([run], MODEL, block="loop")
    two = wrong(**{TORQUE: ONE, K_P: 1.0 / (1.0 + ONE) - 1.0})
    named = causes(seen, two, TORQUE, K_P)
    asked = [Hypothesis(K_I, (), ("error_fraction",))]
    final, told = as_one_gain(seen, named[0].contender.found, named, asked, BAND, believed=MODEL)
    if known:
        assert told == named
        return
    (cause,) = told
    assert cause.effect == K_I
    assert final.value(f"{K_I}.error_fraction") == pytest.approx(ONE, abs=0.01)
    assert final.errors.cost(final.sigma) < 1.05 * named[0].contender.found.errors.cost(final.sigma)


def test_two_gains_of_which_one_is_not_asked_stay() -> None:
    run = recorded(wrong(**{K_I: ONE}), 6, slots=400, channels=("load_angle_rad",))
    seen = evidence_of([run], MODEL, block="loop")
    named = causes(seen, wrong(**{TORQUE: ONE, K_P: 1.0 / (1.0 + ONE) - 1.0}), TORQUE, K_P)
    final = named[0].contender.found
    assert as_one_gain(seen, final, named, [], BAND, believed=MODEL) == (final, named)


def test_two_gains_stay_where_the_rig_s_file_has_one_of_them_already() -> None:
    run = recorded(wrong(**{K_I: ONE}), 6, slots=400, channels=("load_angle_rad",))
    seen = evidence_of([run], MODEL, block="loop")
    named = causes(seen, wrong(**{TORQUE: ONE, K_P: 1.0 / (1.0 + ONE) - 1.0}), TORQUE, K_P)
    final, asked = named[0].contender.found, [Hypothesis(K_I, (), ("error_fraction",))]
    known = wrong(**{K_I: 0.05})
    assert as_one_gain(seen, final, named, asked, BAND, believed=known) == (final, named)
