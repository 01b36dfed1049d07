"""Framings of serial counters: check sums, codecs, profiles, and what a line can hold."""

import binascii
import zlib
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pymodbus.framer import FramerRTU

from drivers.counter.checks import CHECKS, pair_parity_holds
from drivers.counter.frames import Frame, Part
from drivers.counter.profile import load_profile
from drivers.counter.settings import CounterLine, CounterSettings, sum_of
from drivers.errors import SettingsError
from servo_bench.errors import ConfigError
from servo_bench.rig import RigConfig, load_rig
from servo_bench.run import preflight
from servo_bench.run.axes import axis_settings
from servo_bench.run.finding import Level
from servo_bench.run.virtual import play_virtually
from sim_rig.counter.framings import FRAMINGS, State
from tests.test_run_session import experiment

CATALOGUE = {
    "crc-8/smbus": 0xF4,
    "crc-8/maxim-dow": 0xA1,
    "crc-16/modbus": 0x4B37,
    "crc-16/ibm-3740": 0x29B1,
    "crc-16/xmodem": 0x31C3,
    "crc-32/iso-hdlc": 0xCBF43926,
}
"""What each gives for the ASCII digits 1 to 9: the `check` of the CRC catalogue."""
WORDS = st.integers(0, 0xFFFFFFFF)
BYTES = st.integers(0, 255)
STATES = st.builds(State, position=WORDS, status=BYTES, index_number=BYTES, index=WORDS)
GENERIC = sorted(FRAMINGS)


@pytest.mark.parametrize("name", CATALOGUE)
def test_a_crc_gives_the_catalogues_check_value(name: str) -> None:
    assert CHECKS[name].of(b"123456789") == CATALOGUE[name]


@settings(deadline=None)
@given(st.binary(max_size=64))
def test_check_sums_agree_with_other_hands(data: bytes) -> None:
    assert CHECKS["crc-16/xmodem"].of(data) == binascii.crc_hqx(data, 0)
    assert CHECKS["crc-16/ibm-3740"].of(data) == binascii.crc_hqx(data, 0xFFFF)
    assert CHECKS["crc-32/iso-hdlc"].of(data) == zlib.crc32(data)
    swapped = FramerRTU.compute_CRC(data)
    assert CHECKS["crc-16/modbus"].of(data) == (swapped >> 8 | (swapped & 0xFF) << 8)
    assert CHECKS["sum8"].of(data + bytes([CHECKS["lrc8"].of(data)])) == 0
    assert CHECKS["xor8"].of(data + bytes([CHECKS["xor8"].of(data)])) == 0


def test_pair_parity_takes_the_data_sheets_word_and_sees_every_wrong_bit() -> None:
    assert pair_parity_holds(0x61AB)
    assert not any(pair_parity_holds(0x61AB ^ 1 << bit) for bit in range(16))
    frame = load_profile("cui-amt21").answers
    assert frame.decode((0x61AB).to_bytes(2, "little")) == {"position": 0x21AB}
    assert frame.decode((0x61AA).to_bytes(2, "little")) is None


@pytest.mark.parametrize("name", GENERIC)
@settings(deadline=None)
@given(sequence=BYTES, state=STATES, data=st.data())
def test_what_the_software_counter_says_is_read_and_no_wrong_byte_is(
    name: str, sequence: int, state: State, data: st.DataObject
) -> None:
    profile = load_profile(name)
    sent = FRAMINGS[name].answer(sequence, state)
    assert profile.answers.decode(sent) == {
        "sequence": sequence,
        "status": state.status,
        "index_number": state.index_number,
        "position": state.position,
        "index": state.index,
    }
    place, other = data.draw(st.integers(0, len(sent) - 1)), data.draw(st.integers(1, 255))
    wrong = bytearray(sent)
    wrong[place] ^= other
    assert profile.answers.decode(bytes(wrong)) is None
    assert FRAMINGS[name].answer_bytes == profile.answers.size


@pytest.mark.parametrize("name", GENERIC)
@settings(deadline=None)
@given(sequence=BYTES, noise=st.binary(max_size=3))
def test_the_software_counter_finds_every_request(name: str, sequence: int, noise: bytes) -> None:
    request = load_profile(name).asks.encode({"sequence": sequence})
    assert FRAMINGS[name].request(bytearray(noise + request)) == sequence


def test_a_display_with_a_sign_and_a_box_in_hexadecimal_are_read_as_their_manuals_say() -> None:
    display = load_profile("heidenhain-nd")
    assert display.asks.encode({}) == b"\x1bA0200\r"
    assert display.answers.decode(b"\x02-000001473\r\n") == {"position": -1473}
    assert display.answers.decode(b"\x02+123456789\r\n") == {"position": 123456789}
    assert display.answers.decode(b"\x02+12345678?\r\n") is None
    box = load_profile("us-digital-qsb")
    assert box.asks.encode({}) == b"R0E\r"
    assert box.answers.decode(b"r0EFFFFFFFE\r\n") == {"position": 0xFFFFFFFE}
    assert not box.answers.is_checked


