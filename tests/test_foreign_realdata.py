"""Measured data from four other benches, by the maps that ship: what is known of them is there.

Read from SERVO_BENCH_REALDATA; a file that is absent is skipped. What is asserted comes from those
who measured (their scripts, papers and readmes) or from the data themselves, by other means.
"""

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from servo_bench.foreign.importing import read_foreign
from servo_bench.foreign.maps import load_map
from servo_bench.recording.blocks import blocks_of
from servo_bench.recording.mcap_file import load
from servo_bench.recording.measured_writer import save_measured
from servo_bench.recording.recording import Recording
from tests.foreign_files import measured

LAAS = (
    "acc_current",
    "rolling_data1",
    "rolling_data2",
    "speed_test",
    "speed_test1",
    "stopped_data",
)
BAM = {"10h28m10": 100, "10h28m49": 200, "10h30m10": 800}
CYCLOIDAL = {
    "2024-07-11__15-47-12__torqueramp__base_runin1.csv": 2.50,
    "2024-07-12__16-23-23__torqueramp__conic_3pre1.csv": 0.55,
}


@cache
def _read(path: Path, name: str) -> Recording:
    return read_foreign(path, load_map(f"maps/{name}.toml"))


def laas(name: str) -> Recording:
    return _read(measured(f"laas_cogging/{name}.txt"), "laas_cogging")


def bam(name: str) -> Recording:
    return _read(measured(f"bam_xl330/2026-01-15_{name}.json"), "bam_xl330")


def undcmotor(name: str) -> Recording:
    return _read(measured(f"undcmotor/DCmotor_{name}.csv"), "undcmotor")


def cycloidal(name: str) -> Recording:
    return _read(measured(f"cycloidal_play/{name}"), "cycloidal_play")


def lines(path: Path) -> int:
    return len(path.read_text().splitlines())


@pytest.mark.parametrize("name", LAAS)
def test_laas_every_file_is_read_whole_and_reads_back(name: str, tmp_path: Path) -> None:
    recording = laas(name)
    assert len(recording) == lines(measured(f"laas_cogging/{name}.txt")) - 1
    assert {"motor_position_rad", "motor_velocity_rad_s", "current_a"} <= set(recording.channels)
    assert ("anti_cogging" in recording) == name.startswith("speed")
    assert "mechanics" in [block.name for block in blocks_of(recording)]
    save_measured(recording, tmp_path / "a.mcap")
    loaded = load(tmp_path / "a.mcap")
    for channel, values in recording.channels.items():
        assert loaded[channel].tobytes() == values.tobytes()
    assert (loaded.provenance, loaded.events) == (recording.provenance, recording.events)


def test_laas_the_current_is_the_sine_that_their_script_commanded() -> None:
    """ud.refCurrent0 = 0.4 sin(2 pi 2 now): amplitude, frequency, and a jittering millisecond."""
    recording = laas("acc_current")
    t, current = recording["t_s"], recording["current_a"]

    def amplitude(frequency_hz: float) -> float:
        phase = 2 * np.pi * frequency_hz * t
        basis = np.column_stack([np.cos(phase), np.sin(phase), np.ones(t.size)])
        return float(np.hypot(*np.linalg.lstsq(basis, current)[0][:2]))

    frequencies = np.arange(1.99, 2.01, 0.0005)
    best = frequencies[np.argmax([amplitude(f) for f in frequencies])]
    assert best == pytest.approx(2.0, abs=0.002)
    assert amplitude(2.0) == pytest.approx(0.4, rel=0.05)
    steps = np.diff(t)
    assert recording.period_s == pytest.approx(1e-3, rel=1e-6)
    assert steps.min() == pytest.approx(2e-4, abs=1e-9)
    assert steps.max() > 5e-3


def test_laas_the_drivers_velocity_is_the_slope_of_the_position() -> None:
    recording = laas("rolling_data1")
    t, angle = recording["t_s"], recording["motor_position_rad"]
    slope = np.polyfit(t, angle, 1)[0]
    assert slope == pytest.approx(recording["motor_velocity_rad_s"].mean(), rel=2e-3)


