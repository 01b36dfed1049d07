"""The software rig on Modbus, and with a serial counter, in virtual time; see `virtual_rig`."""

from dataclasses import replace
from typing import Any

from drivers.axis import Axis
from drivers.counter.axis import AxisWithCounter
from drivers.modbus.master import ModbusAxis
from servo_bench.rig import RigConfig
from sim_rig.canopen.cia402 import POWERED, State
from sim_rig.counter.box import box_of
from sim_rig.modbus.drive import ModbusDrive
from sim_rig.modbus.line import Timing
from tests.coasting_plant import CoastingPlant
from tests.virtual_line import CounterEnd, RtuEnd, TcpEnd
from tests.virtual_rig import VirtualRig
from tests.virtual_world import VirtualWorld


class VirtualModbus(VirtualWorld):
    """A drive on Modbus, TCP or RTU as its rig file says."""

    def __init__(self, name: str, config: RigConfig) -> None:
        super().__init__()
        settings = config.simulation_settings()
        self._drive = ModbusDrive(
            replace(settings, faults=settings.wire_faults), CoastingPlant(settings.nominal)
        )
        if settings.protocol == "modbus-tcp":
            self.line: Any = TcpEnd(self, name, self._drive)
            self._config = config.with_bus(host=self.line.name)
        else:
            self.line = RtuEnd(self, name, self._drive, Timing.of(settings.bus))
            self._config = config.with_bus(device=self.line.name)

    @property
    def powered(self) -> bool:
        return self._drive._drive.state in POWERED

    @property
    def velocity_rad_s(self) -> float:
        return self._drive._machine.outputs.motor_velocity_rad_s

    def rig_wait_us(self) -> int:
        return self._drive.wait_us(self.now_ns // 1000)

    def rig_tick(self) -> None:
        self._drive.tick(self.now_ns // 1000)

    def axis(self) -> Axis:
        """A master for this rig."""
        return ModbusAxis(self._config.modbus_settings(0.008), self.clock())

    def close(self) -> None:
        """The rig is gone."""
        self.line.close()


class VirtualCounterRig(VirtualRig):
    """The rig on CANopen with the load's angle from a serial counter beside it."""

    def __init__(self, name: str, config: RigConfig) -> None:
        settings = config.simulation_settings()
        super().__init__(name, seed=settings.seed, faults=settings.faults, counter=settings.counter)
        assert settings.counter is not None
        box = box_of(
            settings,
            self.load_counts,
            lambda: self.rig.drive.state is State.OPERATION_ENABLED,
        )
        self.line = CounterEnd(self, name, box, settings.counter)
        self._config = config.with_bus(encoder_device=self.line.name)

    def axis_with_counter(self) -> Axis:
        """A master for drive and counter."""
        settings = self._config.counter_settings(0.008)
        assert settings is not None
        alone = replace(self.canopen_settings(), encoder=None)
        return AxisWithCounter(self.axis(alone), settings, self.clock())

    def close(self) -> None:
        """The rig is gone."""
        self.line.close()
