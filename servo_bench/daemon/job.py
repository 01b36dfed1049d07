"""What the daemon hands a run's process, and what it gets back: a job and a result, both JSON."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from servo_bench.errors import ConfigError
from servo_bench.excitation.experiment import Experiment, experiment_from_table
from servo_bench.rig import RigConfig, rig_from_table

JOB, RUNNER, RESULT = "job.json", "runner.json", "result.json"
Outcome = Literal["complete", "stopped", "faulted", "nothing", "cut"]


@dataclass(frozen=True, slots=True)
class RunJob:
    """What the daemon hands over. `facts` go into the recording's provenance."""

    id: str
    experiment: Experiment
    rig: RigConfig
    out: Path
    simulated: bool
    priority: int
    cpu: int | None
    stop_alone_s: float | None
    facts: dict[str, str]

    def table(self) -> dict[str, Any]:
        """The job as it stands in `job.json`."""
        return {
            "id": self.id,
            "experiment": self.experiment.model_dump(mode="json"),
            "rig": self.rig.model_dump(mode="json"),
            "out": str(self.out),
            "simulated": self.simulated,
            "priority": self.priority,
            "cpu": self.cpu,
            "stop_alone_s": self.stop_alone_s,
            "facts": self.facts,
        }

    @classmethod
    def from_table(cls, table: Mapping[str, Any]) -> "RunJob":
        """The job again; ConfigError where the table is none."""
        try:
            return cls(
                **{
                    **table,
                    "experiment": experiment_from_table(table["experiment"], JOB),
                    "rig": rig_from_table(table["rig"], JOB),
                    "out": Path(table["out"]),
                }
            )
        except (KeyError, TypeError) as error:
            raise ConfigError(f"{JOB} is no job of this version: {error}. Remove it.") from error


@dataclass(frozen=True, slots=True)
class RunResult:
    """What became of a run, in one sentence and a few numbers."""

    outcome: Outcome
    sentence: str
    error: str = ""
    slots: int = 0
    played: int = 0
    missed: int = 0
    notes: tuple[str, ...] = ()

    @classmethod
    def from_table(cls, table: Mapping[str, Any]) -> "RunResult":
        """The result again, from its JSON."""
        return cls(**{**table, "notes": tuple(table.get("notes", ()))})
