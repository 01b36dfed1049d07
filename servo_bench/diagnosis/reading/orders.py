"""Which orders (periods a revolution) of the motor's shaft stand in an error.

On the motor a wave d = exp(j n theta) of torque reaches the speed and the current through the
nominal loop,

    w(s) = s/(J s^2 + K_T K_P s + K_T K_I) d(s),      i(s) = -(K_P + K_I/s) w(s),

so every order, whole or not, is one filtered template. theta is the angle that was measured, where
the motor has an encoder: the loop is linear in d, but a strong wave turns the shaft from where the
nominal loop would have it by more than a period of a high order. A line counts where the share of
the error that it explains is beyond chance.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.interpolate import make_interp_spline
from scipy.signal import cont2discrete, lfilter

from servo_bench.diagnosis.comparing.comparison import Comparison
from servo_bench.diagnosis.comparing.rows import Array
from sim_rig.model import Model

FINE_S = 2e-3
FEWEST_ANGLES = 16
MOST_ROWS = 2500
LOWEST_MOTOR, HIGHEST_MOTOR = 2.6, 100.0
"""Below are weight, eccentricity and misalignment, which have effects of their own."""
USUAL = (6.0, 8.0, 10.0, 12.0, 24.0)
"""Orders that are tried where no line stands out."""
STANDS_OUT = 25.0
"""Explained over mean residual variance, of two degrees of freedom: exp(-12.5) by chance."""
FAINT = 5.0
"""What stands out by less is not looked at again when a stronger line is taken out."""


class OrderLine(NamedTuple):
    """One line: its order, its share of the error's variance, and how far it stands out."""

    order: float
    share: float
    height: float


class MotorLines(NamedTuple):
    """Lines of the motor's shaft, strongest first: of a torque (cogging), and of one that grows
    with the current (ripple)."""

    torque: tuple[OrderLine, ...]
    ripple: tuple[OrderLine, ...]


class Wave(NamedTuple):
    """A torque on the motor's shaft, torque_nm sin(order theta + phase_rad)."""

    order: float
    torque_nm: float
    phase_rad: float


def motor_lines(comparison: Comparison, model: Model, most: int = 3) -> MotorLines:
    """The lines that stand out; both empty where none does, or the loop is not what is compared."""
    if comparison.block != "loop":
        return MotorLines((), ())
    loop = _Loop.seen(comparison, model)
    return MotorLines(
        *(
            _strongest(_Shaft(loop.angle, weight), loop, most)
            for weight in (np.ones(loop.angle.size), loop.current)
        )
    )


def torque_waves(comparison: Comparison, model: Model, orders: Sequence[float]) -> tuple[Wave, ...]:
    """The waves of these orders that explain the error best together, the largest first."""
    if comparison.block != "loop" or not orders:
        return ()
    loop = _Loop.seen(comparison, model)
    shaft = _Shaft(loop.angle, np.ones(loop.angle.size))
    columns = _columns(shaft, loop, orders)
    parts = np.linalg.lstsq(columns, loop.values, rcond=None)[0].reshape(-1, 2)
    waves = [
        Wave(order, float(np.hypot(*part)), float(np.arctan2(*part)))
        for order, part in zip(orders, parts, strict=True)
    ]
    return tuple(sorted(waves, key=lambda wave: -wave.torque_nm))


class _Loop(NamedTuple):
    """What orders are looked for in: the shaft on a fine grid, the current over its rms, the errors
    and how a wave shows in them."""

    angle: Array
    current: Array
    respond: "_Response"
    targets: "Sequence[_Target]"

    @classmethod
    def seen(cls, comparison: Comparison, model: Model) -> "_Loop":
        """Of the longest piece's beginning."""
        rows, piece = comparison.source.rows, comparison.longest
        piece = piece._replace(last=min(piece.last, piece.first + MOST_ROWS))
        period_s = rows.period_s
        fine = max(1, round(period_s / FINE_S))
        commands = np.repeat(rows.channel("velocity_command_rad_s")[piece.rows], fine)
        durations = np.repeat(rows.durations_s[piece.rows] / fine, fine)
        angle_rad = piece.motor_angle_rad
        start = model.state(motor_angle_rad=angle_rad, load_angle_rad=angle_rad)
        done = model.simulate(commands, durations, start)
        rms = max(float(np.sqrt(np.mean(done.motor_current_a**2))), 1e-12)
        angle = done.motor_angle_rad
        if rows.has("motor_position_rad"):
            angle = _finely(rows.channel("motor_position_rad")[piece.rows], angle, fine)
        targets = _targets(comparison, model, piece.last - 1)
        respond = _Response(model, period_s / fine, fine)
        return cls(angle, done.motor_current_a / rms, respond, targets)

    @property
    def values(self) -> Array:
        """The whitened errors of all targets."""
        return np.concatenate([target.values for target in self.targets])


def _finely(measured: Array, simulated: Array, fine: int) -> Array:
    """The measured angle between its samples, shape of `simulated`: cubic, where it is known."""
    known = np.flatnonzero(np.isfinite(measured))
    if known.size < FEWEST_ANGLES:
        return simulated
    spline = make_interp_spline(known * fine, measured[known], k=3)
    places = np.clip(np.arange(simulated.size), known[0] * fine, known[-1] * fine)
    return np.asarray(spline(places))


class _Shaft(NamedTuple):
    """Where the shaft is, and what a wave on it is multiplied with."""

    angle: Array
    weight: Array


