"""Two hundred seeded faults in virtual time, and that the campaign itself can fail."""

from dataclasses import replace
from pathlib import Path

import pytest

from tests.fault_campaign import run_scenario
from tests.fault_outcome import Outcome, judged, passes
from tests.fault_scenarios import GOES_ON, MAKERS, Scenario, scenario
from tests.virtual_line import install_lines
from tests.virtual_rig import install

SEED = 20
PARTS, EACH = 8, 25
AT_ONCE = 2  # of these parts; the others are long


@pytest.fixture(autouse=True, scope="module")
def _installed() -> None:
    install()
    install_lines()


@pytest.mark.parametrize(
    "part",
    [
        *range(AT_ONCE),
        *(pytest.param(it, marks=pytest.mark.long) for it in range(AT_ONCE, PARTS)),
    ],
)
def test_no_hang_nothing_left_moving_and_the_right_cause_named(part: int, tmp_path: Path) -> None:
    numbers = range(part * EACH, (part + 1) * EACH)
    figures = judged([run_scenario(scenario(SEED, number), tmp_path) for number in numbers])
    assert passes(figures | {"right_share": 1.0}), figures
    assert figures["right"] == EACH, figures["wrong"]


@pytest.mark.long
def test_a_scenario_is_repeatable(tmp_path: Path) -> None:
    for number in range(len(MAKERS)):
        first, again = (run_scenario(scenario(3, number), tmp_path) for _ in range(2))
        assert (first.cause, first.text, first.told) == (again.cause, again.text, again.told)
        assert first.played == again.played


@pytest.mark.parametrize("rig", ["paper", "serial-counter", "modbus-tcp", "modbus-rtu"])
def test_in_slots_that_the_bench_missed_the_motor_went_on_as_commanded(
    rig: str, tmp_path: Path
) -> None:
    stall = Scenario(5, "stall at=21 for_ms=185", (GOES_ON,), "slot skipped", rig)
    outcome = run_scenario(stall, tmp_path)
    assert outcome.flawless, outcome


def test_the_judge_sees_each_flaw() -> None:
    goes_on = next(it for it in (scenario(1, n) for n in range(99)) if it.right == (GOES_ON,))
    ends = next(it for it in (scenario(1, n) for n in range(99)) if "emcy" in it.fault)
    good = Outcome(goes_on, cause=GOES_ON, told=[goes_on.names])
    named = Outcome(ends, cause="emergency", text=f"it was {ends.names}")
    assert passes(judged([good, named]))
    for flaw in (
        replace(good, hung=True),
        replace(good, moving=True),
        replace(good, readable=False),
        replace(named, cause=GOES_ON),
        replace(named, cause="node silent"),
        replace(named, text="it was something else"),
        replace(good, cause="LimitError", text="the load's velocity"),
    ):
        assert not passes(judged([good, named, flaw])), flaw
