"""The bus hub: its grammar, its contract with any client, and python-can's own client on it."""

import json
import os
import selectors
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, suppress

import can
import pytest
from can.interfaces.socketcand.socketcand import (
    convert_ascii_message_to_can_message,
    convert_can_message_to_ascii_message,
)
from hypothesis import given
from hypothesis import strategies as st

from sim_rig.canopen import socketcand
from sim_rig.canopen.client import Outgoing
from sim_rig.canopen.hub import BACKLOG_BYTES, Hub, loopback_address, main
from sim_rig.canopen.socketcand import ProtocolError, Send, parse, take_messages
from sim_rig.errors import RigSettingsError, SimRigError

AWAY_S = 0.1
"""How long the hub leaves a frame unread."""

frames = st.builds(
    Send,
    can_id=st.integers(0, 0x7FF),
    extended=st.just(False),
    data=st.binary(max_size=8),
) | st.builds(
    Send,
    can_id=st.integers(0, 0x1FFFFFFF),
    extended=st.just(True),
    data=st.binary(max_size=8),
)


class Client:
    """A raw client of a hub in the same thread: every wait turns the hub."""

    def __init__(self, hub: Hub, channel: str | None = "can0", *, talk: bool = True) -> None:
        self._hub = hub
        self.sock = socket.create_connection(hub.address)
        self.sock.setblocking(False)
        self._heard = b""
        self.expect("< hi >")
        if channel is not None:
            self.ask(f"< open {channel} >", "< ok >")
            self.ask("< rawmode >", "< ok >")
        if talk:
            self.say("< echo >")

    def say(self, text: str | bytes) -> None:
        self.sock.setblocking(True)
        self.sock.sendall(text.encode() if isinstance(text, str) else text)
        self.sock.setblocking(False)

    def ask(self, text: str | bytes, answer: str) -> None:
        self.say(text)
        self.expect(answer)

    def message(self) -> str | None:
        """The next whole message; None at end-of-file."""
        for _ in range(1000):
            head, bracket, rest = self._heard.partition(b">")
            if bracket:
                self._heard = rest
                return (head + bracket).decode()
            try:
                chunk = self.sock.recv(65536)
            except BlockingIOError:
                self._hub.step(0.01)
                continue
            except ConnectionResetError:
                return None
            if not chunk:
                return None
            self._heard += chunk
        raise AssertionError("the hub says nothing")

    def expect(self, start: str) -> str:
        message = self.message()
        assert message is not None
        assert message.startswith(start)
        return message

    def frame(self) -> can.Message:
        """The next frame, as python-can understands it."""
        message = self.message()
        while message == "< echo >":
            message = self.message()
        assert message is not None
        parsed = convert_ascii_message_to_can_message(message)
        assert parsed is not None
        return parsed


@pytest.fixture
def hub() -> Iterator[Hub]:
    with closing(Hub()) as running:
        yield running


@pytest.fixture
def connect(hub: Hub) -> Iterator[Callable[..., Client]]:
    with ExitStack() as leaving:

        def new(channel: str | None = "can0", *, talk: bool = True) -> Client:
            client = Client(hub, channel, talk=talk)
            leaving.callback(client.sock.close)
            return client

        yield new


Connect = Callable[..., Client]


# the grammar


@given(frames)
def test_what_python_can_sends_is_understood(frame: Send) -> None:
    message = can.Message(
        arbitration_id=frame.can_id, is_extended_id=frame.extended, data=frame.data
    )
    text = convert_can_message_to_ascii_message(message)
    assert parse(text.encode()) == frame


@given(frames, st.integers(0, 2**31 * 10**6))
def test_what_the_hub_says_python_can_understands(frame: Send, time_us: int) -> None:
    text = socketcand.frame_message(frame, time_us).decode()
    message = convert_ascii_message_to_can_message(text)
    assert (message.arbitration_id, message.is_extended_id) == (frame.can_id, frame.extended)
    assert bytes(message.data) == frame.data
    assert round(message.timestamp * 1e6) == time_us


