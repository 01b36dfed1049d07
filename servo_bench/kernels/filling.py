"""Kernels from periods in which some samples are spoilt by a hole in the run.

The correlation needs whole periods. A spoilt sample is filled with what another period has at the
same chip, else with what the kernels themselves predict there, and the kernels are extracted anew
until nothing changes (the expectation-maximisation of a linear estimate). What is filled adds no
information: the kernels are those of the samples that are left.
"""

import numpy as np
from numpy.typing import NDArray

from servo_bench.kernels.played import Played, as_played
from servo_bench.kernels.predict import predict
from servo_bench.kernels.volterra import Kernels

Array = NDArray[np.float64]

ROUNDS = 30
SETTLED = 1e-6
"""Filling ends where no filled sample moves by more than this share of the response's deviation."""


def spoilt_by(disturbed: NDArray[np.bool_], memory: int) -> NDArray[np.bool_]:
    """Which responses a disturbed slot reaches: its own and the `memory` after it; shape kept."""
    reach = np.convolve(disturbed, np.ones(memory + 1))[: disturbed.size]
    spoilt: NDArray[np.bool_] = reach > 0.5
    return spoilt


def extract_filled(
    periods: Array,
    spoilt: NDArray[np.bool_],
    sequence: Played | str,
    amplitude: float,
    memory: int,
    *,
    period_s: float,
) -> tuple[Kernels, Array]:
    """Kernels to order 3 of `periods`, shape (periods, N), and the periods as they were filled.

    `spoilt` has the same shape; a polynomial alone is that M-sequence. Errors as the extraction's.
    """
    played = as_played(sequence)
    filled = _from_other_periods(periods, spoilt)
    alone = spoilt & spoilt.all(axis=0)
    filled[alone] = float(periods[~spoilt].mean()) if not spoilt.all() else 0.0
    kernels = played.kernels(filled, amplitude, memory, period_s=period_s)
    if not alone.any():
        return kernels, filled
    chips = played.chips
    scale = float(filled.std())
    for _ in range(ROUNDS):
        predicted = np.broadcast_to(predict(kernels, chips, history=chips), filled.shape)
        moved = float(np.abs(filled[alone] - predicted[alone]).max())
        filled[alone] = predicted[alone]
        kernels = played.kernels(filled, amplitude, memory, period_s=period_s)
        if moved < SETTLED * scale:
            break
    return kernels, filled


def _from_other_periods(periods: Array, spoilt: NDArray[np.bool_]) -> Array:
    """Spoilt samples replaced by the mean of the good ones at the same chip, if any."""
    good = ~spoilt
    count = good.sum(axis=0)
    mean = np.where(good, periods, 0.0).sum(axis=0) / np.maximum(count, 1)
    return np.where(spoilt & (count > 0), mean, periods)
