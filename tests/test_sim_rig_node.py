"""What CiA 301 asks of the rig's nodes: NMT, SDO, PDOs, SYNC, heartbeats; and the encoder's 406."""

import math
import struct

import canopen
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sim_rig.canopen.busloop import BusClock
from sim_rig.canopen.machine import CLOCK_JUMP_US, Machine
from sim_rig.canopen.objects import load_dictionary
from sim_rig.errors import RigSettingsError
from sim_rig.model import Model
from sim_rig.plant import PlantOutputs
from tests.wire import (
    COUNTS,
    DRIVE,
    DRIVE_MOTION,
    DRIVE_STATE,
    ENCODER,
    LOAD,
    NOMINAL,
    RPDO,
    LocalRig,
    SdoAbortError,
    local_rig,
    sdo_request,
)

TPDO1, TPDO1_MAP = 0x1800, 0x1A00
DISABLED = 1 << 31


def refused(rig: LocalRig, *write: int) -> int:
    with pytest.raises(SdoAbortError) as abort:
        rig.sdo(*write)
    return abort.value.code


class Held:
    """A plant that stands where the test puts it."""

    angle_rad = 0.0

    def advance(self, velocity_command_rad_s: float | None, duration_s: float) -> None:
        pass

    def outputs(self) -> PlantOutputs:
        return PlantOutputs(0.0, 0.0, 0.0, self.angle_rad)


# NMT and heartbeats


def test_it_says_that_it_has_booted() -> None:
    rig = local_rig()
    assert rig.sent == [(0x700 + DRIVE, b"\0"), (0x700 + ENCODER, b"\0")]


@pytest.mark.parametrize("command", [129, 130])
def test_a_reset_is_a_boot(command: int) -> None:
    rig = local_rig()
    rig.send(0, bytes([1, 0]))
    rig.sdo(DRIVE, 0x1017, 0, 100, 2)
    rig.sdo(DRIVE, 0x6083, 0, 77)
    rig.sent.clear()
    rig.send(0, bytes([command, DRIVE]))
    assert rig.take(0x700 + DRIVE) == [b"\0"]
    rig.send(0x80)
    assert [can_id for can_id, _ in rig.sent] == [LOAD], "a node in pre-operational has no PDOs"
    assert rig.sdo(DRIVE, 0x1017) == 0
    assert (rig.sdo(DRIVE, 0x6083) == 77) == (command == 130)


def test_nmt_is_for_the_node_it_names() -> None:
    rig = local_rig()
    rig.send(0, bytes([1, ENCODER]))
    rig.sent.clear()
    rig.send(0x80)
    assert [can_id for can_id, _ in rig.sent] == [LOAD]


def test_a_stopped_node_answers_no_sdo_but_beats() -> None:
    rig = local_rig()
    rig.sdo(DRIVE, 0x1017, 0, 100, 2)
    rig.send(0, bytes([2, DRIVE]))
    rig.sent.clear()
    rig.send(0x600 + DRIVE, sdo_request(0x1000, 0, None, 4))
    rig.wait(250_000)
    assert rig.sent == [(0x700 + DRIVE, b"\4")] * len(rig.sent)
    assert len(rig.sent) in (2, 3)


@pytest.mark.parametrize(("command", "state"), [(1, 5), (2, 4), (128, 127)])
def test_heartbeats_tell_the_state_on_their_grid(command: int, state: int) -> None:
    rig = local_rig()
    rig.sdo(DRIVE, 0x1017, 0, 50, 2)
    rig.send(0, bytes([command, 0]))
    rig.sent.clear()
    rig.wait(1_000_000)
    beats = rig.take(0x700 + DRIVE)
    assert set(beats) == {bytes([state])}
    assert len(beats) in (20, 21)


# SDO


def test_identity_and_names() -> None:
    rig = local_rig()
    assert [rig.sdo(DRIVE, 0x1018, sub) for sub in range(1, 4)] == [0, 402, 1]
    assert [rig.sdo(ENCODER, 0x1018, sub) for sub in range(1, 4)] == [0, 406, 1]
    assert rig.sdo(DRIVE, 0x1000) & 0xFFFF == 402
    assert rig.sdo(ENCODER, 0x1000) & 0xFFFF == 406