def _strongest(shaft: _Shaft, loop: _Loop, most: int) -> tuple[OrderLine, ...]:
    """One after another, each in what those before it leave."""
    turns = max(float(np.ptp(shaft.angle)) / (2.0 * np.pi), 0.25)
    step = float(np.clip(0.2 / turns, 0.02, 0.25))
    width = max(1.0 / turns, 0.3)
    grid = np.arange(LOWEST_MOTOR, HIGHEST_MOTOR, 2.0 * step)
    found: list[OrderLine] = []
    while len(found) < most and grid.size:
        left = _left(shaft, loop, [line.order for line in found])
        lines = [_line(shaft, loop, left, float(order)) for order in grid]
        near = max(lines, key=lambda line: line.height).order + step * np.linspace(-2.0, 2.0, 9)
        best = max((_line(shaft, loop, left, float(n)) for n in near), key=lambda it: it.height)
        if best.height < STANDS_OUT:
            break
        found.append(best)
        heights = np.array([line.height for line in lines])
        grid = grid[(np.abs(grid - best.order) > width) & (heights > FAINT)]
    return tuple(found)


def _line(shaft: _Shaft, loop: _Loop, values: Array, order: float) -> OrderLine:
    """Share of the variance that sine and cosine explain, and that over what chance would."""
    return OrderLine(order, *_explained(loop.respond.templates(shaft, order, loop.targets), values))


def _left(shaft: _Shaft, loop: _Loop, orders: Sequence[float]) -> Array:
    """What waves of these orders together leave of the errors."""
    if not orders:
        return loop.values
    columns = _columns(shaft, loop, orders)
    return np.asarray(loop.values - columns @ np.linalg.lstsq(columns, loop.values, rcond=None)[0])


def _columns(shaft: _Shaft, loop: _Loop, orders: Sequence[float]) -> Array:
    """Cosine and sine of each order, as they show; shape (points, 2 orders)."""
    found = [loop.respond.templates(shaft, order, loop.targets) for order in orders]
    return np.stack([part for t in found for part in (t.real, t.imag)], axis=1)


class _Target(NamedTuple):
    kind: str
    values: Array
    known: Array


def _targets(comparison: Comparison, model: Model, last: int) -> list[_Target]:
    """Whitened errors over one row: motor (or load) velocity, and torque. Of the longest piece's
    points to row `last`: errors are those of all pieces, one after another."""
    errors = comparison.errors(model)
    start = np.concatenate([points.start for points in comparison.pieces])
    here = (start >= comparison.longest.first) & (start < last)
    targets = []
    quick = [s for s in comparison.signals if s.increments and s.stride == 1]
    wanted = next((s for s in quick if s.channel == "motor_position_rad"), quick[0])
    for signal, row in zip(comparison.signals, errors, strict=True):
        torque = not signal.increments and signal.simulated == "current_a"
        if signal is not wanted and not torque:
            continue
        known = np.isfinite(row) & np.isfinite(comparison.measured[0]) & comparison.seen
        sigma = max(signal.floor, 1.4826 * float(np.median(np.abs(row[known]))))
        scale = sigma / signal.factor if torque else sigma
        values = np.clip(np.where(known, row, 0.0) / sigma, -4.0, 4.0)[here]
        weight = (known / scale)[here]
        targets.append(_Target("current" if torque else "velocity", values, weight))
    return targets


class _Response:
    """Templates of one order at the rows of a comparison."""

    def __init__(self, model: Model, step_s: float, fine: int) -> None:
        n = model.nominal
        self.k_p, self.k_i = n.proportional_gain_a_s_per_rad, n.integral_gain_a_per_rad
        loop = n.inertia_kg_m2, n.torque_constant_nm_per_a * self.k_p
        below = (*loop, n.torque_constant_nm_per_a * self.k_i)
        self.angle = self._discrete([1.0], below, step_s)
        self.speed = self._discrete([1.0, 0.0], below, step_s)
        self.step_s, self.fine = step_s, fine

    @staticmethod
    def _discrete(
        top: Sequence[float], below: Sequence[float], step_s: float
    ) -> tuple[Array, Array]:
        b, a, _ = cont2discrete((np.array(top), np.array(below)), step_s, method="bilinear")
        return np.asarray(b).ravel(), np.asarray(a).ravel()

    def templates(self, shaft: _Shaft, order: float, targets: Sequence[_Target]) -> Array:
        """Whitened, shape (points of all targets,), complex."""
        wave = shaft.weight * np.exp(1j * order * shaft.angle)
        turned = lfilter(*self.angle, wave)
        at_rows = turned[:: self.fine]
        parts = []
        for target in targets:
            if target.kind == "velocity":
                rate = np.diff(at_rows) / (self.fine * self.step_s)
                parts.append(rate[: target.values.size] * target.known)
            else:
                speed = lfilter(*self.speed, wave)[:: self.fine]
                current = -(self.k_p * speed + self.k_i * at_rows)[1:]
                parts.append(current[: target.values.size] * target.known)
        return np.concatenate(parts)


def _explained(template: Array, values: Array) -> tuple[float, float]:
    terms = np.stack((template.real, template.imag))
    gram = terms @ terms.T
    size = np.sqrt(np.maximum(np.diag(gram), 1e-300))
    seen = terms @ values / size
    gram = gram / np.outer(size, size) + 1e-9 * np.eye(2)
    explained = float(seen @ np.linalg.solve(gram, seen))
    total = float(values @ values)
    points = max(int(np.count_nonzero(values)), 1)
    left = max(total - explained, 1e-300) / points
    return explained / max(total, 1e-300), explained / left
