"""Which axis a rig's drive is: the one place that knows every protocol."""

from drivers.axis import Axis, StopAsked, never
from drivers.canopen.master import CanopenAxis
from drivers.canopen.settings import CanopenSettings
from drivers.canopen.stopline import CanopenStopLine
from drivers.counter.axis import AxisWithCounter
from drivers.modbus.master import ModbusAxis
from drivers.modbus.settings import ModbusSettings
from drivers.modbus.stopline import ModbusStopLine
from drivers.stopline import StopLine
from servo_bench.devices import ModbusDriveConfig
from servo_bench.rig import RigConfig

_CIA402_ENABLED = 0x6F, 0x27


def axis_settings(rig: RigConfig, period_s: float) -> CanopenSettings | ModbusSettings:
    """What the rig's master needs; ConfigError where this rig cannot be run at `period_s`."""
    rig.counter_settings(period_s)
    if isinstance(rig.drive, ModbusDriveConfig):
        return rig.modbus_settings(period_s)
    return rig.canopen_settings(period_s)


def open_axis(rig: RigConfig, period_s: float, stop_asked: StopAsked = never) -> Axis:
    """The rig's axis, not yet entered; ConfigError as `axis_settings`. Entering it raises
    StopAskedError where `stop_asked` says so before the drive is enabled."""
    settings, counter = axis_settings(rig, period_s), rig.counter_settings(period_s)
    axis: Axis = (
        ModbusAxis(settings, stop_asked=stop_asked)
        if isinstance(settings, ModbusSettings)
        else CanopenAxis(settings, stop_asked=stop_asked)
    )
    return axis if counter is None else AxisWithCounter(axis, counter)


def stop_line(rig: RigConfig, period_s: float) -> StopLine:
    """Another way to the rig's drive, not yet opened; ConfigError as `axis_settings`."""
    settings = axis_settings(rig, period_s)
    if isinstance(settings, ModbusSettings):
        return ModbusStopLine(settings)
    return CanopenStopLine(settings)


def enabled_bits(rig: RigConfig, period_s: float) -> tuple[int, int]:
    """Mask and value by which a statusword says that the drive is enabled."""
    settings = axis_settings(rig, period_s)
    if isinstance(settings, ModbusSettings):
        bits = settings.drive.profile.bits.enabled
        return bits.mask, bits.value
    return _CIA402_ENABLED
