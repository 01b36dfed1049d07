"""The states of the daemon, in one table; the drawing in docs/daemon.md is made from it.

A stop is possible in every state: where nothing plays it changes no state and holds the queue.
"""

from collections.abc import Mapping
from enum import StrEnum
from types import MappingProxyType


class State(StrEnum):
    """What the daemon does with its rig."""

    IDLE = "idle"
    PREPARING = "preparing"
    RUNNING = "running"
    STOPPING = "stopping"
    ANALYSING = "analysing"
    FAULTED = "faulted"


class Event(StrEnum):
    """What can happen to it."""

    STARTED = "a run is started, or found after a restart"
    MOVED = "the drive is enabled and the first slot was played"
    STOP_ASKED = "a stop is asked, or the last slot was played"
    ENDED = "the rig stands, and there is a recording"
    NOTHING = "the rig stands, and nothing was recorded"
    FAILED = "the run ended with an error"
    ANALYSED = "the analysis is over, well or not"
    ARMED = "an operator arms the queue again"


TABLE: Mapping[tuple[State, Event], State] = MappingProxyType(
    {
        (State.IDLE, Event.STARTED): State.PREPARING,
        (State.PREPARING, Event.MOVED): State.RUNNING,
        (State.PREPARING, Event.STOP_ASKED): State.STOPPING,
        (State.PREPARING, Event.ENDED): State.ANALYSING,
        (State.PREPARING, Event.NOTHING): State.IDLE,
        (State.PREPARING, Event.FAILED): State.FAULTED,
        (State.RUNNING, Event.STOP_ASKED): State.STOPPING,
        (State.RUNNING, Event.ENDED): State.ANALYSING,
        (State.RUNNING, Event.FAILED): State.FAULTED,
        (State.STOPPING, Event.ENDED): State.ANALYSING,
        (State.STOPPING, Event.NOTHING): State.IDLE,
        (State.STOPPING, Event.FAILED): State.FAULTED,
        (State.ANALYSING, Event.ANALYSED): State.IDLE,
        (State.FAULTED, Event.ARMED): State.IDLE,
    }
)

PLAYING = frozenset({State.PREPARING, State.RUNNING, State.STOPPING})
"""Where the rig may be powered."""


def after(state: State, event: Event) -> State:
    """The state that follows; the same one where `event` means nothing in `state`."""
    return TABLE.get((state, event), state)


def drawing() -> str:
    """The table as a Mermaid state diagram, one arrow a row."""
    arrows = [
        f"    {source.value} --> {target.value}: {event.value}"
        for (source, event), target in TABLE.items()
    ]
    return "\n".join(["stateDiagram-v2", f"    [*] --> {State.IDLE.value}", *arrows])
