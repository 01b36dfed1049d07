"""A small slow move there and back: does the shaft turn as told, and do the encoders count it?

An ordinary run, supervised and recorded, with limits of its own: the velocity `SPEED_RAD_S`, a
travel of `TRAVEL_RAD`, torque lowered. From the second half of the way there, when play is taken
up, by least squares

    motor's angle = a + s_motor · commanded angle        s = 1 where counts, gear and sign are right
    load's angle  = b + s_load  · motor's angle          true counts = configured counts · |s|

An encoder with a wrong sign trips (`drivers.plausible`) before the shaft has gone far.
"""

import math
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.canopen.settings import CanopenSettings
from servo_bench.devices import AnyEncoderConfig, SecondEncoderConfig
from servo_bench.errors import BenchError
from servo_bench.excitation.experiment import Experiment, MSequence, Phase, RandomBinary
from servo_bench.recording.mcap_file import load
from servo_bench.recording.recording import Recording
from servo_bench.rig import RigConfig
from servo_bench.run.axes import axis_settings
from servo_bench.run.doctor import canopen
from servo_bench.run.finding import Finding, change, note, ok, stop
from servo_bench.run.preflight import rated_torque_nm
from servo_bench.run.session import OPERATOR, run

SPEED_RAD_S = math.radians(15.0)
TRAVEL_RAD = math.radians(30.0)
TORQUE_PER_MILLE = 300
_OVERSHOOT = 4.0
_RIPPLE = 1e-3
_CLOSE = 0.03
_LEAST_RAD = math.radians(2.0)
Array = NDArray[np.float64]


def there_and_back(period_s: float) -> Experiment:
    """The move: constant velocity there, the same back."""
    slots = round(TRAVEL_RAD / SPEED_RAD_S / period_s)
    ripple_rad_s = _RIPPLE * SPEED_RAD_S  # an experiment plays sequences; this one is all bias
    return Experiment(
        name="doctor's move",
        rig="none",
        period_s=period_s,
        memory=1,
        standstill_s=0.2,
        lead_in=1,
        identification=MSequence(
            polynomial="2327", amplitude_rad_s=ripple_rad_s, bias_rad_s=SPEED_RAD_S, length=slots
        ),
        validation=RandomBinary(
            kind="random-binary",
            seed=1,
            amplitude_rad_s=ripple_rad_s,
            bias_rad_s=-SPEED_RAD_S,
            length=slots,
        ),
    )


def examine(
    rig: RigConfig,
    period_s: float,
    *,
    stop_asked: Callable[[], bool] = lambda: False,
    stopped_by: Callable[[], str] = lambda: OPERATOR,
) -> list[Finding]:
    """Move and judge; what is asked as in `run`. Raises BenchError where the drive cannot even be
    prepared, or is not left as it was found."""
    folder, kept = Path(tempfile.mkdtemp(prefix="servo-bench-")), False
    out = folder / "move.mcap"
    try:
        with _lowered(rig, period_s) as (careful, finding):
            stopped_early, ended = False, None
            try:
                move = there_and_back(period_s)
                done = run(move, careful, out, stop=stop_asked, stopped_by=stopped_by)
                stopped_early = done.stopped_early
            except BenchError as error:
                ended = error
            kept = ended is not None and out.exists()
            recording = load(out, allow_cut=True) if out.exists() else None
    finally:
        if not kept:
            shutil.rmtree(folder, ignore_errors=True)
    if stopped_early:
        return [finding, stop("move", f"it was ended by {stopped_by()}: repeat it.")]
    where = [note("recording", f"of the move as far as it came: {out}")] if kept else []
    return [finding, *judge(recording, careful, ended), *where]


@contextmanager
def _lowered(rig: RigConfig, period_s: float) -> Iterator[tuple[RigConfig, Finding]]:
    """The rig with the move's limits, its drive's torque limit lowered where it has one."""
    settings = axis_settings(rig, period_s)
    if isinstance(settings, CanopenSettings):
        rated_nm = canopen.rated_nm(settings)
        with canopen.lowered_torque(settings, TORQUE_PER_MILLE) as finding:
            yield _careful(rig, rated_nm), finding
    else:
        text = "no register for it: limits.torque_nm trips where the torque is read."
        yield _careful(rig, rated_torque_nm(rig)), note("torque limit", text)


