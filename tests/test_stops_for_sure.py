"""A stop whose first word is lost, refused, or not confirmed: nothing turns on meanwhile."""

import re
import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from types import TracebackType
from typing import Any, Self

import numpy as np
import pytest
from pymodbus.pdu import ExceptionResponse, ModbusPDU

from drivers.axis import Sample, StopAsked
from drivers.canopen.master import CanopenAxis
from drivers.canopen.node import NMT_STOP
from drivers.canopen.settings import CanopenSettings
from drivers.canopen.stopline import CanopenStopLine
from drivers.clock import SYSTEM_CLOCK
from drivers.errors import DriveError, DriverError, StopAskedError, WireError
from drivers.modbus.link import Reply
from drivers.modbus.master import ModbusAxis
from drivers.modbus.setup import Registers
from drivers.modbus.stopping import stop_over
from servo_bench.errors import DriveError as BenchDriveError
from servo_bench.errors import LimitError, gathered
from servo_bench.rig import RigConfig, load_rig
from servo_bench.run import busloop
from servo_bench.run.busloop import Job, player_for, run_job
from servo_bench.run.table import UNPLAYED, SlotTable, Stage
from servo_bench.run.virtual import play_virtually
from servo_bench.run.virtual_wire import VirtualWire
from tests.small_runs import experiment, paper_rig
from tests.virtual_line import install_lines
from tests.virtual_modbus import VirtualModbus
from tests.virtual_rig import VirtualRig, install

PERIOD_S, PERIOD_NS = 0.008, 8_000_000
LAST = 299
SDO_ANSWER = 0x581
ENABLE_OPERATION = 0x0F


@pytest.mark.parametrize("fault", ["", "lost frames=drive-state at=295", "lost frames=load at=299"])
def test_while_an_answer_that_is_lost_is_waited_for_the_motor_is_told_to_stand(fault: str) -> None:
    """It turned at 150 deg/s when the stop was asked; and what was answered is recorded."""
    rig = paper_rig().with_faults(fault) if fault else paper_rig()
    wire = VirtualWire(rig.simulation_settings())
    settings = rig.model_copy(update={"bus": wire.bus}).canopen_settings(PERIOD_S)
    schedule = experiment().schedule()
    with SlotTable.create(schedule.slots) as table, StoppedAxis(settings, wire, table) as axis:
        player = player_for(rig, axis, schedule, table, wire.run_clock())
        player.play(wire.now_ns + PERIOD_NS, lambda *_, **__: None)
        assert table.done == LAST + 1
        assert list(table.rows["slot"][: LAST + 2]) == [*range(LAST + 1), UNPLAYED]
        answered = np.isfinite(table.rows["motor_position_rad"][: LAST + 1])
        assert np.count_nonzero(~answered) == ("drive-state" in fault)
        last_s, last_rad_s = axis.commands[-1]
        if fault:
            assert last_rad_s == 0.0
            assert axis.stage is Stage.RESTING
            assert len(set(axis.beats_ns)) == len(axis.commands), "the supervisor sees each of them"
            first_s = next(at_s for at_s, command in axis.commands if at_s and command == 0.0)
            assert first_s - axis.asked_s <= 1.5 * PERIOD_S
            assert last_s - first_s <= settings.answer_timeout_s + 2 * PERIOD_S
        else:
            assert abs(last_rad_s) == pytest.approx(np.radians(150.0))
            assert wire.now_ns * 1e-9 - last_s <= PERIOD_S


@pytest.mark.parametrize("silent", ["encoder", "drive"])
def test_what_the_other_node_answered_while_one_was_silent_is_recorded(silent: str) -> None:
    """Its answers wait for those of the silent one, for as long as these may be late."""
    run = play_virtually(
        experiment(), paper_rig().with_faults(f"lost frames={silent} at=200 count=0")
    )
    assert run.error is not None
    (stopped_in,) = re.findall(r"stopped in slot (\d+)", str(run.error))
    slots = run.recording["slot"]
    assert list(slots) == list(range(int(stopped_in) + 1))
    channel = {"encoder": "motor_position_rad", "drive": "load_angle_rad"}[silent]
    answered = np.isfinite(run.recording[channel])
    assert np.count_nonzero(answered[200:]) >= 0.2 / PERIOD_S


class StoppedAxis(CanopenAxis):
    """Asks to stop with a command in the middle, as an operator would; knows what came after."""

    def __init__(self, settings: CanopenSettings, wire: VirtualWire, table: SlotTable) -> None:
        super().__init__(settings, wire.drivers_clock())
        self._wire, self._table = wire, table
        self.asked_s = 0.0
        self.beats_ns: list[int] = []
        self.stage = Stage.STARTING
        self.commands: list[tuple[float, float]] = []

    def command(self, velocity_rad_s: float, slot: int) -> int:
        now_s = self._wire.now_ns * 1e-9
        if slot == LAST:
            self._table.ask_stop()
            self.asked_s = now_s
        if self.asked_s:
            self.commands.append((now_s, velocity_rad_s))
            self.beats_ns.append(self._table.beat_ns)
            self.stage = self._table.stage
        return super().command(velocity_rad_s, slot)