@given(st.binary(max_size=600))
def test_any_bytes_are_understood_or_refused(message: bytes) -> None:
    try:
        understood = parse(message)
    except ProtocolError as error:
        answer = socketcand.error_message(str(error))
        assert take_messages(bytearray(answer)) == [answer]
    else:
        assert message.strip().startswith(b"<")
        assert understood is not None


@given(
    st.lists(st.binary(max_size=300) | st.just(b"< echo >"), max_size=8),
    st.lists(st.integers(1, 40), min_size=1, max_size=20),
)
def test_messages_are_cut_by_their_bytes_not_by_their_packets(
    parts: list[bytes], sizes: list[int]
) -> None:
    stream = b"".join(parts)
    whole = bytearray(stream)
    expected = take_messages(whole)
    buffer, found, at = bytearray(), [], 0
    while at < len(stream):
        size = sizes[at % len(sizes)]
        buffer += stream[at : at + size]
        at += size
        found += take_messages(buffer)
    assert found == expected
    assert buffer == whole
    assert b"".join(found) + bytes(buffer) == stream
    assert len(buffer) < socketcand.LONGEST_MESSAGE


@pytest.mark.parametrize(
    "message",
    [
        b"< send 201 1 >",
        b"< send 201 9 0 0 0 0 0 0 0 0 0 >",
        b"< send 201 1 100 >",
        b"< send 201 1 zz >",
        b"< send 201 1 +1 >",
        b"< send 801 0 >",
        b"< send 2FFFFFFF 0 >",
        b"< send 20 0 >",
        b"< send >",
        b"< open >",
        b"< open can 0 >",
        b"< open ../etc >",
        b"< bcmmode >",
        b"< < echo >",
        b"echo >",
        b"< \xe9cho >",
        b">",
        b"<>",
    ],
)
def test_malformed_messages_are_refused(message: bytes) -> None:
    with pytest.raises(ProtocolError):
        parse(message)


# the hub


def test_a_frame_reaches_everybody_else_on_its_channel(connect: Connect) -> None:
    sender, near, also, far = connect(), connect(), connect(), connect("can1")
    sender.say("< send 123 2 a ff >")
    for listener in (near, also):
        frame = listener.frame()
        assert (frame.arbitration_id, bytes(frame.data)) == (0x123, b"\x0a\xff")
    far.say("< send 124 0  >")
    near.say("< send 125 0  >")
    assert sender.frame().arbitration_id == 0x125, "heard itself, or the other channel"


def test_every_listener_sees_the_same_stamp_and_stamps_never_fall(connect: Connect) -> None:
    sender, one, two = connect(), connect(), connect()
    for number in range(50):
        sender.say(f"< send {number:03X} 0  >")
    first = [one.frame() for _ in range(50)]
    second = [two.frame() for _ in range(50)]
    assert [f.arbitration_id for f in first] == list(range(50))
    stamps = [f.timestamp for f in first]
    assert stamps == [f.timestamp for f in second] == sorted(stamps)


def test_a_frame_is_stamped_when_it_came_however_late_the_hub_has_its_turn(
    hub: Hub, connect: Connect
) -> None:
    """The best of three: the kernel begins to note a little after it is asked first."""
    sender, listener = connect(), connect()
    off_s = []
    for _ in range(3):
        sent_s = time.time()
        sender.say("< send 002 0  >")
        with closing(Hub()) as elsewhere:
            elsewhere.step(AWAY_S)
        assert time.time() - sent_s >= AWAY_S
        off_s.append(abs(listener.frame().timestamp - sent_s))
    assert min(off_s) < 0.5 * AWAY_S, "a hub that stamps what it reads is late every time"


def test_a_clock_that_was_set_while_a_frame_lay_unread_stamps_it_as_read(
    connect: Connect, monkeypatch: pytest.MonkeyPatch
) -> None:
    sender, listener = connect(), connect()
    for hours in (-1.0, 1.0):
        before_s = time.time()
        set_ns = time.time_ns() + round(hours * 3600e9)
        with monkeypatch.context() as patched:
            patched.setattr("sim_rig.canopen.arrival.time.time_ns", lambda now=set_ns: now)
            sender.say("< send 003 0  >")
            stamp_s = listener.frame().timestamp
        assert abs(stamp_s - before_s) < 1.0


