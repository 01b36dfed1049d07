"""Rows in which no command can have changed: thinned, and nothing of what was commanded is lost."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from servo_bench.diagnosis.comparing.evidence import beginning, evidence_of
from servo_bench.diagnosis.comparing.rows import rows_of
from servo_bench.diagnosis.comparing.thinning import rows_to_a_command, thinned
from servo_bench.diagnosis.searching.finding import find_causes
from servo_bench.recording.recording import Recording
from sim_rig.model import Model
from tests.fit_recordings import NOMINAL, commands, recorded

MODEL = Model(NOMINAL)
FAST_S, HELD = 0.001, 8


def held(model: Model, seed: int, chips: int, *, first: int = 0) -> Recording:
    """A run at 1 kHz whose commands change every 8 ms, `first` rows after its own first."""
    played = np.repeat(commands(seed, chips), HELD)
    played = np.concatenate((np.zeros(first), played))
    fast = recorded(model, seed, played=played, period_s=FAST_S)
    phase = np.repeat(recorded(MODEL, seed, slots=chips)["phase"], HELD)
    phase = np.concatenate((np.full(first, phase[0]), phase))
    return replace(fast, channels={**fast.channels, "phase": phase})


def travelled(recording: Recording) -> float:
    """Of the commands, from the first row to the end of the last."""
    slots = np.append(recording["slot"], recording["slot"][-1] + 1)
    return float(recording["velocity_command_rad_s"] @ np.diff(slots)) * recording.period_s


def alone(recording: Recording) -> Recording:
    return thinned(recording, rows_to_a_command([recording]))


def without_slots(recording: Recording, time_s: NDArray[np.float64]) -> Recording:
    """As data from elsewhere come: with times, and with no slots."""
    kept = {n: v for n, v in recording.channels.items() if n not in ("slot", "asked_ns")}
    return replace(recording, channels={**kept, "t_s": time_s})


@pytest.mark.parametrize("first", [0, 3])
def test_a_row_is_kept_for_every_command(first: int) -> None:
    fast = held(MODEL, 41, 300, first=first)
    slow = alone(fast)
    assert slow.period_s == pytest.approx(HELD * FAST_S)
    np.testing.assert_array_equal(slow["velocity_command_rad_s"], commands(41, 300))
    kept = slice(first, None, HELD)
    np.testing.assert_array_equal(slow["load_angle_rad"], fast["load_angle_rad"][kept])
    np.testing.assert_array_equal(np.diff(slow["slot"]), 1)


def test_what_came_late_because_a_row_was_skipped_keeps_the_angle_that_was_asked() -> None:
    fast = held(MODEL, 42, 300)
    changes = np.flatnonzero(np.diff(fast["velocity_command_rad_s"])) + 1
    kept = np.ones(len(fast), np.bool_)
    kept[[changes[5], changes[9] - 1, changes[20] + 3]] = False
    gapped = replace(fast, channels={n: v[kept] for n, v in fast.channels.items()})
    slow = alone(gapped)
    assert slow.period_s == pytest.approx(HELD * FAST_S)
    assert travelled(slow) == pytest.approx(travelled(gapped), rel=1e-12)
    lacking = np.flatnonzero(np.diff(slow["slot"]) == 2)
    assert lacking.size == 1  # the row of the command that was skipped


@pytest.mark.parametrize(("period_s", "rows"), [(0.008, 1), (0.001, 1), (0.004, 3), (0.002, 7)])
def test_rows_stay_where_commands_change_at_any_of_them(period_s: float, rows: int) -> None:
    """Or where they are slow already; seven rows of 2 ms are held for too long to be one."""
    played = np.repeat(commands(43, 200), rows)
    fast = recorded(MODEL, 43, played=played, period_s=period_s)
    assert rows_to_a_command([fast]) == 1
    assert alone(fast) is fast


@pytest.mark.parametrize(
    ("late_s", "slow", "jitter_s"), [(0.5e-3, 0.0, 0.0), (0.0, 1e-3, 0.0), (0.0, 1e-4, 1e-4)]
)
def test_times_number_the_rows_whenever_they_began_and_whatever_their_clock_loses(
    late_s: float, slow: float, jitter_s: float
) -> None:
    fast = held(MODEL, 48, 300)
    time_s = late_s + FAST_S * (1.0 + slow) * np.arange(len(fast))
    time_s += jitter_s * np.random.default_rng(48).uniform(-1.0, 1.0, len(fast))
    assert rows_to_a_command([without_slots(fast, time_s)]) == HELD


def test_recordings_of_one_diagnosis_are_thinned_alike_and_what_is_held_out_has_no_say() -> None:
    often = recorded(MODEL, 45, played=np.repeat(commands(45, 300), 4), period_s=FAST_S)
    seldom = held(MODEL, 46, 200)
    resting = recorded(MODEL, 47, played=np.zeros(800), period_s=FAST_S)
    assert rows_to_a_command([seldom, often]) == 4
    assert rows_to_a_command([often, resting]) == 4
    assert len(thinned(resting, 4)) == 200
    assert rows_to_a_command([seldom]) == HELD
    assert thinned(often, HELD) is often  # as a hold-out: judged with its own rows


def test_rows_stay_that_a_measured_input_or_a_hole_needs() -> None:
    fast = held(MODEL, 49, 300)
    open_ = {n: v for n, v in fast.channels.items() if "angle" not in n and "position" not in n}
    assert rows_to_a_command([replace(fast, channels=open_)]) == 1
    time_s = FAST_S * np.arange(len(fast)) + np.where(np.arange(len(fast)) > 900, 0.05, 0.0)
    assert rows_to_a_command([without_slots(fast, time_s)]) == 1
    empty = replace(fast, channels={n: v[:1] for n, v in fast.channels.items()})
    assert rows_to_a_command([fast, empty]) == 1


@pytest.mark.long
def test_wrong_samples_are_counted_in_all_the_rows_that_came() -> None:
    fast = held(MODEL, 50, 900)
    wrong = np.array(fast["load_angle_rad"])
    wrong[1003::130] += 0.3
    shown = replace(fast, channels={**fast.channels, "load_angle_rad": wrong})
    found = find_causes([shown], MODEL, only=("transport_delay",))
    assert found.wild > 0.9 * wrong[1003::130].size


@pytest.mark.long
def test_at_1_khz_the_same_cause_is_named_as_at_the_pace_of_the_commands() -> None:
    delayed = MODEL.with_effect("transport_delay", delay_s=2.3e-3)
    rested = held(delayed, 44, 900, first=2000)  # two seconds at rest before anything moves
    found = find_causes([rested], MODEL, only=("transport_delay", "command_slew"))
    assert [n.effect for n in found.named] == ["transport_delay"]
    assert found.final.model.effects["transport_delay"].delay_s == pytest.approx(2.3e-3, rel=0.02)
    assert found.misfit_after.max() < 1.0


def test_a_long_rest_before_anything_moves_leaves_as_much_motion_to_a_quick_look() -> None:
    resting = np.concatenate((np.zeros(900), commands(51, 500)))
    moves = int(np.argmax(resting != 0.0))
    late = recorded(MODEL, 51, played=resting)
    assert len(beginning(late, 400)) == moves + 300
    soon = recorded(MODEL, 51, slots=500)
    assert len(beginning(soon, 400)) == 400


@pytest.mark.parametrize("phases", [True, False])
def test_a_rest_before_anything_moves_is_compared_with_nothing(*, phases: bool) -> None:
    """Where in its gap the load was left no command tells: a guess would cost more than a cause."""
    resting = np.concatenate((np.zeros(300), commands(52, 500)))
    late = beginning(recorded(MODEL, 52, played=resting), 900)
    kept = late.channels if phases else {n: v for n, v in late.channels.items() if n != "phase"}
    moves = int(np.argmax(resting != 0.0))
    rows = rows_of(replace(late, channels=kept))
    assert not (rows.seen | rows.held_out)[:moves].any()
    assert (rows.seen | rows.held_out)[moves:].all()
    still = {**kept, "velocity_command_rad_s": np.zeros(len(late))}
    assert rows_of(replace(late, channels=still)).seen[0]


def test_what_may_be_missed_is_known_where_a_first_piece_is_too_short_for_a_point() -> None:
    """At 5 kHz the mechanics' points are 40 rows apart, and a piece may have 20."""
    fast = recorded(MODEL, 61, played=np.repeat(commands(61, 300), 40), period_s=2e-4)
    phase = np.repeat(recorded(MODEL, 61, slots=300)["phase"], 40)
    torn = np.array(fast["motor_torque_nm"])
    torn[20] = np.nan
    channels = {**fast.channels, "phase": phase}
    whole, cut = (
        evidence_of([replace(fast, channels={**channels, **more})], MODEL, block="mechanics")
        for more in ({}, {"motor_torque_nm": torn})
    )
    assert cut.fitted[0].pieces[0].start.size == 0
    np.testing.assert_allclose(cut.allowed, whole.allowed, rtol=0.2)
