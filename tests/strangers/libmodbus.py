"""libmodbus (Debian's libmodbus5, LGPL) through ctypes: a client, and a drive on its server."""

import ctypes
import ctypes.util
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

NOBASE = 112345678
"""libmodbus adds exception codes to this for errno."""
NAME = ctypes.util.find_library("modbus")

_REGISTERS = 0x210
STATES = {0x00: 0x250, 0x02: 0x250, 0x06: 0x231, 0x07: 0x233, 0x0F: 0x237, 0x80: 0x250}


class _Mapping(ctypes.Structure):
    """modbus_mapping_t of modbus.h, 3.1."""

    _fields_ = (
        ("nb_bits", ctypes.c_int),
        ("start_bits", ctypes.c_int),
        ("nb_input_bits", ctypes.c_int),
        ("start_input_bits", ctypes.c_int),
        ("nb_input_registers", ctypes.c_int),
        ("start_input_registers", ctypes.c_int),
        ("nb_registers", ctypes.c_int),
        ("start_registers", ctypes.c_int),
        ("tab_bits", ctypes.c_void_p),
        ("tab_input_bits", ctypes.c_void_p),
        ("tab_input_registers", ctypes.POINTER(ctypes.c_uint16)),
        ("tab_registers", ctypes.POINTER(ctypes.c_uint16)),
    )


def library() -> ctypes.CDLL:
    """The library, its pointers declared."""
    lib = ctypes.CDLL(NAME, use_errno=True)
    lib.modbus_new_tcp.restype = lib.modbus_new_rtu.restype = ctypes.c_void_p
    lib.modbus_new_tcp.argtypes = [ctypes.c_char_p, ctypes.c_int]
    lib.modbus_new_rtu.argtypes = [
        ctypes.c_char_p,
        ctypes.c_int,
        ctypes.c_char,
        ctypes.c_int,
        ctypes.c_int,
    ]
    lib.modbus_mapping_new.restype = ctypes.POINTER(_Mapping)
    for name in ("connect", "close", "free"):
        getattr(lib, f"modbus_{name}").argtypes = [ctypes.c_void_p]
    lib.modbus_set_slave.argtypes = [ctypes.c_void_p, ctypes.c_int]
    lib.modbus_set_response_timeout.argtypes = [ctypes.c_void_p, ctypes.c_uint32, ctypes.c_uint32]
    words = ctypes.POINTER(ctypes.c_uint16)
    number = ctypes.c_int
    lib.modbus_read_registers.argtypes = [ctypes.c_void_p, number, number, words]
    lib.modbus_write_registers.argtypes = [ctypes.c_void_p, number, number, words]
    lib.modbus_write_register.argtypes = [ctypes.c_void_p, number, ctypes.c_uint16]
    lib.modbus_write_and_read_registers.argtypes = [
        ctypes.c_void_p,
        number,
        number,
        words,
        number,
        number,
        words,
    ]
    lib.modbus_tcp_listen.argtypes = [ctypes.c_void_p, number]
    lib.modbus_tcp_accept.argtypes = [ctypes.c_void_p, ctypes.POINTER(number)]
    lib.modbus_receive.argtypes = [ctypes.c_void_p, ctypes.c_char_p]
    lib.modbus_reply.argtypes = [
        ctypes.c_void_p,
        ctypes.c_char_p,
        number,
        ctypes.POINTER(_Mapping),
    ]
    lib.modbus_mapping_free.argtypes = [ctypes.POINTER(_Mapping)]
    return lib


