"""Which bytes are the answer, over a real socket and a real pty; every answer made by hand."""

import errno
import os
import socket
import termios
from collections.abc import Iterator
from itertools import pairwise

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pymodbus.pdu import ExceptionResponse

from drivers.clock import SYSTEM_CLOCK
from drivers.errors import DriveError, SettingsError, WireError
from drivers.modbus.frames import read_request, write_request
from drivers.modbus.lines import RtuLine, TcpLine
from drivers.modbus.link import readable, transact
from drivers.modbus.rtu import RtuLink
from drivers.modbus.tcp import TcpLink
from tests.modbus_peer import pty, rtu_frame, tcp_frame, tcp_listener

PATIENCE_NS = 5_000_000_000
LOOK_NS = 20_000_000
GOOD = bytes([3, 4, 0x12, 0x34, 0x56, 0x78])


class Tcp:
    """A link and its other end."""

    def __init__(self, link: TcpLink, far: socket.socket) -> None:
        self.link = link
        self.far = far
        self.transaction = 0
        self.wait_ns = PATIENCE_NS

    def ask(self) -> int:
        """Begin to read two registers; the transaction id that went out."""
        self.link.begin(read_request(3, 0x10, 2))
        frame = self.far.recv(100)
        self.transaction = int.from_bytes(frame[:2], "big")
        assert frame == tcp_frame(bytes([3, 0, 0x10, 0, 2]), self.transaction)
        return self.transaction

    def says(self, data: bytes) -> list[int] | str | None:
        """What the link makes of these bytes: registers, an exception, nothing."""
        self.far.sendall(data)
        reply = self.link.poll(SYSTEM_CLOCK.now_ns() + self.wait_ns)
        if reply is None:
            return None
        if isinstance(reply.pdu, ExceptionResponse):
            return f"exception {reply.pdu.exception_code}"
        return list(reply.pdu.registers)

    def ignores(self, data: bytes) -> bool:
        """Whether these bytes are no answer, for as long as a look takes."""
        self.wait_ns = LOOK_NS
        nothing = self.says(data) is None
        self.wait_ns = PATIENCE_NS
        return nothing


@pytest.fixture
def tcp() -> Iterator[Tcp]:
    with tcp_listener() as listener:
        link = TcpLink(TcpLine(*listener.getsockname()), 1)
        far, _ = listener.accept()
        far.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        with far:
            yield Tcp(link, far)
        link.close()


def test_tcp_takes_the_answer_of_its_transaction_and_no_other(tcp: Tcp) -> None:
    number = tcp.ask()
    assert tcp.ignores(tcp_frame(GOOD, number + 1))
    assert tcp.ignores(tcp_frame(GOOD, number, unit=2))
    assert tcp.ignores(tcp_frame(bytes([4]) + GOOD[1:], number)), "another function"
    assert tcp.ignores(tcp_frame(bytes([3, 2, 0, 1]), number)), "another length"
    assert tcp.says(tcp_frame(GOOD, number)) == [0x1234, 0x5678]
    assert (tcp.link.strays, tcp.link.damaged) == (1, 3)


def test_tcp_never_takes_the_answer_to_a_request_that_was_given_up(tcp: Tcp) -> None:
    late = tcp_frame(bytes([3, 4, 0, 1, 0, 1]), tcp.ask())
    tcp.link.abandon()
    number = tcp.ask()
    assert tcp.ignores(late)
    assert tcp.says(late + tcp_frame(GOOD, number) + late) == [0x1234, 0x5678]


@given(st.lists(st.integers(1, 12), max_size=4))
@settings(
    suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, max_examples=30
)
def test_tcp_frames_may_come_in_any_pieces(tcp: Tcp, cuts: list[int]) -> None:
    frame = tcp_frame(GOOD, tcp.ask())
    edges = [0, *sorted(set(cuts)), len(frame)]
    for begin, end in pairwise(edges[:-1]):
        tcp.far.sendall(frame[begin:end])
        assert tcp.link.poll(0) is None
    assert tcp.says(frame[edges[-2] :]) == [0x1234, 0x5678]