def test_laas_the_speed_loop_was_asked_for_one_turn_a_second() -> None:
    for name, first in (("speed_test", 1), ("speed_test1", 0)):
        recording = laas(name)
        np.testing.assert_allclose(recording["velocity_command_rad_s"], 2 * np.pi, rtol=1e-6)
        flag = recording["anti_cogging"]
        assert flag.dtype == np.int64
        assert set(flag) == {0, 1}
        assert flag[0] == first
        turned = recording["motor_position_rad"][-1] - recording["motor_position_rad"][0]
        assert turned / recording["t_s"][-1] == pytest.approx(2 * np.pi, rel=0.25)


def test_laas_anti_cogging_steadies_the_speed_as_they_say() -> None:
    recording = laas("speed_test1")
    settled = recording["t_s"] > 2.0
    on = recording["anti_cogging"] == 1
    ripple = recording["motor_velocity_rad_s"]
    assert ripple[on & settled].std() < ripple[~on & settled].std()


@pytest.mark.parametrize(("name", "kp"), BAM.items())
def test_bam_the_pendulum_is_the_one_that_was_hung_on(name: str, kp: int) -> None:
    recording = bam(name)
    assert recording.plant is not None
    pendulum, loop = recording.plant.pendulum, recording.plant.position_loop
    assert pendulum is not None
    assert loop is not None
    assert (pendulum.mass_kg, pendulum.length_m) == (0.49, 0.1)
    # counts per radian, over their divisor 256 and the full PWM 885, times the supply
    gain = kp * 4096 / (2 * np.pi) / (256 * 885) * 7.4
    assert loop.proportional_gain_v_per_rad == pytest.approx(gain, rel=1e-6)
    assert loop.voltage_limit_v == 7.4


def test_bam_rates_lengths_and_ranges() -> None:
    """Six seconds at about 190 Hz, irregular; the motor warmed from 28 to 39 degrees."""
    recording = bam("10h28m10")
    assert 1.0 / recording.period_s == pytest.approx(190, abs=5)
    assert np.ptp(recording["t_s"]) == pytest.approx(6.0, abs=0.01)
    assert np.unique(np.diff(recording["t_s"])).size > 100
    assert recording["temperature_c"].min() >= 27
    assert bam("10h30m10")["temperature_c"].max() >= 38
    assert np.abs(recording["voltage_v"]).max() <= recording["supply_voltage_v"].max()


def test_bam_the_voltage_is_what_their_position_loop_gives() -> None:
    """duty = error_gain kp (goal - position), their own law, on a slow trajectory."""
    name, kp = "10h28m57", 200  # up_and_down
    recording = bam(name)
    duty = recording["voltage_v"] / recording["supply_voltage_v"]
    error = recording["position_command_rad"] - recording["motor_position_rad"]
    slope = np.polyfit(error, duty, 1)[0]
    assert slope == pytest.approx(kp * 4096 / (2 * np.pi) / (256 * 885), rel=0.1)


def test_bam_the_servos_velocity_is_the_slope_of_its_position() -> None:
    recording = bam("10h30m10")
    slope = np.gradient(recording["motor_position_rad"], recording["t_s"])
    given = recording["motor_velocity_rad_s"]
    assert np.corrcoef(slope, given)[0, 1] > 0.95
    assert np.polyfit(slope, given, 1)[0] == pytest.approx(1.0, abs=0.1)


def chips(recording: Recording, hold: int) -> NDArray[np.int64]:
    high = (recording["voltage_v"] > recording["voltage_v"].mean()).astype(np.int64)
    changes = np.flatnonzero(np.diff(high)) + 1
    assert (changes % hold == 0).all()
    return high[::hold]


