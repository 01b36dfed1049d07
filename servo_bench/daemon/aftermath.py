"""After a run that ended badly: ask the drive itself whether it has stopped, and stop it if not.

Only when no bus process lives any more, so that there is one master on the bus at any time.
"""

import time

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


def standing_sentence(rig: RigConfig, period_s: float) -> str:
    """What the drive says about itself, as a sentence for the operator; never raises ours."""
    if isinstance(rig.drive, ModbusDriveConfig):
        return f"The drive on {rig.drive.protocol} was not asked whether it stands: look at it."
    try:
        with gathered():
            settings = rig.canopen_settings(period_s)
            bus = open_bus(settings.bus)
            try:
                node = open_drive(Line(bus, SYSTEM_CLOCK), settings.drive)
                return _asked(node, rig.drive.heartbeat_timeout_s + OWN_STOP_S)
            finally:
                bus.shutdown()
    except BenchError as error:
        return f"The drive could not be asked whether it stands ({error}): look at it."


def _asked(node: Node, patience_s: float) -> str:
    """Wait for the drive's own stop; where it does not come, stop it by SDO."""
    until_s = time.monotonic() + patience_s
    while _powered(word := node.read(0x6041)) and time.monotonic() < until_s:
        time.sleep(LOOK_EVERY_S)
    if not _powered(word):
        return f"Asked afterwards, the drive says: {cia402.describe_statusword(word)}."
    node.write(0x6040, 0, cia402.QUICK_STOP)
    node.write(0x6040, 0, cia402.DISABLE_VOLTAGE)
    word = node.read(0x6041)
    advice = " Use the emergency stop if the shaft turns." if _powered(word) else ""
    return (
        f"The drive had not stopped by itself after {patience_s:g} s and was powered off; it says: "
        f"{cia402.describe_statusword(word)}.{advice}"
    )


def _powered(statusword: int) -> bool:
    return cia402.decode_state(statusword) in cia402.POWERED
