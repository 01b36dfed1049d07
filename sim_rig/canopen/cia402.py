"""The power state machine of CiA 402 as a table: state and controlword in, state out."""

from enum import Enum, IntEnum, auto


class State(IntEnum):
    """The states; each one's value is its pattern in the statusword."""

    SWITCH_ON_DISABLED = 0x40
    READY_TO_SWITCH_ON = 0x21
    SWITCHED_ON = 0x23
    OPERATION_ENABLED = 0x27
    QUICK_STOP_ACTIVE = 0x07
    FAULT_REACTION_ACTIVE = 0x0F
    FAULT = 0x08


class Status:
    """Bits of the statusword beside the state."""

    VOLTAGE_ENABLED = 1 << 4
    REMOTE = 1 << 9
    TARGET_REACHED = 1 << 10
    INTERNAL_LIMIT = 1 << 11
    FOLLOWS_COMMAND = 1 << 12
    STANDSTILL = 1 << 12
    """Bit 12 means the first in cyclic synchronous velocity, the second in profile velocity."""


class Control:
    """Bits of the controlword."""

    SWITCH_ON = 1 << 0
    ENABLE_VOLTAGE = 1 << 1
    NO_QUICK_STOP = 1 << 2
    ENABLE_OPERATION = 1 << 3
    FAULT_RESET = 1 << 7
    HALT = 1 << 8


class Command(Enum):
    """What the lowest four bits of a controlword order."""

    DISABLE_VOLTAGE = auto()
    QUICK_STOP = auto()
    SHUTDOWN = auto()
    SWITCH_ON = auto()
    ENABLE_OPERATION = auto()


POWERED = frozenset({State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE, State.FAULT_REACTION_ACTIVE})
"""The states in which the motor is driven."""

_OFF, _READY, _ON = State.SWITCH_ON_DISABLED, State.READY_TO_SWITCH_ON, State.SWITCHED_ON
_ENABLED, _STOPPING = State.OPERATION_ENABLED, State.QUICK_STOP_ACTIVE

TRANSITIONS: dict[tuple[State, Command], State] = {
    (_OFF, Command.SHUTDOWN): _READY,  # 2
    (_READY, Command.SWITCH_ON): _ON,  # 3
    (_READY, Command.ENABLE_OPERATION): _ENABLED,  # 3 and 4 at once
    (_ON, Command.ENABLE_OPERATION): _ENABLED,  # 4
    (_ENABLED, Command.SWITCH_ON): _ON,  # 5, "disable operation"
    (_ON, Command.SHUTDOWN): _READY,  # 6
    (_READY, Command.DISABLE_VOLTAGE): _OFF,  # 7
    (_READY, Command.QUICK_STOP): _OFF,  # 7
    (_ENABLED, Command.SHUTDOWN): _READY,  # 8
    (_ENABLED, Command.DISABLE_VOLTAGE): _OFF,  # 9
    (_ON, Command.DISABLE_VOLTAGE): _OFF,  # 10
    (_ON, Command.QUICK_STOP): _OFF,  # 10
    (_ENABLED, Command.QUICK_STOP): _STOPPING,  # 11
    (_STOPPING, Command.DISABLE_VOLTAGE): _OFF,  # 12
    (_STOPPING, Command.ENABLE_OPERATION): _ENABLED,  # 16, where the quick stop holds the axis
}
"""By CiA 402's numbers. 15, out of a fault, takes a rising edge; 13 and 14 the drive takes itself.
What is not here changes nothing."""


def command(controlword: int) -> Command:
    """The order in a controlword."""
    if not controlword & Control.ENABLE_VOLTAGE:
        return Command.DISABLE_VOLTAGE
    if not controlword & Control.NO_QUICK_STOP:
        return Command.QUICK_STOP
    if not controlword & Control.SWITCH_ON:
        return Command.SHUTDOWN
    enable = controlword & Control.ENABLE_OPERATION
    return Command.ENABLE_OPERATION if enable else Command.SWITCH_ON


def next_state(state: State, controlword: int, before: int, *, quick_stop_holds: bool) -> State:
    """The state after `controlword` has followed the controlword `before`.

    `quick_stop_holds`: option code 5 or 6, the axis stays in quick stop active.
    """
    if state is State.FAULT:
        risen = controlword & ~before & Control.FAULT_RESET
        return _OFF if risen else state
    order = command(controlword)
    if state is _STOPPING and order is Command.ENABLE_OPERATION and not quick_stop_holds:
        return state
    return TRANSITIONS.get((state, order), state)


def approach(value: float, target: float, most: float) -> float:
    """`value` moved towards `target` by at most `most`."""
    return min(max(target, value - most), value + most)