def test_undcmotor_the_voltage_is_a_10_bit_prbs_at_50_hz() -> None:
    """Two levels, held for 8 samples; every chip obeys x^10 + x^7 + 1, which is primitive."""
    recording = undcmotor("prbs_open_exp")
    assert len(recording) == 4093
    assert np.unique(recording["voltage_v"]).size == 2
    np.testing.assert_allclose(np.diff(recording["t_s"]), 0.02, rtol=1e-6)
    bits = chips(recording, hold=8)
    assert (bits[10:] == bits[7:-3] ^ bits[:-10]).all()
    assert bits.size > 500


def test_undcmotor_the_speed_is_quantised_as_its_encoder_is() -> None:
    """2800 counts a revolution, counted for 20 ms: steps of 360/2800/0.02 = 6.43 deg/s."""
    speed = undcmotor("prbs_open_exp")["motor_velocity_rad_s"]
    step = 2 * np.pi / 2800 / 0.02
    counts = speed / step
    np.testing.assert_allclose(counts, np.rint(counts), atol=1e-5)


def test_undcmotor_more_voltage_is_more_speed() -> None:
    recording = undcmotor("step_open_exp")
    voltage, speed = recording["voltage_v"], recording["motor_velocity_rad_s"]
    low, high = np.unique(voltage)
    assert speed[voltage == high][-100:].mean() > 1.2 * speed[voltage == low][:100].mean()


@pytest.mark.parametrize("name", CYCLOIDAL)
def test_cycloidal_runs_are_ramps_of_torque_on_a_locked_output(name: str) -> None:
    recording = cycloidal(name)
    assert len(recording) == lines(measured(f"cycloidal_play/{name}")) - 1
    assert recording.plant is not None
    assert recording.plant.output_locked
    assert [block.name for block in blocks_of(recording)] == ["transmission", "loop"]
    run, command = recording["run"], recording["torque_command_nm"]
    assert np.unique(run).tolist() == [0, 1, 2, 3, 4, 100, 101, 102]
    for number in np.unique(run):
        ramp = command[run == number]
        peak = 4.0 if number < 100 else 40.0
        assert (ramp.max(), ramp.min()) == pytest.approx((peak, -peak), rel=0.01)
        quarters = np.array_split(np.abs(ramp), 4)
        shape = [np.polyfit(np.arange(part.size), part, 1)[0] > 0 for part in quarters]
        assert shape == [True, False, True, False]
    assert not recording["fault"].any()


@pytest.mark.parametrize("name", CYCLOIDAL)
def test_cycloidal_times_are_spread_within_the_hosts_ticks(name: str) -> None:
    recording = cycloidal(name)
    raw = np.loadtxt(measured(f"cycloidal_play/{name}"), delimiter=",", skiprows=1, usecols=0)
    moved = recording["t_s"] - raw
    assert (moved >= 0).all()
    assert (moved < 0.032).all()
    within = np.diff(recording["run"]) == 0
    assert (np.diff(recording["t_s"])[within] > 0).all()
    repeated = int((np.diff(raw)[within] == 0).sum())
    assert [event.data for event in recording.events] == [{"rows": repeated}]
    # a ramp is linear in time: the spread times make it straighter than the ticks do
    first = recording["run"] == 100
    torque = recording["torque_command_nm"][first]
    rising = slice(100, torque.size // 4 - 100)
    ours, ticks = (
        np.polyfit(t[first][rising], torque[rising], 1, full=True)[1][0]
        for t in (recording["t_s"], raw)
    )
    assert ours < 0.5 * ticks


@pytest.mark.parametrize(("name", "play_deg"), CYCLOIDAL.items())
def test_cycloidal_the_play_that_was_published_is_in_the_position(
    name: str, play_deg: float
) -> None:
    """The position's range over a small ramp is the play and a little twist."""
    recording = cycloidal(name)
    for number in range(5):
        swing = np.ptp(np.rad2deg(recording["motor_position_rad"][recording["run"] == number]))
        assert play_deg < swing < play_deg + 0.6
