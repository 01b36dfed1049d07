"""A cause and a rival that changes something else: both may be, and one that is missed is."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from servo_bench.diagnosis.comparing.evidence import Evidence, evidence_of
from servo_bench.diagnosis.judging.causes import cause_of
from servo_bench.diagnosis.judging.judgement import UNSURE
from servo_bench.diagnosis.searching.contenders import Contender, Round, faced
from servo_bench.diagnosis.searching.joint import Named, own_unknowns
from servo_bench.diagnosis.searching.late import Late
from servo_bench.diagnosis.searching.rounds import Told
from servo_bench.diagnosis.searching.scales import scales_of
from servo_bench.diagnosis.searching.seeking import seek
from servo_bench.diagnosis.searching.unlike import beside_the_unlike
from servo_bench.report.diagnosis_page import _evidence_words
from tests.fit_hypotheses import BAND, DELAY, LAG, LINE, MODEL, SIZES, fitted, rig
from tests.fit_recordings import recorded


def doubted(seen: Evidence, effect: str, *rivals: str) -> Named:
    """A cause that leads its rivals by nothing, as a recording's beginning may say."""
    base = seek(seen, MODEL, BAND, iterations=3)
    played = faced(seen, base, [fitted(seen, name) for name in (effect, *rivals)])
    contenders = {c.effect: c for c in played.contenders}
    one = contenders[effect]
    others = tuple(_as_good(contenders[rival], one) for rival in rivals)
    begun: Round = replace(played, contenders=(one, *others))
    return Named(effect, begun, one, own_unknowns(one, effect))


def _as_good(rival: Contender, one: Contender) -> Contender:
    rough = np.random.default_rng(3).normal(0.0, 0.01 * one.costs.mean(), one.costs.size)
    return replace(rival, costs=one.costs + rough, held_gain=0.1)


def late_of(seen: Evidence, report: Told, *believed: str) -> Late:
    """Asked of everything, with nothing else to ask; the rig's file has what is `believed`."""
    commands = np.asarray(seen.fitted[0].source.rows.channel("velocity_command_rad_s"))
    scales = scales_of(MODEL, commands, 0.008)
    had = tuple((name, rig(name).effects[name]) for name in believed)
    return Late(seen, seen, (), scales._replace(believed=had), BAND, report)


@pytest.fixture(scope="module")
def seen() -> Evidence:
    """Of a rig with both."""
    return evidence_of([recorded(rig(LAG, LINE), 71, slots=900)], MODEL, block="loop")


NOT_BOTH = (((LINE,), False), ((LAG,), True))


@pytest.mark.parametrize(
    ("hidden", "is_there"),
    [((LAG, LINE), True), *(pytest.param(*it, marks=pytest.mark.long) for it in NOT_BOTH)],
)
def test_what_is_missed_beside_an_unlike_rival_is_no_matter_of_one_or_the_other(
    hidden: tuple[str, ...], is_there: bool
) -> None:
    both = evidence_of([recorded(rig(*hidden), 71, slots=900)], MODEL, block="loop")
    one, told = doubted(both, LAG, LINE), list[str]()
    (kept,) = beside_the_unlike(one.contender.found, [one], late_of(both, told.append))
    assert told == [f"{LAG} beside {LINE}"]
    assert kept.effect == LAG
    assert (kept is not one) is is_there
    assert kept.beside == (LINE if is_there else "")
    before, after = cause_of(one, {}), cause_of(kept, {})
    assert before.rival == LINE
    assert after.rival == (None if is_there else LINE)
    if is_there:
        names = {u.name for u in kept.round.base.unknowns}
        assert {f"{LINE}.torque_nm", f"{LINE}.phase_rad"} <= names, "the rival is free there"
        assert kept.round.base.model.effects[LAG].lag_s < 0.5 * SIZES[LAG]["lag_s"]
        assert after.confidence > max(before.confidence, UNSURE)


def test_what_is_no_rival_is_asked_beside_no_cause(seen: Evidence) -> None:
    """What is a cause itself, what is too small for a name, what was read off."""
    one = doubted(seen, LAG, LINE)
    final, line = one.contender.found, one.round.contenders[1]
    named = replace(one, effect=LINE, contender=line, missed_z=9.0)
    told = list[str]()
    late = late_of(seen, told.append)
    assert beside_the_unlike(final, [one, named], late) == [one, named]
    assert beside_the_unlike(final, [one], late, there=[LINE]) == [one]
    assert not told


def test_beside_one_that_changes_the_same_it_is_one_or_the_other(seen: Evidence) -> None:
    """However surely the cause is missed beside another one, which is not alike."""
    one, told = doubted(seen, LAG, LINE, DELAY), list[str]()
    assert beside_the_unlike(one.contender.found, [one], late_of(seen, told.append)) == [one]
    assert not told


def test_a_cause_that_the_rig_has_already_is_compared_with_that(seen: Evidence) -> None:
    one, told = doubted(seen, LAG, LINE), list[str]()
    assert beside_the_unlike(one.contender.found, [one], late_of(seen, told.append, LAG)) == [one]
    assert not told


def test_a_page_says_what_a_cause_was_told_beside() -> None:
    cause = SimpleNamespace(effect=LAG, evidence=7.0, rival=None, over_rival=None)
    verdict: Any = SimpleNamespace(causes=[cause])
    lost = SimpleNamespace(rows=())
    for beside, says in ((LINE, "both with cogging"), ("", "scatter.")):
        named = [SimpleNamespace(effect=LAG, beside=beside)]
        found: Any = SimpleNamespace(lattice=None, lost=lost, readings=(), named=named)
        (words,) = _evidence_words(verdict, found)
        assert says in words
