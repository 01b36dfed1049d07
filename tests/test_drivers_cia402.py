"""The CiA 402 tables against a second hand: a state machine written from the standard's graph."""

import pytest

from drivers.canopen import cia402
from drivers.canopen.cia402 import State

# IEC 61800-7-201, the statusword bits 6 5 . . 3 2 1 0 of each state, x = don't care.
PATTERNS = {
    State.NOT_READY: "0xxx0000",
    State.SWITCH_ON_DISABLED: "1xxx0000",
    State.READY: "01xx0001",
    State.SWITCHED_ON: "01xx0011",
    State.OPERATION_ENABLED: "01xx0111",
    State.QUICK_STOP_ACTIVE: "00xx0111",
    State.FAULT_REACTION: "0xxx1111",
    State.FAULT: "0xxx1000",
}


def matches(statusword: int, pattern: str) -> bool:
    bits = f"{statusword & 0x7F:07b}"
    bits = bits[:2] + "x" + bits[2] + bits[3:]  # bit 4 is voltage: nobody's pattern
    wanted = pattern[:2] + "xx" + pattern[4:]
    return all(w in ("x", b) for w, b in zip(wanted, bits, strict=True))


@pytest.mark.parametrize("high", [0x00, 0x02, 0x16, 0xFF])
def test_every_statusword_has_the_state_of_the_standard(high: int) -> None:
    for low in range(256):
        statusword = high << 8 | low
        expected = [state for state, pattern in PATTERNS.items() if matches(statusword, pattern)]
        assert [cia402.decode_state(statusword)] == (expected or [State.UNDEFINED])


HELD = {State.NOT_READY, State.FAULT_REACTION, State.FAULT}
ON = {State.READY: State.SWITCHED_ON, State.OPERATION_ENABLED: State.SWITCHED_ON}
ENABLE = dict.fromkeys((State.SWITCHED_ON, State.QUICK_STOP_ACTIVE), State.OPERATION_ENABLED)
QUICK = dict.fromkeys((State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE), State.QUICK_STOP_ACTIVE)


def after(state: State, controlword: int) -> State:
    """The standard's transitions 2..16, for a drive whose voltage is on."""
    if state in HELD:
        follower = state
    elif controlword & 0x02 == 0:
        follower = State.SWITCH_ON_DISABLED
    elif controlword & 0x06 == 0x02:
        follower = QUICK.get(state, State.SWITCH_ON_DISABLED)
    elif controlword & 0x07 == 0x06:
        follower = state if state == State.QUICK_STOP_ACTIVE else State.READY
    elif controlword & 0x0F == 0x07:
        follower = ON.get(state, state)
    else:
        follower = ENABLE.get(state, state)
    return follower


@pytest.mark.parametrize(
    "start",
    [
        State.SWITCH_ON_DISABLED,
        State.READY,
        State.SWITCHED_ON,
        State.OPERATION_ENABLED,
        State.QUICK_STOP_ACTIVE,
    ],
)
def test_the_controlwords_lead_to_enabled_from_every_state(start: State) -> None:
    state = start
    for _ in range(5):
        state = after(state, cia402.controlword_towards_enabled(state))
    assert state == State.OPERATION_ENABLED
    assert after(state, cia402.controlword_towards_enabled(state)) == State.OPERATION_ENABLED


@pytest.mark.parametrize("start", list(State))
def test_the_controlwords_towards_disabled_never_power_anything(start: State) -> None:
    state, stages = start, [start]
    for _ in range(6):
        state = after(state, cia402.controlword_towards_disabled(state))
        stages.append(state)
    assert State.OPERATION_ENABLED not in stages[1:]
    if start == State.OPERATION_ENABLED:
        assert stages[1] == State.QUICK_STOP_ACTIVE, "stop first, then power off"


def test_a_statusword_in_words_names_what_holds_the_drive_back() -> None:
    assert cia402.describe_statusword(0x0240) == (
        "switch on disabled (statusword 0x0240, voltage not enabled)"
    )
    assert "local control" in cia402.describe_statusword(0x0050)
    assert cia402.describe_statusword(0x1237) == "operation enabled (statusword 0x1237)"


@pytest.mark.parametrize(
    ("code", "words"),
    [
        (0x3220, "DC link under-voltage"),
        (0x8130, "heartbeat"),
        (0x7399, "sensor"),
        (0x9001, "external"),
        (0x5199, "device hardware"),
        (0xFF42, "manufacturer"),
        (0xA000, "no class"),
        (0x0000, "no error"),
    ],
)
def test_error_codes_come_in_words(code: int, words: str) -> None:
    text = cia402.describe_error_code(code)
    assert words in text
    assert f"0x{code:04X}" in text
    assert cia402.remedy(code)
