"""The recorded command as an experiment that a rig can play.

Where the recording brings its experiment, and that says the very commands that were recorded, it
is played again. Otherwise (a file from elsewhere, or edited) the commands themselves are: held over
each period, after one at rest and followed by one, so that the rig begins and ends still.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from servo_bench.errors import RecordingError
from servo_bench.excitation.experiment import Experiment
from servo_bench.excitation.sequences import MAX_CHIPS, FromRecording
from servo_bench.kernels.response import slot_numbers
from servo_bench.recording.recording import Recording

Array = NDArray[np.float64]


class Order(NamedTuple):
    """What is played, whether that is the recording's own experiment, and which of its slots has
    the recording's first command."""

    experiment: Experiment
    again: bool
    first_slot: int


def order_of(recording: Recording, rig_name: str) -> Order:
    """What to play. RecordingError where there is no command, or one that is not finite."""
    if recording.experiment is not None and _says_what_was_played(recording, recording.experiment):
        again = recording.experiment.model_copy(update={"rig": rig_name})
        return Order(again, again=True, first_slot=int(recording["slot"][0]))
    commands = held_commands(recording)
    experiment = Experiment(
        name="replay",
        rig=rig_name,
        period_s=recording.period_s,
        memory=1,
        standstill_s=0.0,
        lead_in=1,
        identification=FromRecording(commands_rad_s=(*commands.tolist(), 0.0)),
        validation=FromRecording(commands_rad_s=(0.0,)),
    )
    return Order(experiment, again=False, first_slot=experiment.lead_in)


def held_commands(recording: Recording) -> Array:
    """The command of every period from the first to the last, shape (slots,)."""
    if "velocity_command_rad_s" not in recording or len(recording) == 0:
        raise RecordingError(
            "the recording holds no velocity command, so nothing can be played from it. It has "
            f"{', '.join(sorted(recording.channels)) or 'no channels'}."
        )
    slots = slot_numbers(recording) - slot_numbers(recording)[0]
    if (np.diff(slots) < 0).any():
        raise RecordingError("the recording's times do not rise: it holds several runs. Split it.")
    if slots[-1] >= MAX_CHIPS:
        raise RecordingError(f"the recording spans {slots[-1]} periods: at most {MAX_CHIPS}.")
    commands = recording["velocity_command_rad_s"].astype(np.float64)
    if not np.isfinite(commands).all():
        raise RecordingError("the recorded command has values that are not finite. Mend the file.")
    newest = np.searchsorted(slots, np.arange(int(slots[-1]) + 1), side="right") - 1
    return np.asarray(commands[newest])


def _says_what_was_played(recording: Recording, experiment: Experiment) -> bool:
    if "slot" not in recording or "velocity_command_rad_s" not in recording:
        return False
    scheduled, slots = experiment.schedule().velocity_rad_s, recording["slot"]
    if len(recording) == 0 or slots[-1] >= scheduled.size:
        return False
    return bool(np.allclose(scheduled[slots], recording["velocity_command_rad_s"], atol=1e-9))
