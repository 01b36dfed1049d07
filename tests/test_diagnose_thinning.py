"""Rows in which no command can have changed: thinned, and nothing of what was commanded is lost."""

from dataclasses import replace

import numpy as np
import pytest

from servo_bench.diagnosis.finding import find_causes
from servo_bench.diagnosis.thinning import thinned
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
    phase = np.concatenate((phase[:first], phase))
    return replace(fast, channels={**fast.channels, "phase": phase})


def travelled(recording: Recording) -> float:
    """Of the commands, from the first row to the end of the last."""
    slots = np.append(recording["slot"], recording["slot"][-1] + 1)
    return float(recording["velocity_command_rad_s"] @ np.diff(slots)) * recording.period_s


@pytest.mark.parametrize("first", [0, 3])
def test_a_row_is_kept_for_every_command(first: int) -> None:
    fast = held(MODEL, 41, 300, first=first)
    (slow,) = thinned([fast])
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
    (slow,) = thinned([gapped])
    assert slow.period_s == pytest.approx(HELD * FAST_S)
    assert travelled(slow) == pytest.approx(travelled(gapped), rel=1e-12)
    lacking = np.flatnonzero(np.diff(slow["slot"]) == 2)
    assert lacking.size == 1  # the row of the command that was skipped


@pytest.mark.parametrize(("period_s", "rows"), [(0.008, 1), (0.001, 1), (0.004, 3), (0.002, 7)])
def test_rows_stay_where_commands_change_at_any_of_them(period_s: float, rows: int) -> None:
    """Or where they are slow already; seven rows of 2 ms are held for too long to be one."""
    played = np.repeat(commands(43, 200), rows)
    fast = recorded(MODEL, 43, played=played, period_s=period_s)
    assert thinned([fast])[0] is fast


def test_recordings_of_one_diagnosis_are_thinned_alike() -> None:
    often = recorded(MODEL, 45, played=np.repeat(commands(45, 300), 4), period_s=FAST_S)
    both = thinned([held(MODEL, 46, 200), often])
    assert [one.period_s for one in both] == pytest.approx([4 * FAST_S, 4 * FAST_S])
    resting = recorded(MODEL, 47, played=np.zeros(800), period_s=FAST_S)
    assert [len(one) for one in thinned([often, resting])] == [len(often) // 4, 200]


def test_at_1_khz_the_same_cause_is_named_as_at_the_pace_of_the_commands() -> None:
    delayed = MODEL.with_effect("transport_delay", delay_s=2.3e-3)
    found = find_causes([held(delayed, 44, 900)], MODEL, only=("transport_delay", "command_slew"))
    assert [n.effect for n in found.named] == ["transport_delay"]
    assert found.final.model.effects["transport_delay"].delay_s == pytest.approx(2.3e-3, rel=0.02)
    assert found.misfit_after.max() < 1.0
