"""Our slaves against python-canopen's own CiA 402 master: a stranger with other habits."""

import logging
import threading
import time
from collections.abc import Callable, Iterator
from importlib.resources import files

import canopen
import pytest
from canopen.profiles.p402 import BaseNode402

from tests.wire import DRIVE, spawned

pytestmark = pytest.mark.wire
CSV = "CYCLIC SYNCHRONOUS VELOCITY"


@pytest.fixture
def network(monkeypatch: pytest.MonkeyPatch) -> Iterator[canopen.Network]:
    for name in ("canopen", "can"):
        monkeypatch.setattr(logging.getLogger(name), "propagate", False)
    with spawned() as rig:
        network = canopen.Network()
        network.connect(**rig.bus)
        yield network
        network.disconnect()


def add(network: canopen.Network) -> BaseNode402:
    node = BaseNode402(DRIVE, str(files("sim_rig") / "eds" / "sim_drive.eds"))
    network.add_node(node)
    return node


def until(condition: Callable[[], bool], timeout_s: float = 5.0) -> bool:
    end_s = time.monotonic() + timeout_s
    while not condition() and time.monotonic() < end_s:
        threading.Event().wait(0.01)
    return condition()


def test_identity_strings_and_heartbeat_by_sdo(network: canopen.Network) -> None:
    node = add(network)
    assert node.sdo[0x1018][2].raw == 402
    assert node.sdo[0x1008].raw == "servo-bench simulated drive"  # segmented upload
    beats: list[int] = []
    node.nmt.add_heartbeat_callback(beats.append)
    node.sdo[0x1017].raw = 20
    assert until(lambda: len(beats) >= 3)
    assert set(beats) == {127}
    with pytest.raises(canopen.SdoAbortedError, match="0x06020000"):
        node.sdo.upload(0x5FFF, 0)


def test_its_state_machine_enables_moves_and_disables_our_drive(network: canopen.Network) -> None:
    node = add(network)
    node.nmt.state = "PRE-OPERATIONAL"
    node.setup_402_state_machine()
    node.nmt.state = "OPERATIONAL"
    command = node.rpdo[1]
    network.sync.start(0.01)
    command.start(0.01)
    try:
        node.op_mode = CSV
        assert node.op_mode == CSV
        node.state = "OPERATION ENABLED"
        assert node.state == "OPERATION ENABLED"
        before = node.sdo[0x6064].raw
        command[0x60FF].raw = 60_000
        assert until(lambda: node.sdo[0x6064].raw > before + 10_000)
        command[0x60FF].raw = 0
        node.state = "SWITCH ON DISABLED"
        assert node.state == "SWITCH ON DISABLED"
    finally:
        command.stop()
        network.sync.stop()


def test_a_master_that_falls_silent_gets_an_emergency(network: canopen.Network) -> None:
    node = add(network)
    heard: list[int] = []
    node.emcy.add_callback(lambda error: heard.append(error.code))
    node.sdo[0x1016][1].raw = 127 << 16 | 50
    network.send_message(0x77F, [5])
    assert until(lambda: 0x8130 in heard)
