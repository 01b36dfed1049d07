"""Commands that the drive never heard, by what the motion lacks of them."""

import numpy as np
import pytest
from numpy.typing import NDArray

from servo_bench.diagnosis.comparing.comparison import compare
from servo_bench.diagnosis.comparing.evidence import SCALES
from servo_bench.diagnosis.reading.lost import _pulse, heard, lost_by_playing, lost_commands
from servo_bench.diagnosis.searching.coasting import Face, coasting
from servo_bench.recording.recording import Recording
from sim_rig.model import Model
from tests.fit_recordings import NOMINAL, PERIOD_S, RUN, recorded, with_channels

MODEL = Model(NOMINAL)
COASTS = coasting(MODEL, 760.0, Face(3e-5, 0.0))
SLOTS = 900
LOAD_ALONE = ("load_angle_rad",)
SLOW = {
    "current_limit": {"limit_per_a": 0.5},
    "command_slew": {"slowness_s2_per_rad": 1.5e-3},
    "transport_delay": {"delay_s": 7.5e-3},
    "command_deadband": {"deadband_rad_s": 3.0},
}


def with_lost_ones(
    model: Model, seed: int, channels: tuple[str, ...] = RUN
) -> tuple[Recording, Recording, NDArray[np.intp]]:
    """A run as it was told, as it was heard, and the rows between: what was sent there was never
    heard, and the one before was held."""
    heard_run = recorded(model, seed, slots=SLOTS, channels=channels)
    sent = np.array(heard_run["velocity_command_rad_s"])
    changes = np.flatnonzero(np.diff(sent) == 0.0)[100:300:47] + 1
    told = sent.copy()
    told[changes] += 6.0
    return with_channels(heard_run, velocity_command_rad_s=told), heard_run, changes


@pytest.mark.parametrize("seed", [11, 12])
def test_lost_commands_are_found_to_the_slot_and_put_right(seed: int) -> None:
    told, heard_run, changes = with_lost_ones(MODEL, seed)
    found = lost_commands(compare(told, MODEL, scales=SCALES), MODEL)
    assert set(changes.tolist()) <= set(found.rows)
    mended = heard(told, found.rows)["velocity_command_rad_s"]
    np.testing.assert_array_equal(mended[changes], heard_run["velocity_command_rad_s"][changes])


@pytest.mark.parametrize("effect", ["cogging", "gravity_imbalance", "coulomb", "pre_sliding"])
def test_what_acts_as_a_spring_at_rest_shapes_no_response(effect: str) -> None:
    """A chip's response is that of a motor that turns, and not of one in a magnet's valley."""
    plain = _pulse(MODEL, PERIOD_S)
    rough = MODEL.with_effect(effect, torque_nm=0.03)
    np.testing.assert_array_equal(_pulse(rough, PERIOD_S), plain)
    stiff = MODEL.with_effect("proportional_gain_error", error_fraction=0.3)
    assert np.abs(_pulse(stiff, PERIOD_S) - plain).max() > 0.05 * np.abs(plain).max()


def test_nothing_is_lost_where_nothing_was() -> None:
    run = recorded(MODEL, 13, slots=SLOTS)
    assert lost_commands(compare(run, MODEL, scales=SCALES), MODEL).rows == ()


@pytest.mark.parametrize("effect", ["current_limit", "command_slew", "transport_delay"])
def test_what_slows_every_reversal_has_lost_no_command(effect: str) -> None:
    slowed = recorded(MODEL.with_effect(effect, **SLOW[effect]), 17, slots=SLOTS)
    assert lost_commands(compare(slowed, MODEL, scales=SCALES), MODEL).rows == ()


@pytest.mark.parametrize("seed", [14, 15, 16])
def test_by_a_load_that_coasts_alone_they_are_found_to_the_slot(seed: int) -> None:
    """Of the rigid play's error a chip that was lost is no whole one there, and one in five may be
    too little of one (seed 14); none is told that was heard."""
    told, _, changes = with_lost_ones(COASTS, seed, LOAD_ALONE)
    found = lost_by_playing(told, MODEL)
    assert set(found.rows) <= set(changes.tolist())
    assert len(found.rows) >= changes.size - 1
    strictly = lost_commands(compare(told, MODEL, scales=SCALES), MODEL)
    assert len(strictly.rows) < len(found.rows)


@pytest.mark.parametrize("effect", [None, *SLOW])
def test_a_load_that_coasts_has_lost_no_command_by_that(effect: str | None) -> None:
    rig = COASTS if effect is None else COASTS.with_effect(effect, **SLOW[effect])
    assert lost_by_playing(recorded(rig, 18, slots=SLOTS, channels=LOAD_ALONE), MODEL).rows == ()
