"""Whole trials in a third hand's rigs: the first null, and the first pair.

Chosen by nothing but their kind; `python -m tests.third` plays any other.
"""

import pytest

from tests.third.asked import asked
from tests.third.plant import has_compiler
from tests.third.told import run_trial

pytestmark = pytest.mark.skipif(not has_compiler(), reason="there is no C compiler")


@pytest.mark.nightly
@pytest.mark.parametrize(("seed", "kind"), [(1, "null"), (5, "pair")])
def test_what_is_hidden_in_a_third_hands_rig_is_named_and_nothing_else(
    seed: int, kind: str
) -> None:
    line = run_trial(seed)
    assert (line["kind"], line["failure"]) == (kind, "")
    assert line["score"]["right"], line["verdict"]["sentence"]
    assert line["score"]["sizes_right"], line["score"]["sizes"]


def test_each_is_the_first_of_its_kind() -> None:
    kinds = [asked(seed).kind for seed in range(6)]
    assert [kinds.index("null"), kinds.index("pair")] == [1, 5]