def test_a_long_string_comes_in_segments() -> None:
    rig = local_rig()
    rig.sent.clear()
    rig.send(0x600 + DRIVE, sdo_request(0x1008, 0, None, 4))
    (answer,) = rig.take(0x580 + DRIVE)
    size, text, toggle = int.from_bytes(answer[4:], "little"), b"", 0
    while len(text) < size:
        rig.send(0x600 + DRIVE, bytes([0x60 | toggle]) + bytes(7))
        (segment,) = rig.take(0x580 + DRIVE)
        assert segment[0] & 0x10 == toggle
        text += segment[1 : 8 - (segment[0] >> 1 & 7)]
        toggle ^= 0x10
    assert text == b"servo-bench simulated drive"


def test_what_is_not_there() -> None:
    rig = local_rig()
    assert refused(rig, DRIVE, 0x5555) == 0x06020000
    assert refused(rig, DRIVE, 0x1018, 9) == 0x06090011
    assert refused(rig, DRIVE, 0x1016, 2) == 0x06090011
    assert refused(rig, DRIVE, 0x6040, 1) == 0x06090011
    assert refused(rig, DRIVE, 0x1018, 1, 5) == 0x06010002


# PDOs


def map_pdo(rig: LocalRig, cob_id: int, *entries: int) -> None:
    """CiA 301's procedure: disable, clear, map, count, enable."""
    rig.sdo(DRIVE, TPDO1, 1, cob_id | DISABLED)
    rig.sdo(DRIVE, TPDO1_MAP, 0, 0, 1)
    for place, entry in enumerate(entries, start=1):
        rig.sdo(DRIVE, TPDO1_MAP, place, entry)
    rig.sdo(DRIVE, TPDO1_MAP, 0, len(entries), 1)
    rig.sdo(DRIVE, TPDO1, 1, cob_id)


def test_a_mapping_carries_what_the_master_chose() -> None:
    rig = local_rig()
    map_pdo(rig, 0x191, 0x60FF0020, 0x60610008, 0x60410010)
    rig.sdo(DRIVE, 0x60FF, 0, -5)
    rig.send(0, bytes([1, DRIVE]))
    rig.sent.clear()
    rig.send(0x80)
    frames = dict(rig.sent)
    assert DRIVE_STATE not in frames
    target, mode, status = struct.unpack("<ibH", frames[0x191])
    assert (target, mode, status & 0x6F) == (-5, 3, 0x40)


def test_a_mapping_is_changed_in_order_or_not_at_all() -> None:
    rig = local_rig()
    assert refused(rig, DRIVE, TPDO1_MAP, 0, 0, 1) == 0x06010000
    assert refused(rig, DRIVE, TPDO1, 1, 0x191) == 0x06090030
    rig.sdo(DRIVE, TPDO1, 1, 0x181 | DISABLED)
    assert refused(rig, DRIVE, TPDO1_MAP, 1, 0x60410010) == 0x06010000
    rig.sdo(DRIVE, TPDO1_MAP, 0, 0, 1)
    for unmappable in (0x60830020, 0x60410020, 0x60410008):
        assert refused(rig, DRIVE, TPDO1_MAP, 1, unmappable) == 0x06040041
    assert refused(rig, DRIVE, TPDO1_MAP, 1, 0x55550010) == 0x06020000
    for place, entry in enumerate((0x60640020, 0x606C0020, 0x60410010), start=1):
        rig.sdo(DRIVE, TPDO1_MAP, place, entry)
    assert refused(rig, DRIVE, TPDO1_MAP, 0, 3, 1) == 0x06040042
    assert refused(rig, DRIVE, TPDO1_MAP, 0, 9, 1) == 0x06090030
    rig.sdo(DRIVE, TPDO1_MAP, 0, 2, 1)
    rig.send(0, bytes([1, DRIVE]))
    assert refused(rig, DRIVE, TPDO1_MAP, 0, 0, 1) == 0x08000022


def test_a_received_pdo_maps_only_what_can_be_written() -> None:
    rig = local_rig()
    rig.sdo(DRIVE, 0x1400, 1, 0x201 | DISABLED)
    rig.sdo(DRIVE, 0x1600, 0, 0, 1)
    assert refused(rig, DRIVE, 0x1600, 1, 0x60410010) == 0x06040041


