"""Twenty faults on the real wire: the same causes as in virtual time, and the drive off after."""

import logging
from pathlib import Path

import pytest

from tests.fault_scenarios import GOES_ON, Scenario
from tests.wire_faults import run_on_wire

pytestmark = pytest.mark.wire

SILENT = ("node silent", "heartbeat missing")
BUS = ("bus silent", "heartbeat missing", "emergency")
SCENARIOS = [
    ("lost frames=load at=20 count=3", (GOES_ON,), "answer lost"),
    ("lost frames=drive at=20 count=0", SILENT, "drive 1"),
    ("lost frames=encoder at=20 count=0", SILENT, "encoder 2"),
    ("lost frames=sync at=20 count=0", ("bus silent",), ""),
    ("late frames=answers at=20 delay_ms=12 count=5", (GOES_ON,), ""),
    ("reordered frames=drive at=20 count=5", (GOES_ON,), ""),
    ("slow-slave frames=drive delay_ms=2", (GOES_ON,), ""),
    ("bus-off at=20 for_ms=600", BUS, ""),
    ("reset node=drive at=20", ("node restarted",), "drive 1"),
    ("reset node=encoder at=20", ("node restarted",), "encoder 2"),
    ("emcy node=drive code=0x3220 at=20", ("emergency",), "0x3220"),
    ("sdo-abort object=0x60C2:1 code=0x06090030", ("DriveError",), "0x60C2:1"),
    ("stuck-encoder encoder=load at=10", ("load does not move",), "load"),
    ("stuck-encoder encoder=motor at=10", ("motor does not move", "motor encoder stuck"), "drive"),
    ("encoder-jump encoder=load at=20 counts=9000", ("LimitError",), "the load's velocity"),
    ("lying-statusword at=20 power=on value=0x0250", ("drive not enabled",), "drive 1"),
    ("lying-statusword at=20 power=off", ("motor does not move", "motor does not follow"), "drive"),
]


@pytest.mark.parametrize(
    ("fault", "right", "names"),
    [
        pytest.param(*it, id=it[0], marks=[pytest.mark.long] if k % 3 else [])
        for k, it in enumerate(SCENARIOS)
    ],
)
def test_the_run_ends_or_goes_on_with_the_right_cause_and_the_drive_is_off(
    fault: str,
    right: tuple[str, ...],
    names: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(logging.getLogger("can"), "propagate", False)
    outcome = run_on_wire(Scenario(5, fault, right, names), tmp_path)
    assert outcome.right, outcome
    assert not outcome.moving, outcome
    assert outcome.readable, outcome
