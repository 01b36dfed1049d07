"""A rig in a few lines, to make recordings with a known truth. Shares nothing with `sim_rig`.

command -> G(s) = (2 zeta wn s + wn^2)/(s^2 + 2 zeta wn s + wn^2) -> 1/s -> play -> load angle
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import cont2discrete, lfilter

from servo_bench.excitation.experiment import Experiment, MSequence, RandomBinary
from servo_bench.recording.recording import MISSING, SAMPLE_DTYPE, Recording

Array = NDArray[np.float64]

WN_RAD_S, ZETA = 62.5, 0.4
SUBSTEPS = 16


def experiment(
    polynomial: str = "40473",
    *,
    memory: int = 21,
    periods: int = 1,
    seed: int = 1,
    fresh: int = 8192,
) -> Experiment:
    """The paper's experiment with the assumed amplitude of 150 degrees per second."""
    amplitude = np.radians(150.0)
    return Experiment(
        name="played",
        rig="none",
        period_s=0.008,
        memory=memory,
        standstill_s=0.8,
        lead_in=256,
        identification=MSequence(polynomial=polynomial, amplitude_rad_s=amplitude, periods=periods),
        validation=RandomBinary(
            kind="random-binary", seed=seed, amplitude_rad_s=amplitude, length=fresh
        ),
    )


def play(angle: Array, gap: float) -> Array:
    """The load's angle behind a gap of full width; moves only where it is pushed."""
    half, y = gap / 2.0, 0.0
    out = []
    for x in angle.tolist():
        y = min(max(y, x - half), x + half)
        out.append(y)
    return np.array(out)


@dataclass(frozen=True)
class Rig:
    """What may go wrong with it. Delay in whole slots; jitter as a standard deviation."""

    gap_rad: float = float(np.radians(1.5))
    delay_slots: int = 0
    counts_per_revolution: int | None = 65536
    noise_rad: float = 0.0
    ask_jitter_s: float = 0.0
    seed: int = 0
    velocity_law: Callable[[Array], Array] | None = None
    """Distorts the load's velocity, for even orders."""
    holes: tuple[int, ...] = ()
    """Slots that are skipped, the command before them held; the next ask is half a period late."""

    def record(self, played: Experiment) -> Recording:
        """Play the experiment; one row for every slot."""
        schedule = played.schedule()
        rng = np.random.default_rng(self.seed)
        step_s = schedule.period_s / SUBSTEPS
        asks = np.arange(schedule.slots) * SUBSTEPS
        jitter = np.abs(rng.normal(0.0, self.ask_jitter_s / step_s, schedule.slots))
        asks = asks + np.minimum(np.rint(jitter), SUBSTEPS - 1).astype(int)
        kept = np.delete(np.arange(schedule.slots), self.holes)
        asks[np.isin(np.arange(schedule.slots), np.array(self.holes, int) + 1)] += SUBSTEPS // 2
        asks = asks[kept]
        command = np.concatenate([np.zeros(self.delay_slots), schedule.velocity_rad_s])
        fine_command = np.repeat(
            np.concatenate([[0.0], command[: schedule.slots][kept]]),
            np.diff(np.concatenate([[0], asks, [schedule.slots * SUBSTEPS]])),
        )
        load = play(_motor_angle(fine_command, step_s), self.gap_rad)
        if self.velocity_law is not None:
            load = np.cumsum(self.velocity_law(np.diff(load, prepend=0.0) / step_s)) * step_s
        angle = load[asks] + rng.normal(0.0, self.noise_rad, kept.size)
        return self._recording(played, angle, asks * step_s, kept)

    def _recording(
        self, played: Experiment, angle: Array, asked_s: Array, kept: NDArray[np.intp]
    ) -> Recording:
        schedule = played.schedule()
        rows = np.zeros(kept.size, SAMPLE_DTYPE)
        rows["slot"] = kept
        rows["phase"], rows["chip"] = schedule.phase[kept], schedule.chip[kept]
        rows["velocity_command_rad_s"] = schedule.velocity_rad_s[kept]
        rows["asked_ns"] = np.rint(asked_s * 1e9)
        rows["device_time_us"] = np.rint(asked_s * 1e6)
        rows["motor_position_counts"] = rows["load_angle_counts"] = MISSING
        rows["motor_position_rad"] = np.nan
        if self.counts_per_revolution is not None:
            unit = 2.0 * np.pi / self.counts_per_revolution
            rows["load_angle_counts"] = np.floor(angle / unit)
            angle = rows["load_angle_counts"] * unit
        rows["load_angle_rad"] = angle
        return recording_of(rows, played)


def recording_of(rows: NDArray[np.void], played: Experiment | None) -> Recording:
    """Rows as a recording without a rig."""
    return Recording(
        channels={name: np.ascontiguousarray(rows[name]) for name in rows.dtype.names or ()},
        period_s=0.008,
        experiment=played,
        rig=None,
        provenance={},
    )


def rows_of(recording: Recording) -> NDArray[np.void]:
    """The rows of a recording, to be spoilt."""
    rows = np.zeros(len(recording), SAMPLE_DTYPE)
    for name in SAMPLE_DTYPE.names or ():
        rows[name] = recording[name]
    return rows


def _motor_angle(command: Array, step_s: float) -> Array:
    numerator = np.array([2.0 * ZETA * WN_RAD_S, WN_RAD_S**2])
    denominator = np.array([1.0, 2.0 * ZETA * WN_RAD_S, WN_RAD_S**2, 0.0])
    b, a, _ = cont2discrete((numerator, denominator), step_s, method="zoh")
    return np.asarray(lfilter(b.ravel(), a, command))
