"""The state machine's laws, and that its documentation is made from it."""

from pathlib import Path

import pytest

from servo_bench.daemon.machine import PLAYING, TABLE, Event, State, after, drawing

DOCUMENT = Path(__file__).parent.parent / "docs" / "daemon.md"


def reachable(start: State, without: frozenset[Event] = frozenset()) -> set[State]:
    """Every state that events can lead to."""
    found = {start}
    while True:
        more = {TABLE[key] for key in TABLE if key[0] in found and key[1] not in without} - found
        if not more:
            return found
        found |= more


def test_every_state_can_be_reached_and_left_for_idle() -> None:
    assert reachable(State.IDLE) == set(State)
    for state in State:
        assert State.IDLE in reachable(state)


def test_every_event_means_something_somewhere() -> None:
    assert {event for _, event in TABLE} == set(Event)


@pytest.mark.parametrize("state", sorted(PLAYING))
def test_where_the_rig_may_be_powered_an_error_is_a_fault_and_no_start_is_heard(
    state: State,
) -> None:
    assert after(state, Event.FAILED) is State.FAULTED
    assert after(state, Event.STARTED) is state
    assert after(state, Event.STOP_ASKED) is State.STOPPING
    assert after(state, Event.ARMED) is state


def test_only_an_operator_leads_out_of_a_fault() -> None:
    assert {event for state, event in TABLE if state is State.FAULTED} == {Event.ARMED}
    assert reachable(State.FAULTED, frozenset({Event.ARMED})) == {State.FAULTED}


def test_a_stopped_rig_moves_only_through_preparing() -> None:
    into = {source for (source, _), target in TABLE.items() if target is State.RUNNING}
    assert into == {State.PREPARING}
    assert {source for (source, _), target in TABLE.items() if target is State.PREPARING} == {
        State.IDLE
    }


def test_the_drawing_in_the_documentation_is_the_table() -> None:
    assert f"```mermaid\n{drawing()}\n```" in DOCUMENT.read_text()
