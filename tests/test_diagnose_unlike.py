"""A cause and a rival that changes something else: both may be, and one that is missed is."""

from dataclasses import replace

import numpy as np
import pytest

from servo_bench.diagnosis.comparing.evidence import Evidence, evidence_of
from servo_bench.diagnosis.judging.causes import cause_of
from servo_bench.diagnosis.judging.judgement import UNSURE
from servo_bench.diagnosis.searching.contenders import Contender, Round, faced
from servo_bench.diagnosis.searching.finding import nothing_told
from servo_bench.diagnosis.searching.hypotheses import Hypothesis, Trial
from servo_bench.diagnosis.searching.joint import Named, own_unknowns
from servo_bench.diagnosis.searching.late import Late
from servo_bench.diagnosis.searching.rounds import Told
from servo_bench.diagnosis.searching.scales import scales_of
from servo_bench.diagnosis.searching.seeking import Found, seek
from servo_bench.diagnosis.searching.unknowns import merged, nuisances, widened
from servo_bench.diagnosis.searching.unlike import beside_the_unlike
from sim_rig.model import Model
from tests.fit_recordings import NOMINAL, recorded

MODEL = Model(NOMINAL)
BAND = nuisances(0.05, NOMINAL.backlash_gap_rad)
LAG, LINE = "current_loop_lag", "cogging"
SIZES = {LAG: {"lag_s": 4e-4}, LINE: {"torque_nm": 3e-3, "order": 24.0, "phase_rad": 0.4}}
FREE = {LAG: ("lag_s",), LINE: ("torque_nm", "phase_rad")}


def rig(*effects: str) -> Model:
    """With these wrong."""
    model = MODEL
    for effect in effects:
        model = model.with_effect(effect, **SIZES[effect])
    return model


def fitted(seen: Evidence, effect: str) -> tuple[Found, Hypothesis]:
    """The search of a hypothesis from its true size."""
    start, size = rig(effect), next(iter(SIZES[effect].values()))
    own = widened(effect, FREE[effect], start, size)
    hypothesis = Hypothesis(effect, (Trial(effect, dict(SIZES[effect]), size),), FREE[effect])
    return seek(seen, start, merged(BAND, own), iterations=3), hypothesis


def doubted(seen: Evidence, effect: str, rival: str) -> Named:
    """A cause that leads its rival by nothing, as a recording's beginning may say."""
    base = seek(seen, MODEL, BAND, iterations=3)
    played = faced(seen, base, [fitted(seen, name) for name in (effect, rival)])
    contenders = {c.effect: c for c in played.contenders}
    one = contenders[effect]
    other = replace(contenders[rival], costs=one.costs + _noise(one), held_gain=0.1)
    begun: Round = replace(played, contenders=(one, other))
    return Named(effect, begun, one, own_unknowns(one, effect))


def _noise(one: Contender) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    return np.random.default_rng(3).normal(0.0, 0.01 * one.costs.mean(), one.costs.size) + 1e-6


def late_of(seen: Evidence, report: Told = nothing_told) -> Late:
    """Asked of everything, with nothing else to ask."""
    commands = np.asarray(seen.fitted[0].source.rows.channel("velocity_command_rad_s"))
    return Late(seen, seen, (), scales_of(MODEL, commands, 0.008), BAND, report)


@pytest.mark.parametrize(
    ("hidden", "is_there"), [((LAG, LINE), True), ((LINE,), False), ((LAG,), True)]
)
def test_what_is_missed_beside_an_unlike_rival_is_no_matter_of_one_or_the_other(
    hidden: tuple[str, ...], is_there: bool
) -> None:
    seen = evidence_of([recorded(rig(*hidden), 71, slots=900)], MODEL, block="loop")
    one = doubted(seen, LAG, LINE)
    final = one.contender.found
    (kept,) = beside_the_unlike(final, [one], late_of(seen))
    assert kept.effect == LAG
    assert (kept is not one) is is_there
    if is_there:
        assert LINE in kept.round.base.model.effects
        assert LAG in kept.round.base.model.effects  # in its band, as every rig may have it
        assert cause_of(one, {}).confidence < cause_of(kept, {}).confidence > UNSURE


@pytest.mark.parametrize("named", [True, False])
def test_no_rival_is_asked_that_is_a_cause_already(named: bool) -> None:
    seen = evidence_of([recorded(rig(LAG, LINE), 71, slots=600)], MODEL, block="loop")
    one = doubted(seen, LAG, LINE)
    final = one.contender.found
    told: list[str] = []
    small = [LINE] if named else []
    beside_the_unlike(final, [one], late_of(seen, told.append), small=small)
    assert bool(told) is not named
