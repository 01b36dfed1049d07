"""Two causes of which neither is beyond chance alone: each rule on numbers."""

from types import SimpleNamespace
from typing import Any

import pytest

from servo_bench.diagnosis.searching import in_two as here
from servo_bench.diagnosis.searching.in_two import in_two
from sim_rig.model import Model
from tests.fit_recordings import NOMINAL

DROOP, FRICTION = "torque_constant_droop", "load_dependent_friction"


def one(effect: str, *gains: float) -> Any:
    """Gain and z of what was seen, and of what was held out."""
    names = ("seen_gain", "seen_z", "held_gain", "held_z")
    told = dict(zip(names, gains, strict=True))
    found = SimpleNamespace(model=Model(NOMINAL))
    return SimpleNamespace(effect=effect, found=found, hypothesis=None, **told)


HALF = one(DROOP, 0.88, 7.8, -0.36, -5.1)
REST = one(FRICTION, 0.56, 27.0, 0.68, 21.0)
BOTH = one(FRICTION, 0.93, 10.0, 0.44, 20.0)


@pytest.mark.parametrize(
    ("first", "second", "both", "there"),
    [
        (HALF, REST, BOTH, True),
        (one(DROOP, 0.3, 7.8, -0.36, -5.1), REST, BOTH, False),  # no half of it
        (HALF, one(FRICTION, 0.02, 3.0, 0.68, 21.0), BOTH, False),  # not beyond chance beside it
        (HALF, REST, one(FRICTION, 0.93, 10.0, -0.1, -3.0), False),  # both mend nothing unseen
        (one("coupling_compliance", 0.88, 7.8, -0.36, -5.1), REST, BOTH, False),
        (HALF, one("coupling_compliance", 0.56, 27.0, 0.68, 21.0), BOTH, False),
    ],
)
def test_two_are_causes_where_both_mend_what_no_fit_saw(
    monkeypatch: pytest.MonkeyPatch, first: Any, second: Any, both: Any, there: bool
) -> None:
    asked_there = []

    def play(_: object, __: object, asked: Any, *___: object) -> Any:
        asked_there.extend(h.effect for h in asked)
        return SimpleNamespace(contenders=(second,))

    monkeypatch.setattr(here, "play_round", play)
    monkeypatch.setattr(here, "faced", lambda *_, **__: SimpleNamespace(contenders=(both,)))
    alone: Any = SimpleNamespace(contenders=(first,), base=None, sigma=None)
    asked: Any = [SimpleNamespace(effect=effect) for effect in (DROOP, FRICTION)]
    evidence: Any = None
    found = in_two(evidence, alone, asked, {}, lambda _: None)
    assert (found is not None) is there
    assert DROOP not in asked_there
    if found is not None:
        assert (found.first, found.second) == (first, second)
