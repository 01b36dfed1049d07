"""The catalogue's effects as columns: their own laws on whole stretches, at unit strength.

Torques are in units of the effort (K_T = 1): amperes where a current drives, volts where a voltage
does. A law that is proportional to its strength gives one column, with a phase two (sine and
cosine); one that is not is taken at a few sizes, and then its coefficient must come out near one.
Every other parameter runs over a few values of its usual range, orders over the position spectrum.
"""

import itertools
import math
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from servo_bench.diagnosis.elsewhere.weak import WeakRows
from servo_bench.diagnosis.fitting.foreign_channels import Array, Stretch
from sim_rig.effects import catalogue
from sim_rig.effects.effect import Effect, Parameter, Port, Signals

PORTS = (Port.ELECTRIC_TORQUE, Port.MOTOR_TORQUE, Port.LOAD_TORQUE)
"""Between the measured effort and the measured motion; the load is taken as rigid."""
SLOWEST_SHARES = (0.006, 0.03)
"""Widths of a smoothed sign change, over the rms of the velocity."""
SLOWEST_LAW = 0.12
"""Of that too: what changes at smaller speeds is told from no change of sign."""
POINTS = 3
SLOWEST_LINE = 0.5 * math.pi
"""Largest step of a line's phase between two samples that is still seen: four a period."""
CHUNKS, WARM_UP = 256, 0.25


@dataclass(frozen=True)
class Term:
    """One effect with all chosen but its size; `strength` and `phase` name what is fitted."""

    effect: Effect
    strength: str
    phase: str | None
    shape: Mapping[str, float] = field(default_factory=dict)
    size: float | None = None

    @property
    def name(self) -> str:
        """The effect's name."""
        return self.effect.name

    @property
    def order(self) -> float | None:
        """Periods a revolution, where it is a line in the position spectrum."""
        name = order_of(self.effect, self.strength)
        return self.shape.get(name) if name is not None else None

    @property
    def complexity(self) -> tuple[int, int, int]:
        """What tells the simpler of two equals: memory, place, number of parameters."""
        far = PORTS.index(self.effect.port) if self.effect.port is Port.LOAD_TORQUE else 0
        return (int(self.effect.memory is not None), far, len(self.effect.parameters))

    def at_phase(self, phase_rad: float) -> "Term":
        """The same with its phase fixed."""
        fixed = {self.phase: phase_rad} if self.phase is not None else {}
        return replace(self, phase=None, shape={**self.shape, **fixed})

    @property
    def signed(self) -> bool:
        """Whether its strength may be negative."""
        if any(name.endswith("phase_rad") for name in self.shape):
            return True  # half a turn of its phase
        return next(p.prior.least for p in self.effect.parameters if p.name == self.strength) < 0.0

    @property
    def most(self) -> float:
        """Of its strength: a share of something that no rig has more of; else nobody knows."""
        if not self.strength.endswith("fraction"):
            return math.inf
        return next(p.prior.high for p in self.effect.parameters if p.name == self.strength)


Electric = Callable[[Stretch], Array]


def columns(term: Term, rows: WeakRows, electric: Electric) -> Array:
    """Its columns in the weak equation, in units of the effort, (rows, 1 or 2)."""
    phases = (0.0, 0.5 * math.pi) if term.phase is not None else (0.0,)

    def column(phase_rad: float) -> Array:
        return rows.column(lambda s: torque(term, s, electric(s), 1.0, phase_rad))

    return np.stack([column(phase) for phase in phases], axis=1)


def torque(
    term: Term, stretch: Stretch, electric: Array, strength: float, phase_rad: float
) -> Array:
    """The torque that the effect adds, in units of the effort; shape (points,)."""
    values = dict(term.shape) | {term.strength: strength * (term.size or 1.0)}
    if term.phase is not None:
        values[term.phase] = phase_rad
    params = term.effect.params(**values)
    signals = signals_of(stretch, electric)
    added = _law(term.effect, signals, params, stretch.step_s)
    if not term.effect.port.is_sum:
        added = added - getattr(signals, term.effect.port.value)
    added = np.broadcast_to(np.asarray(added, dtype=np.float64), electric.shape)
    order = term.order
    if order is None:
        return added
    seen = order * np.abs(stretch.velocity_rad_s) * stretch.period_s < SLOWEST_LINE
    return np.where(seen, added, 0.0)  # quicker lines pass between samples, and average out


def signals_of(stretch: Stretch, electric: Array) -> Signals:
    """What a law may read; the load is rigid."""
    return Signals(
        time_s=stretch.time_s,
        step_s=stretch.step_s,
        torque_constant_nm_per_a=1.0,
        motor_angle_rad=stretch.angle_rad,
        motor_velocity_rad_s=stretch.velocity_rad_s,
        load_angle_rad=stretch.angle_rad,
        load_velocity_rad_s=stretch.velocity_rad_s,
        contact_torque_nm=electric,
        current_a=electric,
        measured_current_a=electric,
        electric_torque_nm=electric,
        motor_torque_nm=electric,
    )


