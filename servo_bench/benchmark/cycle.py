"""The bus loop against a C loop of the same class and priority, on the same CPU, in the same run.

The reference wakes half a period after the loop, on the same CPU, so that a hole in which the
machine was stolen hits both. A *stolen window* is where the reference itself woke more than
`reference.STOLEN_S` late; cycles within one period of it are left out of the clean figures, and a
skipped slot there is explained. On CAN a listener on the bus adds what a third party sees.
"""

import json
import math
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from servo_bench.benchmark.listener import spread_us
from servo_bench.benchmark.memory import MemoryWatch
from servo_bench.benchmark.reference import outside, running_reference, stolen_windows
from servo_bench.clock import NS_PER_S, monotonic_ns
from servo_bench.errors import ConfigError
from servo_bench.excitation.experiment import Experiment, MSequence, RandomBinary
from servo_bench.excitation.sequences import MAX_CHIPS
from servo_bench.recording.mcap_file import load
from servo_bench.recording.recording import Recording
from servo_bench.rig import load_rig
from servo_bench.run.session import Status, run
from sim_rig.process import spawn

AMPLITUDE_RAD_S = 0.5
SETUP_S = 3.0
FEWEST_SLOTS = 10
_NOTHING: Mapping[str, Any] = MappingProxyType({})


def measure(
    *,
    period_s: float,
    seconds: float,
    priority: int,
    cpu: int | None,
    rig_name: str = "rigs/paper.toml",
    drive: Mapping[str, Any] = _NOTHING,
    bus: Mapping[str, Any] = _NOTHING,
    progress: Callable[[Status], None] = lambda _: None,
) -> dict[str, Any]:
    """Play `seconds` at `period_s` on the software rig; the figures, ready for JSON.

    `drive` and `bus` are keys of these tables that differ from the rig file's. Where the angles are
    sampled faster than the command, the loop and the reference turn once per sample.
    Raises BenchError where there is no C compiler and what a run raises.
    """
    rig = load_rig(rig_name).on_a_free_port().with_bus(**bus)
    rig = rig.model_copy(update={"drive": rig.drive.model_copy(update=dict(drive))})
    experiment = _experiment(period_s, seconds)
    chosen = max(os.sched_getaffinity(0)) if cpu is None else cpu
    period_ns = round(period_s / rig.samples_per_command * NS_PER_S)
    cycles = experiment.schedule().slots * rig.samples_per_command
    cycles += round(SETUP_S * NS_PER_S / period_ns)
    memory = MemoryWatch()

    def told(status: Status) -> None:
        memory.look()
        progress(status)

    with tempfile.TemporaryDirectory() as folder, spawn(rig.simulation_settings()) as simulated:
        out = Path(folder) / "cycle.mcap"
        on_can = rig.drive.protocol == "canopen"  # elsewhere there is nobody to listen in
        slots = experiment.schedule().slots * rig.samples_per_command
        listener = _start_listener(dict(simulated.bus), slots) if on_can else None
        echo = None
        if rig.drive.protocol == "modbus-rtu":
            echo = _start_echo(period_s, experiment.schedule().slots, priority)
        with running_reference(
            priority=priority,
            cpu=chosen,
            start_ns=monotonic_ns() + period_ns,
            period_ns=period_ns,
            cycles=cycles,
        ) as reference:
            summary = run(
                experiment,
                rig.with_bus(**simulated.bus),
                out,
                priority=priority,
                cpu=chosen,
                progress=told,
            )
            due_ns, late_ns = reference.rows()
        seen = json.loads(listener.communicate()[0]) if listener else None
        echoed_s = json.loads(echo.communicate()[0]) if echo else []
        recording = load(out)
    loop = recording.fast or recording.channels  # a row for every turn of the loop
    asked_ns = loop["asked_ns"]
    lateness_s = np.abs(loop["lateness_s"])  # a drive's SYNC may be early
    during = (due_ns >= asked_ns[0]) & (due_ns <= asked_ns[-1])  # without set-up and tear-down
    due_ns, late_ns = due_ns[during], late_ns[during]
    stolen = stolen_windows(due_ns, late_ns)
    return {
        "period_s": period_s,
        "seconds": seconds,
        "priority": priority,
        "cpu": chosen,
        "refused": list(summary.sentences),
        "cycles": asked_ns.size,
        "loop": _figures(asked_ns, lateness_s, stolen, period_ns),
        "reference": _figures(due_ns, late_ns / NS_PER_S, stolen, period_ns),
        "stolen_windows": len(stolen),
        "ratio": _ratio((asked_ns, lateness_s), (due_ns, late_ns), stolen, period_ns),
        "missed_slots": summary.missed,
        "unexplained_gaps": _unexplained(recording, stolen, period_ns),
        "round_trip": _round_trip(recording, stolen, period_ns),
        "unanswered_slots": int(np.count_nonzero(~np.isfinite(recording["drive_latency_s"]))),
        "memory": memory.figures(),
        "bus": _seen_on_the_bus(seen),
        **_echo_figures(echoed_s),
    }


