"""Whole trials in a third hand's rigs: the first seed of each kind, and the first coupling.

Chosen by nothing but their kind; `python -m tests.third` plays any other.
"""

import pytest

from tests.third.asked import asked
from tests.third.plant import has_compiler
from tests.third.told import run_trial

pytestmark = pytest.mark.skipif(not has_compiler(), reason="there is no C compiler")


@pytest.mark.long
@pytest.mark.parametrize(
    ("seed", "kind"),
    [(0, "outside"), (1, "null"), (2, "one"), (5, "pair"), (18, "pair")],
    ids=["a supply", "nothing", "ripple", "ripple and friction", "coupling and ripple"],
)
def test_what_is_hidden_in_a_third_hands_rig_is_named_and_nothing_else(
    seed: int, kind: str
) -> None:
    line = run_trial(seed)
    assert (line["kind"], line["failure"]) == (kind, "")
    assert line["score"]["right"], line["verdict"]["sentence"]
    assert line["score"]["sizes_right"], line["score"]["sizes"]


def test_each_is_the_first_of_its_kind() -> None:
    trials = [asked(seed) for seed in range(19)]
    kinds = [trial.kind for trial in trials]
    assert [kinds.index(kind) for kind in ("outside", "null", "one", "pair")] == [0, 1, 2, 5]
    coupled = ["coupling_compliance" in [h.effect for h in trial.hidden] for trial in trials]
    assert coupled.index(True) == 18
