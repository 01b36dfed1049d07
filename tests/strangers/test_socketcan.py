"""Real SocketCAN, where the kernel has it and vcan0 is up: raw, BCM, error frames, can-utils.

`.ci/strangers` runs this inside user-mode Linux, whose kernel has CAN where the host's has none.
"""

import shutil
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import IO

import can
import pytest

import sim_rig
from drivers.axis import WireEvent
from drivers.canopen.line import open_bus
from drivers.canopen.master import CanopenAxis
from drivers.canopen.settings import (
    CanopenSettings,
    DriveSettings,
    EncoderSettings,
    NodeSettings,
)
from drivers.clock import SYSTEM_CLOCK
from drivers.errors import WireError
from sim_rig.canopen.busloop import RigOnBus
from sim_rig.canopen.busloop import open_bus as open_rig_bus
from sim_rig.model import Model
from tests.contract_axis import check_axis
from tests.wire import DRIVE_STATE, LOAD, NOMINAL, SETTINGS

CHANNEL = "vcan0"
BUS = {"interface": "socketcan", "channel": CHANNEL}
EDS = Path(sim_rig.__file__).parent / "eds"
PERIOD_S = 0.05  # the emulated machine is slow, and stolen whenever its host is


def _there() -> bool:
    if not hasattr(socket, "AF_CAN"):
        return False
    with suppress(OSError), socket.socket(socket.AF_CAN, socket.SOCK_RAW, socket.CAN_RAW) as sock:
        sock.bind((CHANNEL,))
        return True
    return False


pytestmark = [
    pytest.mark.skipif(not _there(), reason=f"no SocketCAN with {CHANNEL} here"),
    # python-can leaves its socket open where the interface is missing
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]


@pytest.fixture(autouse=True)
def link() -> Iterator[None]:
    """Whatever a test does to the interface, the next finds it up."""
    yield
    ip("set", CHANNEL, "up")


def ip(*words: str) -> None:
    subprocess.run(["ip", "link", *words], check=True)


@contextmanager
def rig() -> Iterator[None]:
    """The software rig's slaves on vcan0, in a thread of this process."""
    ended = threading.Event()
    bus = open_rig_bus(BUS)
    loop = RigOnBus(replace(SETTINGS, bus=BUS, host_hub=False), Model(NOMINAL).plant(), bus)
    loop.rig.boot()

    def run() -> None:
        with suppress(Exception):  # the interface that a test takes away
            loop.run(ended.is_set)

    thread = threading.Thread(target=run)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join(10.0)
        bus.shutdown()


def settings() -> CanopenSettings:
    return CanopenSettings(
        bus=BUS,
        drive=DriveSettings(NodeSettings(1, EDS / "sim_drive.eds", 0, 402), 65536),
        encoder=EncoderSettings(NodeSettings(2, EDS / "sim_encoder.eds", 0, 406), 65536),
        period_s=PERIOD_S,
        answer_timeout_s=2.0,
    )


def is_enabled() -> bool:
    """Ask the drive for its statusword."""
    with open_bus(BUS) as bus:
        data = struct.pack("<BHB4x", 0x40, 0x6041, 0)
        bus.send(can.Message(arbitration_id=0x601, data=data, is_extended_id=False))
        while (frame := bus.recv(5.0)) is not None:
            if frame.arbitration_id == 0x581 and frame.data[:4] == b"\x4b\x41\x60\x00":
                return struct.unpack_from("<H", frame.data, 4)[0] & 0x6F == 0x27
    raise AssertionError("the drive does not answer")


def play_until_fatal(axis: CanopenAxis) -> list[WireEvent]:
    events: list[WireEvent] = []
    for slot in range(200):
        end_ns = SYSTEM_CLOCK.now_ns() + round(PERIOD_S * 1e9)
        axis.command(0.0, slot)
        axis.samples(end_ns)
        events += axis.events()
        if any(event.fatal for event in events):
            return events
        SYSTEM_CLOCK.sleep_until(end_ns)
    raise AssertionError("nothing fatal was told")


def test_master_and_slaves_over_raw_sockets() -> None:
    with rig():
        check_axis(lambda: CanopenAxis(settings()), is_enabled, period_s=PERIOD_S)


def test_an_error_frame_of_the_controller_is_told_and_bus_off_ends_the_run() -> None:
    with rig(), CanopenAxis(settings()) as axis, can.Bus(**BUS) as other:
        for classes in (0x04, 0x40):  # controller problem, bus-off: linux/can/error.h
            frame = can.Message(arbitration_id=classes, is_error_frame=True, data=bytes(8))
            other.send(frame)
        told = {event.kind: event for event in play_until_fatal(axis)}
    assert not told["bus errors"].fatal
    assert "controller" in told["bus errors"].text
    assert told["bus-off"].fatal
    assert "restart-ms" in told["bus-off"].text