def test_tcp_exception_replies(tcp: Tcp) -> None:
    assert tcp.says(tcp_frame(bytes([0x83, 2]), tcp.ask())) == "exception 2"


def test_tcp_that_closes_is_a_wire_error(tcp: Tcp) -> None:
    tcp.ask()
    tcp.far.close()
    with pytest.raises(WireError, match="closed the connection"):
        tcp.link.poll(SYSTEM_CLOCK.now_ns() + PATIENCE_NS)


def test_tcp_that_is_not_modbus_is_a_wire_error(tcp: Tcp) -> None:
    tcp.ask()
    with pytest.raises(WireError, match="is no Modbus TCP"):
        tcp.says(b"HTTP/1.1 400 Bad Request\r\n")


def test_tcp_where_nobody_listens() -> None:
    with tcp_listener() as listener:
        line = TcpLine(*listener.getsockname())
    with pytest.raises(WireError, match="cannot be reached"):
        TcpLink(line, 1)


def test_tcp_transaction_ids_never_are_zero_and_come_back_late(tcp: Tcp) -> None:
    tcp.link._last_id = 0xFFFE
    assert [tcp.ask(), tcp.ask(), tcp.ask()] == [0xFFFF, 1, 2]


# RTU


class Rtu:
    """A link and the near end of its pty."""

    def __init__(self, link: RtuLink, near: int) -> None:
        self.link = link
        self.near = near
        self.wait_ns = PATIENCE_NS

    def ask(self, words: int = 2) -> None:
        """Begin to read; what went out is as the specification has it."""
        self.link.begin(read_request(3, 0x10, words))
        asked = rtu_frame(bytes([3, 0, 0x10, 0, words]))
        assert self.hears(len(asked)) == asked

    def hears(self, length: int) -> bytes:
        """What went out, at least so much of it: a pty hands it over when the kernel gets to it."""
        data = b""
        while len(data) < length:
            give_up_ns = SYSTEM_CLOCK.now_ns() + PATIENCE_NS
            assert readable(self.near, give_up_ns, SYSTEM_CLOCK), f"after {data!r} nothing came"
            data += os.read(self.near, 100)
        return data

    def says(self, data: bytes) -> list[int] | str | None:
        """What the link makes of these bytes."""
        os.write(self.near, data)
        reply = self.link.poll(SYSTEM_CLOCK.now_ns() + self.wait_ns)
        if reply is None:
            return None
        if isinstance(reply.pdu, ExceptionResponse):
            return f"exception {reply.pdu.exception_code}"
        return list(reply.pdu.registers)

    def ignores(self, data: bytes) -> bool:
        """Whether these bytes are no answer, for as long as a look takes."""
        self.wait_ns = LOOK_NS
        nothing = self.says(data) is None
        self.wait_ns = PATIENCE_NS
        return nothing


@pytest.fixture
def rtu() -> Iterator[Rtu]:
    with pty() as (near, device):
        link = RtuLink(RtuLine(device, 460800, "N", 2), 1)
        yield Rtu(link, near)
        link.close()


def test_rtu_takes_what_fits_its_request_and_nothing_else(rtu: Rtu) -> None:
    rtu.ask()
    assert rtu.ignores(rtu_frame(GOOD, unit=2))
    assert rtu.ignores(rtu_frame(bytes([4]) + GOOD[1:])), "another function"
    assert rtu.ignores(rtu_frame(bytes([3, 6, 0, 1, 0, 2, 0, 3]))), "another length"
    assert rtu.ignores(rtu_frame(GOOD)[:-1] + b"\0"), "a wrong check sum"
    assert rtu.says(rtu_frame(GOOD)) == [0x1234, 0x5678]
    assert rtu.link.damaged >= 1


def test_rtu_drops_what_came_before_the_request(rtu: Rtu) -> None:
    rtu.ask()
    rtu.link.abandon()
    os.write(rtu.near, rtu_frame(bytes([3, 4, 0, 1, 0, 1])))
    rtu.ask()
    assert rtu.link.strays == 1
    assert rtu.says(rtu_frame(GOOD)) == [0x1234, 0x5678]