def test_a_stream_of_single_bytes_is_a_stream(connect: Connect) -> None:
    sender, listener = connect(), connect()
    for byte in b"< send 7FF 3 1 2 3 >< send 00000001 0  >":
        sender.say(bytes([byte]))
    first, second = listener.frame(), listener.frame()
    assert (first.arbitration_id, bytes(first.data)) == (0x7FF, b"\1\2\3")
    assert (second.is_extended_id, second.dlc) == (True, 0)


def test_malformed_input_is_answered_and_harms_nobody(connect: Connect) -> None:
    bad, good, other = connect(talk=False), connect(), connect()
    bad.say(b"\xff\x00 rubbish > < send 1 2 3 >" + b"x" * 1000 + b">")
    for _ in range(6):
        bad.expect("< error ")
    bad.say("< send 111 0  >")
    assert good.frame().arbitration_id == 0x111
    good.say("< send 112 0  >")
    assert other.frame().arbitration_id == 0x111
    assert other.frame().arbitration_id == 0x112


@pytest.mark.parametrize("early", ["< send 111 0  >", "< rawmode >"])
def test_the_order_of_the_opening_matters(connect: Connect, early: str) -> None:
    client = connect(None, talk=False)
    client.ask(early, "< error open a channel")
    client.ask("< open can0 >", "< ok >")
    client.ask("< rawmode >", "< ok >")


def test_frames_wait_until_a_new_client_has_read_its_ok(hub: Hub, connect: Connect) -> None:
    """python-can's client fails when anything follows `< ok >` in the same read."""
    sender, late = connect(), connect(None, talk=False)
    late.ask("< open can0 >", "< ok >")
    late.say("< rawmode >")
    hub.step(1.0)
    sender.say("< send 111 0  >")
    hub.step(1.0)
    assert late.sock.recv(256) == b"< ok >"
    assert late.frame().arbitration_id == 0x111


def test_a_client_that_leaves_is_forgotten(connect: Connect) -> None:
    sender, gone, listener = connect(), connect(), connect()
    gone.sock.close()
    sender.say("< send 111 0  >")
    assert listener.frame().arbitration_id == 0x111
    sender.say("< send 112 0  >")
    assert listener.frame().arbitration_id == 0x112


def test_a_client_that_never_reads_is_dropped(hub: Hub, connect: Connect) -> None:
    sender, slow, listener = connect(), connect(), connect()
    slow.sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    burst = b"< send 111 8 1 2 3 4 5 6 7 8 >" * 1000
    heard = 0
    for _ in range(400):
        sender.say(burst)
        for _ in range(1000):
            assert listener.frame().arbitration_id == 0x111
            heard += 1
        try:
            slow.sock.send(b" ")
        except (ConnectionResetError, BrokenPipeError):
            break
    else:
        raise AssertionError("the slow client is still there")
    assert heard * 40 > BACKLOG_BYTES


@pytest.mark.parametrize("host", ["0.0.0.0", "192.168.1.1", "example.org", "::1", ""])  # noqa: S104
def test_only_loopback_is_served(host: str) -> None:
    with pytest.raises(RigSettingsError, match="this machine only"):
        loopback_address(host)


def test_names_of_loopback() -> None:
    assert loopback_address("localhost") == "127.0.0.1"
    assert loopback_address("127.1.2.3") == "127.1.2.3"


def test_a_port_that_is_taken_is_named(hub: Hub) -> None:
    with pytest.raises(SimRigError, match=f"{hub.address[1]}.*Port 0"):
        Hub(*hub.address)


def test_the_command_line_says_why_it_ends(capsys: pytest.CaptureFixture[str]) -> None:
    before = {number: signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGINT)}
    try:
        assert main(["--host", "10.0.0.1"]) == 2
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
    assert "127.0.0.1" in capsys.readouterr().err


# the hub as a process, python-can as its client


@pytest.fixture
def hub_process() -> Iterator[tuple[subprocess.Popen[bytes], int]]:
    command = [sys.executable, "-m", "sim_rig.canopen.hub", "--parent", str(os.getpid())]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as process:
        try:
            assert process.stdout is not None
            yield process, json.loads(process.stdout.readline())["port"]
        finally:
            process.terminate()


