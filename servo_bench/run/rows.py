"""A sample as a row of the slot table, and back."""

import math
from typing import Any

from drivers.axis import Sample
from servo_bench.clock import NS_PER_S
from servo_bench.recording.recording import MISSING

_COUNTS = ("device_time_us", "motor_position_counts", "load_angle_counts")
_FLOATS = ("motor_position_rad", "motor_velocity_rad_s", "motor_torque_nm", "load_angle_rad")


def write_answer(row: Any, sample: Sample) -> None:
    """Put what a sample brought into its slot's row."""
    row["slot"] = sample.slot
    for name in ("statusword", *_COUNTS, *_FLOATS):
        value = getattr(sample, name)
        if value is not None:
            row[name] = value
    for name, answered_ns in (
        ("drive_latency_s", sample.drive_answered_ns),
        ("encoder_latency_s", sample.encoder_answered_ns),
    ):
        if answered_ns is not None:
            row[name] = (answered_ns - sample.asked_ns) / NS_PER_S


def read_sample(row: Any) -> Sample:
    """The sample that `write_answer` wrote; a current that the row does not hold is None."""
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
        load_angle_counts=_count(row["load_angle_counts"]),
        load_angle_rad=_value(row["load_angle_rad"]),
    )


def _count(value: Any) -> int | None:
    return None if value == MISSING else int(value)


def _value(value: Any) -> float | None:
    return None if math.isnan(value) else float(value)


def _answered(asked_ns: int, latency_s: float) -> int | None:
    return None if math.isnan(latency_s) else asked_ns + round(latency_s * NS_PER_S)
