"""A Delta ASDA-A2 by its manual, by hand: parameters of two words, low first; no function 23."""

import math

from drivers.modbus.library import load_profile
from drivers.modbus.lines import RtuLine
from drivers.modbus.master import ModbusAxis
from drivers.modbus.settings import LoadEncoder, ModbusDriveSettings, ModbusSettings
from tests.contract_axis import play
from tests.modbus_peer import Peer, Registers, pty, running

PERIOD_S = 0.06
SERVO_ON, SPEED_1 = 0x01, 0x02


class Delta(Registers):
    """P0-09 to P0-13 show what P0-17 to P0-21 and the mappings say; P4-07 drives the inputs."""

    position = 0
    log: list[tuple[int, int]]

    def parameter(self, group: int, number: int) -> int:
        address = group << 8 | 2 * number
        return self.words.get(address, 0) | self.words.get(address + 1, 0) << 16

    def answer(self, pdu: bytes) -> bytes:
        assert pdu[0] in (3, 6, 16), "function 23 is not there"
        if pdu[0] == 3:
            assert int.from_bytes(pdu[3:5], "big") <= 10
        self._show()
        return super().answer(pdu)

    def _write(self, address: int, data: bytes) -> None:
        value = int.from_bytes(data[2:4] + data[0:2], "big")
        self.log.append((address, value))
        super()._write(address, data)
        if address == 0x0112 and self.inputs == SERVO_ON | SPEED_1:
            speed = value - (1 << 32) if value >> 31 else value
            self.position += speed  # one count for each 0.1 rpm and command

    @property
    def inputs(self) -> int:
        return self.parameter(4, 7) & self.parameter(3, 6)

    def _show(self) -> None:
        status = 0x01 | (0x02 if self.inputs & SERVO_ON else 0)
        for number in range(5):
            shown = self._monitored(self.parameter(0, 17 + number), status) & 0xFFFFFFFF
            address = 2 * (9 + number)
            self.words[address], self.words[address + 1] = shown & 0xFFFF, shown >> 16

    def _monitored(self, code: int, status: int) -> int:
        if code in (19, 20):
            target = self.parameter(0, 35 + code - 19)
            return {0x002E002E: status << 16 | status, 0x05110511: 2 * self.position}.get(target, 0)
        return {3: self.position, 7: 0, 11: 50}.get(code, 0)


def test_it_is_enabled_by_its_inputs_commanded_and_stopped() -> None:
    delta = Delta(words={})
    delta.log = []
    with pty() as (near, device):
        peer = Peer(lambda _number, _frame, answer: [answer], near=near)
        peer.registers = delta
        drive = ModbusDriveSettings(
            1,
            load_profile("delta-asda-a2"),
            1_280_000,
            rated_torque_nm=1.27,
            load=LoadEncoder(10_000, -1),
        )
        line = RtuLine(device, 115200, "N", 2)
        axis = ModbusAxis(ModbusSettings(line, drive, PERIOD_S, stuck_travel_rad=10.0))
        with running(peer), axis:
            assert delta.inputs == SERVO_ON | SPEED_1
            assert delta.parameter(3, 3) == delta.parameter(3, 4) == 1, "stops after 1 s"
            samples = play(axis, [math.tau / 60 * 12.3] * 6, PERIOD_S)
    known = [s for s in samples if s.motor_position_counts is not None]
    assert len(known) >= 3
    last = known[-1]
    counts = last.motor_position_counts or 0
    assert counts % 123 == 0, "12.3 rpm are 123 digits"
    assert counts > 0
    assert last.load_angle_counts == 2 * counts
    assert last.load_angle_rad == -2 * counts * math.tau / 10_000
    assert last.motor_torque_nm is not None
    assert math.isclose(last.motor_torque_nm, 0.5 * 1.27)
    assert delta.inputs == 0
    assert delta.parameter(3, 4) == 0, "its watchdog is off again"
    order = [address for address, _ in delta.log]
    assert order.index(0x023C) == 0, "nothing is kept in the EEPROM"
    assert order.index(0x0112) < max(i for i, e in enumerate(delta.log) if e == (0x040E, 1))
    stops = [e for e in delta.log if e[0] in (0x0112, 0x040E)][-3:]
    assert stops == [(0x0112, 0), (0x040E, SERVO_ON), (0x040E, 0)], "zero, hold, off"
