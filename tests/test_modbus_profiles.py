"""Register maps and the arithmetic of their periods."""

import math
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.errors import SettingsError
from drivers.modbus.budget import response_timeout_s, shortest_period
from drivers.modbus.library import SHIPPED, load_profile, profile_names
from drivers.modbus.lines import RtuLine, TcpLine
from drivers.modbus.plan import plan_of
from drivers.modbus.profile import DriveProfile
from drivers.modbus.registers import Codec, Item, Type, WordOrder
from drivers.modbus.settings import LoadEncoder, ModbusDriveSettings, ModbusSettings

TCP = TcpLine("127.0.0.1", 1502)


def table(**changes: Any) -> dict[str, Any]:
    """A small register map: two registers written, `read` registers read, in one transaction."""
    return {
        "title": "small",
        "transports": ["modbus-rtu"],
        "functions": {"read_write": 23},
        "timing": {"turnaround_s": 0.001, "baud_rates": [115200, 460800, 1000000]},
        "items": {
            "target_velocity": {"address": 0x100, "type": "int32", "unit": "rpm", "scale": 0.1},
            "motor_position": {"address": 0x200, "type": "int32", "unit": "count"},
            "load_position": {"address": 0x202, "type": "int32", "unit": "count"},
            "statusword": {"address": 0x207},
        },
        "cycle": {
            "write": ["target_velocity"],
            "read": [["motor_position", "load_position", "statusword"]],
        },
        "status": {"enabled": {"mask": 1, "value": 1}, "fault": {"mask": 2, "value": 2}},
    } | changes


def small(**changes: Any) -> DriveProfile:
    return DriveProfile.model_validate(table(**changes))


def settings(profile: DriveProfile, **changes: Any) -> ModbusSettings:
    drive = {"unit": 1, "counts_per_revolution": 65536, "without_watchdog": True} | changes
    line = drive.pop("line", RtuLine("/dev/ttyUSB0"))
    period_s = drive.pop("period_s", 0.05)
    return ModbusSettings(line, ModbusDriveSettings(profile=profile, **drive), period_s)


@pytest.mark.parametrize("name", profile_names())
def test_every_shipped_profile_loads_and_has_its_sources(name: str) -> None:
    profile = load_profile(name)
    assert profile.title
    assert profile.sources
    assert plan_of(profile).exchanges


def test_all_three_kinds_ship() -> None:
    assert set(profile_names()) == {"generic", "delta-asda-a2", "hiwin-d1-n"}
    assert {path.name for path in SHIPPED.iterdir()} == {f"{n}.toml" for n in profile_names()}


# the sum, against figures worked out by hand (the Modbus specifications' lengths and t3.5)


@pytest.mark.parametrize(
    ("baud_rate", "turnaround_s", "total_ms"),
    [
        (115200, 0.001, 38 * 11 / 115.2 + 3.5 + 1.0),
        (460800, 0.001, 38 * 11 / 460.8 + 3.5 + 1.0),
        (1_000_000, 0.0, 38 * 11 / 1000 + 3.5),
        (9600, 0.001, (38 + 7) * 11 / 9.6 + 1.0),  # t3.5 is 3.5 characters here
    ],
)
def test_the_sum_of_function_23_is_17_and_21_bytes_and_two_silences(
    baud_rate: int, turnaround_s: float, total_ms: float
) -> None:
    profile = small(timing={"turnaround_s": turnaround_s})
    budget = shortest_period(profile, RtuLine("/dev/ttyUSB0", baud_rate))
    assert budget.total_s == pytest.approx(total_ms * 1e-3, rel=1e-12)
    assert str(budget).startswith(f"17 + 21 bytes at {baud_rate} Bd 8E1 = ")


def test_a_period_that_cannot_be_held_is_refused_with_the_sum_and_what_would_hold() -> None:
    with pytest.raises(SettingsError) as refused:
        settings(small(), period_s=0.008)
    assert (
        "17 + 21 bytes at 115200 Bd 8E1 = 3.6 ms, 2 x t3.5 = 3.5 ms, turnaround = 1 ms: 8.1 ms > "
        "8 ms. Use 460800 Bd (5.4 ms), or period_s >= 0.009." in str(refused.value)
    )
    settings(small(), period_s=0.008, line=RtuLine("/dev/ttyUSB0", 460800))
    settings(small(), period_s=0.009)