def python_can(port: int) -> can.BusABC:
    return can.Bus(
        interface="socketcand", host="127.0.0.1", port=port, channel="can0", tcp_tune=True
    )


@pytest.mark.wire
def heard_by(bus: can.BusABC) -> can.Message:
    message = bus.recv(10.0)
    assert message is not None
    return message


def test_python_can_talks_through_it(hub_process: tuple[subprocess.Popen[bytes], int]) -> None:
    with python_can(hub_process[1]) as one, python_can(hub_process[1]) as two:
        sent = [
            can.Message(arbitration_id=0x80, is_extended_id=False),
            can.Message(arbitration_id=0x181, data=bytes(range(8)), is_extended_id=False),
            can.Message(arbitration_id=0x1ABCDEF0, data=b"\xff", is_extended_id=True),
        ]
        for message in sent:
            one.send(message)
        for message in sent:
            heard = two.recv(5.0)
            assert heard is not None
            assert heard.equals(
                message, timestamp_delta=None, check_direction=False, check_channel=False
            )


@pytest.mark.wire
def test_a_burst_arrives_whole_and_in_order(
    hub_process: tuple[subprocess.Popen[bytes], int],
) -> None:
    with python_can(hub_process[1]) as one, python_can(hub_process[1]) as two:
        for number in range(2000):
            data = number.to_bytes(4, "little")
            one.send(can.Message(arbitration_id=0x181, data=data, is_extended_id=False))
        heard = [two.recv(5.0) for _ in range(2000)]
    assert [int.from_bytes(m.data, "little") for m in heard if m] == list(range(2000))


@pytest.mark.wire
def test_what_a_rig_answers_at_once_reaches_the_hub_in_one_piece(
    hub_process: tuple[subprocess.Popen[bytes], int],
) -> None:
    """One read has one stamp. A machine that is away for 0.2 s lets the kernel cut: best of ten."""
    in_one_piece = 0
    with python_can(hub_process[1]) as rig, python_can(hub_process[1]) as listener:
        outgoing = Outgoing(rig)
        for _ in range(10):
            with outgoing:
                for can_id in range(8):
                    outgoing.send(can_id, b"answer")
            heard = [heard_by(listener) for _ in range(8)]
            assert [message.arbitration_id for message in heard] == list(range(8))
            in_one_piece += len({message.timestamp for message in heard}) == 1
            outgoing.send(0x7FF, b"alone")  # and what belongs to nothing does not wait
            assert bytes(heard_by(listener).data) == b"alone"
    assert in_one_piece >= 5, "sent one by one, eight frames are not read at once again and again"


@pytest.mark.wire
def test_what_was_answered_before_an_error_leaves_all_the_same(
    hub_process: tuple[subprocess.Popen[bytes], int],
) -> None:
    with python_can(hub_process[1]) as rig, python_can(hub_process[1]) as listener:
        outgoing = Outgoing(rig)
        with suppress(ZeroDivisionError), outgoing:
            outgoing.send(1, b"before")
            raise ZeroDivisionError
        assert bytes(heard_by(listener).data) == b"before"


def test_a_bus_without_a_hub_takes_every_frame_as_it_is() -> None:
    with (
        can.Bus(interface="virtual", channel="alone") as rig,
        can.Bus(interface="virtual", channel="alone") as listener,
        Outgoing(rig) as outgoing,
    ):
        outgoing.send(1, b"at once")
        assert bytes(heard_by(listener).data) == b"at once"


@pytest.mark.wire
def test_it_ends_on_sigterm(hub_process: tuple[subprocess.Popen[bytes], int]) -> None:
    process, port = hub_process
    with socket.create_connection(("127.0.0.1", port)) as client:
        assert client.recv(100) == b"< hi >"
        process.terminate()
        assert process.wait(10.0) == 0
        assert client.recv(100) == b""


def test_no_descriptor_is_left(hub: Hub) -> None:
    """A selector that still knows a dropped client would spin on it."""
    for _ in range(20):
        Client(hub).sock.close()
    for _ in range(50):
        hub.step(0.0)
    watched = hub._selector.get_map()
    assert len(watched) == 1
    assert next(iter(watched.values())).events == selectors.EVENT_READ
