"""What judges must have been recorded apart from what was fitted, and under other commands."""

from dataclasses import replace

import numpy as np
import pytest

from servo_bench.diagnosis.concluding import conclude
from servo_bench.diagnosis.judging.excitations import check_apart, same_commands
from servo_bench.errors import ConfigError
from servo_bench.recording.recording import Recording
from sim_rig.model import Model
from tests.fit_recordings import NOMINAL

REST, ROWS = 20, 400


def _run(commands: int, noise: int, rest: int = REST) -> Recording:
    """Rest, then a random command; the angle is that command's integral and a sensor's noise."""
    moving = np.random.default_rng(commands).choice([-3.0, -1.0, 1.0, 3.0], ROWS)
    command = np.concatenate([np.zeros(rest), moving, np.zeros(REST)])
    angle = 0.008 * np.cumsum(command)
    angle += 1e-5 * np.random.default_rng((noise, 1)).standard_normal(angle.size)
    channels = {"velocity_command_rad_s": command, "load_angle_rad": angle}
    return Recording(channels, 0.008, None, None, {})


def test_the_same_rows_never_judge_what_was_fitted_to_them() -> None:
    with pytest.raises(ConfigError, match="held-out recording and recording 2 are the same rows"):
        check_apart([_run(1, 1), _run(2, 2)], _run(2, 2))
    with pytest.raises(ConfigError, match="recordings 1 and 3 are the same rows"):
        check_apart([_run(1, 1), _run(2, 2), _run(1, 1)], None)
    check_apart([_run(1, 1), _run(1, 2)], _run(1, 3))


@pytest.mark.parametrize("rest", [REST, 3 * REST])
def test_the_same_commands_once_more_leave_another_excitation_open(rest: int) -> None:
    (said,) = same_commands([_run(1, 1), _run(2, 2)], _run(2, 3, rest))
    assert "Record another sequence" in said


def test_other_commands_leave_nothing_open() -> None:
    assert list(same_commands([_run(1, 1), _run(2, 2)], _run(3, 3))) == []
    assert list(same_commands([_run(1, 1)], None)) == []
    louder = _run(1, 3)
    command = 1.1 * louder["velocity_command_rad_s"]
    louder = replace(louder, channels={**louder.channels, "velocity_command_rad_s": command})
    assert list(same_commands([_run(1, 1)], louder)) == []


def test_a_recording_without_commands_has_none_to_compare() -> None:
    measured = Recording({"load_angle_rad": np.arange(9.0)}, 0.008, None, None, {})
    assert list(same_commands([measured], measured)) == []


def test_a_diagnosis_is_refused_before_it_begins() -> None:
    run = _run(1, 1)
    with pytest.raises(ConfigError, match="a gain there is one that a fit has seen"):
        conclude([run], held_out=run, model=Model(NOMINAL))
