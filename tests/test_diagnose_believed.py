"""A rig's file that has effects already: what is right in it is no cause, what is wrong is one."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

from servo_bench.diagnosis.concluding import conclude
from servo_bench.diagnosis.judging.judgement import verdict_of
from servo_bench.diagnosis.searching.finding import find_causes
from servo_bench.diagnosis.searching.gate import beyond_belief
from servo_bench.diagnosis.searching.hypotheses import hypotheses
from servo_bench.diagnosis.searching.scales import as_believed, band_of, scales_of
from servo_bench.errors import ConfigError
from sim_rig.model import Model
from tests.fit_recordings import NOMINAL, PERIOD_S, commands, recorded

MODEL = Model(NOMINAL)
RUBS = {"torque_nm": 0.01, "transition_rad_s": 0.05}


def test_a_run_in_slots_that_names_no_rig_asks_for_one() -> None:
    run = recorded(MODEL, 5, slots=200)
    with pytest.raises(ConfigError, match="says nothing of its rig: give --rig"):
        conclude([replace(run, rig=None)])


@pytest.mark.parametrize(
    ("effect", "believed", "true"),
    [
        pytest.param("coulomb", RUBS, RUBS, marks=pytest.mark.long),
        pytest.param(
            "backlash_width", {"change_rad": 4e-3}, {"change_rad": 4e-3}, marks=pytest.mark.long
        ),
        ("coulomb", RUBS, {**RUBS, "torque_nm": 0.016}),
        pytest.param("coulomb", RUBS, {**RUBS, "torque_nm": 0.004}, marks=pytest.mark.long),
        pytest.param(
            "proportional_gain_error",
            {"error_fraction": 0.1},
            {"error_fraction": -0.05},
            marks=pytest.mark.long,
        ),
        pytest.param("cogging", {"torque_nm": 2e-3}, {"torque_nm": 4e-3}, marks=pytest.mark.long),
    ],
)
def test_what_a_rigs_file_has_is_a_cause_where_it_is_wrong(
    effect: str, believed: Mapping[str, float], true: Mapping[str, float]
) -> None:
    has, is_so = (MODEL.with_effect(effect, **table) for table in (believed, true))
    verdict = verdict_of(find_causes([recorded(is_so, 5, slots=900)], has, only=(effect,)))
    if believed == true:
        assert verdict.verdict == "none", verdict.sentence
        return
    assert verdict.names == (effect,)
    strength, value = next(iter(true.items()))
    found = verdict.causes[0].parameters[strength]
    assert found.value == pytest.approx(value, abs=4.0 * found.standard_error)
    assert verdict.effects[effect][strength] == found.value
    assert "its file has" in verdict.sentence


def test_bands_and_trials_are_about_what_a_file_has() -> None:
    has = MODEL.with_effect("coulomb", **RUBS).with_effect("command_scale", error_fraction=0.02)
    plain, scales = (scales_of(m, commands(3, 100), PERIOD_S) for m in (MODEL, has))
    reach = {u.name: u.high for u in band_of(plain, MODEL)}
    for unknown in band_of(scales, has):
        believed = unknown.of(has)
        assert unknown.high == believed + reach[unknown.name]
        assert believed in (0.0, unknown.centre)
    sizes = [
        t.settings["torque_nm"] for h in hypotheses(scales, only=("coulomb",)) for t in h.trials
    ]
    assert min(sizes) > 0.0
    assert min(sizes) < RUBS["torque_nm"] < max(sizes)
    signed = [
        t.settings["error_fraction"]
        for h in hypotheses(scales, only=("command_scale",))
        for t in h.trials
    ]
    assert min(signed) < 0.02 < max(signed)


def test_what_is_worth_a_name_is_beside_what_a_file_has() -> None:
    has = MODEL.with_effect("cogging", torque_nm=2e-3, phase_rad=0.5)
    scales = scales_of(has, commands(3, 100), PERIOD_S)
    assert beyond_belief(has, "cogging", scales) == pytest.approx(0.0)
    turned = has.with_effect("cogging", torque_nm=2e-3, phase_rad=0.5 + 3.141592653589793)
    assert beyond_belief(turned, "cogging", scales) == pytest.approx(4e-3)
    assert beyond_belief(MODEL, "cogging", scales) == pytest.approx(2e-3)
    assert as_believed(turned, "cogging", scales) == has
    assert as_believed(MODEL.with_effect("coulomb", **RUBS), "coulomb", scales) == MODEL


@pytest.mark.long
@pytest.mark.parametrize("is_there", [True, False], ids=["twice as large", "not there"])
@pytest.mark.parametrize(
    ("effect", "strength", "size"),
    [("cogging", "torque_nm", 6e-3), ("encoder_eccentricity", "amplitude_rad", 2e-3)],
)
def test_a_wave_of_a_rigs_file_that_is_not_so_is_a_cause(
    effect: str, strength: str, size: float, is_there: bool
) -> None:
    order = {"order": 6.0} if effect == "cogging" else {}
    believed = MODEL.with_effect(effect, **{strength: size}, **order)
    hidden = MODEL.with_effect(effect, **{strength: 2.0 * size}, **order) if is_there else MODEL
    played = commands(3, 900) + np.where(np.arange(960) < 60, 0.0, 1.0)
    verdict = verdict_of(
        find_causes([recorded(hidden, 3, played=played)], believed, only=(effect,))
    )
    (cause,) = verdict.causes
    assert cause.effect == effect
    found = cause.parameters[strength].value
    assert found == pytest.approx(2.0 * size if is_there else 0.0, abs=0.05 * size)
