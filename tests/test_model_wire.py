"""The software rig on the wire runs the model that can be simulated offline, sample by sample."""

from pathlib import Path

import pytest

from servo_bench.benchmark.experiment import wire_less_simulation_counts
from servo_bench.recording.mcap_file import load
from servo_bench.rig import RigConfig, load_rig
from servo_bench.run.session import run
from sim_rig.process import spawn
from tests.test_run_session import experiment

EFFECTS = {
    "coulomb": {"torque_nm": 0.01},
    "cogging": {"torque_nm": 0.01, "order": 12.0},
    "gravity_imbalance": {"torque_nm": 0.02},
    "encoder_eccentricity": {"amplitude_rad": 0.001},
}


@pytest.mark.wire
@pytest.mark.parametrize("effects", [{}, EFFECTS], ids=["ideal", "with effects"])
def test_a_recorded_run_is_the_offline_simulation_at_the_recorded_sync_times(
    effects: dict[str, dict[str, float]], tmp_path: Path
) -> None:
    table = load_rig("rigs/paper.toml").on_a_free_port().model_dump() | {"effects": effects}
    rig = RigConfig.model_validate(table)
    with spawn(rig.simulation_settings()) as started:
        run(experiment(), rig.with_bus(**started.bus), tmp_path / "run.mcap")
    difference = wire_less_simulation_counts(load(tmp_path / "run.mcap"))
    assert difference["max"] <= 0.5 + 1e-6
