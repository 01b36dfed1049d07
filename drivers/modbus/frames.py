"""Requests, and which answer belongs to one. PDUs and frames are pymodbus's.

A request and its answer on a serial line, in bytes (n registers read, m written):

    03, 04 read          8                    5 + 2 n
    06     write one     8                    8
    16     write         9 + 2 m              8
    23     read, write   13 + 2 m             5 + 2 n
    any, refused                              5
"""

from collections.abc import Sequence

from pymodbus.framer import FramerRTU
from pymodbus.pdu import DecodePDU, ExceptionResponse, ModbusPDU
from pymodbus.pdu.register_message import (
    ReadHoldingRegistersRequest,
    ReadInputRegistersRequest,
    ReadWriteMultipleRegistersRequest,
    WriteMultipleRegistersRequest,
    WriteSingleRegisterRequest,
)

EXCEPTION_BYTES = 5
_ECHO_BYTES = 8
_NAMES = {
    1: "illegal function: the drive does not have this function code",
    2: "illegal address: the drive has no such register, or not for this function code",
    3: "illegal value: the drive refuses this value or number of registers",
    4: "device failure: the drive could not do it in its present state",
    5: "acknowledged, still working",
    6: "busy",
    8: "memory parity error",
    10: "gateway path unavailable",
    11: "gateway: the device behind it does not answer",
}


def read_request(function: int, address: int, count: int) -> ModbusPDU:
    """Function 3 or 4."""
    kind = ReadInputRegistersRequest if function == 4 else ReadHoldingRegistersRequest
    return kind(address=address, count=count)


def write_request(function: int, address: int, words: Sequence[int]) -> ModbusPDU:
    """Function 6 (one register) or 16."""
    kind = WriteSingleRegisterRequest if function == 6 else WriteMultipleRegistersRequest
    return kind(address=address, registers=list(words))


def read_write_request(
    read_address: int, read_count: int, write_address: int, words: Sequence[int]
) -> ModbusPDU:
    """Function 23: the write comes first, then the read."""
    return ReadWriteMultipleRegistersRequest(
        read_address=read_address,
        read_count=read_count,
        write_address=write_address,
        write_registers=list(words),
    )


def words_asked(request: ModbusPDU) -> int | None:
    """How many registers the answer must bring; None for a write."""
    if isinstance(request, ReadWriteMultipleRegistersRequest):
        return request.read_count
    if isinstance(request, ReadHoldingRegistersRequest):
        return request.count
    return None


def answer_bytes(request: ModbusPDU) -> int:
    """How long the good answer is on a serial line."""
    words = words_asked(request)
    return _ECHO_BYTES if words is None else 5 + 2 * words


def request_bytes(request: ModbusPDU) -> int:
    """How long the request is on a serial line."""
    return len(FramerRTU(DecodePDU(is_server=False)).buildFrame(request))


def belongs(answer: ModbusPDU, request: ModbusPDU) -> bool:
    """Whether an answer can be one to this request: function, length, and what a write echoes."""
    if isinstance(answer, ExceptionResponse):
        return answer.function_code & 0x7F == request.function_code
    if answer.function_code != request.function_code:
        return False
    words = words_asked(request)
    if words is not None:
        return len(answer.registers) == words
    if answer.address != request.address:
        return False
    if isinstance(request, WriteSingleRegisterRequest):
        return list(answer.registers) == list(request.registers)
    return answer.count == request.count


def describe_exception(answer: ExceptionResponse) -> str:
    """An exception reply in words."""
    code = answer.exception_code
    name = _NAMES.get(code, "the vendor's own; see the drive's manual")
    return f"exception 0x{code:02X} to function {answer.function_code & 0x7F} ({name})"
