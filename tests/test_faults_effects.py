"""Each fault does what its row says, at its time, and the same again with the same seed."""

import struct
from collections.abc import Callable
from itertools import pairwise

import pytest

from sim_rig.errors import RigSettingsError
from sim_rig.faults.catalogue import KINDS, parse
from sim_rig.settings import RigSettings
from tests.wire import (
    DRIVE,
    DRIVE_MOTION,
    DRIVE_STATE,
    ENCODER,
    LOAD,
    RPDO,
    SETTINGS,
    LocalRig,
    SdoAbortError,
    local_rig,
)

PERIOD_US = 8000
RANGE = 65536 * 4096
"""Where the load's encoder wraps."""


class Run:
    """An enabled rig, cycled; every frame it sends, with its time and the SYNC it came after."""

    def __init__(self, *faults: str, seed: int = 7) -> None:
        self.local: LocalRig = local_rig(faults=faults, seed=seed)
        self.frames: list[tuple[int, int, int, bytes]] = []
        self.sync = 0
        self.local.rig._send = self._heard
        self._inbox: list[tuple[int, bytes]] = []
        self.enable()

    def _heard(self, can_id: int, data: bytes) -> None:
        self.frames.append((self.sync, self.local.now_us, can_id, data))
        self._inbox.append((can_id, data))

    def enable(self) -> None:
        """Operational, CSV, and up the state machine; SYNC 0 is the first with the drive on."""
        self.local.send(0x600 + DRIVE, struct.pack("<BHBb3x", 0x2F, 0x6060, 0, 9))
        self.local.send(0, bytes([1, 0]))
        for controlword in (0x06, 0x07, 0x0F):
            self.local.send(RPDO, struct.pack("<Hi", controlword, 0))
            self.local.send(0x80)
            self.pass_period()
        self.frames.clear()
        self.sync = -1

    def pass_period(self) -> None:
        end_us = self.local.now_us + PERIOD_US
        while self.local.now_us < end_us:
            wait_us = self.local.rig.wait_us(self.local.now_us)
            self.local.now_us += max(1, min(wait_us, end_us - self.local.now_us))
            self.local.rig.tick(self.local.now_us)

    def play(self, syncs: int = 100, velocity_increments_s: int = 20000) -> "Run":
        for _ in range(syncs):
            self.sync += 1
            self.local.send(RPDO, struct.pack("<Hi", 0x0F, velocity_increments_s))
            self.local.send(0x80)
            self.pass_period()
        return self

    def of(self, can_id: int) -> list[tuple[int, bytes]]:
        """The SYNC after which each frame of an identifier came, and its data."""
        return [(sync, data) for sync, _, sent_id, data in self.frames if sent_id == can_id]

    def syncs(self, can_id: int) -> list[int]:
        return [sync for sync, _ in self.of(can_id)]

    def counts(self, can_id: int, layout: str, place: int = 0) -> list[int]:
        return [int(struct.unpack_from(layout, data)[place]) for _, data in self.of(can_id)]


ALL = list(range(100))


def test_without_a_fault_every_sync_is_answered() -> None:
    run = Run().play()
    for can_id in (DRIVE_STATE, DRIVE_MOTION, LOAD):
        assert run.syncs(can_id) == ALL


def test_lost() -> None:
    run = Run("lost frames=drive-state at=10 count=3").play()
    assert run.syncs(DRIVE_STATE) == [n for n in ALL if n not in (10, 11, 12)]
    assert run.syncs(LOAD) == ALL


def test_lost_by_chance_is_seeded_and_repeatable() -> None:
    line = "lost frames=load at=0 count=0 rate=0.3"
    first, again, other = (Run(line, seed=s).play().syncs(LOAD) for s in (7, 7, 8))
    assert first == again != other
    assert 50 <= len(first) <= 85


