"""Thousands of cases of whatever anybody may send or write: only our own errors come out."""

from typing import Any

import pytest
from hypothesis import HealthCheck, Phase, given, settings

from tests.fuzz_targets import TARGETS, examples

COUNT = 1_500


@pytest.mark.parametrize("count", [COUNT, pytest.param(10_000, marks=pytest.mark.nightly)])
@pytest.mark.parametrize("name", TARGETS)
def test_only_our_errors_come_out(name: str, count: int) -> None:
    target = TARGETS[name]

    @settings(
        max_examples=examples(target, count),
        deadline=None,
        database=None,
        phases=[Phase.generate, Phase.shrink],
        suppress_health_check=list(HealthCheck),
    )
    @given(target.cases)
    def play(case: Any) -> None:
        target(case)

    play()


FOUND: list[tuple[str, Any]] = [
    ("frames: counter", b"\x02"),
    ("frames: CANopen, to the master", [(2, 0x581, b"", False)]),
    ("frames: CANopen, to the master", [*[(0, 0x81, b"", False)] * 7, (85, 0x701, b"", False)]),
]


@pytest.mark.parametrize(("name", "case"), FOUND)
def test_what_was_found_once_stays_mended(name: str, case: Any) -> None:
    TARGETS[name](case)
