"""How far beyond its own limit a hidden cause is: measured from the truth alone."""

import json
from pathlib import Path

import pytest

from tests.trials.drawing import Question
from tests.trials.margins import counted, main, margin_of


def cogging(multiple: float) -> Question:
    return Question(seed=1904, effect="cogging", multiple=multiple)


@pytest.mark.long
def test_a_cause_that_is_linear_is_twice_as_far_out_at_twice_its_size() -> None:
    near, far = (margin_of(cogging(multiple)) for multiple in (2.0, 4.0))
    assert far == pytest.approx(2.0 * near, rel=0.02)
    assert 0.5 < near / 2.0 < 2.0  # its own rig's limit is near the one of three rigs


def test_those_nearer_than_their_limit_are_not_counted_from_there_on() -> None:
    trials = [
        {"margin": margin, "right": right} for margin, right in ((0.2, False), (3.0, True), (9, 1))
    ]
    found = counted(trials)
    assert [found[m]["of"] for m in ("1", "2", "4", "8")] == [2, 2, 1, 1]
    assert found["1"]["share"] == 1.0


def test_the_margins_of_a_campaign_are_written_beside_its_lines(tmp_path: Path) -> None:
    question = cogging(8.0)
    said = {"hidden": {"causes": ["cogging"]}, "score": {"right": True}}
    null = {"question": Question(seed=1904, kind="none").numbers(), **said}
    lines = [{"question": question.numbers(), **said}, null]
    path = tmp_path / "out.jsonl"
    path.write_text("".join(json.dumps(line) + "\n" for line in lines))
    assert main([str(path)]) == 0
    written = json.loads((tmp_path / "out-margins.json").read_text())
    assert [(t["cause"], t["right"]) for t in written["trials"]] == [("cogging", True)]
    assert written["named_from"]["2"]["of"] == 1