def test_every_run_meets_the_same_faults() -> None:
    run = Run("lost frames=load at=5 count=0 rate=0.3").play(40)
    first = run.syncs(LOAD)
    run.local.send(RPDO, struct.pack("<Hi", 0, 0))  # the master disables and ends the run
    run.local.send(0x80)
    run.local.send(0, bytes([0x80, 0]))
    run.enable()
    assert run.play(40).syncs(LOAD) == first


def test_late_and_those_behind_it_stay_behind_it() -> None:
    run = Run("late frames=load at=10 delay_ms=20 count=1").play()
    assert run.syncs(LOAD)[8:16] == [8, 9, 12, 12, 12, 13, 14, 15]
    counts = run.counts(LOAD, "<I")
    assert counts == sorted(counts), "in the order in which they were sent"


def test_duplicated() -> None:
    run = Run("duplicated frames=drive-motion at=4 count=2").play(10)
    assert run.syncs(DRIVE_MOTION) == [0, 1, 2, 3, 4, 4, 5, 5, 6, 7, 8, 9]


def test_reordered() -> None:
    run = Run("reordered frames=drive-state at=4 count=1").play(10)
    order = [can_id for sync, _, can_id, _ in run.frames if sync == 4]
    assert order == [DRIVE_MOTION, DRIVE_STATE, LOAD]


def test_sync_jitter_is_late_by_up_to_its_most() -> None:
    run = Run("sync-jitter at=0 most_ms=2").play()
    times = [us for _, us, can_id, _ in run.frames if can_id == LOAD]
    late = [(us - times[0]) % PERIOD_US for us in times]
    stamps = [struct.unpack_from("<iI", data)[1] for _, data in run.of(DRIVE_MOTION)]
    gaps = [b - a for a, b in pairwise(stamps)]
    assert len(times) == 100
    assert max(late) > 0
    assert min(gaps) < PERIOD_US - 300
    assert PERIOD_US + 300 < max(gaps) <= PERIOD_US + 2000


def test_slow_slave_is_late_with_everything() -> None:
    run = Run("slow-slave frames=drive delay_ms=3")
    asked_us = run.local.now_us
    run.local.send(0x600 + DRIVE, struct.pack("<BHB4x", 0x40, 0x6041, 0))
    run.pass_period()
    assert [us - asked_us for _, us, i, _ in run.frames if i == 0x581] == [3000]


def test_bus_off_takes_every_frame_both_ways_and_comes_back() -> None:
    run = Run("bus-off at=10 for_ms=80.5").play(40)
    gone = list(range(10, 21))
    assert run.syncs(LOAD) == [n for n in range(40) if n not in gone]
    stamps = [struct.unpack_from("<iI", data)[1] for _, data in run.of(DRIVE_MOTION)]
    assert max(b - a for a, b in pairwise(stamps)) == 12 * PERIOD_US


@pytest.mark.parametrize(("node", "node_id"), [("drive", DRIVE), ("encoder", ENCODER)])
def test_reset_boots_anew_and_forgets(node: str, node_id: int) -> None:
    run = Run(f"reset node={node} at=10").play(20)
    assert run.of(0x700 + node_id) == [(10, b"\x00")]
    assert max(run.syncs(0x280 + node_id)) == 9


def test_emcy_faults_the_drive() -> None:
    run = Run("emcy node=drive code=0x3220 at=10").play(60)
    (sent,) = run.of(0x080 + DRIVE)
    assert sent[0] == 10
    assert sent[1][:2] == b"\x20\x32"
    assert run.counts(DRIVE_STATE, "<H")[-1] & 0x4F == 0x08


def test_emcy_of_the_encoder_is_a_frame() -> None:
    run = Run("emcy node=encoder code=0x4210 at=10").play(20)
    assert [sync for sync, _ in run.of(0x080 + ENCODER)] == [10]
    assert run.syncs(LOAD) == list(range(20))


def test_sdo_abort_refuses_one_object_and_one_access() -> None:
    rig = local_rig(faults=("sdo-abort object=0x60C2:1 code=0x08000022",))
    with pytest.raises(SdoAbortError, match="0x08000022"):
        rig.sdo(DRIVE, 0x60C2, 1, 8, 1)
    assert rig.sdo(DRIVE, 0x60C2, 1) == 8
    rig.sdo(DRIVE, 0x60C2, 2, -3, 1)


