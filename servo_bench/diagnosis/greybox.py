"""Grey-box fit: nominal values of the rig's own model, made free and fitted to a recording.

The model plays the recorded commands at the recorded times; what is compared is the load's
velocity (angle increments over the time between two asks), so that neither the start angle nor a
slow drift of the angle counts. The fit sees lead-in and identification; the gain is measured on
the validation phase, which it never saw.

Rigid play makes the error piecewise smooth in the gap: steps of the finite differences begin wide
(a tenth of the value) and shrink, so that the first direction is not that of a ripple.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from servo_bench.errors import ConfigError, FitError, gathered
from servo_bench.excitation.experiment import Phase
from servo_bench.recording.recording import MISSING, Recording
from sim_rig.settings import Nominal
from sim_rig.simulation import simulate

FREE_SCALES: Mapping[str, float] = {
    "inertia_kg_m2": 1e-4,
    "proportional_gain_a_s_per_rad": 0.1,
    "integral_gain_a_per_rad": 10.0,
    "backlash_gap_rad": 0.01,
}
"""Values that may be freed, with the step that counts for a value of zero. The torque constant is
not among them: without the current, K_T cannot be told from J."""

Residual = Callable[[NDArray[np.float64]], NDArray[np.float64]]
RELATIVE_STEPS = (0.1, 0.01, 0.001)
SETTLE_SLOTS = 32


@dataclass(frozen=True, slots=True)
class GreyBoxFit:
    """Fitted values and what they are worth.

    `standard_error` maps each freed name to one standard deviation, from the fit's curvature and
    its residual, taken as white. Errors are rms of the load's velocity, in rad/s; the held-out ones
    are over the validation phase.
    """

    nominal: Nominal
    free: tuple[str, ...]
    standard_error: Mapping[str, float]
    held_out_before_rad_s: float
    held_out_after_rad_s: float

    @property
    def gain(self) -> float:
        """The share of the held-out error that the fit removed, 0 to 1."""
        return 1.0 - self.held_out_after_rad_s / self.held_out_before_rad_s


def velocity_error_rad_s(recording: Recording, nominal: Nominal) -> NDArray[np.float64]:
    """Measured minus simulated load velocity, shape (rows - 1,), NaN where no angle came.

    Raises FitError where the recording has no load angle or no command.
    """
    for channel in ("load_angle_rad", "velocity_command_rad_s"):
        if channel not in recording:
            raise FitError(f"the recording has no channel {channel}: this fit needs it.")
    durations_s = np.diff(_times_s(recording))
    commands = recording["velocity_command_rad_s"]
    with gathered():
        simulated = simulate(nominal, commands, np.append(durations_s, recording.period_s))
    error: NDArray[np.float64] = np.diff(recording["load_angle_rad"] - simulated.load_angle_rad)
    return error / durations_s


def fit(recording: Recording, nominal: Nominal, free: tuple[str, ...]) -> GreyBoxFit:
    """Fit the named values to lead-in and identification; judge on the validation phase.

    Raises ConfigError for a name that cannot be freed and FitError where the data do not suffice.
    """
    for name in free:
        if name not in FREE_SCALES:
            raise ConfigError(f"{name} cannot be freed: choose from {', '.join(FREE_SCALES)}.")
    seen, held_out = _halves(recording)
    scales = np.array([abs(getattr(nominal, name)) or FREE_SCALES[name] for name in free])

    def with_values(x: NDArray[np.float64]) -> Nominal:
        return replace(nominal, **dict(zip(free, (x * scales).tolist(), strict=True)))

    def residual(x: NDArray[np.float64]) -> NDArray[np.float64]:
        return velocity_error_rad_s(recording, with_values(x))[seen]

    x = np.array([getattr(nominal, name) for name in free]) / scales
    for step in RELATIVE_STEPS:
        found = least_squares(
            residual,
            x,
            bounds=(0.0, np.inf),
            diff_step=[step] * len(free),
            loss="soft_l1",
            f_scale=_noise(x, residual),
        )
        x = found.x
    return GreyBoxFit(
        nominal=with_values(x),
        free=free,
        standard_error=_standard_errors(free, np.asarray(found.jac), residual(x), scales),
        held_out_before_rad_s=_rms(velocity_error_rad_s(recording, nominal)[held_out]),
        held_out_after_rad_s=_rms(velocity_error_rad_s(recording, with_values(x))[held_out]),
    )


def _times_s(recording: Recording) -> NDArray[np.float64]:
    """When each sample was taken, by the device's clock where it has one."""
    device = recording.channels.get("device_time_us")
    if device is not None and not np.any(device == MISSING):
        return np.asarray((device - device[0]) * 1e-6)
    asked = recording["asked_ns"]
    return np.asarray((asked - asked[0]) * 1e-9)


def _halves(recording: Recording) -> tuple[NDArray[np.bool], NDArray[np.bool]]:
    """Which increments the fit may see, and which it is judged on."""
    phase = recording["phase"][:-1]
    known = np.isfinite(np.diff(recording["load_angle_rad"]))
    seen = known & np.isin(phase, (Phase.LEAD_IN, Phase.IDENTIFICATION))
    seen[: int(np.argmax(seen)) + SETTLE_SLOTS] = False
    held_out = known & (phase == Phase.VALIDATION)
    if min(seen.sum(), held_out.sum()) < 2 * SETTLE_SLOTS:
        raise FitError(
            f"{seen.sum()} samples to fit and {held_out.sum()} held out are too few: both phases "
            f"need at least {2 * SETTLE_SLOTS}. Record a longer identification and validation."
        )
    return seen, held_out


def _noise(x: NDArray[np.float64], residual: Residual) -> float:
    """The scale beyond which a residual counts as an outlier: thrice a robust deviation."""
    return float(3.0 * 1.4826 * np.median(np.abs(residual(x))) + 1e-12)


def _standard_errors(
    free: tuple[str, ...],
    jacobian: NDArray[np.float64],
    residual: NDArray[np.float64],
    scales: NDArray[np.float64],
) -> dict[str, float]:
    information = jacobian.T @ jacobian
    variance = float(np.mean(residual**2))
    deviations = np.sqrt(np.diag(np.linalg.pinv(information)) * variance) * scales
    return dict(zip(free, deviations.tolist(), strict=True))


def _rms(values: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(values**2)))