@dataclass
class LeftAxis:
    """An axis that is entered and left; whether its drive confirmed the stop is given."""

    confirmed: bool
    refused: bool = False
    may_be_powered: bool = field(default=False, init=False)

    def __enter__(self) -> Self:
        self.may_be_powered = not self.confirmed
        if self.refused:
            raise DriveError("it does not enable")
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None: ...

    def command(self, velocity_rad_s: float, slot: int) -> int:
        raise DriveError("the bus is gone")

    def samples(self, until_ns: int) -> list[Sample]:
        return []

    def finish(self) -> list[Sample]:
        return []

    def events(self) -> list[Any]:
        return []


@pytest.mark.parametrize("refused", [False, True])
@pytest.mark.parametrize(("confirmed", "stage"), [(True, Stage.OVER), (False, Stage.UNCONFIRMED)])
def test_the_loop_is_over_where_the_drive_confirmed_its_stop_and_there_only(
    monkeypatch: pytest.MonkeyPatch, confirmed: bool, stage: Stage, refused: bool
) -> None:
    axis = LeftAxis(confirmed, refused)
    monkeypatch.setattr(busloop, "open_axis", lambda *_: axis)
    monkeypatch.setattr(busloop, "make_punctual", lambda priority: ())
    monkeypatch.setattr(busloop, "tell", lambda *_, **__: None)
    plan = experiment()
    with SlotTable.create(plan.schedule().slots) as table:
        with pytest.raises(BenchDriveError):
            run_job(Job(plan, paper_rig(), table.descriptor), table)
        assert table.stage is stage


def test_a_stop_that_is_asked_before_opens_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(busloop, "open_axis", lambda *_: pytest.fail("it was opened"))
    monkeypatch.setattr(busloop, "make_punctual", lambda priority: ())
    told: list[str] = []
    monkeypatch.setattr(busloop, "tell", lambda kind, text: told.append(kind))
    plan = experiment()
    with SlotTable.create(plan.schedule().slots) as table:
        table.ask_stop()
        run_job(Job(plan, paper_rig(), table.descriptor), table)
        assert (table.stage, told) == (Stage.OVER, ["stopping"])


def test_the_supervisor_sees_that_enabling_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    plan = experiment()
    with SlotTable.create(plan.schedule().slots) as table:

        def opened(rig: RigConfig, period_s: float, stop_asked: StopAsked) -> LeftAxis:
            assert not table.beat_ns
            assert not stop_asked()
            assert table.beat_ns
            return LeftAxis(confirmed=True, refused=True)

        monkeypatch.setattr(busloop, "open_axis", opened)
        monkeypatch.setattr(busloop, "make_punctual", lambda priority: ())
        with pytest.raises(BenchDriveError):
            run_job(Job(plan, paper_rig(), table.descriptor), table)


def test_a_stop_that_is_asked_during_set_up_does_not_enable_the_drive() -> None:
    install()
    rig = VirtualRig("asked")
    axis = CanopenAxis(rig.canopen_settings(), rig.clock(), lambda: True)
    with pytest.raises(StopAskedError, match="nothing was played"):
        axis.__enter__()
    assert ENABLE_OPERATION not in [data[0] for can_id, data in rig.sent if can_id == 0x201]
    assert not axis.may_be_powered
    assert rig.closed == 1


@pytest.mark.parametrize("looks", [0, 1])
def test_a_stop_that_is_asked_during_set_up_does_not_enable_a_modbus_drive(
    monkeypatch: pytest.MonkeyPatch, looks: int
) -> None:
    install_lines()
    rig = VirtualModbus(f"asked {looks}", load_rig("rigs/modbus-tcp.toml"))
    steps: list[Any] = []
    follow = Registers.follow
    monkeypatch.setattr(
        Registers,
        "follow",
        lambda self, what, *rest: steps.append(what) or follow(self, what, *rest),
    )
    settings = rig.axis()._settings  # type: ignore[attr-defined]
    left = [False] * looks
    axis = ModbusAxis(settings, rig.clock(), lambda: not left or left.pop())
    with pytest.raises(StopAskedError):
        axis.__enter__()
    rig.close()
    assert (settings.drive.profile.set_up in steps) == bool(looks)
    assert settings.drive.profile.enable not in steps
    assert not axis.may_be_powered


