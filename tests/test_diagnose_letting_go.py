"""A cause that takes the place of one that was not asked: its name does not stand."""

from types import SimpleNamespace
from typing import Any

import pytest

from servo_bench.diagnosis.judging.judgement import verdict_of
from servo_bench.diagnosis.searching import letting_go
from servo_bench.diagnosis.searching.finding import find_causes
from servo_bench.diagnosis.searching.letting_go import (
    stands_at_its_end,
    without_idle,
    without_stand_ins,
)
from servo_bench.diagnosis.searching.unknowns import nuisances
from sim_rig.errors import EffectError
from sim_rig.model import Model
from tests.fit_recordings import NOMINAL, recorded

MODEL = Model(NOMINAL)
RUBS = {"torque_nm": 0.012}


@pytest.mark.parametrize(
    ("only", "named"),
    [
        pytest.param(("thermal_friction",), (), marks=pytest.mark.nightly),
        pytest.param(("thermal_friction", "coulomb"), ("coulomb",), marks=pytest.mark.long),
        pytest.param(("coulomb",), ("coulomb",), marks=pytest.mark.nightly),
    ],
)
def test_a_neighbour_of_what_is_not_asked_has_no_name(
    only: tuple[str, ...], named: tuple[str, ...]
) -> None:
    """Constant friction is one that warms slowly, where it may not be more than every rig's."""
    seen = recorded(MODEL.with_effect("coulomb", **RUBS), 71, slots=1000)
    finding = find_causes([seen], MODEL, only=only)
    told = verdict_of(finding)
    assert told.names == named, told.sentence
    assert told.verdict == ("named" if named else "unknown")
    assert [doubt.effect for doubt in finding.doubts] == ([] if named else ["thermal_friction"])
    assert all("coulomb" in doubt.instead for doubt in finding.doubts)
    assert named or "coulomb" in told.sentence


def test_a_number_is_held_back_at_either_end_of_a_band() -> None:
    band = {u.effect: u for u in nuisances(0.1, 0.02)}
    damping, inertia = band["viscous"], band["inertia_error"]
    assert stands_at_its_end(damping, damping.high)
    assert not stands_at_its_end(damping, 0.0)
    assert stands_at_its_end(inertia, inertia.low)
    assert not stands_at_its_end(inertia, 0.5 * inertia.low)


@pytest.mark.parametrize(
    ("effect", "missed", "instead", "kept"),
    [
        ("coupling_compliance", True, ("viscous",), False),
        ("coupling_compliance", True, (), True),
        ("coupling_compliance", False, (), False),
        ("coulomb", True, ("viscous",), True),  # a law of its own, asked beside the damping
    ],
)
def test_a_coupling_that_a_little_more_damping_would_be_has_no_name(
    monkeypatch: pytest.MonkeyPatch, effect: str, missed: bool, instead: tuple[str, ...], kept: bool
) -> None:
    monkeypatch.setattr(letting_go, "_holds", lambda *_: True)
    monkeypatch.setattr(letting_go, "_instead", lambda *_, **__: instead)
    monkeypatch.setattr(letting_go, "is_needed", lambda *_: missed)
    monkeypatch.setattr(letting_go, "without_effect", lambda *_: None)
    one: Any = SimpleNamespace(effect=effect)
    nothing: Any = None
    final: Any = SimpleNamespace()
    less, named = without_stand_ins(nothing, final, [one], nuisances(0.1, 0.02))
    assert (named == [one]) is kept
    assert (less is final) is kept


@pytest.mark.parametrize(
    ("effect", "missed", "rounds", "left"),
    [
        ("anti_windup", True, (), ["anti_windup"]),
        ("anti_windup", False, ("current_limit",), ["current_limit"]),
        ("anti_windup", False, ("viscous",), []),  # both stood in for something else
        ("coulomb", False, (), ["coulomb"]),
    ],
)
def test_what_acts_beside_another_is_no_cause_where_that_would_do(
    monkeypatch: pytest.MonkeyPatch,
    effect: str,
    missed: bool,
    rounds: tuple[str, ...],
    left: list[str],
) -> None:
    monkeypatch.setattr(letting_go, "without_effect", lambda *_: None)
    monkeypatch.setattr(letting_go, "is_needed", lambda *_: missed)
    monkeypatch.setattr(
        letting_go, "carried_by", lambda _, carrier: SimpleNamespace(effect=carrier)
    )
    played = SimpleNamespace(contenders=[SimpleNamespace(effect=one) for one in rounds])
    one: Any = SimpleNamespace(effect=effect, round=played)
    nothing: Any = None
    _, named = without_idle(nothing, nothing, [one], ())
    assert [n.effect for n in named] == left


def test_a_coupling_that_others_need_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    """A load's friction rubs behind it: without the coupling there is no such rig."""

    def no_rig(*_: Any, **__: Any) -> None:
        raise EffectError("load_friction needs a load")

    monkeypatch.setattr(letting_go, "_holds", lambda *_: True)
    monkeypatch.setattr(letting_go, "without_effect", no_rig)
    one: Any = SimpleNamespace(effect="coupling_compliance")
    nothing: Any = None
    final: Any = SimpleNamespace()
    less, named = without_stand_ins(nothing, final, [one], nuisances(0.1, 0.02))
    assert less is final
    assert named == [one]
