"""Commands that a drive takes over at its next tick, sent by a clock that jitters beside it."""

from dataclasses import replace

import numpy as np
import pytest

from servo_bench.diagnosis.comparing.comparison import compare
from servo_bench.diagnosis.comparing.lateness import TICK_S, lateness_rms, lateness_s
from servo_bench.diagnosis.comparing.rows import Array
from servo_bench.recording.recording import Recording
from sim_rig.model import Model
from tests.fit_recordings import NOMINAL, commands, recorded

MODEL = Model(NOMINAL)
SCALES = (1, 6, 36)


def test_even_slots_are_never_late() -> None:
    even = compare(recorded(MODEL, 5), MODEL, "loop", scales=SCALES)
    assert lateness_s(even) == 0.0
    assert not lateness_rms(even).any()


@pytest.mark.parametrize(("jitter_s", "least_s", "most_s"), [(20e-6, 10e-6, 30e-6), (1e-3, 0, 1)])
def test_lateness_is_the_slots_jitter_within_a_tick(
    jitter_s: float, least_s: float, most_s: float
) -> None:
    uneven = compare(recorded(MODEL, 6, jitter_s=jitter_s), MODEL, "loop", scales=SCALES)
    assert least_s < lateness_s(uneven) < most_s
    assert lateness_s(uneven) <= TICK_S / np.sqrt(12.0)


def test_what_late_commands_do_is_foretold() -> None:
    """Every command up to a tick late in the simulation itself, on the recording's own slots."""
    seed, slots, jitter_s = 7, 3000, 1e-3
    recording = recorded(MODEL, seed, slots=slots, jitter_s=jitter_s, noise_counts=0.0)
    seen = compare(recording, MODEL, "loop", scales=SCALES)
    played = commands(seed, slots)
    lasted_s = np.append(np.diff(recording["asked_ns"]) * 1e-9, recording.period_s)
    late_s = np.random.default_rng(8).uniform(0.0, TICK_S, played.size)
    late = recorded_late(played, lasted_s, late_s)
    missed = np.nanstd(seen.measured - compare_angles(recording, late), axis=1)
    foretold = lateness_rms(seen)
    moved = [k for k, s in enumerate(seen.signals) if s.name.startswith("motor velocity")]
    for k in moved:
        assert 0.4 < foretold[k] / missed[k] < 2.5, seen.signals[k].name
    assert len(moved) == len(SCALES)


def recorded_late(played: Array, lasted_s: Array, late_s: Array) -> Array:
    """Motor angles at the asks when every command is held back by its lateness."""
    parts_s = np.column_stack([late_s, lasted_s - late_s]).ravel()
    held = np.column_stack([np.concatenate([[0.0], played[:-1]]), played]).ravel()
    return MODEL.simulate(held, parts_s).motor_angle_rad[::2]


def compare_angles(recording: Recording, angles: Array) -> Array:
    """The same signals of a recording that shows these angles."""
    channels = {**recording.channels, "motor_position_rad": angles, "load_angle_rad": angles}
    return compare(replace(recording, channels=channels), MODEL, "loop", scales=SCALES).measured