def test_whatever_ended_a_run_its_words_tell_that_the_drive_did_not_confirm_its_stop(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The player's own errors are the bench's already when they meet the axis that is left."""

    class Unconfirmed(LeftAxis):
        def __exit__(
            self,
            kind: type[BaseException] | None,
            error: BaseException | None,
            trace: TracebackType | None,
        ) -> None:
            if error is not None:
                error.add_note("drive 1 did not confirm its stop.")

        def command(self, velocity_rad_s: float, slot: int) -> int:
            raise LimitError("the load's travel reached 91 deg.")

    monkeypatch.setattr(busloop, "open_axis", lambda *_: Unconfirmed(confirmed=False))
    monkeypatch.setattr(busloop, "make_punctual", lambda priority: ())
    monkeypatch.setattr(busloop, "tell", lambda *_, **__: None)
    plan = experiment()
    with (
        SlotTable.create(plan.schedule().slots) as table,
        pytest.raises(LimitError) as raised,
        gathered(),
    ):
        run_job(Job(plan, paper_rig(), table.descriptor), table)
    words = "the load's travel reached 91 deg. drive 1 did not confirm its stop."
    assert str(raised.value) == words


@pytest.fixture
def turning(monkeypatch: pytest.MonkeyPatch) -> tuple[VirtualRig, CanopenAxis]:
    """The software rig at 2 rad/s, whose master has gone without a word."""
    install()
    rig = VirtualRig("turning")
    axis = rig.axis()
    axis.__enter__()
    for slot in range(40):
        asked_ns = axis.command(2.0, slot)
        axis.samples(asked_ns + PERIOD_NS // 2)
        rig.pass_until(asked_ns + PERIOD_NS)
    return rig, axis


def test_a_stop_whose_answer_is_lost_is_tried_again_by_a_node_that_hears(
    turning: tuple[VirtualRig, CanopenAxis],
) -> None:
    rig, _ = turning
    swallow(rig, 1)
    line = CanopenStopLine(rig.canopen_settings(), rig.clock())
    assert line.stop() is None
    assert not rig.powered
    assert (0x000, bytes((NMT_STOP, 1))) not in rig.sent


def test_nmt_stop_goes_out_where_the_second_connection_fails(
    turning: tuple[VirtualRig, CanopenAxis], monkeypatch: pytest.MonkeyPatch
) -> None:
    rig, _ = turning
    swallow(rig, 1000)
    line = CanopenStopLine(rig.canopen_settings(), rig.clock())
    connect, made = line._connect, [0]

    def busy() -> Any:
        made[0] += 1
        if made[0] == 2:
            raise WireError("the adapter is busy.")
        return connect()

    monkeypatch.setattr(line, "_connect", busy)
    problem = line.stop() or ""
    assert "did not answer an SDO" in problem
    assert "the adapter is busy" in problem
    assert rig.sent[-1] == (0x000, bytes((NMT_STOP, 1)))


def test_nmt_stop_is_the_last_word_to_a_drive_that_answers_nothing(
    turning: tuple[VirtualRig, CanopenAxis],
) -> None:
    rig, _ = turning
    swallow(rig, 1000)
    problem = CanopenStopLine(rig.canopen_settings(), rig.clock()).stop()
    assert problem is not None
    assert rig.sent[-1] == (0x000, bytes((NMT_STOP, 1)))
    asked = [data for can_id, data in rig.sent if can_id == 0x201]
    assert asked[-2:] == [struct.pack("<Hi", 0x0002, 0)] * 2


def swallow(rig: VirtualRig, answers: int) -> None:
    """Lose so many of the drive's SDO answers."""
    heard: Callable[[int, bytes], None] = rig._heard
    left = [answers]

    def lossy(can_id: int, data: bytes) -> None:
        if can_id == SDO_ANSWER and left[0]:
            left[0] -= 1
        else:
            heard(can_id, data)

    rig.rig._send = lossy


def test_an_axis_may_be_powered_until_its_drive_says_otherwise(
    turning: tuple[VirtualRig, CanopenAxis],
) -> None:
    rig, axis = turning
    assert axis.may_be_powered
    axis.__exit__(None, None, None)
    assert not axis.may_be_powered
    assert not rig.powered


class Deaf:
    """A Modbus drive that refuses its target velocity, and whatever else is named."""

    name, strays, damaged = "drive 1", 0, 0

    def __init__(self, refused: int) -> None:
        self.refused = refused
        self.wrote: list[int] = []

    def begin(self, request: ModbusPDU) -> int:
        self.request = request
        return SYSTEM_CLOCK.now_ns()

    def poll(self, until_ns: int) -> Reply:
        address = self.request.address
        if self.request.function_code in (6, 16):
            self.wrote.append(address)
            if address == self.refused:
                return Reply(
                    ExceptionResponse(self.request.function_code, 6), SYSTEM_CLOCK.now_ns()
                )
        raise StopIteration

    def abandon(self) -> None: ...

    def close(self) -> None: ...


def test_a_modbus_drive_that_takes_no_velocity_is_stopped_and_disabled_all_the_same() -> None:
    settings = load_rig("rigs/modbus-tcp.toml").modbus_settings(PERIOD_S)
    items = settings.drive.profile.items
    target = items["target_velocity"].address
    link = Deaf(target)
    with pytest.raises((DriverError, StopIteration)):
        stop_over(link, settings, SYSTEM_CLOCK)  # type: ignore[arg-type]
    told = (settings.drive.profile.stop[0], settings.drive.profile.disable[0])
    assert link.wrote == [target, *(items[step.write].address for step in told)]
