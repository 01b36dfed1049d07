"""A trial's recording as another bench would hand it over: a CSV file, imported by a map.

It has a clock, the command, and the sensors; no slots, no phases, and no beginning: it is cut where
the seed says, at rest or in the middle of a motion. `servo-bench import` and a rig file are all
that a diagnosis of it needs.
"""

from pathlib import Path

import numpy as np

from servo_bench.foreign.importing import read_foreign
from servo_bench.foreign.maps import load_map
from servo_bench.recording.measured_writer import save_measured
from servo_bench.recording.recording import Recording
from tests.trials.names import Channels

MOST_CUT = 0.12
"""Of a recording, off its beginning, of which a good third is a standstill."""
LOAD = {
    "time": ("t", "s"),
    "velocity_command": ("command", "rad/s"),
    "load_position": ("load", "rad"),
}
MOTOR = {"motor_position": ("motor", "rad"), "motor_torque": ("torque", "Nm")}
SOURCES = {
    "command": "velocity_command_rad_s",
    "load": "load_angle_rad",
    "motor": "motor_position_rad",
    "torque": "motor_torque_nm",
}


def write_measured(recording: Recording, path: Path, channels: Channels, cut: float) -> None:
    """Less that share of its beginning, through CSV and import, into the new file `path`."""
    columns = LOAD if channels == "load" else {**LOAD, **MOTOR}
    first = round(cut * len(recording))
    time_s = recording.period_s * np.arange(len(recording) - first)
    table = [
        time_s if name == "t" else np.asarray(recording[SOURCES[name]], np.float64)[first:]
        for name, _ in columns.values()
    ]
    sheet, plan = path.with_suffix(".csv"), path.with_suffix(".map.toml")
    header = ",".join(name for name, _ in columns.values())
    np.savetxt(sheet, np.column_stack(table), delimiter=",", header=header, comments="", fmt="%.9g")
    told = [
        f'[[channel]]\nrole = "{role}"\ncolumn = "{name}"\nunit = "{unit}"\n'
        for role, (name, unit) in columns.items()
    ]
    plan.write_text('name = "another bench"\n' + "".join(told))
    save_measured(read_foreign(sheet, load_map(str(plan))), path)
    sheet.unlink()
    plan.unlink()


def cut_of(seed: int, take: int) -> float:
    """How much of its beginning a recording lacks that nobody began for us."""
    return float(np.random.default_rng((seed, 14, take)).uniform(0.0, MOST_CUT))
