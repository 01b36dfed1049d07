"""The bench as a test has it: run, analyse, diagnose, compare; everything it did is kept."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

from servo_bench.check.verdict import verdict_of, words_of
from servo_bench.diagnosis.judging.verdict import Verdict
from servo_bench.errors import ConfigError
from servo_bench.excitation.experiment import Experiment, load_experiment
from servo_bench.files import find
from servo_bench.kernels.analysis import Analysis
from servo_bench.kernels.analysis import analyse as analyse_recording
from servo_bench.pytest_plugin.rigs import SimRig
from servo_bench.recording.mcap_file import load
from servo_bench.recording.recording import Recording
from servo_bench.replay.compare import Comparison
from servo_bench.replay.compare import compare as compare_recordings
from servo_bench.rig import RigConfig
from servo_bench.run.session import run as run_session
from servo_bench.run.virtual import play_virtually
from sim_rig.model import Model

NO_PRIORITY = 0
"""Tests run beside others: no real-time priority for the bus loop."""


@dataclass(slots=True)
class Bench:
    """`folder` is the test's, `scratch` a folder of the test's own; `note` writes a property.

    `recordings` are all runs of the test so far, also those that ended with an error.
    """

    folder: Path
    scratch: Path
    permitted: bool
    note: Callable[[str, str], None]
    recordings: list[Recording] = field(default_factory=list, repr=False)

    def run(self, experiment: str | Experiment, rig: SimRig | RigConfig) -> Recording:
        """Play an experiment (a file beside the test, one that ships, or a value) on a rig.

        A `SimRig` in virtual time or on its wire. A `RigConfig` is somebody's real rig: it needs
        `--permit-real-rig`. The recording says what the data sheet says: hidden effects and
        faults are not in it. Raises what a run raises: LimitError, WireError, DriveError, ...
        """
        plan = experiment if isinstance(experiment, Experiment) else self._experiment(experiment)
        if isinstance(rig, SimRig) and not rig.wire:
            return self._virtual(plan, rig)
        config = rig.shown if isinstance(rig, SimRig) else rig
        if isinstance(rig, RigConfig) and not self.permitted:
            raise ConfigError(
                f"rig {rig.name!r} is not a software rig of this test: it would move. Make one "
                "with sim_rig(...), or permit it for this invocation: pytest --permit-real-rig."
            )
        return self._on_a_bus(plan, config)

    def analyse(self, recording: Recording) -> Analysis:
        """Kernels and figures; the main ones become properties of the test."""
        found = analyse_recording(recording)
        numbers = found.numbers()
        for name in ("vaf_fresh_order1_percent", "vaf_fresh_order3_percent", "noise_rad_s"):
            self.note(f"servo_bench.{name}", str(numbers[name]))
        return found

    def diagnose(
        self,
        *recordings: Recording,
        model: Model | None = None,
        held_out: Recording | None = None,
    ) -> Verdict:
        """What the rig's simulation gets wrong; the verdict becomes a property of the test."""
        found = verdict_of(recordings, model=model, held_out=held_out)
        self.note("servo_bench.verdict", ", ".join(words_of(found)))
        return found

    def compare(self, a: Recording, b: Recording) -> Comparison:
        """Has the rig changed from a to b?"""
        found = compare_recordings(a, b)
        self.note("servo_bench.changed", str(found.changed).lower())
        return found

    def _experiment(self, name: str) -> Experiment:
        return load_experiment(find(name, self.folder))

    def _virtual(self, plan: Experiment, rig: SimRig) -> Recording:
        done = play_virtually(plan, rig.config)
        recording = self._kept(replace(done.recording, rig=rig.shown))
        if done.error is not None:
            raise done.error
        return recording

    def _on_a_bus(self, plan: Experiment, config: RigConfig) -> Recording:
        out = self.scratch / f"run-{len(self.recordings) + 1}.mcap"
        try:
            run_session(plan, config, out, priority=NO_PRIORITY)
        finally:
            if out.exists():
                recording = self._kept(load(out, allow_cut=True))
        return recording

    def _kept(self, recording: Recording) -> Recording:
        self.recordings.append(recording)
        number = len(self.recordings)
        experiment, rig = recording.experiment, recording.rig
        told = (experiment.name if experiment else "", rig.name if rig else "")
        self.note(f"servo_bench.run{number}", f"{told[0]} on {told[1]}: {len(recording)} samples")
        return recording
