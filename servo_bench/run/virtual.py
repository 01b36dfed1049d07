"""An experiment on the software rig in virtual time: the same value as a run, in a few seconds.

    run_virtually(load_experiment("experiments/paper.toml"), load_rig("rigs/paper.toml"))

plays 168 s. Master, bus loop, limits, and slaves are those of a run on the wire; processes,
sockets, and the machine's own lateness are not there.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.canopen.master import CanopenAxis
from servo_bench.clock import NS_PER_S
from servo_bench.devices import ModbusDriveConfig, SerialEncoderConfig
from servo_bench.errors import BenchError, ConfigError, gathered
from servo_bench.excitation.experiment import Experiment
from servo_bench.recording.provenance import clock_pair, provenance
from servo_bench.recording.recording import (
    FAST_DTYPE,
    SAMPLE_DTYPE,
    Event,
    Recording,
    recording_from_rows,
)
from servo_bench.recording.writer import RecordingWriter
from servo_bench.rig import RigConfig
from servo_bench.run.busloop import player_for
from servo_bench.run.limits import check_schedule
from servo_bench.run.session import check_memory
from servo_bench.run.table import UNPLAYED, SlotTable
from servo_bench.run.virtual_wire import VirtualWire


@dataclass(frozen=True, slots=True, eq=False)
class VirtualRun:
    """What was recorded, and what ended the run before its schedule did, if anything."""

    recording: Recording
    error: BenchError | None = None


def run_virtually(experiment: Experiment, rig: RigConfig) -> Recording:
    """The recording of a whole run. Raises what a run raises: see `play_virtually`, and faults."""
    done = play_virtually(experiment, rig)
    if done.error is not None:
        raise done.error
    return done.recording


def play_virtually(experiment: Experiment, rig: RigConfig) -> VirtualRun:
    """Play to the schedule's end, or to what ends it; the rig's faults happen as they do on a wire.

    Raises ConfigError or LimitError for what can never be played: a rig on Modbus, a schedule
    beyond the rig's limits, an effect that cannot be.
    """
    if isinstance(rig.drive, ModbusDriveConfig):
        raise ConfigError(
            f"rig {rig.name!r} is on {rig.drive.protocol}, and virtual time speaks CANopen. Play "
            "it on its wire, in wall time."
        )
    if isinstance(rig.encoder, SerialEncoderConfig):
        raise ConfigError(
            f"rig {rig.name!r} has its encoder on a serial line, and virtual time speaks CANopen. "
            "Play it on its wire, in wall time (servo-bench run --simulated)."
        )
    schedule = experiment.schedule()
    check_memory(experiment)
    check_schedule(schedule, rig.limits)
    with gathered():
        wire = VirtualWire(rig.simulation_settings())
    events: list[Event] = []

    def tell(kind: str, text: str, *, time_ns: int | None = None, **data: Any) -> None:
        events.append(Event(time_ns or wire.now_ns, kind, text, data))

    facts = provenance(clock_pair(monotonic=lambda: wire.now_ns)) | {"time": "virtual"}
    settings = rig.model_copy(update={"bus": wire.bus}).canopen_settings(experiment.period_s)
    error: BenchError | None = None
    with SlotTable.create(schedule.slots, rig.samples_per_command) as table:
        try:
            with gathered(), CanopenAxis(settings, wire.drivers_clock()) as axis:
                start_ns = wire.now_ns + round(experiment.period_s * NS_PER_S)
                tell("playing", "the drive is enabled", start_ns=start_ns)
                player_for(rig, axis, schedule, table, wire.run_clock()).play(start_ns, tell)
                tell("stopping", "the last slot was played")
        except BenchError as failure:
            error = failure
            tell("error", str(failure), error=type(failure).__name__)
        rows = table.rows[table.rows["slot"] != UNPLAYED].copy()
        fast = table.fast[table.fast["slot"] != UNPLAYED].copy()
    recording = recording_from_rows(rows, experiment, rig, facts, tuple(events), fast=fast)
    return VirtualRun(recording, error)


def save(recording: Recording, path: Path) -> None:
    """Write a run's recording to a new file. RecordingError where it cannot be written."""
    if recording.experiment is None or recording.rig is None:
        raise ConfigError("only a recording with its experiment and its rig is written as a run's.")
    rows = _rows(recording.channels, SAMPLE_DTYPE)
    per_s = 1.0 / recording.period_s
    with RecordingWriter(
        path, recording.experiment, recording.rig, recording.provenance, per_s
    ) as writer:
        if recording.fast:
            writer.fast(_rows(recording.fast, FAST_DTYPE))
        writer.samples(rows)
        for event in recording.events:
            writer.event(event)


def _rows(columns: Mapping[str, NDArray[Any]], dtype: "np.dtype[np.void]") -> NDArray[np.void]:
    rows = np.zeros(len(columns["slot"]), dtype)
    for name in dtype.names or ():
        rows[name] = columns.get(name, np.nan)
    return rows
