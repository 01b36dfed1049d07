"""A rig on Modbus, until it is stopped: one thread, one event loop."""

import asyncio
import selectors
import time
from collections.abc import Callable
from contextlib import AbstractAsyncContextManager, AsyncExitStack
from dataclasses import replace
from typing import Any

from sim_rig.counter import line as counter_line
from sim_rig.counter.box import box_of
from sim_rig.modbus import line, tcp
from sim_rig.modbus.drive import ModbusDrive
from sim_rig.plant import Plant
from sim_rig.settings import ENCODER_DEVICE, RigSettings


def serve(
    settings: RigSettings,
    plant: Plant,
    ready: Callable[[dict[str, Any]], None],
    stop: Callable[[], bool],
) -> None:
    """Answer until `stop()`. `ready` hears the bus options, with the real port or device.

    Raises RigSettingsError for settings that cannot be, SimRigError where the port is taken.
    """

    # epoll counts in milliseconds; select in microseconds, as t3.5 must be
    def loop() -> asyncio.AbstractEventLoop:
        return asyncio.SelectorEventLoop(selectors.SelectSelector())

    with asyncio.Runner(loop_factory=loop) as runner:
        runner.run(_serve(settings, plant, ready, stop))


async def _serve(
    settings: RigSettings,
    plant: Plant,
    ready: Callable[[dict[str, Any]], None],
    stop: Callable[[], bool],
) -> None:
    drive = ModbusDrive(replace(settings, faults=settings.wire_faults), plant)
    listening: AbstractAsyncContextManager[dict[str, Any]] = (
        tcp.listening(drive, settings.bus)
        if settings.protocol == "modbus-tcp"
        else line.listening(drive, settings.bus)
    )
    async with listening as where, AsyncExitStack() as leaving:
        told = {**settings.bus, **where}
        if settings.counter is not None:
            box = box_of(settings, drive.load_counts, drive.is_enabled)
            at = counter_line.listening(box, settings.counter)
            told[ENCODER_DEVICE] = await leaving.enter_async_context(at)
        ready(told)
        while not stop():
            now_us = time.monotonic_ns() // 1000
            drive.tick(now_us)
            await asyncio.sleep(drive.wait_us(now_us) * 1e-6)
