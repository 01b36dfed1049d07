"""When a sample was really taken: beside the command, late on the device's clock, or not at all."""

from dataclasses import replace
from typing import Literal

import numpy as np
import pytest

from servo_bench.diagnosis.comparing.allowance import SCALES
from servo_bench.diagnosis.comparing.comparison import compare
from servo_bench.diagnosis.comparing.evidence import evidence_of
from servo_bench.diagnosis.comparing.rows import Array, rows_of
from servo_bench.diagnosis.searching.gate import misfit
from servo_bench.recording.recording import MISSING, Recording
from servo_bench.rig import load_rig
from sim_rig.model import Model
from tests.fit_recordings import NOMINAL, PERIOD_S, commands, recorded, with_channels

MODEL = Model(NOMINAL)


def sampled_beside(seed: int, beside_s: float, slots: int = 900) -> Recording:
    """A run without noise whose load is read so long after (below zero: before) each command."""
    played = commands(seed, slots)
    cut_s = beside_s if beside_s >= 0.0 else PERIOD_S + beside_s
    halves_s = np.tile([cut_s, PERIOD_S - cut_s], played.size)
    load = MODEL.simulate(np.repeat(played, 2), halves_s).load_angle_rad[1::2]
    if beside_s < 0.0:
        load = np.concatenate([[0.0], load[:-1]])
    run = recorded(MODEL, seed, slots=slots, noise_counts=0.0)
    after_s = np.full(played.size, beside_s)
    after_s[7] = np.nan
    return with_channels(run, load_angle_rad=load, load_sampled_s=after_s)


def left(recording: Recording) -> Array:
    """Root mean square of what the model leaves in every signal, over its floor."""
    seen = compare(recording, MODEL, "loop", scales=SCALES)
    error = seen.rms(seen.errors(MODEL), seen.seen)
    return np.asarray(error / np.array([signal.floor for signal in seen.signals]))


@pytest.mark.parametrize("beside_s", [2.3e-4, 3.1e-3, -1.7e-3])
def test_a_load_that_is_read_beside_the_command_is_compared_where_it_was_read(
    beside_s: float,
) -> None:
    recording = sampled_beside(21, beside_s)
    assert np.nanmax(left(recording)) < 2.0
    untold = replace(
        recording, channels={k: v for k, v in recording.channels.items() if k != "load_sampled_s"}
    )
    assert np.nanmax(left(untold)) > 5.0


def test_a_command_acts_when_a_serial_drive_has_its_request() -> None:
    """Function 23: the same request brings the command and reads the angles."""
    rig = load_rig("rigs/modbus-rtu.toml")
    unit_function, read, write, count, command, crc = 2, 4, 4, 1, 6, 2
    request_s = (unit_function + read + write + count + command + crc) * 11 / 460800
    assert rig.command_after_s(PERIOD_S) == pytest.approx(request_s)
    run = replace(recorded(MODEL, 22), rig=rig)
    asked = np.full(len(run), request_s)
    assert not rows_of(with_channels(run, motor_sampled_s=asked, load_sampled_s=asked)).after_s
    rounded = asked + 1e-9  # one row later than all others brings none of them beside its command
    rounded[9] += 5e-6
    told = rows_of(with_channels(run, motor_sampled_s=rounded, load_sampled_s=asked)).after_s
    assert np.count_nonzero(told["motor_position_rad"]) == 1
    beside = rows_of(with_channels(run, motor_sampled_s=asked, load_sampled_s=asked - 2e-4))
    assert beside.after_s["load_angle_rad"][5] == pytest.approx(-2e-4)
    assert load_rig("rigs/paper.toml").command_after_s(PERIOD_S) == 0.0


