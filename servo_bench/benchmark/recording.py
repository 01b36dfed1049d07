"""Reading a recording: ours against the mcap library's own reader, on one file in one run.

The file is 131 s at 8 ms (N = 16383, the paper's experiment) as a run writes it. The reference
does what a user of the library would: `make_reader(...).iter_messages` and `struct` per message,
into the same arrays. The two must agree in every bit.
"""

import struct
import tempfile
from collections.abc import Callable
from pathlib import Path
from statistics import median
from time import perf_counter
from typing import Any

import numpy as np
from mcap.reader import make_reader
from numpy.typing import NDArray

from servo_bench.excitation.experiment import load_experiment
from servo_bench.recording.cdr import HEADER_BYTES
from servo_bench.recording.format import SAMPLES_TOPIC
from servo_bench.recording.mcap_file import RecordingWriter, load
from servo_bench.recording.provenance import provenance
from servo_bench.recording.recording import MISSING, SAMPLE_DTYPE, SAMPLE_FIELDS
from servo_bench.rig import load_rig

ROWS = 16383
BATCH = 12
"""A session writes about ten times a second."""
COUNTS_PER_RAD = 65536 / (2.0 * np.pi)


def measure(seed: int, *, rows: int = ROWS, repeats: int = 15) -> dict[str, Any]:
    """Medians over `repeats`, ready for JSON. Raises RecordingError where /tmp has no room."""
    experiment, rig = load_experiment("experiments/paper.toml"), load_rig("rigs/paper.toml")
    made = sample_rows(seed, rows, experiment.period_s)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "benchmark.mcap"
        began_s = perf_counter()
        with RecordingWriter(path, experiment, rig, provenance(), 1 / experiment.period_s) as out:
            for first in range(0, rows, BATCH):
                out.samples(made[first : first + BATCH])
        write_s = perf_counter() - began_s
        ours_ms, theirs_ms = _medians_ms(repeats, lambda: load(path), lambda: library_columns(path))
        recording, columns = load(path), library_columns(path)
        file_bytes = path.stat().st_size
    return {
        "seed": seed,
        "rows": rows,
        "seconds": rows * experiment.period_s,
        "repeats": repeats,
        "file_bytes": file_bytes,
        "load_ms": ours_ms,
        "reference": "mcap.reader.make_reader, iter_messages, struct.unpack",
        "reference_ms": theirs_ms,
        "speedup": theirs_ms / ours_ms,
        "equal": all(np.array_equal(recording[n], columns[n], equal_nan=True) for n in columns),
        "write_us_per_row": write_s / rows * 1e6,
    }


def _medians_ms(repeats: int, *acts: Callable[[], object]) -> tuple[float, ...]:
    """The median time of each act; they take turns, so that a busy machine hits all alike."""
    times_ms: list[list[float]] = [[] for _ in acts]
    for _ in range(repeats):
        for act, own in zip(acts, times_ms, strict=True):
            began_s = perf_counter()
            act()
            own.append((perf_counter() - began_s) * 1e3)
    return tuple(median(own) for own in times_ms)


def library_columns(path: Path) -> dict[str, NDArray[Any]]:
    """Every field of /samples by the mcap library's own means, as arrays of shape (rows,)."""
    codes = {"int64": "q", "float64": "d", "uint32": "I"}
    row = struct.Struct("<" + "".join(codes[kind] for _, kind in SAMPLE_FIELDS))
    with path.open("rb") as file:
        rows = [
            row.unpack_from(message.data, HEADER_BYTES)
            for _, _, message in make_reader(file).iter_messages(topics=[SAMPLES_TOPIC])
        ]
    columns = zip(*rows, strict=True)
    return {
        name: np.array(values, kind)
        for (name, kind), values in zip(SAMPLE_FIELDS, columns, strict=True)
    }


def sample_rows(seed: int, rows: int, period_s: float) -> NDArray[np.void]:
    """Rows that compress as a run's do: angles on the counts' grid, noise in the timings."""
    rng = np.random.default_rng(seed)
    made = np.zeros(rows, SAMPLE_DTYPE)
    slot = np.arange(rows)
    command = 2.6 * rng.choice([-1.0, 1.0], rows)
    angle = np.cumsum(command) * period_s
    lateness_s = rng.exponential(30e-6, rows)
    made["slot"] = made["chip"] = slot
    made["asked_ns"] = 10**13 + slot * round(period_s * 1e9) + (lateness_s * 1e9).astype(np.int64)
    made["device_time_us"] = MISSING
    made["velocity_command_rad_s"] = command
    made["motor_velocity_rad_s"] = command + rng.normal(0.0, 0.01, rows)
    made["motor_torque_nm"] = np.round(rng.normal(0.0, 0.05, rows), 3)
    for name in ("motor_position", "load_angle"):
        counts = np.round(angle * COUNTS_PER_RAD + rng.normal(0.0, 1.0, rows))
        made[f"{name}_counts"] = counts
        made[f"{name}_rad"] = counts / COUNTS_PER_RAD
    made["lateness_s"] = lateness_s
    made["drive_latency_s"] = rng.gamma(20.0, 20e-6, rows)
    made["encoder_latency_s"] = rng.gamma(20.0, 20e-6, rows)
    made["phase"] = 2
    made["statusword"] = 0x0237
    return made
