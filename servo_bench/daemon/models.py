"""What goes over the API, typed: the bodies of requests and answers."""

import json
from collections.abc import Mapping
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field

from servo_bench.catalogue.run import printable
from servo_bench.daemon.jobs import JobState, Kind
from servo_bench.daemon.machine import State
from servo_bench.daemon.requests import Overrides
from servo_bench.diagnosis.judging.verdict import Verdict

LONGEST_TEXT = 200
Text = Annotated[str, Field(max_length=LONGEST_TEXT, pattern=r"^[^\x00-\x1f\x7f]*$")]
"""One line of words."""
Person = Annotated[
    str,
    Field(
        min_length=1, max_length=64, pattern=r"^[^\x00-\x1f\x7f]*[^\x00-\x20\x7f][^\x00-\x1f\x7f]*$"
    ),
]
RunId = Annotated[str, Field(pattern=r"^[0-9a-f]{16}$", description="as the catalogue gives it")]
Tag = Annotated[str, Field(min_length=1, max_length=64)]


class Asked(BaseModel):
    """A request's body: what it does not know is refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class RunRequest(Asked):
    """A run that somebody wants; `confirm` says that they stand at the rig and mean it."""

    experiment: Annotated[str, Field(min_length=1, max_length=200)]
    name: Text = ""
    notes: Annotated[str, Field(max_length=10_000)] = ""
    operator: Person
    confirm: Literal[True]
    overrides: Overrides = Overrides()


class PreviewRequest(Asked):
    """An experiment with changes, to look at before anybody confirms it."""

    experiment: Annotated[str, Field(min_length=1, max_length=200)]
    overrides: Overrides = Overrides()


class Annotation(Asked):
    """New notes or tags; what is not given stays."""

    notes: Annotated[str, Field(max_length=100_000)] | None = None
    tags: Annotated[list[Tag], Field(max_length=64)] | None = None


class StopRequest(Asked):
    """Who stops, and why. A stop is heeded whatever it says: what does not fit is cut or left."""

    operator: Text = ""
    reason: Text = ""

    @classmethod
    def in_bytes(cls, body: bytes | str) -> "StopRequest":
        """The words of a body, as far as they are any."""
        try:
            table = json.loads(body)
        except (ValueError, RecursionError):
            return cls()
        return cls.in_table(table) if isinstance(table, dict) else cls()

    @classmethod
    def in_table(cls, table: Mapping[str, Any]) -> "StopRequest":
        """The words of a message, as far as they are any."""
        said = {
            key: printable(" ".join(table[key].split()), LONGEST_TEXT)
            for key in cls.model_fields
            if isinstance(table.get(key), str)
        }
        return cls(**said)

    def words(self, nobody: str = "an operator", elsewhere: str = "") -> str:
        """Who stops and why, as it is shown; `nobody` where no name came.

        `elsewhere`: the address of the machine that asks, if it is another one.
        """
        reason = f" ({self.reason})" if self.reason else ""
        machine = f" from {elsewhere}" if elsewhere else ""
        return f"{self.operator or nobody}{reason}{machine}"


class ArmRequest(Asked):
    """Who has looked at the rig and lets the queue go on.

    `seen`: the status's `arming` as it was looked at; where it is another by now, nothing is armed.
    """

    operator: Person
    seen: Annotated[str, Field(max_length=64)] | None = None


class ReplayRequest(Asked):
    """A recording to show; speed 1 is the time in which it was made. Ask again to seek."""

    run: RunId
    speed: Annotated[float, Field(ge=0.1, le=1000.0)] = 1.0
    start_s: Annotated[float, Field(ge=0.0, le=1e7)] = 0.0


class LoginRequest(Asked):
    """The token of the daemon's configuration."""

    token: Annotated[str, Field(max_length=1000)]


class Health(BaseModel):
    """That the daemon answers."""

    status: Literal["ok"] = "ok"
    version: str
    uptime_s: float


class LimitsView(BaseModel):
    """The rig's limits, from its configuration."""

    velocity_rad_s: float
    travel_rad: float
    run_time_s: float


class RigView(BaseModel):
    """The rig. `reachable` is what the last run found, null before one."""

    name: str
    bus: dict[str, str | int | float | bool]
    limits: LimitsView
    simulated: bool
    reachable: bool | None


class QueueEntry(BaseModel):
    """A run that waits."""

    id: str
    name: str
    experiment: str
    operator: str


class RunStatus(QueueEntry):
    """The run that plays."""

    phase: str
    slot: int
    slots: int
    seconds_left: float
    missed: int
    lateness_p50_s: float
    lateness_max_s: float


class Fault(BaseModel):
    """Why the rig is faulted."""

    sentence: str
    at_utc: str


class Last(BaseModel):
    """How the last run ended."""

    id: str
    sentence: str


class Replaying(BaseModel):
    """The recording that the page shows."""

    run: str
    speed: float


class JobView(BaseModel):
    """A piece of work on a recording: what it does now, and how it ended."""

    id: str
    kind: Kind
    run: str
    state: JobState
    progress: str
    sentence: str


class Status(BaseModel):
    """Everything that changes while the daemon lives; `jobs` are those that wait or work.

    `arming` stands for what arming would do now: which run would begin, after which stop or fault.
    """

    state: State
    held: bool
    held_reason: str
    holder: str
    run: RunStatus | None
    queue: list[QueueEntry]
    limits: LimitsView
    fault: Fault | None
    arming: str
    bus_alive: bool
    last: Last | None
    replay: Replaying | None
    jobs: list[JobView]


class ExperimentView(BaseModel):
    """An experiment that may be asked for, by its `file`."""

    name: str
    file: str
    text: str
    period_s: float
    seconds: float
    slots: int
    peak_velocity_rad_s: float
    peak_travel_rad: float


class Accepted(BaseModel):
    """A run that waits now, with so many before it."""

    id: str
    position: int


class Stopped(BaseModel):
    """The stop was given; `standing` says whether the rig is known to stand already.

    It is false while the rig is being stopped, and after a fault that left nobody to confirm it.
    """

    stopped: Literal[True] = True
    standing: bool
    state: State


class RunRow(BaseModel):
    """A recording, as a line of the catalogue."""

    id: str
    name: str
    file: str
    experiment: str
    rig: str
    started_utc: str
    seconds: float | None
    state: str
    operator: str
    tags: list[str]
    notes: str
    missed: int | None
    sentence: str
    figures: dict[str, Any]
    verdict: str | None
    causes: list[str]
    bytes: int


class RunPage(BaseModel):
    """Some of the runs that a search found, the latest first."""

    total: int
    runs: list[RunRow]


class EventView(BaseModel):
    """Something that happened beside the samples, `at_s` after the first event."""

    at_s: float
    kind: str
    text: str
    data: dict[str, Any]


class RunDetail(RunRow):
    """A recording with what its analysis says, as far as there is one."""

    sentences: list[str]
    quality: dict[str, Any] | None
    kernels: dict[str, Any] | None
    diagnosis: Verdict | None
    events: list[EventView]
    has_report: bool
    has_diagnosis_page: bool


class Column(BaseModel):
    """The smallest and the largest value of each block of rows; null where nothing came."""

    min: list[float | None]
    max: list[float | None]


class Samples(BaseModel):
    """Channels of a recording, thinned; `t_s` is the beginning of each block."""

    rows: int
    t_s: list[float]
    columns: dict[str, Column]


class Problem(BaseModel):
    """An error (RFC 9457)."""

    type: str
    title: str
    status: int
    detail: str
    instance: str = ""


class JobStarted(BaseModel):
    """The job that was begun."""

    job: str
