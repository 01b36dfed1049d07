"""A handful of hidden-effect trials with the real diagnosis, short and on seeds of development.

What a campaign finds over hundreds is in its figures; here the chain must hold, and what is large
and unmistakable must be named.
"""

import pytest

from servo_bench.cli.app import COMMANDS
from tests.trial import run_trial
from tests.trials.drawing import Question

pytestmark = pytest.mark.skipif("diagnose" not in COMMANDS, reason="there is no diagnose command")

SECONDS = 6.0


@pytest.mark.parametrize(
    ("seed", "effect", "measured"),
    [
        (1501, "cogging", False),
        pytest.param(1507, "transport_delay", True, marks=pytest.mark.long),
    ],
)
def test_a_hidden_effect_is_named(seed: int, effect: str, *, measured: bool) -> None:
    line = run_trial(Question(seed=seed, effect=effect, seconds=SECONDS, measured=measured))
    assert line["failure"] == ""
    assert line["score"]["in_set"], line["score"]["named"]


def test_where_nothing_is_hidden_nothing_is_named() -> None:
    line = run_trial(Question(seed=1504, kind="none", seconds=SECONDS))
    assert line["failure"] == ""
    assert line["score"]["verdict"] != "named", line["score"]["named"]
