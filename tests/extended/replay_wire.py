"""A recording played once more over CANopen frames between processes, in wall time."""

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from servo_bench.cli import app as cli
from servo_bench.recording.mcap_file import load
from tests.daemon_process import rig_text
from tests.small_runs import noisy_rig

pytestmark = pytest.mark.wire

NOISE_RAD = 1e-3
"""As far as the shaft turns in 0.4 ms: a machine that is late by less hides in it."""
EXPERIMENT = """
name = "three-seconds"
rig = "then.toml"
period_s = 0.008
memory = 8
standstill_s = 0.8
lead_in = 16
[identification]
polynomial = "2327"
amplitude_rad_s = 2.5
length = 200
[validation]
kind = "random-binary"
seed = 2
amplitude_rad_s = 2.5
length = 60
"""


def _call(*words: object) -> str:
    done = CliRunner().invoke(cli.app, list(map(str, words)))
    assert done.exit_code == 0, (done.output, done.exception)
    return done.output


def test_the_same_rig_on_a_wire_differs_by_its_sensors_noise_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    noise = {"load_encoder_noise_rad": NOISE_RAD, "motor_encoder_noise_rad": NOISE_RAD}
    for seed, name in ((1, "then"), (2, "now")):
        (tmp_path / f"{name}.toml").write_text(rig_text(noisy_rig(seed, **noise)))
    (tmp_path / "three.toml").write_text(EXPERIMENT)
    monkeypatch.chdir(tmp_path)
    _call("run", "three.toml", "--simulated", "-o", "then.mcap")
    told = _call(
        *("replay", "then.mcap", "--against", "now.toml", "--wire"),
        *("-o", "now.mcap", "--json", "difference.json"),
    )
    assert "slots of both runs, new less old:" in told
    then, now = load(Path("then.mcap")), load(Path("now.mcap"))
    assert now.experiment is not None
    assert now.provenance.get("time") != "virtual"
    assert now["asked_ns"][0] > then["asked_ns"][-1], "it was played, after the other had ended"
    found = json.loads(Path("difference.json").read_text())
    assert found["same_experiment"]
    signals = found["signals"]
    assert signals["command"]["rms"] == 0.0
    for name in ("motor velocity", "load velocity"):
        signal = signals[name]
        assert signal["rms_a"] > 4.0 * signal["floor"], "the shaft turned"
        # two runs, two samples in an increment: four times the variance of one sample
        assert signal["floor"] == pytest.approx(2.0 * NOISE_RAD / 0.008, rel=0.3)
        # Another rig differs in every tenth that moves; a machine that was taken away, in those
        # where it lost slots, and how many these are is not the replay's to promise.
        moving = sorted(signal["pieces"][3:])
        assert moving[1] < 1.3 * signal["floor"], signal