@pytest.mark.parametrize("cob_id", [0x000, 0x080, 0x101, 0x581, 0x601, 0x701, 0x20000181])
def test_reserved_identifiers_are_refused(cob_id: int) -> None:
    assert refused(local_rig(), DRIVE, TPDO1, 1, cob_id | DISABLED) == 0x06090030


def test_a_transmit_pdo_counts_syncs() -> None:
    rig = local_rig()
    rig.sdo(DRIVE, TPDO1, 2, 3, 1)
    rig.send(0, bytes([1, DRIVE]))
    rig.sent.clear()
    for _ in range(10):
        rig.send(0x80)
    assert len(rig.take(DRIVE_STATE)) == 3
    assert refused(rig, DRIVE, TPDO1, 2, 241, 1) == 0x06090030


def test_acyclic_synchronous_means_after_a_change() -> None:
    rig = local_rig()
    rig.sdo(DRIVE, TPDO1, 2, 0, 1)
    rig.send(0, bytes([1, DRIVE]))
    rig.sent.clear()
    for _ in range(5):
        rig.send(0x80)
    assert len(rig.take(DRIVE_STATE)) == 1
    rig.sdo(DRIVE, 0x6040, 0, 0x06, 2)
    rig.sent.clear()
    for _ in range(5):
        rig.send(0x80)
    assert len(rig.take(DRIVE_STATE)) == 1


def test_an_asynchronous_rpdo_acts_at_once_a_synchronous_one_at_the_sync() -> None:
    for transmission, at_once in ((1, False), (255, True)):
        rig = local_rig()
        rig.sdo(DRIVE, 0x1400, 2, transmission, 1)
        rig.send(0, bytes([1, DRIVE]))
        rig.send(RPDO, struct.pack("<Hi", 0x06, 5))
        assert (rig.sdo(DRIVE, 0x60FF) == 5) is at_once
        rig.send(0x80)
        assert rig.sdo(DRIVE, 0x60FF) == 5


def test_a_short_rpdo_is_an_emergency() -> None:
    rig = local_rig()
    rig.send(0, bytes([1, DRIVE]))
    rig.sent.clear()
    rig.send(RPDO, b"\x06\x00")
    (emergency,) = rig.take(0x080 + DRIVE)
    assert struct.unpack_from("<H", emergency) == (0x8210,)
    rig.send(0x80)
    assert rig.sdo(DRIVE, 0x6040) == 0


def test_the_sync_identifier_can_be_moved() -> None:
    rig = local_rig()
    rig.sdo(DRIVE, 0x1005, 0, 0x90)
    rig.send(0, bytes([1, DRIVE]))
    rig.sent.clear()
    rig.send(0x80)
    assert not rig.take(DRIVE_MOTION)
    rig.send(0x90)
    assert len(rig.take(DRIVE_MOTION)) == 1


# the encoder


def test_the_encoder_counts_wraps_and_presets() -> None:
    plant = Held()
    rig = local_rig(plant)
    step = math.tau / COUNTS
    assert rig.sdo(ENCODER, 0x6004) == 0
    plant.angle_rad = -step
    assert rig.sdo(ENCODER, 0x6004) == 4096 * COUNTS - 1
    assert rig.sdo(ENCODER, 0x6002) == 4096 * COUNTS
    rig.sdo(ENCODER, 0x6003, 0, 1000)
    assert rig.sdo(ENCODER, 0x6004) == 1000
    plant.angle_rad += 7 * step
    assert rig.sdo(ENCODER, 0x6004) == 1007
    assert refused(rig, ENCODER, 0x6003, 0, 4096 * COUNTS) == 0x06090030
    rig.send(0, bytes([129, ENCODER]))
    assert rig.sdo(ENCODER, 0x6004) == 6


def test_the_encoder_counts_the_other_way_on_request() -> None:
    plant = Held()
    rig = local_rig(plant)
    plant.angle_rad = 5 * math.tau / COUNTS
    rig.sdo(ENCODER, 0x6000, 0, 1, 2)
    assert rig.sdo(ENCODER, 0x6004) == 4096 * COUNTS - 5


@settings(max_examples=40, deadline=None)
@given(st.floats(-1000.0, 1000.0), st.integers(1, 2**24))
def test_a_count_is_the_nearest(angle_rad: float, counts: int) -> None:
    plant = Held()
    plant.angle_rad = angle_rad
    rig = local_rig(plant, load_counts_per_revolution=counts)
    modulus = rig.sdo(ENCODER, 0x6002)
    error = rig.sdo(ENCODER, 0x6004) - angle_rad * counts / math.tau
    assert abs((error + modulus / 2) % modulus - modulus / 2) <= 0.5 + 1e-5


