"""The recorded command played into a rig, and what came back against what came then.

Who plays it is the caller's choice: a software rig in virtual time or on a wire, or a real rig,
which needs a person's permission each time. The rig's limits hold as in any run.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from servo_bench.errors import ConfigError
from servo_bench.excitation.experiment import Experiment
from servo_bench.recording.recording import Recording
from servo_bench.replay.command import order_of
from servo_bench.replay.difference import RunDifference, difference
from servo_bench.rig import RigConfig
from servo_bench.run.virtual import run_virtually

Play = Callable[[Experiment, RigConfig], Recording]


@dataclass(frozen=True, slots=True, eq=False)
class Replayed:
    """The new run, and how it differs from the old one."""

    recording: Recording
    difference: RunDifference
    again: bool

    def numbers(self) -> dict[str, Any]:
        """As plain values, ready for JSON."""
        return {"same_experiment": self.again, **self.difference.numbers()}


def against(recording: Recording, rig: RigConfig, play: Play = run_virtually) -> Replayed:
    """Play the command of `recording` into `rig`.

    Raises RecordingError where there is no command, LimitError where the rig's limits do not allow
    it (before anything is enabled), and what `play` raises.
    """
    experiment, again, first_slot = order_of(recording, rig.name)
    if abs(experiment.period_s / recording.period_s - 1.0) > 1e-9:
        raise ConfigError(
            f"the recording's period is {recording.period_s} s and its experiment's "
            f"{experiment.period_s} s. Mend the file."
        )
    played = play(experiment, rig)
    return Replayed(
        recording=played,
        difference=difference(recording, played, first_slot=first_slot),
        again=again,
    )