def test_an_interface_that_goes_down_mid_run_is_a_wire_error() -> None:
    with rig(), pytest.raises(WireError, match=r"is gone.*ip link set"):
        lose_the_interface()


def lose_the_interface() -> None:
    with CanopenAxis(settings()) as axis:
        ip("set", CHANNEL, "down")
        play_until_fatal(axis)


def test_an_interface_that_is_down_or_missing_says_what_to_do() -> None:
    ip("set", CHANNEL, "down")
    with pytest.raises(WireError, match="ip link set"):
        axis_of(settings())
    missing = replace(settings(), bus={**BUS, "channel": "can77"})
    with pytest.raises(WireError, match="no such CAN interface"):
        axis_of(missing)


def axis_of(some: CanopenSettings) -> None:
    with CanopenAxis(some):
        pytest.fail("entered")


def test_the_kernels_own_sync_by_bcm_is_answered_every_time() -> None:
    with rig(), can.Bus(**BUS) as bus:
        bus.send(can.Message(arbitration_id=0, data=[1, 0], is_extended_id=False))
        sync = can.Message(arbitration_id=0x080, data=b"", is_extended_id=False)
        task = bus.send_periodic(sync, 0.02)
        assert "bcm" in type(task).__module__ or hasattr(task, "bcm_socket")
        answers = syncs = 0
        end_s = time.monotonic() + 3.0
        while time.monotonic() < end_s and answers < 50:
            frame = bus.recv(0.5)
            answers += frame is not None and frame.arbitration_id == LOAD
        task.stop()
        syncs = answers
    assert syncs == 50


needs_can_utils = pytest.mark.skipif(shutil.which("cansend") is None, reason="no can-utils")


class Dump:
    """candump, and cansend beside it: a dialogue from the standards, frame by frame."""

    def __init__(self) -> None:
        self._process = subprocess.Popen(
            ["candump", "-L", CHANNEL], stdout=subprocess.PIPE, text=True
        )
        assert self._process.stdout is not None
        self._lines: IO[str] = self._process.stdout
        self.send("7FF#")  # whatever is printed after this was sent after candump listened
        self._expect(lambda frame: frame == "7FF#", again="7FF#")

    def close(self) -> None:
        self._process.terminate()
        self._process.wait()
        self._lines.close()

    def send(self, frame: str) -> None:
        subprocess.run(["cansend", CHANNEL, frame], check=True)

    def ask(self, frame: str, answer: str) -> str:
        """Send, and wait for a frame that begins so."""
        self.send(frame)
        return self._expect(lambda seen: seen.startswith(answer))

    def _expect(self, wanted: Callable[[str], bool], again: str = "") -> str:
        timer = threading.Timer(10.0, self._process.kill)
        timer.start()
        repeat = threading.Timer(0.5, self.send, [again]) if again else None
        if repeat:
            repeat.start()
        try:
            for line in self._lines:
                frame = line.split()[2]
                if wanted(frame):
                    return frame
        finally:
            timer.cancel()
            if repeat:
                repeat.cancel()
        raise AssertionError("candump has not seen it")


@pytest.fixture
def dump() -> Iterator[Dump]:
    with rig():
        dump = Dump()
        yield dump
        dump.close()


@needs_can_utils
def test_a_dialogue_of_cia_301_by_can_utils(dump: Dump) -> None:
    assert dump.ask("601#4000100000000000", "581#43001000") == "581#4300100092010200"
    assert dump.ask("601#4018100200000000", "581#43181002") == "581#4318100292010000"
    assert dump.ask("601#40FF5F0000000000", "581#80FF5F00") == "581#80FF5F0000000206"
    assert dump.ask("601#2B17100032000000", "581#60171000") == "581#6017100000000000"
    assert dump.ask("000#", "701#") == "701#7F"  # an NMT without data is nobody's
    assert dump.ask("000#0101", "701#05") == "701#05"
    assert dump.ask("000#8101", "701#00") == "701#00"


@needs_can_utils
def test_a_dialogue_of_cia_402_by_can_utils(dump: Dump) -> None:
    state = f"{DRIVE_STATE:03X}#"
    assert dump.ask("601#2F60600009000000", "581#60606000") == "581#6060600000000000"
    dump.send("000#0101")
    seen = []
    for word in ("0600", "0700", "0F00", "0F00", "0200"):
        dump.send(f"201#{word}00000000")
        dump.ask("080#", state)
        seen.append(dump.ask("080#", state)[4:6])
    assert seen[:4] == ["31", "33", "37", "37"]
    assert seen[4] in ("17", "50")


if __name__ == "__main__":
    sys.exit(
        pytest.main([__file__, "-q", "-o", "addopts=", "--color=no", "-p", "no:cacheprovider"])
    )
