"""What a recording from elsewhere has: effort in, motion out, on even times, stretch by stretch.

A stretch is a part of one run without a hole. Its times are even, FINE to a sample, by straight
lines between what was measured; a velocity channel is shifted by the lag that the slope of the
position shows.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from servo_bench.errors import FitError
from servo_bench.recording.blocks import blocks_of
from servo_bench.recording.measured import TIME
from servo_bench.recording.recording import Recording

Array = NDArray[np.float64]
Kind = Literal["mechanics", "locked"]
Motion = Literal["motor_position_rad", "motor_velocity_rad_s"]

EFFORTS = ("motor_torque_nm", "torque_nm", "current_a", "motor_current_a", "voltage_v")
"""What drives the motion, what says most of it first."""
FINE = 2
HOLE_PERIODS = 12.0
FEWEST_ROWS = 64
LAGS = np.arange(-2.0, 8.25, 0.25)
"""Lags of a velocity channel that are tried, in periods."""


class Stretch(NamedTuple):
    """Channels on even times, arrays of shape (points,); `angle_rad` is NaN where none came.

    `period_s` is that of the recording's samples.
    """

    record: int
    period_s: float
    time_s: Array
    angle_rad: Array
    velocity_rad_s: Array
    effort: Array

    @property
    def step_s(self) -> float:
        """Between two points."""
        return float(self.time_s[1] - self.time_s[0])


def kind_of(recording: Recording) -> Kind | None:
    """What can be judged: mechanics, a locked output, or neither."""
    there = {block.name: block for block in blocks_of(recording)}
    if recording.plant is not None and recording.plant.output_locked:
        return "locked" if "transmission" in there and _torque(recording) else None
    inputs = set(there["mechanics"].inputs) if "mechanics" in there else set()
    return "mechanics" if inputs & set(EFFORTS) else None


def is_open(recording: Recording) -> bool:
    """Whether it came from elsewhere, with an effort and the motion (or twist) that it caused, or
    with the commands of a loop that is known. A run in slots is of a loop whose rig is not told."""
    if recording.rig is not None or TIME not in recording:
        return False
    return kind_of(recording) is not None or can_be_looped(recording)


def can_be_looped(recording: Recording) -> bool:
    """Whether the position loop that commanded it is known, and its position was recorded."""
    plant = recording.plant
    if plant is None or plant.position_loop is None or plant.output_locked:
        return False
    needed = ("position_command_rad", "motor_position_rad")
    return all(name in recording and np.isfinite(recording[name]).any() for name in needed)


def with_voltage(recording: Recording) -> Recording:
    """With the voltage that its position loop gave, u = gain (command - angle) within its limit,
    where no effort was recorded; else the recording as it is."""
    loop = recording.plant.position_loop if recording.plant is not None else None
    known = any(np.isfinite(recording[name]).any() for name in EFFORTS if name in recording)
    if loop is None or known or not can_be_looped(recording):
        return recording
    off = np.asarray(
        recording["position_command_rad"] - recording["motor_position_rad"], np.float64
    )
    most = loop.voltage_limit_v if loop.voltage_limit_v is not None else np.inf
    voltage = np.clip(loop.proportional_gain_v_per_rad * off, -most, most)
    return replace(recording, channels={**recording.channels, "voltage_v": voltage})


def effort_of(recording: Recording) -> str:
    """The channel that drives the motion. FitError where there is none."""
    for name in EFFORTS:
        if name in recording and np.isfinite(recording[name]).any():
            return name
    raise FitError(
        f"no effort is among {', '.join(sorted(recording.channels))}: one of {', '.join(EFFORTS)} "
        "is needed beside the motion. Map the column that holds the current or the voltage."
    )


def torque_of(recording: Recording) -> str:
    """The torque that twists a locked transmission; the command is free of noise."""
    found = _torque(recording)
    if found is None:
        raise FitError(
            f"no torque is among {', '.join(sorted(recording.channels))}: a locked output needs "
            "torque_command_nm, torque_nm, motor_torque_nm or current_a. Map one of them."
        )
    return found


def _torque(recording: Recording) -> str | None:
    names = ("torque_command_nm", "torque_nm", "motor_torque_nm", "current_a")
    return next((n for n in names if n in recording and np.isfinite(recording[n]).any()), None)


def velocity_lag_s(recording: Recording) -> float:
    """By how much the velocity channel comes after the slope of the position."""
    if not {"motor_position_rad", "motor_velocity_rad_s"} <= set(recording.channels):
        return 0.0
    misfits = np.zeros(LAGS.size)
    for rows in _pieces(recording):
        time_s, angle = recording["t_s"][rows], recording["motor_position_rad"][rows]
        slope = np.diff(angle) / np.diff(time_s)
        middle = 0.5 * (time_s[1:] + time_s[:-1])
        speed = recording["motor_velocity_rad_s"][rows]
        for k, lag in enumerate(LAGS):
            off = slope - np.interp(middle + lag * recording.period_s, time_s, speed)
            misfits[k] += float(np.sum(np.abs(off)))
    return float(LAGS[np.argmin(misfits)]) * recording.period_s


def stretches(
    recording: Recording, record: int, motion: Motion, effort: str
) -> tuple[Stretch, ...]:
    """Every stretch. With `motion` the position, velocity is its slope, else its own channel."""
    lag_s = velocity_lag_s(recording)
    found = []
    for rows in _pieces(recording):
        measured_s = recording["t_s"][rows]
        step_s = recording.period_s / FINE
        margin_s = max(lag_s, 0.0)
        count = int((measured_s[-1] - measured_s[0] - margin_s) / step_s)
        if count < FINE * FEWEST_ROWS:
            continue
        time_s = measured_s[0] + step_s * np.arange(count)
        angle = np.full(count, np.nan)
        if "motor_position_rad" in recording:
            angle = np.interp(time_s, measured_s, recording["motor_position_rad"][rows])
        if motion == "motor_position_rad":
            speed = np.gradient(angle, step_s)
        else:
            channel = recording["motor_velocity_rad_s"][rows]
            speed = np.interp(time_s + lag_s, measured_s, channel)
        driven = np.interp(time_s, measured_s, recording[effort][rows])
        found.append(Stretch(record, recording.period_s, time_s, angle, speed, driven))
    return tuple(found)


def _pieces(recording: Recording) -> Iterator[NDArray[np.intp]]:
    """Rows of every part of a run without a hole in which the drive was on."""
    time_s = recording["t_s"]
    usable = np.isfinite(time_s)
    for name, values in recording.channels.items():
        if "enable" in name:
            usable &= values != 0
        elif name in (*EFFORTS, "motor_position_rad", "motor_velocity_rad_s"):
            usable &= np.isfinite(values)
    rows = np.flatnonzero(usable)
    hole = np.diff(time_s[rows]) > HOLE_PERIODS * recording.period_s
    hole |= np.diff(rows) > HOLE_PERIODS
    hole |= np.diff(time_s[rows]) <= 0.0
    if "run" in recording:
        hole |= np.diff(recording["run"][rows]) != 0
    for piece in np.split(rows, np.flatnonzero(hole) + 1):
        if piece.size >= FEWEST_ROWS:
            yield piece
