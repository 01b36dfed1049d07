"""A recording played once more over CANopen frames between processes, in wall time."""

import json
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from typer.testing import CliRunner

from servo_bench.cli import app as cli
from servo_bench.recording.mcap_file import load
from servo_bench.recording.recording import Recording
from tests.daemon_process import rig_text
from tests.small_runs import noisy_rig

pytestmark = pytest.mark.wire

Array = NDArray[np.float64]

NOISE_RAD = 1e-3
"""As far as the shaft turns in 0.4 ms: a slot that is late by half of that hides in it."""
LATE_S = 0.2e-3
SETTLED = 5
"""Slots until a shaft that was commanded late follows again."""
ENOUGH = 20
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
    quiet = _of_even_slots(then, now)
    for name, channel in (
        ("motor velocity", "motor_position_rad"),
        ("load velocity", "load_angle_rad"),
    ):
        signal = signals[name]
        assert signal["rms_a"] > 4.0 * signal["floor"], "the shaft turned"
        # Two runs, two samples in an increment: four times the variance of one sample, which
        # a hundred samples and the encoder's counts leave open to a third.
        assert signal["floor"] == pytest.approx(2.0 * NOISE_RAD / 0.008, rel=0.4)
        differences = quiet[channel]
        if differences.size < ENOUGH:
            pytest.skip(
                f"This machine gave {differences.size} slots of both runs, of 260, on time to "
                f"{LATE_S * 1e3:.1f} ms; {ENOUGH} are wanted to see noise alone between them."
            )
        assert np.sqrt(np.mean(differences**2)) < 1.7 * signal["floor"], name


def _of_even_slots(then: Recording, now: Recording) -> dict[str, Array]:
    """Difference in velocity, rad/s, of the moving slots that both runs had on time.

    A machine that was taken away plays a slot late, which shows until the shaft follows its command
    again; how many these are is not the replay's to promise. Another rig differs in all of them.
    """
    _, mine, other = np.intersect1d(then["slot"], now["slot"], return_indices=True)
    late = np.diff(then["slot"][mine], prepend=-1) != 1
    for run, rows in ((then, mine), (now, other)):
        for clock_s in (run["asked_ns"][rows] * 1e-9, run["device_time_us"][rows] * 1e-6):
            lasted_s = np.diff(clock_s, prepend=clock_s[0] - 0.008)
            late |= np.abs(lasted_s - 0.008) > LATE_S
    even = (np.convolve(late, np.ones(SETTLED))[: late.size] < 0.5) & (then["phase"][mine] >= 2)
    found = {}
    for channel in ("motor_position_rad", "load_angle_rad"):
        apart = np.diff(now[channel][other] - then[channel][mine], prepend=0.0) / 0.008
        found[channel] = apart[even & np.isfinite(apart)]
    return found