def test_delta_over_rtu_says_with_the_arithmetic_that_8_ms_cannot_be() -> None:
    words = (
        r"13 \+ 8 and 8 \+ 25 bytes at 115200 Bd 8E1 = 5\.2 ms, 4 x silent interval of 10 ms = "
        r"40 ms, 2 x turnaround of 1 ms = 2 ms: 47\.2 ms > 8 ms\. No speed of the line helps "
        r"\(its silences and turnaround alone take 42 ms\): use period_s >= 0\.048, or CANopen"
    )
    delta = load_profile("delta-asda-a2")
    with pytest.raises(SettingsError, match=words):
        settings(delta, period_s=0.008, communication_timeout_s=1.0)
    held = settings(delta, period_s=0.048, communication_timeout_s=0.3)
    assert held.own_stop_s == 1.0, "P3-04 counts whole seconds"


@given(
    baud_rate=st.integers(1200, 2_000_000),
    silent_ms=st.floats(0, 20),
    turnaround_ms=st.floats(0, 10),
    function_23=st.booleans(),
)
def test_the_sum_grows_with_every_term_and_with_a_second_transaction(
    baud_rate: int, silent_ms: float, turnaround_ms: float, function_23: bool
) -> None:
    timing = {"silent_interval_s": silent_ms * 1e-3, "turnaround_s": turnaround_ms * 1e-3}
    line = RtuLine("/dev/ttyUSB0", baud_rate, "N", 2)
    one = shortest_period(small(timing=timing), line).total_s
    two = shortest_period(small(timing=timing, functions={}), line).total_s
    assert two > one >= max(2 * silent_ms, turnaround_ms) * 1e-3
    profile = small(timing=timing, functions={"read_write": 23} if function_23 else {})
    exchange = plan_of(profile).exchanges[0]
    assert response_timeout_s(profile, line, exchange) > profile.timing.max_response_s


def test_without_the_load_encoder_its_block_is_not_read() -> None:
    cycle = {
        "write": ["target_velocity"],
        "read": [["motor_position", "statusword"], ["load_position"]],
    }
    profile = small(cycle=cycle)
    assert len(settings(profile).plan.exchanges) == 1
    assert len(settings(profile, load=LoadEncoder(4096)).plan.exchanges) == 3


# registers


TYPES: list[Type] = ["int16", "uint16", "int32", "uint32"]