def _round_trip(
    recording: Recording, stolen: NDArray[np.int64], period_ns: int
) -> dict[str, dict[str, float]]:
    """From the ask to the drive's answer."""
    answered = np.isfinite(recording["drive_latency_s"])
    asked_ns, latency_s = recording["asked_ns"][answered], recording["drive_latency_s"][answered]
    return _figures(asked_ns, latency_s, stolen, period_ns)


def _seen_on_the_bus(seen: dict[str, list[float]] | None) -> dict[str, Any]:
    """What the listener took down; nothing without one."""
    if seen is None:
        return {}
    return {
        "sync_interval": spread_us(np.diff(seen.pop("sync_s")).tolist()),
        "answers_after_sync": {cob_id: spread_us(after) for cob_id, after in seen.items()},
    }


def _experiment(period_s: float, seconds: float) -> Experiment:
    slots = round(seconds / period_s)
    if slots < FEWEST_SLOTS:
        raise ConfigError(
            f"{seconds:g} s hold {slots} periods of {period_s:g} s: at least {FEWEST_SLOTS} are "
            "measured. Give more seconds, or a shorter period."
        )
    if slots > MAX_CHIPS:
        raise ConfigError(
            f"{seconds:g} s hold {slots} periods of {period_s:g} s: at most {MAX_CHIPS} are "
            "played at once. Give fewer seconds."
        )
    return Experiment(
        name="benchmark cycle",
        rig="rigs/paper.toml",
        period_s=period_s,
        memory=1,
        standstill_s=0.0,
        lead_in=1,
        identification=MSequence(
            polynomial="15341", amplitude_rad_s=AMPLITUDE_RAD_S, length=slots - 2
        ),
        validation=RandomBinary(
            kind="random-binary", seed=1, amplitude_rad_s=AMPLITUDE_RAD_S, length=1
        ),
    )


def _start_listener(
    bus: dict[str, str | int | float | bool], syncs: int
) -> "subprocess.Popen[bytes]":
    return _start("listener", {"bus": bus, "syncs": syncs})


def _start_echo(period_s: float, pings: int, priority: int) -> "subprocess.Popen[bytes]":
    return _start("pty_echo", {"period_s": period_s, "pings": pings, "priority": priority})


def _start(module: str, job: dict[str, Any]) -> "subprocess.Popen[bytes]":
    process = subprocess.Popen(
        [sys.executable, "-m", f"servo_bench.benchmark.{module}"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    if process.stdin:
        process.stdin.write(json.dumps(job).encode() + b"\n")
        process.stdin.flush()
    return process


def _echo_figures(echoed_s: list[float]) -> dict[str, Any]:
    """A byte's way there and back over another pty in the same run; nothing without one."""
    if not echoed_s:
        return {}
    came_s = [took_s for took_s in echoed_s if took_s < math.inf]
    lost = len(echoed_s) - len(came_s)
    return {"pty_echo": {**spread_us(came_s), "longer_than_a_period": lost}}


def _figures(
    at_ns: NDArray[np.int64],
    lateness_s: NDArray[np.float64],
    stolen: NDArray[np.int64],
    period_ns: int,
) -> dict[str, dict[str, float]]:
    clean = outside(at_ns, stolen, period_ns)
    return {
        "raw": spread_us(lateness_s.tolist()),
        "clean": spread_us(lateness_s[clean].tolist()),
    }


def _ratio(
    loop: tuple[NDArray[np.int64], NDArray[np.float64]],
    reference: tuple[NDArray[np.int64], NDArray[np.int64]],
    stolen: NDArray[np.int64],
    period_ns: int,
) -> dict[str, float]:
    """Clean lateness of the loop over that of the reference."""
    due_ns, late_ns = reference
    loop_s = loop[1][outside(loop[0], stolen, period_ns)]
    reference_ns = late_ns[outside(due_ns, stolen, period_ns)]
    return {
        name: _percentile(loop_s * NS_PER_S, mark) / _percentile(reference_ns, mark)
        for name, mark in (("p50", 50.0), ("p99", 99.0))
    }


def _percentile(values: NDArray[np.floating] | NDArray[np.integer], mark: float) -> float:
    """NaN of nothing: the machine may have been taken away in every cycle."""
    return float(np.percentile(values, mark)) if values.size else float("nan")


def _unexplained(recording: Recording, stolen: NDArray[np.int64], period_ns: int) -> list[int]:
    """Slots after which there is a gap that no hole of the machine explains."""
    slots, asked_ns = recording["slot"], recording["asked_ns"]
    gaps = np.flatnonzero(np.diff(slots) > 1)
    return [
        int(slots[gap])
        for gap in gaps
        if not any(
            begin_ns < asked_ns[gap + 1] + period_ns and end_ns > asked_ns[gap] - period_ns
            for begin_ns, end_ns in stolen
        )
    ]
