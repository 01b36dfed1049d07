"""A sample as a row of the slot table, and back."""

import math
from typing import Any

from drivers.axis import Sample
from servo_bench.clock import NS_PER_S
from servo_bench.recording.recording import MISSING

_COUNTS = ("device_time_us", "motor_position_counts", "load_angle_counts")
_FLOATS = (
    "motor_position_rad",
    "motor_velocity_rad_s",
    "motor_torque_nm",
    "motor_current_a",
    "load_angle_rad",
)


def write_answer(row: Any, sample: Sample) -> None:
    """Put what a sample brought into its slot's row; a command that waited for its line went out
    when the sample says."""
    row["slot"], row["asked_ns"] = sample.slot, sample.asked_ns
    for name in ("statusword", *_COUNTS, *_FLOATS):
        value = getattr(sample, name)
        if value is not None:
            row[name] = value
    for name, answered_ns in (
        ("drive_latency_s", sample.drive_answered_ns),
        ("encoder_latency_s", sample.encoder_answered_ns),
        ("motor_sampled_s", sample.motor_sampled_ns),
        ("load_sampled_s", sample.load_sampled_ns),
    ):
        if answered_ns is not None:
            row[name] = (answered_ns - sample.asked_ns) / NS_PER_S


def write_fast(row: Any, sample: Sample, slot: int) -> None:
    """Put the angles of one of a slot's several samples into its row."""
    row["slot"], row["asked_ns"] = slot, sample.asked_ns
    for name in (*_COUNTS, "motor_position_rad", "load_angle_rad"):
        value = getattr(sample, name)
        if value is not None:
            row[name] = value
    for name, sampled_ns in (
        ("motor_sampled_s", sample.motor_sampled_ns),
        ("load_sampled_s", sample.load_sampled_ns),
    ):
        if sampled_ns is not None:
            row[name] = (sampled_ns - sample.asked_ns) / NS_PER_S


def read_sample(row: Any) -> Sample:
    """The sample that `write_answer` wrote."""
    asked_ns = int(row["asked_ns"])
    drive_ns = _answered(asked_ns, float(row["drive_latency_s"]))
    return Sample(
        slot=int(row["slot"]),
        asked_ns=asked_ns,
        drive_answered_ns=drive_ns,
        encoder_answered_ns=_answered(asked_ns, float(row["encoder_latency_s"])),
        device_time_us=_count(row["device_time_us"]),
        statusword=int(row["statusword"]) if drive_ns is not None else None,
        motor_position_counts=_count(row["motor_position_counts"]),
        motor_position_rad=_value(row["motor_position_rad"]),
        motor_velocity_rad_s=_value(row["motor_velocity_rad_s"]),
        motor_torque_nm=_value(row["motor_torque_nm"]),
        motor_current_a=_value(row["motor_current_a"]),
        motor_sampled_ns=_answered(asked_ns, float(row["motor_sampled_s"])),
        load_sampled_ns=_answered(asked_ns, float(row["load_sampled_s"])),
        load_angle_counts=_count(row["load_angle_counts"]),
        load_angle_rad=_value(row["load_angle_rad"]),
    )


def _count(value: Any) -> int | None:
    return None if value == MISSING else int(value)


def _value(value: Any) -> float | None:
    return None if math.isnan(value) else float(value)


def _answered(asked_ns: int, latency_s: float) -> int | None:
    after_ns = latency_s * NS_PER_S
    return asked_ns + round(after_ns) if math.isfinite(after_ns) else None