class Client:
    """libmodbus as a master. Raises OSError with libmodbus's own errno."""

    def __init__(self, context: Callable[[ctypes.CDLL], Any]) -> None:
        self._lib = library()
        self._context = context(self._lib)
        self._lib.modbus_set_slave(self._context, 1)
        self._lib.modbus_set_response_timeout(self._context, 5, 0)
        self._check(self._lib.modbus_connect(self._context))

    def close(self) -> None:
        self._lib.modbus_close(self._context)
        self._lib.modbus_free(self._context)

    def read(self, address: int, count: int) -> list[int]:
        words = (ctypes.c_uint16 * count)()
        self._check(self._lib.modbus_read_registers(self._context, address, count, words))
        return list(words)

    def write(self, address: int, *values: int) -> None:
        if len(values) == 1:
            self._check(self._lib.modbus_write_register(self._context, address, values[0]))
            return
        words = (ctypes.c_uint16 * len(values))(*values)
        self._check(self._lib.modbus_write_registers(self._context, address, len(values), words))

    def write_and_read(self, at: int, values: list[int], address: int, count: int) -> list[int]:
        words, got = (ctypes.c_uint16 * len(values))(*values), (ctypes.c_uint16 * count)()
        self._check(
            self._lib.modbus_write_and_read_registers(
                self._context, at, len(values), words, address, count, got
            )
        )
        return list(got)

    @staticmethod
    def _check(result: int) -> None:
        if result == -1:
            raise OSError(ctypes.get_errno(), "libmodbus")


class Drive:
    """A drive with the generic profile's registers on libmodbus's server, in a thread."""

    def __init__(self) -> None:
        self.lib = library()
        self.mapping = self.lib.modbus_mapping_new(0, 0, _REGISTERS, _REGISTERS)
        self.words = self.mapping.contents.tab_registers
        for address, word in {
            0x0000: 0x5342,
            0x0001: 402,
            0x0012: 1,
            0x0017: 640,
            0x0019: 18_000,
            0x0200: 0x250,
        }.items():
            self.words[address] = word
        self._position = 0.0
        self._time_s = time.monotonic()

    @property
    def enabled(self) -> bool:
        return self.words[0x0200] & 0x6F == 0x27

    def close(self) -> None:
        self.lib.modbus_mapping_free(self.mapping)

    def answer(self, context: Any) -> bool:
        """One request; False when the master has gone."""
        query = ctypes.create_string_buffer(260)
        length = self.lib.modbus_receive(context, query)
        if length == -1:
            return False
        if length > 0:
            self._move()
            self.lib.modbus_reply(context, query, length, self.mapping)
            self.words[0x0200] = STATES.get(self.words[0x0100], 0x250)
        return True

    def _move(self) -> None:
        now_s = time.monotonic()
        raw = self.words[0x0101] << 16 | self.words[0x0102]
        velocity = raw - (1 << 32) if raw >> 31 else raw
        self._position += velocity * (now_s - self._time_s) if self.enabled else 0.0
        self._time_s = now_s
        count = round(self._position) & 0xFFFFFFFF
        self.words[0x0203], self.words[0x0204] = count >> 16, count & 0xFFFF


@contextmanager
def tcp_drive(port: int) -> Iterator[Drive]:
    """On loopback; serves one master after the other, and ends with the last of them."""
    drive = Drive()
    context = drive.lib.modbus_new_tcp(b"127.0.0.1", port)
    listener = ctypes.c_int(drive.lib.modbus_tcp_listen(context, 1))
    assert listener.value != -1
    over = threading.Event()

    def serve() -> None:
        while drive.lib.modbus_tcp_accept(context, ctypes.byref(listener)) != -1:
            while drive.answer(context):
                pass
            drive.lib.modbus_close(context)
            if over.is_set():
                return

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield drive
    finally:
        over.set()
        last = Client(lambda lib: lib.modbus_new_tcp(b"127.0.0.1", port))
        last.close()
        thread.join()
        drive.lib.modbus_free(context)
        drive.close()


@contextmanager
def rtu_drive(device: str, baud_rate: int, wake: Callable[[], None]) -> Iterator[Drive]:
    """On one end of a pair of ptys; `wake` sends a last request, whatever it is, from the other."""
    drive = Drive()
    context = drive.lib.modbus_new_rtu(device.encode(), baud_rate, b"N", 8, 2)
    drive.lib.modbus_set_slave(context, 1)
    assert drive.lib.modbus_connect(context) != -1
    over = threading.Event()

    def serve() -> None:
        while not over.is_set():
            drive.answer(context)

    thread = threading.Thread(target=serve)
    thread.start()
    try:
        yield drive
    finally:
        over.set()
        wake()
        thread.join()
        drive.lib.modbus_close(context)
        drive.lib.modbus_free(context)
        drive.close()