def test_the_cyclic_timer_is_the_event_timer() -> None:
    rig = local_rig()
    rig.sdo(ENCODER, 0x6200, 0, 10, 2)
    assert rig.sdo(ENCODER, 0x1800, 5) == 10
    rig.sdo(ENCODER, 0x1800, 1, 0x40000180 + ENCODER)
    rig.send(0, bytes([1, ENCODER]))
    rig.sent.clear()
    rig.wait(100_000)
    assert len(rig.take(0x180 + ENCODER)) in (10, 11)


# clocks


def test_the_machine_plays_each_microsecond_once() -> None:
    plant = Model(NOMINAL).plant()
    machine = Machine(plant)
    played: list[int] = []
    machine.driven_by(played.append)
    for time_us in (5_000, 5_000, 13_000, 9_000, 14_000):
        machine.advance_to(time_us)
    assert played == [8_000, 1_000]
    machine.advance_to(14_000 + 2 * CLOCK_JUMP_US)
    machine.advance_to(20_000)
    machine.advance_to(21_000)
    assert played == [8_000, 1_000, 1_000]


def test_the_bus_clock_takes_the_quickest_frame() -> None:
    host_us = 0
    clock = BusClock(lambda: host_us)
    assert clock.now() is None
    for sent_us, late_us in ((1_000, 300), (2_000, 40), (3_000, 900)):
        host_us = sent_us + late_us
        assert clock.stamp((5_000_000 + sent_us) * 1e-6) == 5_000_000 + sent_us
    host_us = 10_000
    assert clock.now() == pytest.approx(5_000_000 + host_us, abs=45)


def test_the_bus_clock_follows_a_clock_that_was_set() -> None:
    host_us = 1_000
    clock = BusClock(lambda: host_us)
    clock.stamp(3600.0)
    clock.stamp(5.0)
    assert clock.now() == 5_000_000


# the EDS files


@pytest.mark.parametrize("name", ["sim_drive.eds", "sim_encoder.eds"])
def test_an_eds_describes_what_a_stranger_needs(name: str) -> None:
    dictionary = load_dictionary(name, 5)
    for index in dictionary:
        entry = dictionary[index]
        single = isinstance(entry, canopen.objectdictionary.ODVariable)
        variables = [entry] if single else list(entry.subindices.values())
        for variable in variables:
            assert variable.access_type in ("ro", "rw", "rww", "const", "wo")
            assert variable.default is not None, variable
            if variable.min is not None:
                assert variable.min <= variable.default <= variable.max, variable
        if not single:
            assert entry.subindices[0].default >= max(entry.subindices, default=0) or (
                0x1600 <= index < 0x1B00 or index == 0x1003
            )
    assert dictionary[0x1014].default == 0x85
    assert dictionary[0x1018][1].default == 0


@pytest.mark.parametrize("name", ["sim_drive.eds", "sim_encoder.eds"])
def test_default_pdos_map_mappable_objects_of_their_length(name: str) -> None:
    dictionary = load_dictionary(name, 5)
    for index in dictionary:
        if not (0x1600 <= index < 0x1640 or 0x1A00 <= index < 0x1A40):
            continue
        bits = 0
        for place in range(1, dictionary[index][0].default + 1):
            mapped = dictionary[index][place].default
            variable = dictionary[mapped >> 16]
            assert variable.pdo_mappable
            assert mapped & 0xFF == len(variable)
            assert variable.writable or index >= 0x1A00
            bits += mapped & 0xFF
        assert bits <= 64


# settings


@pytest.mark.parametrize(
    "changes",
    [
        {"drive_node_id": 0},
        {"encoder_node_id": 128},
        {"drive_node_id": 2},
        {"motor_counts_per_revolution": 0},
        {"load_encoder_noise_rad": -1e-6},
        {"motor_encoder_noise_rad": math.nan},
        {"rated_torque_nm": 0.0},
    ],
)
def test_settings_that_cannot_be(changes: dict[str, float]) -> None:
    with pytest.raises(RigSettingsError, match=next(iter(changes))):
        local_rig(**changes)