def test_rtu_with_another_length_never_takes_a_late_answer(rtu: Rtu) -> None:
    rtu.ask(2)
    rtu.link.abandon()
    rtu.ask(3)
    late, good = rtu_frame(GOOD), rtu_frame(bytes([3, 6, 0, 7, 0, 8, 0, 9]))
    assert rtu.ignores(late)
    assert rtu.says(good) == [7, 8, 9]


@given(st.binary(max_size=12), st.lists(st.integers(1, 12), max_size=3))
@settings(
    suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, max_examples=30
)
def test_rtu_noise_before_an_answer_and_pieces_do_not_cost_it(
    rtu: Rtu, noise: bytes, cuts: list[int]
) -> None:
    rtu.ask()
    data = noise.replace(b"\x01", b"\x02") + rtu_frame(GOOD)
    edges = [0, *sorted({cut for cut in cuts if cut < len(data)}), len(data)]
    for begin, end in pairwise(edges[:-1]):
        os.write(rtu.near, data[begin:end])
        assert rtu.link.poll(0) is None
    assert rtu.says(data[edges[-2] :]) == [0x1234, 0x5678]


def test_rtu_exception_replies(rtu: Rtu) -> None:
    rtu.ask()
    assert rtu.says(rtu_frame(bytes([0x83, 6]))) == "exception 6"


def test_rtu_echo_of_another_write_is_no_answer(rtu: Rtu) -> None:
    rtu.link.begin(write_request(6, 0x100, [7]))
    asked = rtu_frame(bytes([6, 1, 0, 0, 7]))
    assert rtu.hears(len(asked)) == asked
    assert rtu.ignores(rtu_frame(bytes([6, 1, 0, 0, 8])))
    assert rtu.says(rtu_frame(bytes([6, 1, 0, 0, 7]))) == [7]


def test_rtu_pty_that_closes_is_a_wire_error() -> None:
    with pty() as (near, device):
        link = RtuLink(RtuLine(device, 460800, "N", 2), 1)
        link.begin(read_request(3, 0, 1))
        os.read(near, 100)
    with pytest.raises(WireError, match="is gone"):
        link.poll(SYSTEM_CLOCK.now_ns() + PATIENCE_NS)
    link.close()


def test_rtu_devices_that_cannot_be_opened(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(WireError, match=r"cannot open /dev/no-such: .*dialout"):
        RtuLink(RtuLine("/dev/no-such"), 1)
    with pty() as (_, device):
        first = RtuLink(RtuLine(device, 115200, "N", 2), 1)
        with pytest.raises(WireError, match="cannot open"):
            RtuLink(RtuLine(device, 115200, "N", 2), 1)
        first.close()

    def refuse(*_: object, **__: object) -> None:
        raise termios.error(errno.EINVAL, "Invalid argument")  # what tcsetattr says

    monkeypatch.setattr("serial.Serial", refuse)
    with pytest.raises(SettingsError, match=r"refuses 115200 Bd 8E1.*a pty has no parity"):
        RtuLink(RtuLine("/dev/ttyUSB0", 115200, "E"), 1)


def test_a_set_up_transaction_is_repeated_and_then_given_up(rtu: Rtu) -> None:
    with pytest.raises(WireError, match="asked 3 times to read it"):
        transact(rtu.link, read_request(3, 0, 1), 0.002, SYSTEM_CLOCK, "read it")
    asked = 3 * rtu_frame(bytes([3, 0, 0, 0, 1]))
    assert rtu.hears(len(asked)) == asked


def test_a_set_up_transaction_that_is_refused(tcp: Tcp) -> None:
    tcp.far.sendall(tcp_frame(bytes([0x83, 2]), 1))
    with pytest.raises(DriveError, match=r"refuses to read it: exception 0x02 .*illegal address"):
        transact(tcp.link, read_request(3, 0, 1), 1.0, SYSTEM_CLOCK, "read it")
