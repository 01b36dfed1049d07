"""Our CANopen master against durand, an independent CANopen responder (PyPI)."""

from collections.abc import Iterator
from pathlib import Path

import pytest

pytest.importorskip("durand")

from drivers.canopen.master import CanopenAxis
from drivers.canopen.settings import CanopenSettings, DriveSettings, NodeSettings
from drivers.clock import SYSTEM_CLOCK
from drivers.errors import DriveError
from tests.contract_axis import check_axis
from tests.strangers.durand_drive import COUNTS, DurandDrive

PERIOD_S = 0.02


@pytest.fixture
def drive(request: pytest.FixtureRequest) -> Iterator[DurandDrive]:
    drive = DurandDrive(request.node.name)
    yield drive
    drive.close()


@pytest.fixture
def settings(drive: DurandDrive, tmp_path: Path, request: pytest.FixtureRequest) -> CanopenSettings:
    node = NodeSettings(1, drive.eds(tmp_path / "durand.eds"))
    return CanopenSettings(
        bus={"interface": "virtual", "channel": request.node.name},
        drive=DriveSettings(node, COUNTS, without_watchdog=True),
        encoder=None,
        period_s=PERIOD_S,
    )


def test_the_master_keeps_the_promise_of_every_axis(
    drive: DurandDrive, settings: CanopenSettings
) -> None:
    check_axis(lambda: CanopenAxis(settings), lambda: drive.enabled, period_s=PERIOD_S)


def test_its_dictionary_is_read_from_the_eds_that_it_writes(
    drive: DurandDrive, settings: CanopenSettings
) -> None:
    with CanopenAxis(settings) as axis:
        told = {event.kind for event in axis.events()}
        assert drive.enabled
    assert "master not watched" in told, "durand has no heartbeat consumer (0x1016)"
    read = drive.node.object_dictionary.read
    assert read(0x1017, 0) == 100
    assert [read(0x1600, sub) for sub in (0, 1, 2)] == [2, 0x60400010, 0x60FF0020]
    assert [read(0x1A00, sub) for sub in (0, 1, 2)] == [2, 0x60410010, 0x60640020]


def test_an_emergency_of_a_stranger_ends_the_run(
    drive: DurandDrive, settings: CanopenSettings
) -> None:
    with CanopenAxis(settings) as axis:
        drive.trip(0x3210)
        axis.command(0.0, 0)
        axis.samples(SYSTEM_CLOCK.now_ns() + round(PERIOD_S * 1e9))
        kinds = {event.kind: event.text for event in axis.events() if event.fatal}
    assert "0x3210 (DC link over-voltage)" in kinds["emergency"]
    assert not drive.enabled


def test_a_stranger_that_refuses_is_told_with_its_own_abort_code(
    drive: DurandDrive, settings: CanopenSettings
) -> None:
    drive.node.object_dictionary.write(0x6502, 0, 1 << 2)
    words = "does not support mode csv"
    with pytest.raises(DriveError, match=words), CanopenAxis(settings):
        pytest.fail("entered")