def _careful(rig: RigConfig, rated_nm: float | None) -> RigConfig:
    limits = rig.limits
    allowed = [limits.torque_nm, rated_nm and rated_nm * TORQUE_PER_MILLE * 1e-3]
    torque_nm = min((it for it in allowed if it), default=None)
    careful = limits.model_copy(
        update={
            "velocity_rad_s": min(limits.velocity_rad_s, _OVERSHOOT * SPEED_RAD_S),
            "travel_rad": min(limits.travel_rad, 1.5 * TRAVEL_RAD),
            "torque_nm": torque_nm,
        }
    )
    return rig.model_copy(update={"limits": careful})


def judge(recording: Recording | None, rig: RigConfig, ended: BenchError | None) -> list[Finding]:
    """What the move says, however far it came."""
    findings = [] if ended is None else [stop("move", f"it was ended: {ended}")]
    if recording is None:
        return findings
    there = recording["phase"] == Phase.IDENTIFICATION
    motor_rad = recording["motor_position_rad"][there]
    commanded_rad = np.cumsum(recording["velocity_command_rad_s"][there]) * (
        recording.experiment.period_s if recording.experiment else math.nan
    )
    if motor_rad.size < 2 or not np.nanmax(np.abs(commanded_rad)) > _LEAST_RAD:
        return findings or [stop("move", "it ended before the shaft could turn by 2 deg.")]
    findings.append(_motor(_slope(commanded_rad, motor_rad), rig))
    load = rig.encoder or rig.drive.second_encoder
    if load and np.ptp(motor_rad) > _LEAST_RAD:
        where = "encoder" if rig.encoder else "drive.second_encoder"
        findings.append(_load(_slope(motor_rad, recording["load_angle_rad"][there]), where, load))
    return findings


def _slope(x: Array, y: Array) -> float:
    """Least squares over the second half of the way along x."""
    good = np.isfinite(x) & np.isfinite(y)
    x, y = x[good], y[good]
    late = np.abs(x - x[0]) >= 0.5 * np.abs(x - x[0]).max()
    x, y = x[late] - x[late].mean(), y[late] - y[late].mean()
    return float(x @ y / (x @ x)) if x.size > 1 and x @ x > 0.0 else math.nan


def _motor(slope: float, rig: RigConfig) -> Finding:
    counts = rig.drive.counts_per_revolution
    text = f"the motor's encoder counts {slope:+.3f} of what was commanded"
    if abs(slope - 1.0) < _CLOSE:
        return ok("motor", f"{text}: sign, {counts} counts a revolution, and gear agree.")
    if slope < 0.0:
        return stop(
            "motor",
            f"{text}: it counts against the command. The drive's own direction is wrong "
            "(motor phases or encoder swapped): mend that in the drive.",
        )
    return stop(
        "motor",
        f"{text}: drive.counts_per_revolution ({counts}), gear_ratio, or the velocity unit is "
        "wrong by that; or the torque limit holds the shaft.",
    )


def _load(slope: float, where: str, load: AnyEncoderConfig | SecondEncoderConfig) -> Finding:
    text = f"the load's encoder counts {slope:+.3f} of the motor's"
    if abs(slope - 1.0) < _CLOSE:
        good = f"{text}: direction and {load.counts_per_revolution} counts a revolution agree."
        return ok("load encoder", good)
    if abs(slope) < _CLOSE:
        return stop("load encoder", f"{text}: it stands. Check the coupling and its cable.")
    to_do = []
    if slope < 0.0:
        to_do.append(f"{where}.direction = {-load.direction}")
    if abs(abs(slope) - 1.0) >= _CLOSE:
        to_do.append(
            f"{where}.counts_per_revolution = about {load.counts_per_revolution * abs(slope):.0f} "
            f"(is {load.counts_per_revolution})"
        )
    return stop("load encoder", f"{text}. Set {' and '.join(to_do)}.")


def words(rig: RigConfig) -> str:
    """What will happen, for the operator to agree to."""
    return (
        f"The shaft of {rig.name} will turn {math.degrees(TRAVEL_RAD):.0f} deg at "
        f"{math.degrees(SPEED_RAD_S):.0f} deg/s and back, with at most {TORQUE_PER_MILLE / 10:g} % "
        "of the rated torque where the drive takes or tells it. Is the rig clear, and the "
        "emergency stop at hand?"
    )


def advice() -> Finding:
    """What to say where nothing was moved."""
    return change(
        "encoders",
        "direction and counts a revolution were not tried: servo-bench doctor --move turns the "
        "shaft slowly.",
    )
