"""SYNC by the drive: the slave that produces it, the master that follows, and a SYNC that ends."""

import struct
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.axis import Axis, Sample
from drivers.canopen.master import CanopenAxis
from drivers.canopen.profile import load_profile
from drivers.canopen.settings import CanopenSettings
from drivers.canopen.stopline import CanopenStopLine
from drivers.errors import DriveError, SettingsError, SyncMissingError
from servo_bench.excitation.experiment import Experiment, MSequence, RandomBinary
from servo_bench.recording.mcap_file import load
from servo_bench.rig import RigConfig, load_rig
from servo_bench.run.busloop import Player
from servo_bench.run.session import run
from servo_bench.run.table import UNPLAYED, SlotTable
from servo_bench.run.virtual import play_virtually, run_virtually
from sim_rig.process import spawn
from tests.contract_axis import check_axis
from tests.fake_canopen import FakeRig
from tests.virtual_rig import VirtualRig, install
from tests.virtual_world import RunClock
from tests.wire import DRIVE, RPDO, SdoAbortError, local_rig

SYNC = 0x80
PRODUCES = 1 << 30 | SYNC
PERIOD_US = 8000
PLAN = Experiment(
    name="short",
    rig="none",
    period_s=0.008,
    memory=8,
    standstill_s=0.1,
    lead_in=16,
    identification=MSequence(polynomial="2327", amplitude_rad_s=2.0, length=120),
    validation=RandomBinary(kind="random-binary", seed=2, amplitude_rad_s=2.0, length=32),
)


# The slave


def producing(period_us: int = PERIOD_US, **changes: Any) -> Any:
    rig = local_rig(**changes)
    rig.sdo(DRIVE, 0x1006, 0, period_us)
    rig.sdo(DRIVE, 0x1005, 0, PRODUCES)
    rig.sent.clear()
    return rig


@pytest.mark.parametrize("period_us", [1000, 8000, 12_345])
def test_it_produces_sync_at_its_period_until_told_not_to(period_us: int) -> None:
    rig = producing(period_us)
    rig.wait(10 * period_us)
    assert rig.take(SYNC) == [b""] * 10
    rig.send(0, bytes([1, DRIVE]))
    rig.wait(5 * period_us)
    assert len(rig.take(SYNC)) == 5
    rig.send(0, bytes([2, DRIVE]))  # NMT stop ends every service but NMT and error control
    rig.wait(5 * period_us)
    assert rig.take(SYNC) == []
    rig.send(0, bytes([128, DRIVE]))
    rig.sdo(DRIVE, 0x1005, 0, SYNC)
    rig.sent.clear()
    rig.wait(5 * period_us)
    assert rig.take(SYNC) == []


def test_without_a_period_or_after_a_reset_it_produces_none() -> None:
    rig = local_rig()
    rig.sdo(DRIVE, 0x1005, 0, PRODUCES)
    rig.wait(100_000)
    assert rig.take(SYNC) == []
    rig = producing()
    rig.send(0, bytes([129, DRIVE]))
    rig.sent.clear()
    rig.wait(100_000)
    assert rig.take(SYNC) == []


def test_its_identifier_stays_while_it_is_produced() -> None:
    rig = producing()
    with pytest.raises(SdoAbortError):
        rig.sdo(DRIVE, 0x1005, 0, 1 << 30 | 0x90)
    with pytest.raises(SdoAbortError):
        rig.sdo(DRIVE, 0x1005, 0, 1 << 29 | SYNC)


def test_both_nodes_answer_the_drives_sync_and_its_commands_act_on_it() -> None:
    rig = producing()
    rig.sdo(DRIVE, 0x6060, 0, 9, 1)
    rig.send(0, bytes([1, 0]))
    for controlword in (0x06, 0x07, 0x0F, 0x0F):
        rig.send(RPDO, struct.pack("<Hi", controlword, 10_000))
        rig.sent.clear()
        rig.wait(PERIOD_US)
    order = [can_id for can_id, _ in rig.sent]
    assert order[:4] == [SYNC, 0x181, 0x281, 0x282]
    assert struct.unpack_from("<H", dict(rig.sent)[0x181])[0] & 0x6F == 0x27


def test_a_producer_answers_no_sync_but_its_own() -> None:
    rig = producing()
    rig.send(0, bytes([1, 0]))
    rig.sent.clear()
    rig.send(SYNC)  # a bus that echoes, or another producer
    assert rig.sent == []
    rig.wait(PERIOD_US)
    assert len(rig.take(0x181)) == 1


# The master


def following(name: str, **changes: Any) -> tuple[VirtualRig, CanopenSettings]:
    install()
    world = VirtualRig(name, **changes)
    return world, replace(world.canopen_settings(), sync_by_drive=True)


def test_the_contract_of_an_axis() -> None:
    world, settings = following("follower")
    check_axis(
        lambda: world.axis(settings),
        lambda: world.powered,
        period_s=settings.period_s,
        clock=world.axis()._clock,
    )
    assert SYNC not in {can_id for can_id, _ in world.sent}, "the master's is never sent"
    store = world.rig.drive_node.store
    assert (store[0x1005, 0], store[0x1006, 0]) == (SYNC, PERIOD_US), "and the drive's has ended"


