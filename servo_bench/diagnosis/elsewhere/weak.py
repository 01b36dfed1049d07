"""The equation of motion without a derivative of what was measured.

    d omega/dt = g tau + ...      times a bump phi(t), and by parts:

    -integral phi' omega dt = integral phi (g tau + ...) dt,      phi = (1 - x^2)^3, |x| < 1

With the position alone, once more by parts: phi'' theta. Bumps overlap by three quarters. Source:
Messenger, Bortz, Weak SINDy, J. Comput. Phys. 443 (2021).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from servo_bench.diagnosis.elsewhere.gate import BLOCK_S
from servo_bench.diagnosis.fitting.foreign_channels import FINE, Array, Motion, Stretch

HALF_WIDTHS = (8, 16, 32)
"""Half of a bump, in samples; the shortest that keeps the sensor's noise small is taken."""
NOISE_SHARE = 0.15
"""Largest share of the sensor's noise in the rms of the acceleration."""


@dataclass(frozen=True)
class WeakRows:
    """One row a bump: `left` (rows,) is the mean acceleration, `block` which hang together."""

    stretches: tuple[Stretch, ...]
    motion: Motion
    half: int
    left: Array
    velocity_rad_s: Array
    block: NDArray[np.int64]
    record: NDArray[np.int64]

    def column(self, values: Callable[[Stretch], Array]) -> Array:
        """What a torque, given on every point of a stretch, adds on the right; (rows,)."""
        bump = _bump(self.half)
        return np.concatenate([_means(values(s), bump, self.half) for s in self.stretches])


def weak_rows(stretches: Sequence[Stretch], motion: Motion, half: int = 0) -> WeakRows:
    """Rows by the shortest bump that keeps noise small, or of that half width in points."""
    if half:
        return _rows(tuple(stretches), motion, half)
    for width in HALF_WIDTHS:
        rows = _rows(tuple(stretches), motion, width * FINE)
        if not rows.left.size or noise_share(rows) < NOISE_SHARE:
            break
    return rows


def noise_share(rows: WeakRows) -> float:
    """Sensor noise in the acceleration over its rms.

    Noise is told by third differences of the motion, a sample apart.
    """
    quick = np.concatenate([np.diff(_moved(s, rows.motion)[::FINE], 3) for s in rows.stretches])
    sigma = 1.4826 * float(np.median(np.abs(quick))) / np.sqrt(20.0)
    squares = [float(np.sum(_slopes(rows, s) ** 2)) for s in rows.stretches]
    points = [s.time_s.size for s in rows.stretches]
    noise = sigma * float(np.sqrt(FINE * np.average(squares, weights=points)))
    return float(noise / max(float(rows.left.std()), 1e-300))


def effort_noise(rows: WeakRows) -> float:
    """Noise of the effort in a row, rms, in its unit; told as the motion's."""
    quick = np.concatenate([np.diff(s.effort[::FINE], 3) for s in rows.stretches])
    sigma = 1.4826 * float(np.median(np.abs(quick))) / np.sqrt(20.0)
    return float(sigma * np.sqrt(FINE * np.sum(_bump(rows.half) ** 2)))


def _rows(stretches: tuple[Stretch, ...], motion: Motion, half: int) -> WeakRows:
    kept = tuple(s for s in stretches if s.time_s.size > 2 * half + 1)
    empty = np.zeros(0)
    rows = WeakRows(kept, motion, half, empty, empty, empty.astype(int), empty.astype(int))
    left = [_means(_moved(s, motion), _slopes(rows, s), half) for s in kept]
    block, first = [], 0
    for s, values in zip(kept, left, strict=True):
        length = max(1, round(BLOCK_S / (s.step_s * _stride(half))))
        number = first + np.arange(values.size) // length
        block.append(number)
        first = int(number[-1]) + 1
    return WeakRows(
        kept,
        motion,
        half,
        np.concatenate(left) if left else empty,
        rows.column(lambda s: s.velocity_rad_s) if left else empty,
        np.concatenate(block) if left else empty.astype(int),
        np.concatenate([np.full(v.size, s.record) for s, v in zip(kept, left, strict=True)])
        if left
        else empty.astype(int),
    )


def _moved(stretch: Stretch, motion: Motion) -> Array:
    return stretch.angle_rad if motion == "motor_position_rad" else stretch.velocity_rad_s


def _means(values: Array, kernel: Array, half: int) -> Array:
    return np.asarray(sliding_window_view(values, 2 * half + 1)[:: _stride(half)] @ kernel)


def _stride(half: int) -> int:
    return max(half // 2, 1)


def _bump(half: int) -> Array:
    x = np.linspace(-1.0, 1.0, 2 * half + 1)
    bump = (1.0 - x**2) ** 3
    return np.asarray(bump / bump.sum())


def _slopes(rows: WeakRows, stretch: Stretch) -> Array:
    """-phi' or phi'' over the sum of phi, at the stretch's own steps."""
    step_s = stretch.step_s
    x = np.linspace(-1.0, 1.0, 2 * rows.half + 1)
    total = float(((1.0 - x**2) ** 3).sum())
    if rows.motion == "motor_velocity_rad_s":
        return np.asarray(6.0 * x * (1.0 - x**2) ** 2 / (rows.half * step_s * total))
    second = (1.0 - x**2) * (30.0 * x**2 - 6.0)
    second -= second.mean()
    exact = float(second @ x**2) * (rows.half * step_s) ** 2 / 2.0
    return np.asarray(second / exact)


def adjoint(rows: WeakRows, values: Array) -> list[Array]:
    """For every stretch what (values . column of f) = (result . f) needs, shape (points,)."""
    bump, found, first = _bump(rows.half), [], 0
    for stretch in rows.stretches:
        points = stretch.time_s.size
        comb = np.zeros(points - 2 * rows.half)
        count = comb[:: _stride(rows.half)].size
        comb[:: _stride(rows.half)] = values[first : first + count]
        first += count
        found.append(np.convolve(comb, bump))
    return found
