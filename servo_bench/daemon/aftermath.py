"""After a run that ended badly: ask the drive itself whether it has stopped, and stop it if not.

Only when no bus process lives any more, so that there is one master on the bus at any time.
"""

import time
from typing import NamedTuple

from drivers.canopen import cia402
from drivers.canopen.line import Line, open_bus
from drivers.canopen.node import Node
from drivers.canopen.setup import open_drive
from drivers.clock import SYSTEM_CLOCK
from servo_bench.devices import ModbusDriveConfig
from servo_bench.errors import BenchError, gathered
from servo_bench.rig import RigConfig

OWN_STOP_S = 1.0
"""How long after its master's last word a drive may take to stop by itself, beyond its timeout."""
LOOK_EVERY_S = 0.05


class Standing(NamedTuple):
    """What the drive says about itself, for the operator, and whether that is: without power."""

    sentence: str
    confirmed: bool


def ask_standing(rig: RigConfig, period_s: float) -> Standing:
    """What the drive says about itself; never raises ours."""
    if isinstance(rig.drive, ModbusDriveConfig):
        protocol = rig.drive.protocol
        return Standing(
            f"The drive on {protocol} was not asked whether it stands: look at it.", False
        )
    try:
        with gathered():
            settings = rig.canopen_settings(period_s)
            line = Line(open_bus(settings.bus), SYSTEM_CLOCK)
            try:
                node = open_drive(line, settings.drive)
                return _asked(node, rig.drive.heartbeat_timeout_s + OWN_STOP_S)
            finally:
                line.close()
    except BenchError as error:
        return Standing(
            f"The drive could not be asked whether it stands ({error}): look at it.", False
        )


def _asked(node: Node, patience_s: float) -> Standing:
    """Wait for the drive's own stop; where it does not come, stop it by SDO."""
    until_s = time.monotonic() + patience_s
    while _powered(word := node.read(0x6041)) and time.monotonic() < until_s:
        time.sleep(LOOK_EVERY_S)
    if not _powered(word):
        words = cia402.describe_statusword(word)
        return Standing(f"Asked afterwards, the drive says: {words}.", True)
    node.write(0x6040, 0, cia402.QUICK_STOP)
    node.write(0x6040, 0, cia402.DISABLE_VOLTAGE)
    word = node.read(0x6041)
    advice = " Use the emergency stop if the shaft turns." if _powered(word) else ""
    return Standing(
        f"The drive had not stopped by itself after {patience_s:g} s and was powered off; it says: "
        f"{cia402.describe_statusword(word)}.{advice}",
        not _powered(word),
    )


def _powered(statusword: int) -> bool:
    return cia402.decode_state(statusword) in cia402.POWERED