def stalled(seed: int, at: int, late_s: float) -> tuple[Recording, Array]:
    """A host that asks in time, and a device that had one ask late and the next ones at once."""
    played = commands(seed, 900)
    asked_s = PERIOD_S * np.arange(played.size)
    took_s = asked_s.copy()
    took_s[at:] = np.maximum(took_s[at:], asked_s[at] + late_s)
    lasted_s = np.diff(took_s, append=took_s[-1] + PERIOD_S)
    done = MODEL.simulate(played, lasted_s)
    run = recorded(MODEL, seed, slots=900, noise_counts=0.0)
    torque = NOMINAL.torque_constant_nm_per_a * done.motor_current_a
    shown = {"motor_position_rad": done.motor_angle_rad, "load_angle_rad": done.load_angle_rad}
    device = np.rint(took_s * 1e6).astype(np.int64)
    run = with_channels(run, **shown, motor_torque_nm=torque)
    return replace(run, channels={**run.channels, "device_time_us": device}), lasted_s


def test_what_a_stall_delayed_counts_by_the_devices_clock() -> None:
    recording, lasted_s = stalled(23, 400, 0.052)
    assert rows_of(recording).durations_s == pytest.approx(lasted_s, abs=2e-6)
    assert np.nanmax(left(recording)) < 2.0
    device = np.full(len(recording), MISSING)
    assert np.nanmax(left(with_channels(recording, device_time_us=device))) > 5.0


@pytest.mark.parametrize("block", ["mechanics", "transmission", "controller"])
def test_a_stall_stops_no_open_block(
    block: Literal["mechanics", "transmission", "controller"],
) -> None:
    recording, _ = stalled(23, 400, 0.052)
    seen = compare(recording, MODEL, block)
    assert np.isfinite(seen.rms(seen.errors(MODEL), seen.seen)).all()


@pytest.mark.parametrize("at", [500, -1])
@pytest.mark.parametrize("jump_us", [30_000, -500_000, 4_000_000])
def test_a_clock_that_was_set_is_not_believed_where_it_jumped(jump_us: int, at: int) -> None:
    run = recorded(MODEL, 24, slots=900)
    device = np.rint(run["asked_ns"] * 1e-3).astype(np.int64)
    device[at:] += jump_us
    told = with_channels(run, device_time_us=device)
    assert rows_of(told).durations_s == pytest.approx(rows_of(run).durations_s, abs=2e-6)


def test_a_device_clock_that_begins_again_goes_on() -> None:
    """Object 0x1013 has 32 bits of microseconds: 71.6 minutes."""
    recording, lasted_s = stalled(28, 400, 0.052)
    device = (recording["device_time_us"] + (1 << 32) - 3_230_000) % (1 << 32)
    assert device[-1] < device[0]
    wrapped = replace(recording, channels={**recording.channels, "device_time_us": device})
    assert rows_of(wrapped).durations_s == pytest.approx(lasted_s, abs=2e-6)


def test_a_clock_of_coarse_ticks_times_no_row() -> None:
    """8 ms by a clock of 10 ms ticks: rows of nothing, and rows of two."""
    run = recorded(MODEL, 27, slots=900)
    device = np.rint(run["asked_ns"] * 1e-3).astype(np.int64) // 10_000 * 10_000
    told = with_channels(run, device_time_us=device)
    assert rows_of(told).durations_s.min() > 0.7 * PERIOD_S


@pytest.mark.parametrize("share", [0.002, 0.03, 0.2])
def test_samples_that_never_came_blind_no_scale(share: float) -> None:
    """A serial counter loses an answer now and then; the mean of the others is as good."""
    run = recorded(MODEL, 25, slots=1800)
    load = np.array(run["load_angle_rad"])
    load[np.random.default_rng(26).random(load.size) < share] = np.nan
    spotted = with_channels(run, load_angle_rad=load)
    evidence = evidence_of([spotted], MODEL)
    errors = evidence.seen([MODEL])[0]
    assert all(np.isfinite(row).any() for row in errors.rows)
    right = misfit(evidence, errors).max()
    assert right < 0.6
    wrong = MODEL.with_effect("backlash_width", change_rad=-0.012)
    assert misfit(evidence, evidence.seen([wrong])[0]).max() > 3.0 * right
