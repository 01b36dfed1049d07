"""The CiA 402 power state machine and the words for its faults. Pure tables, no wire.

The statusword (0x6041) says the state in bits 0-3, 5, 6; the controlword (0x6040) asks for a
transition in bits 0-3 and 7. Source: IEC 61800-7-201 (CiA 402-2), CiA 301 for the emergencies.
"""

from enum import StrEnum


class State(StrEnum):
    """The states of the power state machine, in the standard's words."""

    NOT_READY = "not ready to switch on"
    SWITCH_ON_DISABLED = "switch on disabled"
    READY = "ready to switch on"
    SWITCHED_ON = "switched on"
    OPERATION_ENABLED = "operation enabled"
    QUICK_STOP_ACTIVE = "quick stop active"
    FAULT_REACTION = "fault reaction active"
    FAULT = "fault"
    UNDEFINED = "no state that CiA 402 knows"


_STATES = (
    # mask, value
    (0x4F, 0x00, State.NOT_READY),
    (0x4F, 0x40, State.SWITCH_ON_DISABLED),
    (0x6F, 0x21, State.READY),
    (0x6F, 0x23, State.SWITCHED_ON),
    (0x6F, 0x27, State.OPERATION_ENABLED),
    (0x6F, 0x07, State.QUICK_STOP_ACTIVE),
    (0x4F, 0x0F, State.FAULT_REACTION),
    (0x4F, 0x08, State.FAULT),
)

VOLTAGE_ENABLED = 1 << 4
REMOTE = 1 << 9
FOLLOWS_COMMAND = 1 << 12
"""Statusword bit 12 in mode CSV: the drive follows the command value. In mode PV: speed is 0."""

SHUTDOWN = 0x06
SWITCH_ON = 0x07
ENABLE_OPERATION = 0x0F
DISABLE_VOLTAGE = 0x00
QUICK_STOP = 0x02
FAULT_RESET = 0x80
"""Acts on its rising edge only: send DISABLE_VOLTAGE before it."""

MODES = {"pv": 3, "csv": 9}
"""0x6060: profile velocity (ramps of its own), cyclic synchronous velocity (none)."""

_TOWARDS_ENABLED = {
    State.SWITCH_ON_DISABLED: SHUTDOWN,
    State.READY: SWITCH_ON,
    State.SWITCHED_ON: ENABLE_OPERATION,
    State.OPERATION_ENABLED: ENABLE_OPERATION,
}

_TOWARDS_DISABLED = {
    State.OPERATION_ENABLED: QUICK_STOP,
    State.QUICK_STOP_ACTIVE: QUICK_STOP,
    State.SWITCHED_ON: SHUTDOWN,
}

POWERED = frozenset({State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE, State.FAULT_REACTION})
"""The states in which the motor may have torque."""


def decode_state(statusword: int) -> State:
    """The state that a statusword reports; UNDEFINED for a pattern that none has."""
    for mask, value, state in _STATES:
        if statusword & mask == value:
            return state
    return State.UNDEFINED


def controlword_towards_enabled(state: State) -> int:
    """The next controlword on the way to OPERATION ENABLED.

    From QUICK STOP ACTIVE the way leads back over SWITCH ON DISABLED, which every drive allows.
    A fault is not left this way: that takes a rising edge of FAULT_RESET.
    """
    return _TOWARDS_ENABLED.get(state, DISABLE_VOLTAGE)


def controlword_towards_disabled(state: State) -> int:
    """The next controlword on the way to SWITCH ON DISABLED: stop first, then power off."""
    return _TOWARDS_DISABLED.get(state, DISABLE_VOLTAGE)


def describe_statusword(statusword: int) -> str:
    """State, number, and what holds the drive back, in words."""
    notes = [f"statusword 0x{statusword:04X}"]
    if not statusword & VOLTAGE_ENABLED:
        notes.append("voltage not enabled")
    if not statusword & REMOTE:
        notes.append("local control")
    return f"{decode_state(statusword)} ({', '.join(notes)})"


_CODES = {
    0x2310: "continuous over current",
    0x2311: "over current",
    0x2320: "short circuit or earth leakage",
    0x2340: "short circuit, motor side",
    0x3110: "mains over-voltage",
    0x3120: "mains under-voltage",
    0x3210: "DC link over-voltage",
    0x3220: "DC link under-voltage",
    0x4210: "device too hot",
    0x4310: "drive too hot",
    0x5113: "5 V supply",
    0x5530: "parameter memory",
    0x6320: "parameter error",
    0x7121: "motor blocked",
    0x7122: "motor or commutation",
    0x7300: "position sensor",
    0x7305: "incremental encoder 1",
    0x7306: "incremental encoder 2",
    0x7310: "speed too high",
    0x7380: "position sensor",
    0x7500: "communication",
    0x8110: "CAN overrun, messages lost",
    0x8120: "CAN error passive",
    0x8130: "heartbeat of the master lost",
    0x8140: "recovered from bus off",
    0x8150: "COB-ID collision",
    0x8210: "PDO not processed, wrong length",
    0x8220: "PDO too long",
    0x8240: "unexpected SYNC length",
    0x8250: "RPDO timed out",
    0x8311: "excess torque",
    0x8400: "velocity controller",
    0x8500: "position controller",
    0x8611: "following error",
    0x8612: "reference limit",
    0x8700: "synchronisation lost",
}

_CLASSES = {
    0x10: "generic error",
    0x20: "current",
    0x21: "current at the input",
    0x22: "current inside the device",
    0x23: "current at the output",
    0x30: "voltage",
    0x31: "mains voltage",
    0x32: "voltage inside the device",
    0x33: "output voltage",
    0x40: "temperature",
    0x41: "ambient temperature",
    0x42: "device temperature",
    0x43: "drive temperature",
    0x50: "device hardware",
    0x60: "device software",
    0x61: "internal software",
    0x62: "user software",
    0x63: "data set",
    0x70: "additional modules",
    0x71: "power",
    0x72: "measurement circuit",
    0x73: "sensor",
    0x80: "monitoring",
    0x81: "communication",
    0x82: "protocol",
    0x83: "torque control",
    0x84: "velocity control",
    0x85: "position control",
    0x86: "positioning",
    0x87: "synchronisation",
    0x90: "external error",
    0xF0: "additional functions",
    0xFF: "the manufacturer's own",
}

_REMEDIES = {
    0x3220: "switch on the DC link",
    0x3120: "switch on the mains",
    0x3210: "check the brake resistor, or decelerate slower",
    0x8130: "see why the master stopped sending (its log, the cable)",
    0x7121: "free the shaft",
    0x8611: "lower the amplitude, or raise the drive's following error window",
}


def describe_error_code(code: int) -> str:
    """An error code of 0x603F or of an emergency, in words.

    What is not in the table is told by its class (CiA 301, table of emergency error codes).
    """
    if code >> 8 == 0:
        return f"0x{code:04X} (no error)"
    words = _CODES.get(code)
    if words is None:
        words = _CLASSES.get(code >> 8) or _CLASSES.get((code >> 8) & 0xF0) or "no class of CiA 301"
    return f"0x{code:04X} ({words})"


def remedy(code: int) -> str:
    """What to do about an error code."""
    return _REMEDIES.get(code, "look the code up in the drive's manual and remove its cause")
