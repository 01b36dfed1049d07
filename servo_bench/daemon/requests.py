"""What a request may ask to be played: an experiment of the configuration, changed a little.

The rig and its limits come from the configuration alone; a request names an experiment and may
lower or raise its amplitude, its periods, and its standstill. What leaves the limits is refused
before it waits, and again before it plays.
"""

import math
import re
import secrets
import shutil
from datetime import UTC, datetime
from pathlib import Path, PurePath
from typing import Any, NamedTuple

from pydantic import BaseModel, ConfigDict, Field

from servo_bench.catalogue import run_id
from servo_bench.daemon.config import Bench
from servo_bench.daemon.problems import DISK_FULL, ApiError
from servo_bench.errors import ConfigError
from servo_bench.excitation.counting import counted_slots
from servo_bench.excitation.experiment import Experiment, Schedule, experiment_from_table
from servo_bench.recording.recording import FAST_DTYPE, SAMPLE_DTYPE
from servo_bench.run.limits import check_run_time, check_schedule

SPARE_BYTES = 16 << 20
"""What must stay free beside a run's recording: notes, queue, report."""
MESSAGE_BYTES = 64
"""What a message takes in a file beside its content, its share of an index included."""
LONGEST_SLUG = 40


class Overrides(BaseModel):
    """What of an experiment a request may change."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    amplitude_deg_s: float | None = Field(default=None, gt=0.0, le=1e6)
    """Of identification and validation, degrees per second."""
    periods: int | None = Field(default=None, ge=1, le=100)
    """How often the identification sequence is played."""
    standstill_s: float | None = Field(default=None, ge=0.0, le=3600.0)


class Chosen(NamedTuple):
    """An experiment, and what playing it does; its schedule is let go."""

    experiment: Experiment
    slots: int
    duration_s: float
    peak_velocity_rad_s: float
    peak_travel_rad: float


def laid_out(experiment: Experiment) -> Chosen:
    """What playing an experiment does. ConfigError where it cannot be played."""
    return _chosen(experiment, experiment.schedule())


def _chosen(experiment: Experiment, schedule: Schedule) -> Chosen:
    return Chosen(
        experiment,
        schedule.slots,
        schedule.duration_s,
        schedule.peak_velocity_rad_s,
        schedule.peak_travel_rad,
    )


def chosen(bench: Bench, name: str, overrides: Overrides) -> Chosen:
    """The experiment that is meant, with its changes.

    It may take seconds. ApiError where the configuration has none of that name; ConfigError or
    LimitError where it cannot be played on the rig.
    """
    experiment = bench.experiments.get(name.removesuffix(".toml"))
    if experiment is None:
        raise ApiError(
            404,
            "no-such-experiment",
            f"there is no experiment {name[:80]!r}; there are {', '.join(bench.experiments)}. "
            "Others must be added to the daemon's configuration.",
        )
    from servo_bench.run.axes import axis_settings  # noqa: PLC0415 - all drivers: /api/health
    from servo_bench.run.session import check_memory  # noqa: PLC0415 - does not wait for them

    changed = experiment_from_table(_table(experiment, overrides), "the request")
    # before its schedule takes the memory
    check_run_time(counted_slots(changed) * changed.period_s, bench.rig.limits)
    schedule = changed.schedule()
    check_memory(changed)
    check_schedule(schedule, bench.rig.limits)
    axis_settings(bench.rig, changed.period_s)
    return _chosen(changed, schedule)


def _table(experiment: Experiment, overrides: Overrides) -> dict[str, Any]:
    table = experiment.model_dump(mode="json")
    if overrides.standstill_s is not None:
        table["standstill_s"] = overrides.standstill_s
    if overrides.periods is not None:
        _change(table["identification"], "periods", overrides.periods)
    if overrides.amplitude_deg_s is not None:
        for sequence in (table["identification"], table["validation"]):
            _change(sequence, "amplitude_rad_s", math.radians(overrides.amplitude_deg_s))
    return table


def _change(sequence: dict[str, Any], key: str, value: float) -> None:
    if key not in sequence:
        raise ConfigError(
            f"a sequence of kind {sequence.get('kind')!r} has no {key} that a request could "
            "change. Choose another experiment, or leave it as it is."
        )
    sequence[key] = value


def recording_bytes(slots: int, samples_per_command: int) -> int:
    """The largest that the recording of a run can become."""
    sample = SAMPLE_DTYPE.itemsize + MESSAGE_BYTES
    fast = samples_per_command * (FAST_DTYPE.itemsize + MESSAGE_BYTES)
    return slots * (sample + (fast if samples_per_command > 1 else 0))


def check_room(folder: Path, needed: int) -> None:
    """ApiError where the folder's disk has no room for so many bytes and what must stay free."""
    free = shutil.disk_usage(folder).free
    if free < needed + SPARE_BYTES:
        raise ApiError(
            *DISK_FULL,
            f"the recording may need {needed / 1e6:.1f} MB, and {free / 1e6:.1f} MB are free "
            f"of which {SPARE_BYTES / 1e6:.0f} MB are kept for the rest. Make room first.",
        )


def new_file(folder: Path, name: str) -> tuple[str, str]:
    """A file name that the folder does not have, and the id that the catalogue will give it.

    A clock that was set back makes no name twice: the last four digits are random.
    """
    slug = re.sub(r"[^A-Za-z0-9_-]+", "-", name).strip("-")[:LONGEST_SLUG] or "run"
    while True:
        stamp = datetime.now(UTC).strftime("%Y%m%d-%H%M%S")
        file = f"{stamp}-{slug}-{secrets.token_hex(2)}.mcap"
        if not (folder / file).exists():
            return file, run_id(PurePath(file))
