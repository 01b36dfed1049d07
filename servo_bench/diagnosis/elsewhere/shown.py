"""What a picture of such a verdict needs: data, the plain model, and the one with its causes."""

from typing import NamedTuple

from servo_bench.diagnosis.fitting.foreign_channels import Array


class Shown(NamedTuple):
    """Rows that no fit saw, in the order of time; arrays of shape (rows,).

    `over` is what the signal is a law of, in `over_unit`: torque of a twist, speed of an effort.
    Where it is the time, the signal is a motion.
    """

    signal: str
    unit: str
    over_name: str
    over_unit: str
    time_s: Array
    over: Array
    measured: Array
    plain: Array
    extended: Array
