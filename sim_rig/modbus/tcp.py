"""The rig's registers over Modbus TCP, by pymodbus's server; loopback only."""

import asyncio
import ipaddress
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from pymodbus.constants import ExcCodes
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from sim_rig.errors import RigSettingsError, SimRigError
from sim_rig.modbus.drive import ModbusDrive
from sim_rig.modbus.table import runs
from sim_rig.settings import BusOptions


def check(bus: BusOptions) -> tuple[str, int]:
    """Host and port to listen on. RigSettingsError for an address that others can reach."""
    host, port = str(bus.get("host", "127.0.0.1")), int(bus.get("port", 0))
    try:
        local = ipaddress.ip_address(host).is_loopback
    except ValueError:
        local = False
    if not local:
        raise RigSettingsError(
            f"bus.host = {host!r}: the software rig listens on loopback only. Use 127.0.0.1, or "
            "run the rig where the bench runs."
        )
    return host, port


@asynccontextmanager
async def listening(drive: ModbusDrive, bus: BusOptions) -> AsyncIterator[dict[str, str | int]]:
    """Serve; yields host and real port. SimRigError where the port is taken."""
    address = check(bus)

    def stamp(sending: bool, data: bytes) -> bytes:
        if sending:
            return drive.outgoing(data)
        if drive.outgoing.unplugged:
            return b""
        drive.request_arrived(time.monotonic_ns() // 1000)
        return data

    server = ModbusTcpServer(_device(drive), address=address, trace_packet=stamp)
    try:
        await server.serve_forever(background=True)
    except RuntimeError as error:
        raise SimRigError(
            f"The rig cannot listen on {address[0]}:{address[1]}: the port is taken. Choose "
            "another one, or 0 for any."
        ) from error
    try:
        listener = server.transport
        assert isinstance(listener, asyncio.Server)  # noqa: S101
        yield {"host": address[0], "port": listener.sockets[0].getsockname()[1]}
    finally:
        await server.shutdown()


def _device(drive: ModbusDrive) -> SimDevice:
    async def act(  # noqa: PLR0917 - pymodbus calls it so
        function: int,  # noqa: ARG001
        start: int,
        address: int,
        count: int,
        registers: list[int],
        values: list[int] | list[bool] | None,
    ) -> ExcCodes | None:
        """Before pymodbus reads its copy, bring it up to date; before it writes, write."""
        if values is not None:
            return drive.write(address, [int(value) for value in values])
        fresh = drive.read(address, count)
        if isinstance(fresh, ExcCodes):
            return fresh
        registers[address - start : address - start + count] = fresh
        return None

    kind = DataType.REGISTERS
    blocks = [SimData(first, count=count, values=0, datatype=kind) for first, count in runs()]
    return SimDevice(drive.unit, blocks, action=act)
