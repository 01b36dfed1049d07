"""A drive with the generic profile's registers on pymodbus' own simulator, in a process.

    python -m tests.strangers.pymodbus_drive tcp PORT
    python -m tests.strangers.pymodbus_drive rtu DEVICE BAUD

The registers, their addressing, function codes and frames are pymodbus'; ours is only what a drive
does when it is written to: a statusword for each controlword, and a shaft that turns as commanded.
"""

import asyncio
import sys
import time

from pymodbus import FramerType
from pymodbus.constants import ExcCodes
from pymodbus.server import ModbusSerialServer, ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from tests.strangers.libmodbus import STATES

CONTROLWORD, VELOCITY, STATUSWORD, POSITION = 0x0100, 0x0101, 0x0200, 0x0203
SWITCHED_ON = {0: 0x5342, 1: 402, 0x12: 1, 0x17: 640, 0x19: 18_000, STATUSWORD: 0x250}


class Shaft:
    """Turns as it was last told, while it is enabled."""

    def __init__(self) -> None:
        self.position = 0.0
        self.time_s = time.monotonic()

    def turn(self, registers: list[int], start: int) -> None:
        """Registers brought up to now; `start` is the address of the first."""
        now_s = time.monotonic()
        raw = registers[VELOCITY - start] << 16 | registers[VELOCITY + 1 - start]
        velocity = raw - (1 << 32) if raw >> 31 else raw
        if registers[STATUSWORD - start] & 0x6F == 0x27:
            self.position += velocity * (now_s - self.time_s)
        self.time_s = now_s
        count = round(self.position) & 0xFFFFFFFF
        registers[POSITION - start] = count >> 16
        registers[POSITION + 1 - start] = count & 0xFFFF


def device() -> SimDevice:
    """Unit 1, each register writable."""
    shaft = Shaft()

    async def act(  # noqa: PLR0917 - as pymodbus calls it
        function: int,
        start: int,
        address: int,
        count: int,
        registers: list[int],
        written: list[int] | list[bool] | None,
    ) -> ExcCodes | None:
        shaft.turn(registers, start)
        if written is not None and address <= CONTROLWORD < address + count:
            control = int(written[CONTROLWORD - address])
            registers[STATUSWORD - start] = STATES.get(control, 0x250)
        return None

    words = [SWITCHED_ON.get(address, 0) for address in range(0x0210)]
    return SimDevice(1, [SimData(0, values=words, datatype=DataType.REGISTERS)], action=act)


async def serve(kind: str, where: str, *more: str) -> None:
    """Until the process is ended."""
    if kind == "tcp":
        server: ModbusTcpServer | ModbusSerialServer = ModbusTcpServer(
            device(), address=("127.0.0.1", int(where))
        )
    else:
        server = ModbusSerialServer(
            device(),
            framer=FramerType.RTU,
            port=where,
            baudrate=int(more[0]),
            parity="N",
            stopbits=2,
        )
    await server.listen()
    print("listening", flush=True)  # noqa: T201 - what the test waits for
    await asyncio.Event().wait()


if __name__ == "__main__":
    asyncio.run(serve(*sys.argv[1:]))
