"""The paper's experiment over the real wire, against the figure it must reach.

On a noise-free rig with W = 1.5 degrees and V = 150 deg/s (40473, wn 62.5 rad/s, zeta 0.4, M = 21)
kernels up to order 3 predict a fresh input to 95.5 % VAF within 0.5.
"""

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from servo_bench.errors import FitError
from servo_bench.excitation.experiment import load_experiment
from servo_bench.kernels.analysis import analyse
from servo_bench.recording.mcap_file import load
from servo_bench.recording.recording import Recording
from servo_bench.rig import load_rig
from servo_bench.run.session import Status, run
from sim_rig.process import spawn

REFERENCE_ORDER3_FRESH = 95.5


def measure(name: str, *, progress: Callable[[Status], None] = lambda _: None) -> dict[str, Any]:
    """Play the experiment called `name` on the software rig and analyse it."""
    experiment = load_experiment(name)
    rig = load_rig(experiment.rig).on_a_free_port()
    with tempfile.TemporaryDirectory() as folder, spawn(rig.simulation_settings()) as simulated:
        out = Path(folder) / "experiment.mcap"
        summary = run(experiment, rig.with_bus(**simulated.bus), out, progress=progress)
        recording = load(out)
        analysis = analyse(recording)
    return {
        "experiment": experiment.model_dump(mode="json"),
        "slots": summary.played,
        "missed_slots": summary.missed,
        "reference_order3_fresh_vaf": REFERENCE_ORDER3_FRESH,
        "analysis": analysis.numbers(),
        "wire_less_simulation_counts": wire_less_simulation_counts(recording),
    }


def wire_less_simulation_counts(recording: Recording) -> dict[str, float]:
    """Recorded load angle less the offline simulation at the recorded SYNC times, in counts.

    The software rig ran the same model, so what is left is the rounding to counts (at most half a
    count) and to whole microseconds of the bus's time stamps (none: the rig's clock is the stamps).
    """
    rig = recording.rig
    if rig is None or rig.encoder is None:
        raise FitError("the recording tells no rig with a load encoder to be simulated.")
    time_s = recording["device_time_us"] * 1e-6
    durations_s = np.append(np.diff(time_s), recording.period_s)
    increment_rad_s = 2.0 * np.pi / rig.drive.counts_per_revolution  # 0x60FF: whole ones a second
    commands_rad_s = (
        np.rint(recording["velocity_command_rad_s"] / increment_rad_s) * increment_rad_s
    )
    simulated = rig.model().simulate(commands_rad_s, durations_s)
    unit_rad = 2.0 * np.pi / rig.encoder.counts_per_revolution
    moved = recording["load_angle_counts"] - recording["load_angle_counts"][0]
    difference = moved - simulated.load_angle_rad / unit_rad
    return {"max": float(np.abs(difference).max()), "rms": float(np.sqrt(np.mean(difference**2)))}