def test_one_command_goes_out_after_each_sync(monkeypatch: pytest.MonkeyPatch) -> None:
    world, settings = following("order")
    order: list[int] = []
    heard, taken = world._heard, world.take

    def hear(can_id: int, data: bytes) -> None:
        order.append(can_id)
        heard(can_id, data)

    def take(can_id: int, data: bytes) -> None:
        order.append(can_id)
        taken(can_id, data)

    monkeypatch.setattr(world.rig, "_send", hear)
    monkeypatch.setattr(world, "take", take)
    with world.axis(settings) as axis:
        order.clear()
        asked = []
        for slot in range(50):
            asked.append(axis.command(1.0, slot))
            axis.samples(asked[-1] + 4_000_000)
    cut = order[: [n for n, it in enumerate(order) if it == SYNC][49] + 1]
    between = "".join({SYNC: "s", RPDO: "c"}.get(it, "") for it in cut)
    assert between == "cs" * 50
    assert set(np.diff(asked) // 1000) <= {PERIOD_US - 1, PERIOD_US, PERIOD_US + 1}


def of(rig: str = "rigs/paper.toml", **drive: Any) -> RigConfig:
    config = load_rig(rig)
    return config.model_copy(update={"drive": config.drive.model_copy(update=drive)})


@pytest.mark.parametrize("samples", [1, 8])
def test_a_run_records_what_it_records_by_the_masters_sync(samples: int) -> None:
    own = run_virtually(PLAN, of())
    followed = run_virtually(PLAN, of(sync="drive", samples_per_command=samples))
    assert np.array_equal(followed["slot"], own["slot"])
    for channel in ("load_angle_counts", "motor_position_counts"):
        moved = followed[channel] - followed[channel][0]
        assert np.abs(moved - (own[channel] - own[channel][0])).max() <= 1
    assert np.ptp(own["load_angle_counts"]) > 1000
    assert len(followed.fast.get("slot", ())) == (samples * len(own) if samples > 1 else 0)


class Stalling:
    """An axis whose loop is held up for a while, once."""

    def __init__(self, axis: CanopenAxis, world: VirtualRig, at: int, for_us: int) -> None:
        self._axis, self._world = axis, world
        self._at, self._for_us = at, for_us

    def __getattr__(self, name: str) -> Any:
        return getattr(self._axis, name)

    def next_slot(self, slot: int) -> int:
        return self._axis.next_slot(slot)

    def samples(self, until_ns: int) -> Sequence[Sample]:
        return self._axis.samples(until_ns)

    def command(self, velocity_rad_s: float, slot: int) -> int:
        asked_ns = self._axis.command(velocity_rad_s, slot)
        if slot == self._at:
            self._world.pass_until(asked_ns + self._for_us * 1000)
        return asked_ns


@pytest.mark.parametrize("missed", [1, 3, 7])
def test_slots_go_on_counting_syncs_when_the_loop_is_held_up(missed: int) -> None:
    world, settings = following(f"stall {missed}")
    schedule = PLAN.schedule()
    told: list[str] = []
    with SlotTable.create(schedule.slots) as table:
        with world.axis(settings) as axis:
            held_up: Axis = Stalling(axis, world, 60, PERIOD_US * missed + 4000)
            limits = load_rig("rigs/paper.toml").limits
            player = Player(held_up, schedule, table, limits, RunClock(world), sync_by_drive=True)
            player.play(0, lambda kind, text, **data: told.append(f"{kind} {data}"))
        rows = table.rows[table.rows["slot"] != UNPLAYED].copy()
        assert table.missed == missed
    slots = rows["slot"]
    assert sorted(set(range(schedule.slots)) - set(slots)) == list(range(61, 61 + missed))
    assert any(f"'slot': 61, 'to': {61 + missed}" in line for line in told)
    by_device = (rows["device_time_us"] - rows["device_time_us"][0]) / PERIOD_US
    assert np.array_equal(by_device, slots - slots[0]), "a row's sample is its own SYNC's"


class HeldUpAtLook(Stalling):
    """A loop that is held up between two looks at the wire, before a slot's command."""

    def samples(self, until_ns: int) -> Sequence[Sample]:
        samples = super().samples(until_ns)
        if until_ns <= self._world.now_ns and self._at:
            self._at -= 1
            if not self._at:
                self._world.pass_until(self._world.now_ns + self._for_us * 1000)
        return samples

    def next_slot(self, slot: int) -> int:
        found = super().next_slot(slot)
        if self._at == 1:
            self._at = 0
            self._world.pass_until(self._world.now_ns + self._for_us * 1000)
        return found

    def command(self, velocity_rad_s: float, slot: int) -> int:
        return self._axis.command(velocity_rad_s, slot)


@pytest.mark.parametrize("at", [40, 41, 60, 61])
def test_a_sync_between_two_looks_asks_for_a_slot_of_its_own(at: int) -> None:
    world, settings = following(f"between {at}")
    schedule = PLAN.schedule()
    with SlotTable.create(schedule.slots) as table:
        with world.axis(settings) as axis:
            held_up: Axis = HeldUpAtLook(axis, world, at, PERIOD_US + 1000)
            limits = load_rig("rigs/paper.toml").limits
            player = Player(held_up, schedule, table, limits, RunClock(world), sync_by_drive=True)
            player.play(0, lambda *_, **__: None)
        rows = table.rows[table.rows["slot"] != UNPLAYED].copy()
    slots = rows["slot"]
    by_device = (rows["device_time_us"] - rows["device_time_us"][0]) / PERIOD_US
    assert np.array_equal(by_device, slots - slots[0]), "a row's sample is its own SYNC's"


def test_a_sync_that_ends_is_bus_silence_and_the_drive_is_stopped_without_it() -> None:
    world, settings = following("silence", faults=("lost frames=sync at=50 count=0",))
    axis = world.axis(settings)
    asked: list[int] = []

    def play() -> None:
        with axis:
            for slot in range(200):
                asked.append(axis.command(2.0, slot))
                axis.samples(asked[-1] + 4_000_000)

    with pytest.raises(SyncMissingError, match=r"no SYNC of drive 1 for 0\.1 s") as raised:
        play()
    assert not getattr(raised.value, "__notes__", ()), "the stop was confirmed, by SDO"
    assert ("bus silent", True) in [(event.kind, event.fatal) for event in axis.events()]
    assert (world.now_ns - asked[-1]) * 1e-9 < 0.1 + 0.5
    assert not world.powered
    assert abs(world.velocity_rad_s) < 0.1


def test_the_supervisors_stop_needs_no_sync_of_its_own_and_ends_the_drives() -> None:
    world, settings = following("supervised")
    axis = world.axis(settings)
    axis.__enter__()
    for slot in range(30):
        asked_ns = axis.command(2.0, slot)
        axis.samples(asked_ns + 4_000_000)
    assert world.powered
    axis._line.bus.shutdown()
    line = CanopenStopLine(settings, axis._clock)  # the loop is dead: nobody commands any more
    assert line.stop() is None
    line.close()
    assert not world.powered
    assert SYNC not in {can_id for can_id, _ in world.sent}
    world.waiting.clear()
    world.pass_until(world.now_ns + 200_000_000)
    assert SYNC not in {frame.arbitration_id for frame in world.waiting}


def test_the_run_that_ends_so_says_so_and_keeps_its_recording() -> None:
    rig = of(sync="drive").with_faults("lost frames=sync at=50 count=0")
    done = play_virtually(PLAN, rig)
    assert "no SYNC of drive 1" in str(done.error)
    assert 45 <= len(done.recording) <= 52


def test_it_is_refused_where_the_profile_or_the_drive_has_it_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fake = FakeRig(tmp_path, monkeypatch)
    other = replace(fake.settings(profile=load_profile("nanotec")), sync_by_drive=True)
    refusal = r'does not say that it can.*drive.sync = "master"'
    with pytest.raises(SettingsError, match=refusal), fake.axis(other):
        pytest.fail("entered")
    fake.drive.aborts[0x1005, 0] = 0x06090030
    refusal = r"refuses to write 0x1005.*produces no SYNC"
    unwilling = replace(fake.settings(), sync_by_drive=True)
    with pytest.raises(DriveError, match=refusal), fake.axis(unwilling):
        pytest.fail("entered")
    assert not fake.drive.enabled
    folder = tmp_path / "without"  # of its own: an EDS may have been read once for all
    folder.mkdir()
    other_fake = FakeRig(folder, monkeypatch)
    without = replace(other_fake.settings(without=(0x1006,)), sync_by_drive=True)
    with pytest.raises(DriveError, match=r"no 0x1006 to write"), other_fake.axis(without):
        pytest.fail("entered")
    assert not other_fake.drive.enabled


@pytest.mark.long
@pytest.mark.wire
def test_on_a_real_bus_the_bench_follows_the_rigs_sync(tmp_path: Path) -> None:
    samples = 4
    rig = of(sync="drive", samples_per_command=samples).on_a_free_port()
    with spawn(rig.simulation_settings()) as simulated:
        summary = run(PLAN, rig.with_bus(**simulated.bus), tmp_path / "run.mcap")
        again = run(PLAN, rig.with_bus(**simulated.bus), tmp_path / "again.mcap")
    assert again.played > 0, "the drive's SYNC was ended, and begins anew"
    recording = load(tmp_path / "run.mcap")
    assert summary.played + summary.missed == summary.slots
    assert len(recording) == summary.played > 100
    # from slot to slot a period of the producer's clock, but where the machine let it miss some
    periods = np.rint(np.diff(recording["device_time_us"]) / PERIOD_US)
    assert np.mean(periods == np.diff(recording["slot"])) > 0.9
    assert len(recording.fast["slot"]) > 0.7 * samples * len(recording)
    own = recording.fast["part"] == 0
    assert np.array_equal(recording.fast["load_angle_counts"][own], recording["load_angle_counts"])
