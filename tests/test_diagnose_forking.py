"""Two that explain as much and change something else: which comes first is tried both ways."""

from dataclasses import replace

import numpy as np
import pytest

from servo_bench.diagnosis.comparing.evidence import Evidence, evidence_of
from servo_bench.diagnosis.searching import forking
from servo_bench.diagnosis.searching.accepting import Accepted, one_way
from servo_bench.diagnosis.searching.contenders import Contender, Round, faced
from servo_bench.diagnosis.searching.finding import nothing_told
from servo_bench.diagnosis.searching.forking import fork_of, rounds_of
from servo_bench.diagnosis.searching.joint import Named, own_unknowns
from servo_bench.diagnosis.searching.scales import scales_of
from servo_bench.diagnosis.searching.seeking import seek
from tests.fit_hypotheses import BAND, DELAY, LAG, LINE, MODEL, fitted, rig
from tests.fit_recordings import recorded

SIZES = {
    LAG: {"lag_s": 6e-4},
    DELAY: {"delay_s": 6e-4},
    LINE: {"torque_nm": 4e-3, "order": 24.0, "phase_rad": 0.4},
}
"""Of which either is beyond chance beside neither."""


@pytest.fixture(scope="module")
def seen() -> Evidence:
    """Of a rig with a lag and a line, which change different things."""
    return evidence_of([recorded(rig(LAG, LINE, sizes=SIZES), 91, slots=900)], MODEL, block="loop")


@pytest.fixture(scope="module")
def played(seen: Evidence) -> Round:
    base = seek(seen, MODEL, BAND, iterations=3)
    return faced(seen, base, [fitted(seen, effect, SIZES) for effect in SIZES])


@pytest.fixture
def walked(seen: Evidence, played: Round) -> tuple[Evidence, Round]:
    return seen, played


def told(played: Round, *effects: str, apart: float = 0.0) -> Round:
    """With these contenders alone; the others are `apart` of the first one's cost behind it."""
    first, *others = (next(c for c in played.contenders if c.effect == e) for e in effects)
    return replace(played, contenders=(first, *(_behind(c, first, apart) for c in others)))


def _behind(other: Contender, first: Contender, apart: float) -> Contender:
    rough = np.random.default_rng(4).normal(apart, 0.02, first.costs.size)
    return replace(other, costs=first.costs * (1.0 + rough))


def fork(played: Round, accepted: str) -> str | None:
    (one,) = (c for c in played.contenders if c.effect == accepted)
    found = fork_of(played, one)
    return None if found is None else found.effect


def test_another_way_begins_with_what_is_as_good_and_changes_something_else(played: Round) -> None:
    assert fork(told(played, LAG, LINE), LAG) == LINE
    assert fork(told(played, LAG, LINE), LINE) == LAG, "whoever was accepted of the two"
    assert fork(told(played, LAG, DELAY), LAG) is None, "the same way by another name"
    assert fork(told(played, LAG, LINE, apart=0.2), LAG) is None, "it is behind beyond chance"
    assert fork(told(played, LAG), LAG) is None


@pytest.mark.parametrize(("like", "other"), [(0.86, LINE), (0.96, None)])
def test_another_way_may_change_much_of_the_same(
    played: Round, monkeypatch: pytest.MonkeyPatch, like: float, other: str | None
) -> None:
    """Friction of the load does of what the motor's does."""
    monkeypatch.setattr(Round, "likeness", lambda *_: like)
    assert fork(told(played, LAG, LINE), LAG) == other


def test_a_coupling_begins_no_other_way(played: Round) -> None:
    """Its three numbers fit a part of anything."""
    both = told(played, LAG, LINE)
    spring = replace(both.contenders[1].hypothesis, effect="coupling_compliance")
    other = replace(both.contenders[1], hypothesis=spring)
    assert fork(replace(both, contenders=(both.contenders[0], other)), LAG) is None


def test_a_way_goes_on_from_who_is_accepted_of_the_round_that_was_played(
    seen: Evidence, played: Round
) -> None:
    """Where nothing else is to ask it ends with that, beside the round it came from."""
    begun = told(played, LAG, LINE)
    commands = np.asarray(seen.fitted[0].source.rows.channel("velocity_command_rad_s"))
    scales = scales_of(MODEL, commands, 0.008)
    for one in begun.contenders:
        asked = (one.hypothesis,)
        way = one_way(seen, begun.base, asked, scales, nothing_told, begun=(begun, one))
        assert [n.effect for n in way.named] == [one.effect]
        assert way.first is one
        assert way.rounds == [begun]
        assert way.now is one.found
    assert one_way(seen, begun.base, (), scales, nothing_told).rounds == []


@pytest.mark.parametrize(
    ("ways", "kept", "asked"),
    [
        (((LAG,), (LAG, LINE)), 1, ["", LINE]),
        pytest.param(((LAG,), (DELAY,)), 0, ["", LINE], marks=pytest.mark.long),
        pytest.param(((LAG, LINE), (LINE,)), 0, [""], marks=pytest.mark.long),
    ],
)
def test_the_better_way_is_taken_and_a_right_one_at_once(
    walked: tuple[Evidence, Round],
    ways: tuple[tuple[str, ...], ...],
    kept: int,
    asked: list[str],
) -> None:
    seen, played = walked
    first, begun_with = told(played, LAG, LINE), list[str]()
    ends = [_end(seen, first, effects) for effects in ways]

    def way(*_: object, begun: tuple[Round, Contender] | None = None) -> Accepted:
        begun_with.append("" if begun is None else begun[1].effect)
        return ends[len(begun_with) - 1]

    commands = np.asarray(seen.fitted[0].source.rows.channel("velocity_command_rad_s"))
    scales = scales_of(MODEL, commands, 0.008)
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(forking, "one_way", way)
        found = rounds_of(seen, first.base, (), scales, nothing_told)
    assert found is ends[kept]
    assert begun_with == asked


def _end(seen: Evidence, played: Round, effects: tuple[str, ...]) -> Accepted:
    """Of a way that found these."""
    free = tuple(u for u in BAND if u.effect not in SIZES)
    end = seek(seen, rig(*effects, sizes=SIZES), free, played.sigma, iterations=2)
    one = played.contenders[0]
    names = [Named(effect, played, one, own_unknowns(one, effect)) for effect in effects]
    return Accepted(end, names, [], [played], [], one)
