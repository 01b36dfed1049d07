"""A cause that makes a recording of another excitation no better has no name."""

from types import SimpleNamespace
from typing import Any

import pytest

from servo_bench.diagnosis.comparing.evidence import evidence_of
from servo_bench.diagnosis.judging.confirming import unconfirmed
from servo_bench.diagnosis.judging.judgement import verdict_of
from servo_bench.diagnosis.searching.finding import find_causes
from servo_bench.recording.recording import Recording
from sim_rig.model import Model
from tests.fit_recordings import NOMINAL, recorded

MODEL = Model(NOMINAL)
RUBS = MODEL.with_effect("coulomb", torque_nm=4e-3, transition_rad_s=0.01)
NEVER = MODEL.with_effect("current_limit", limit_per_a=0.01)


def found(model: Model, held_out: Recording | None) -> Any:
    """As much of a finding as is asked: the final fit is right about what it saw."""
    whole = evidence_of([recorded(model, 81)], model, block="loop")
    sigma = whole.deviation(whole.seen([model])[0])
    final = SimpleNamespace(model=model, sigma=sigma)
    named = [SimpleNamespace(effect=effect) for effect in model.effects]
    return SimpleNamespace(held_out=held_out, named=named, final=final, whole=whole)


@pytest.mark.parametrize(
    ("model", "rig", "against"),
    [
        (RUBS, RUBS, frozenset()),
        (RUBS, MODEL, frozenset({"coulomb"})),
        (NEVER, MODEL, frozenset()),  # what is silent there is neither confirmed nor denied
    ],
)
def test_a_cause_must_make_what_was_held_out_better(
    model: Model, rig: Model, against: frozenset[str]
) -> None:
    assert unconfirmed(found(model, recorded(rig, 82))) == against


def test_without_a_held_out_recording_nothing_is_said() -> None:
    assert unconfirmed(found(RUBS, None)) == frozenset()


def test_of_two_causes_only_the_one_that_does_not_help_is_denied() -> None:
    both = RUBS.with_effect("cogging", torque_nm=4e-3, order=24.0)
    assert unconfirmed(found(both, recorded(RUBS, 83))) == {"cogging"}


def test_a_cause_that_the_held_out_recording_denies_is_noted_and_not_named() -> None:
    """Friction that was gone when the held-out recording was made."""
    seen, gone, same = recorded(RUBS, 84, slots=800), recorded(MODEL, 85), recorded(RUBS, 85)
    verdicts = [
        verdict_of(find_causes([seen], MODEL, held_out=held_out, only=("coulomb",)))
        for held_out in (same, gone)
    ]
    assert verdicts[0].names == ("coulomb",)
    assert verdicts[1].names == ()
    assert verdicts[1].verdict == "unknown"  # something is wrong, and that does not explain it
    assert any("the held-out one is no better by it" in note for note in verdicts[1].notes)