def _law(effect: Effect, signals: Signals, params: Any, step_s: float) -> Any:
    """The law along the stretch.

    With memory, chunks run side by side, each warmed up on what comes before it.
    """
    if effect.memory is None or effect.advance is None:
        return np.asarray(effect.regressor(signals, params))
    points = np.asarray(signals.motor_velocity_rad_s).size
    length = -(-points // CHUNKS)
    warm = min(round(WARM_UP / step_s), points)
    at = np.arange(CHUNKS) * length
    memory = effect.memory()
    found = np.zeros(points)
    for k in range(-warm, length):
        here = np.clip(at + k, 0, points - 1)
        now = Signals(*(v[here] if isinstance(v, np.ndarray) else v for v in signals))
        if k >= 0:
            inside = at + k < points
            value = np.broadcast_to(effect.law(now, memory, params), here.shape)
            found[here[inside]] = value[inside]
        memory = effect.advance(now, memory, params, step_s)
    return found


def candidates(
    rows: WeakRows,
    *,
    voltage: bool,
    inverse: bool = False,
    without: Collection[str],
    only: Collection[str],
) -> Iterator[Term]:
    """Every effect between effort and motion, at every shape that is tried; orders left out. Where
    the effort is explained (`inverse`), what is a part of it would explain it by itself."""
    speed = float(np.sqrt(np.mean(np.concatenate([s.velocity_rad_s for s in rows.stretches]) ** 2)))
    positioned = all(np.isfinite(s.angle_rad).all() for s in rows.stretches)
    for effect in catalogue().values():
        if effect.port not in PORTS or effect.name in without:
            continue
        if only and effect.name not in only:
            continue
        if order_of(effect, effect.strengths[0]) is not None:
            continue
        if inverse and reads_effort(effect):
            continue
        if voltage and "current_a" in effect.law.__code__.co_names:
            continue  # nobody measured it
        if not positioned and _reads_position(effect):
            continue
        for shape in _shapes(effect, speed):
            yield from _sized(effect, shape)


def reads_effort(effect: Effect) -> bool:
    """Whether its law is one of the current or of a torque that it makes."""
    return effect.port is Port.ELECTRIC_TORQUE or bool(
        {"current_a", "electric_torque_nm", "motor_torque_nm", "contact_torque_nm"}
        & set(effect.law.__code__.co_names)
    )


def _reads_position(effect: Effect) -> bool:
    names = effect.law.__code__.co_names
    return "motor_angle_rad" in names or "load_angle_rad" in names


def _shapes(effect: Effect, speed_rad_s: float) -> Iterator[dict[str, float]]:
    """Values of what is neither a strength nor a phase nor an order."""
    grids: dict[str, tuple[float, ...]] = {}
    for parameter in effect.parameters:
        name = parameter.name
        if name in effect.strengths or name.endswith(("phase_rad", "order")):
            continue
        grids[name] = _grid(parameter, speed_rad_s)
    for values in itertools.product(*grids.values()):
        yield dict(zip(grids, values, strict=True))


def _grid(parameter: Parameter, speed_rad_s: float) -> tuple[float, ...]:
    low, high = parameter.prior.low, parameter.prior.high
    if parameter.name.endswith("count"):
        return (1.0,)
    if parameter.name.startswith("transition"):
        usual = np.array(SLOWEST_SHARES) * speed_rad_s
        widths = np.clip(usual, min(low, float(usual[-1])), high)  # some axes are slow
        return tuple(float(width) for width in np.unique(widths))
    if not (math.isfinite(low) and math.isfinite(high)):
        return (parameter.default,)
    if parameter.name.endswith("_rad_s"):
        low = max(low, SLOWEST_LAW * speed_rad_s)
        high = max(high, low)
    if low > 0.0:
        return tuple(np.unique(np.geomspace(low, high, POINTS)).tolist())
    return tuple(np.linspace(low, high, POINTS).tolist())


def _sized(effect: Effect, shape: dict[str, float]) -> Iterator[Term]:
    strength = effect.strengths[0]
    phase = next((p.name for p in effect.parameters if p.name == "phase_rad"), None)
    if _is_proportional(effect, shape, strength):
        yield Term(effect, strength, phase, shape)
        return
    prior = next(p.prior for p in effect.parameters if p.name == strength)
    low, high = max(prior.low, prior.high * 1e-3), prior.high
    for size in np.geomspace(low, high, POINTS + 1):
        yield Term(effect, strength, phase, shape, float(size))


def _is_proportional(effect: Effect, shape: Mapping[str, float], strength: str) -> bool:
    ramp: Array = np.linspace(-1.0, 1.0, 64)
    time_s: Array = np.linspace(0.0, 0.63, 64)
    probe = Stretch(0, 0.01, time_s, 6.0 * ramp, np.sin(9.0 * ramp), np.cos(7.0 * ramp))
    term = Term(effect, strength, None, shape)
    one, two = (torque(term, probe, probe.effort, size, 0.0) for size in (0.1, 0.2))
    return bool(np.allclose(two, 2.0 * one, rtol=1e-6, atol=1e-12))


def order_of(effect: Effect, strength: str) -> str | None:
    """The parameter that holds the order of a strength's line: the one with the same beginning."""
    names = [p.name for p in effect.parameters if p.name.endswith("order")]
    prefix = strength.removesuffix("torque_nm").removesuffix("ripple_fraction")
    return next((n for n in names if prefix and n.startswith(prefix)), names[0] if names else None)