@given(st.sampled_from(TYPES), st.sampled_from(["high-first", "low-first"]), st.data())
def test_registers_keep_every_value_and_its_word_order(
    kind: Type, order: WordOrder, data: st.DataObject
) -> None:
    bits, signed = int(kind[-2:]), not kind.startswith("u")
    low, high = (-(1 << bits - 1), (1 << bits - 1) - 1) if signed else (0, (1 << bits) - 1)
    value = data.draw(st.integers(low, high))
    codec = Codec(Item(address=0, type=kind), order)
    words = codec.encode(value)
    raw = (value % (1 << bits)).to_bytes(bits // 8, "big")
    expected = [int.from_bytes(raw[k : k + 2], "big") for k in range(0, len(raw), 2)]
    assert words == (expected if order == "high-first" else expected[::-1])
    assert codec.decode(words) == value
    for beyond in (low - 1, high + 1, math.nan, math.inf):
        with pytest.raises(ValueError, match=r"outside|no number"):
            codec.encode(beyond)


def test_a_drive_s_own_word_order_beats_the_profile_s() -> None:
    item = Item(address=0, type="uint32", word_order="high-first")
    assert Codec(item, "low-first").encode(0x0BB8_0001) == [0x0BB8, 1]


def test_the_example_of_the_delta_manual() -> None:
    """January 2011, p. 9-12: 300 rpm to P1-09 is 0BB8H, 0000H at 0112H."""
    profile = load_profile("delta-asda-a2")
    request = plan_of(profile).exchanges[0].request({"target_velocity": 3000})
    assert (request.function_code, request.address) == (16, 0x0112)
    assert list(request.registers) == [0x0BB8, 0]


def test_float_registers() -> None:
    codec = Codec(Item(address=0, type="float32"), "high-first")
    assert codec.encode(-1.5) == [0xBFC0, 0]
    assert codec.decode([0xBFC0, 0]) == -1.5
    with pytest.raises(ValueError, match="beyond float32"):
        codec.encode(1e39)


# what a profile must not say


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"status": None}, "commanded needs"),
        ({"cycle": {"read": [["motor_position"]]}}, "read lacks statusword"),
        ({"cycle": {"write": [], "read": [["motor_position", "ghost"]]}}, r"no \[items.ghost\]"),
        ({"enable": [{"write": "statusword", "value": 70000}]}, "outside 0 to 65535"),
        ({"functions": {"words_per_read": 4}}, "are 8 registers, the drive takes 4"),
        ({"functions": {"write": 6}}, "function 6 writes one register"),
        ({"unknown": 1}, "Extra inputs"),
    ],
)
def test_a_profile_that_cannot_be_is_refused_in_words(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        plan_of(DriveProfile.model_validate(table(**changes)))


def test_a_wrong_unit_is_refused() -> None:
    items = table()["items"] | {"motor_position": {"address": 0x200, "type": "int32", "unit": "A"}}
    with pytest.raises(ValueError, match=r"unit = 'A': one of \('count',\)"):
        small(items=items)


@pytest.mark.parametrize(
    ("name", "changes", "words"),
    [
        ("motor_position", {"scale": 16.0}, r"scale = 16: .*into drive\.counts_per_revolution"),
        ("load_position", {"scale": 0.5}, r"into drive\.second_encoder\.counts_per_revolution"),
        ("statusword", {"scale": 2.0}, "scale = 2: .*as they are"),
        ("statusword", {"type": "int16"}, 'type = "int16": one of uint16, uint32'),
        ("statusword", {"type": "float32"}, 'type = "float32": one of uint16, uint32'),
        ("motor_position", {"type": "float32"}, "whole number of counts"),
        ("device_time", {"type": "uint16", "unit": "us"}, 'type = "uint16": one of uint32'),
        ("device_time", {"type": "uint32", "unit": "us", "scale": 0.1}, "scale = 0.1: whole micro"),
    ],
)
def test_digits_that_the_bench_would_misread_are_refused(
    name: str, changes: dict[str, Any], words: str
) -> None:
    items = table()["items"]
    item = items.get(name, {"address": 0x210}) | changes
    with pytest.raises(ValueError, match=words):
        small(items=items | {name: item})


def test_a_device_clock_of_milliseconds_may_be_used() -> None:
    time = {"address": 0x210, "type": "uint32", "unit": "us", "scale": 1000.0}
    assert small(items=table()["items"] | {"device_time": time}).items["device_time"].scale == 1000


def test_neighbours_in_one_block_may_not_overlap() -> None:
    items = table()["items"] | {"statusword": {"address": 0x201}}
    with pytest.raises(ValueError, match="overlap"):
        plan_of(small(items=items))


def test_files_that_are_no_profiles(tmp_path: Path) -> None:
    file = tmp_path / "mine.toml"
    with pytest.raises(SettingsError, match=r"no Modbus drive profile 'no-such'.*generic"):
        load_profile("no-such")
    for text, words in (("title =", "is not TOML"), ('title = "x"', "transports: Field required")):
        file.write_text(text)
        load_profile.cache_clear()
        with pytest.raises(SettingsError, match=words):
            load_profile(str(file))


# what a rig must not ask


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"line": TCP}, "has no modbus-tcp: it speaks modbus-rtu"),
        ({"unit": 0}, "unit id is 1 to 247"),
        ({"without_watchdog": False}, "does not stop by itself when the bench dies"),
    ],
)
def test_settings_that_this_drive_cannot_meet(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(SettingsError, match=words):
        settings(small(), **changes)


def test_a_second_encoder_that_the_drive_does_not_have() -> None:
    items = {k: v for k, v in table()["items"].items() if k != "load_position"}
    cycle = {"write": ["target_velocity"], "read": [["motor_position", "statusword"]]}
    with pytest.raises(SettingsError, match="has no second encoder"):
        settings(small(items=items, cycle=cycle), load=LoadEncoder(4096))


def test_a_drive_that_takes_no_velocity_is_not_driven() -> None:
    with pytest.raises(SettingsError, match="can be read, not driven"):
        settings(load_profile("hiwin-d1-n"), line=RtuLine("/dev/ttyUSB0", 38400))


@pytest.mark.parametrize("timeout_s", [0.02, 100.0])
def test_a_communication_timeout_that_cannot_be(timeout_s: float) -> None:
    with pytest.raises(SettingsError, match=r"communication_timeout_s = .*three periods"):
        settings(load_profile("generic"), line=TCP, communication_timeout_s=timeout_s)


def test_lines_that_cannot_be() -> None:
    with pytest.raises(SettingsError, match="needs the drive's address"):
        TcpLine("", 502)
    with pytest.raises(SettingsError, match="needs a serial device"):
        RtuLine("/dev/ttyUSB0", 1)