BASE = """
title = "mine"
request = [{ text = "?" }]
answer = [{ field = "position", bytes = 2 }, { check = "xor8" }]
"""


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("position", "status", "no field position"),
        ('"xor8"', '"crc-9"', "check 'crc-9' is not known: one of"),
        ("bytes = 2", "bytes = 2, digits = 2", "takes digits .ASCII. or bytes"),
        ('text = "?"', 'field = "sequence", bytes = 1', "sequence must be in the request and in"),
        ('text = "?"', 'hex = "zz"', "hex 'zz'"),
        ('text = "?"', 'text = "é"', "is not ASCII"),
        ("bytes = 2", "bytes = 9", "less than or equal to 8"),
        ("title", "titel", "titel: Extra inputs"),
        ('"xor8" }', '"xor8" }, { field = "index", bytes = 2 }', "come together"),
        ('text = "?"', "text = ''", "one of text, hex, field, check"),
        ("[{", "[[{", "is not TOML"),
    ],
)
def test_a_profile_that_cannot_be_is_refused_in_words(
    tmp_path: Path, old: str, new: str, words: str
) -> None:
    good = tmp_path / "good.toml"
    good.write_text(BASE)
    assert load_profile(str(good)).range == 1 << 16
    bad = tmp_path / "bad.toml"
    bad.write_text(BASE.replace(old, new, 1))
    with pytest.raises(SettingsError, match=words):
        load_profile(str(bad))


def test_a_number_that_does_not_fit_is_refused() -> None:
    frame = Frame((Part.model_validate({"field": "sequence", "digits": 2}),))
    assert frame.encode({"sequence": 0xAB}) == b"AB"
    with pytest.raises(ValueError, match="256 does not fit"):
        frame.encode({"sequence": 256})


@pytest.mark.parametrize(
    ("name", "baud_rate", "shortest_ms"),
    [
        ("generic-binary", 115200, 16 * 10 / 115.2 + 0.2),
        ("generic-ascii", 115200, 31 * 10 / 115.2 + 0.2),
        ("heidenhain-nd", 9600, 20 * 11 / 9.6 + 20.0),
    ],
)
def test_the_shortest_period_is_the_sum_of_its_bytes(
    name: str, baud_rate: int, shortest_ms: float
) -> None:
    profile = load_profile(name)
    line = CounterLine(
        "x", baud_rate, profile.line.data_bits, profile.line.parity, profile.line.stop_bits
    )
    made = CounterSettings(line, profile, 65536, 0.1, 7.0)
    assert made.shortest_period_s == pytest.approx(shortest_ms * 1e-3)
    assert f"{round(shortest_ms, 2):g} ms" in sum_of(profile, line)
    with pytest.raises(SettingsError, match=r"cannot be asked every .*period_s >= 0\.0"):
        CounterSettings(line, profile, 65536, 0.99e-3 * shortest_ms, 7.0)


def rig(**changes: object) -> RigConfig:
    config = load_rig("rigs/serial-counter.toml")
    assert config.encoder is not None
    return config.model_copy(update={"encoder": config.encoder.model_copy(update=changes)})


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"baud_rate": 9600}, r"2 \+ 14 bytes at 9600 Bd 8N1 = 16.67 ms.*Set it to 57600 Bd"),
        ({"profile": "heidenhain-nd"}, "No speed that it has helps: use period_s >="),
        ({"profile": "none"}, "there is no counter profile 'none'"),
        ({"profile": "cui-amt21", "counts_per_revolution": 16384 * 20}, "half the range"),
        ({"device": ""}, "needs a serial device"),
    ],
)
def test_a_rig_whose_counter_cannot_hold_is_refused_before_anything_is_enabled(
    changes: dict[str, object], words: str
) -> None:
    axis_settings(rig(), 0.008)
    with pytest.raises(ConfigError, match=words):
        axis_settings(rig(**changes), 0.008)


def test_the_load_has_one_encoder_a_line_one_owner_and_virtual_time_no_serial_line() -> None:
    twice = rig()
    second = {"counts_per_revolution": 65536, "sensor": 1, "direction": 1}
    table = twice.model_dump()
    table["drive"]["second_encoder"] = second
    with pytest.raises(ConfigError, match="configured twice"):
        axis_settings(RigConfig.model_validate(table), 0.008)
    with pytest.raises(ConfigError, match="a line of its own"):
        axis_settings(twice.with_bus(device="/dev/ttyUSB0"), 0.008)
    with pytest.raises(ConfigError, match="Play it on its wire"):
        play_virtually(experiment(), twice)


def test_preflight_says_the_sum_and_when_the_load_is_sampled() -> None:
    (told,) = preflight._counter(rig().counter_settings(0.008))
    assert told.level is Level.OK
    assert "2 + 14 bytes at 115200 Bd 8N1" in told.text
    assert "0.17 ms after the ask" in told.text
