"""Recordings of a model's own simulation, with the sensors' noise: the truth is known to the digit.

Phases as in a run: standstill, lead-in, identification, validation. Two amplitudes and a pause now
and then, so that friction and damping, and both directions, show.
"""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from servo_bench.excitation.experiment import Phase
from servo_bench.recording.recording import Recording
from sim_rig.model import Model
from sim_rig.settings import Nominal

NOMINAL = Nominal(0.03606, 2.5e-4, 0.3466, 27.08, math.radians(1.5))
PERIOD_S = 0.008
COUNTS = 65536
STANDSTILL, LEAD_IN, VALIDATION = 60, 40, 160
RUN = ("motor_position_rad", "motor_torque_nm", "load_angle_rad")


def commands(seed: int, slots: int) -> NDArray[np.float64]:
    """Random signs at two amplitudes, held for up to six slots, after a standstill."""
    rng = np.random.default_rng(seed)
    moving = np.repeat(rng.choice([-6.0, -2.0, 0.0, 2.0, 6.0], slots), rng.integers(1, 7, slots))
    return np.concatenate((np.zeros(STANDSTILL), moving[:slots]))


def recorded(
    model: Model,
    seed: int,
    *,
    slots: int = 600,
    noise_counts: float = 1.0,
    channels: tuple[str, ...] = RUN,
    jitter_s: float = 0.0,
    period_s: float = PERIOD_S,
    played: NDArray[np.float64] | None = None,
) -> Recording:
    """A run of this model: encoders of 65536 counts with white noise, torque with 0.2 mN m."""
    rng = np.random.default_rng((seed, 1))
    played = commands(seed, slots) if played is None else played
    durations_s = period_s + jitter_s * rng.uniform(-1.0, 1.0, played.size)
    asked_ns = np.rint(np.concatenate(([0.0], np.cumsum(durations_s[:-1]))) * 1e9).astype(np.int64)
    done = model.simulate(played, np.append(np.diff(asked_ns) * 1e-9, period_s))
    noise = noise_counts * rng.standard_normal((3, played.size))
    quantum = math.tau / COUNTS

    def encoder(angle_rad: NDArray[np.float64], white: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(np.rint(angle_rad / quantum + white) * quantum)

    phase = np.full(played.size, Phase.IDENTIFICATION, np.uint32)
    phase[:STANDSTILL] = Phase.STANDSTILL
    phase[STANDSTILL : STANDSTILL + LEAD_IN] = Phase.LEAD_IN
    phase[-VALIDATION:] = Phase.VALIDATION
    shown = {
        "motor_position_rad": encoder(done.motor_angle_rad, noise[0]),
        "load_angle_rad": encoder(done.load_angle_rad, noise[1]),
        "motor_torque_nm": model.nominal.torque_constant_nm_per_a * done.motor_current_a
        + 0.2e-3 * noise[2],
    }
    return Recording(
        channels={
            "slot": np.arange(played.size),
            "phase": phase,
            "asked_ns": asked_ns,
            "velocity_command_rad_s": played,
            **{name: shown[name] for name in channels},
        },
        period_s=period_s,
        experiment=None,
        rig=None,
        provenance={},
    )


def nominal_with(**factors: float) -> Nominal:
    """The nominal rig with some values multiplied."""
    return replace(NOMINAL, **{name: f * getattr(NOMINAL, name) for name, f in factors.items()})


def with_channels(recording: Recording, **channels: NDArray[np.float64]) -> Recording:
    """The same recording with some channels replaced or added."""
    return replace(recording, channels={**recording.channels, **channels})


def rows(recording: Recording, kept: NDArray[np.intp]) -> Recording:
    """Only these rows."""
    return replace(recording, channels={n: v[kept] for n, v in recording.channels.items()})
