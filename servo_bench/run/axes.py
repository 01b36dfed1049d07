"""Which axis a rig's drive is: the one place that knows every protocol."""

from drivers.axis import Axis
from drivers.canopen.master import CanopenAxis
from drivers.canopen.settings import CanopenSettings
from drivers.modbus.master import ModbusAxis
from drivers.modbus.settings import ModbusSettings
from servo_bench.rig import ModbusDriveConfig, RigConfig


def axis_settings(rig: RigConfig, period_s: float) -> CanopenSettings | ModbusSettings:
    """What the rig's master needs; ConfigError where this rig cannot be run at `period_s`."""
    if isinstance(rig.drive, ModbusDriveConfig):
        return rig.modbus_settings(period_s)
    return rig.canopen_settings(period_s)


def open_axis(rig: RigConfig, period_s: float) -> Axis:
    """The rig's axis, not yet entered; ConfigError as `axis_settings`."""
    settings = axis_settings(rig, period_s)
    if isinstance(settings, ModbusSettings):
        return ModbusAxis(settings)
    return CanopenAxis(settings)