def test_stuck_encoder() -> None:
    run = Run("stuck-encoder encoder=load at=20").play()
    counts = run.counts(LOAD, "<I")
    assert len(set(counts[20:])) == 1
    assert len(set(counts[:20])) > 10
    motor = run.counts(DRIVE_STATE, "<Hi", 1)
    assert motor[-1] > motor[20] + 1000


def test_encoder_jump() -> None:
    plain = Run().play().counts(DRIVE_STATE, "<Hi", 1)
    jumped = Run("encoder-jump encoder=motor at=30 counts=-500").play()
    counts = jumped.counts(DRIVE_STATE, "<Hi", 1)
    assert [b - a for a, b in zip(plain, counts, strict=True)] == [0] * 30 + [-500] * 70


def test_encoder_noise_is_seeded() -> None:
    plain = Run().play().counts(LOAD, "<I")

    def noise(seed: int) -> list[int]:
        run = Run("encoder-noise encoder=load at=0 counts=20", seed=seed).play()
        shaken = run.counts(LOAD, "<I")
        return [(b - a + half) % RANGE - half for a, b in zip(plain, shaken, strict=True)]

    half = RANGE // 2
    first, again, other = noise(7), noise(7), noise(8)
    assert first == again != other
    assert 100 < sum(n * n for n in first) / len(first) < 900  # variance 400


def test_lying_statusword_and_the_motor_let_go() -> None:
    run = Run("lying-statusword value=0x1237 power=off at=40").play()
    assert set(run.counts(DRIVE_STATE, "<H")) == {0x1237}
    assert run.local.rig.drive.state == 0x40
    held = Run("lying-statusword value=0x0250 power=on at=40").play()
    assert set(held.counts(DRIVE_STATE, "<H")[40:]) == {0x0250}
    assert held.local.rig.drive.state == 0x27


def test_two_faults_act_one_after_the_other() -> None:
    run = Run("duplicated frames=load at=5 count=1", "lost frames=drive-state at=5 count=1").play(
        10
    )
    assert run.syncs(LOAD).count(5) == 2
    assert 5 not in run.syncs(DRIVE_STATE)


def test_every_kind_parses_without_a_value_and_has_a_sentence() -> None:
    for name, kind in KINDS.items():
        assert parse(name) == (kind, kind.defaults)
        assert kind.text


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("", "no such kind. Known are lost"),
        ("gremlins", "no such kind"),
        ("lost at", "name=value"),
        ("lost where=3", "'where=3' is not name=value"),
        ("lost at=soon", "a value like 50"),
        ("lost frames=mine", "one of sync, command"),
        ("reset node=5", "one of drive, encoder"),
        ("sdo-abort object=60C2:x", "0x60C2:1"),
        ("emcy code=hot", "a value like 12832"),
        ("emcy code=0x12345", "from 1 to 65535"),
        ("sdo-abort code=-1", "from 0 to"),
        ("sdo-abort object=0x12345", "from 0 to 65535"),
        ("lost frames=0x999", "from 0 to 2047"),
        ("lost rate=1.5", "from 0 to 1"),
        ("late delay_ms=inf", "a finite number"),
        ("late delay_ms=-1", "from 0"),
        ("bus-off for_ms=nan", "a finite number"),
        ("sync-jitter most_ms=nan", "a finite number"),
        ("encoder-noise counts=-1", "from 0"),
    ],
)
def test_a_fault_that_cannot_be_is_refused_in_words(line: str, words: str) -> None:
    with pytest.raises(RigSettingsError, match=words):
        RigSettings(**{**_fields(SETTINGS), "faults": (line,)})


def _fields(settings: RigSettings) -> dict[str, object]:
    names: Callable[[RigSettings], tuple[str, ...]] = lambda it: tuple(it.__slots__)  # noqa: E731
    return {name: getattr(settings, name) for name in names(settings)}
