"""The software rig on the wire runs the model that can be simulated offline, sample by sample."""

from pathlib import Path

import numpy as np
import pytest

from servo_bench.benchmark.experiment import wire_less_simulation_counts
from servo_bench.recording.mcap_file import load
from servo_bench.recording.recording import Recording
from servo_bench.rig import RigConfig, load_rig
from servo_bench.run.session import run
from sim_rig.process import spawn
from tests.test_run_session import experiment

TRIES = 4
EFFECTS = {
    "coulomb": {"torque_nm": 0.01},
    "cogging": {"torque_nm": 0.01, "order": 12.0},
    "gravity_imbalance": {"torque_nm": 0.02},
    "encoder_eccentricity": {"amplitude_rad": 0.001},
}


def answered_in_time(rig: RigConfig, folder: Path) -> Recording:
    """A run in which the rig's process always had the processor: where it stood still for longer
    than a slot, what was sent meanwhile came to it at once, and has one time on its clock."""
    for k in range(TRIES):
        with spawn(rig.simulation_settings()) as started:
            run(experiment(), rig.with_bus(**started.bus), folder / f"{k}.mcap")
        recording = load(folder / f"{k}.mcap")
        if np.nanmax(recording["drive_latency_s"]) < recording.period_s:
            return recording
    pytest.fail(f"in each of {TRIES} runs an answer of the rig came later than a slot")


@pytest.mark.wire
@pytest.mark.parametrize("effects", [{}, EFFECTS], ids=["ideal", "with effects"])
def test_a_recorded_run_is_the_offline_simulation_at_the_recorded_sync_times(
    effects: dict[str, dict[str, float]], tmp_path: Path
) -> None:
    table = load_rig("rigs/paper.toml").on_a_free_port().model_dump() | {"effects": effects}
    recording = answered_in_time(RigConfig.model_validate(table), tmp_path)
    difference = wire_less_simulation_counts(recording)
    assert difference["max"] <= 0.5 + 1e-6
