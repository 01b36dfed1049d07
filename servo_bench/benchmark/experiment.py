"""The paper's experiment over the real wire, against the figure it must reach.

On a noise-free rig with W = 1.5 degrees and V = 150 deg/s (40473, wn 62.5 rad/s, zeta 0.4, M = 21)
kernels up to order 3 predict a fresh input to 95.5 % VAF within 0.5.
"""

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from servo_bench.excitation.experiment import load_experiment
from servo_bench.kernels.analysis import analyse
from servo_bench.recording.mcap_file import load
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
        analysis = analyse(load(out))
    return {
        "experiment": experiment.model_dump(mode="json"),
        "slots": summary.played,
        "missed_slots": summary.missed,
        "reference_order3_fresh_vaf": REFERENCE_ORDER3_FRESH,
        "analysis": analysis.numbers(),
    }
