"""A model played over a recording's rows: the closed loop, or one block from its measured input.

A piece is a run of rows without a hole that begins in a known state. The closed loop is one piece
from rest. What is open and drifts (the mechanics: friction errors add up without end) is played
in windows, each from the motor's measured angle and velocity; so is the transmission if asked,
with the load on its measured side of the gap.
"""

from collections.abc import Iterator, Mapping
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from servo_bench.diagnosis.comparing.low_pass import low_passed
from servo_bench.diagnosis.comparing.rows import Array, Mask, Rows
from servo_bench.errors import FitError
from servo_bench.recording.blocks import Name
from sim_rig.model import Model, ModelState, Simulated, controller, mechanics, transmission

FEWEST_ROWS = 16
"""A piece is no shorter."""
SHORTEST_ROW = 0.1
"""Of a period: a stall's rows, which a device took all at once, are shorter."""
FILTER_PARTS, FINEST_PARTS, JUMPED_S = 8, 16, 1e-6
"""A current that is filtered is simulated so many times in a filter's time constant, but in no
more parts of a period than that; and once when a command has just jumped."""
STATE_ROWS, STATE_S = 10, 0.01
"""The state is measured over so many rows to either side, or over so much time."""


class Piece(NamedTuple):
    """Rows `first` to `last` (exclusive), and where they start."""

    first: int
    last: int
    motor_angle_rad: float = 0.0
    motor_velocity_rad_s: float = 0.0
    load_angle_rad: float | None = None

    @property
    def rows(self) -> slice:
        """The rows as a slice."""
        return slice(self.first, self.last)


class Source(NamedTuple):
    """Which block is played, and what it is given."""

    block: Name
    rows: Rows
    current_a: Array | None = None

    def pieces(self, window_s: float | None) -> tuple[Piece, ...]:
        """Whole, or in windows. FitError where no piece is left."""
        broken = self.rows.broken
        if self.block != "loop":  # what drove it, or how fast it was, nobody knows there
            broken = broken | (self.rows.durations_s < SHORTEST_ROW * self.rows.period_s)
        spans = list(_spans(~self._given(), broken))
        if window_s is not None:
            spans = [part for span in spans for part in _windows(self.rows, *span, window_s)]
        pieces = tuple(self._begun(*span, measured=window_s is not None) for span in spans)
        if not pieces:
            raise FitError(
                f"no {FEWEST_ROWS} rows in a row have all that the {self.block} is played from: "
                f"{', '.join(self._inputs())}. Record them without holes."
            )
        return pieces

    def play(self, model: Model, piece: Piece) -> Mapping[str, Array]:
        """What sensors would have shown at every row of the piece, by channel."""
        rows, at = self.rows, piece.rows
        inner = rows.durations_s[piece.first : piece.last - 1]
        time_s = float(rows.t_s[piece.first])
        if self.block == "loop":
            start = model.state(
                motor_angle_rad=piece.motor_angle_rad,
                load_angle_rad=piece.motor_angle_rad,
                time_s=time_s,
            )
            commands = rows.channel("velocity_command_rad_s")[at]
            return _sampled(model, start, commands, rows, at)
        if self.block == "mechanics" and self.current_a is not None:
            motion = mechanics(
                model,
                inner,
                self.current_a[at],
                angle_rad=piece.motor_angle_rad,
                velocity_rad_s=piece.motor_velocity_rad_s,
                time_s=time_s,
            )
            return {
                "motor_position_rad": motion.angle_rad,
                "motor_velocity_rad_s": motion.velocity_rad_s,
            }
        angle = rows.channel("motor_position_rad")[at]
        if self.block == "transmission":
            load = transmission(
                model, inner, angle, load_angle_rad=piece.load_angle_rad, time_s=time_s
            )
            return {"load_angle_rad": load}
        commands = rows.channel("velocity_command_rad_s")[at][:-1]
        return {"current_a": controller(model, inner, commands, angle, time_s=time_s)}

    def _inputs(self) -> tuple[str, ...]:
        return {
            "loop": ("velocity_command_rad_s",),
            "controller": ("velocity_command_rad_s", "motor_position_rad"),
            "mechanics": ("current",),
            "transmission": ("motor_position_rad",),
        }[self.block]

    def _given(self) -> Mask:
        """Rows in which every input came."""
        arrays = [
            self.current_a if name == "current" else self.rows.channel(name)
            for name in self._inputs()
        ]
        came = [np.isfinite(array) for array in arrays if array is not None]
        return np.asarray(np.logical_and.reduce(came))

    def _begun(self, first: int, last: int, *, measured: bool) -> Piece:
        rows = self.rows
        names = [n for n in ("motor_position_rad", "load_angle_rad") if rows.has(n)]
        if self.block != "mechanics" and not measured:
            shown = rows.channel(names[0])[first:last] if names else np.zeros(1)
            came = shown[np.isfinite(shown)]
            return Piece(first, last, float(came[0]) if came.size else 0.0)
        angle, velocity = _state(rows, first, last)
        return Piece(first, last, angle, velocity, _side(rows, first))


def _sampled(
    model: Model, start: ModelState, commands: Array, rows: Rows, at: slice
) -> dict[str, Array]:
    """The loop's channels, each at the instants at which it was sampled.

    A slot is cut where a sample is taken: the same command goes on in its second part.
    """
    durations_s = rows.durations_s[at]
    if not rows.after_s and not rows.filtered_s:
        return _shown(model.simulate(commands, durations_s, start))
    edges_s = _whole_ns(np.concatenate(([0.0], np.cumsum(durations_s))))
    asks_s, end_s = edges_s[:-1], edges_s[-1]

    def taken_s(*names: str) -> Array:
        after_s = next((rows.after_s[name][at] for name in names if name in rows.after_s), 0.0)
        return np.clip(_whole_ns(asks_s + after_s), 0.0, end_s)

    motor_s, load_s = taken_s("motor_position_rad"), taken_s("load_angle_rad")
    current_s = taken_s("current_a", "motor_position_rad")
    fine_s = _fine(model, asks_s, end_s, rows) if rows.filtered_s else asks_s
    cuts_s = np.unique(np.concatenate([asks_s, motor_s, load_s, current_s, fine_s]))
    held = np.searchsorted(asks_s, cuts_s, side="right") - 1
    lasted_s = np.diff(cuts_s, append=max(end_s, cuts_s[-1]))
    shown = _shown(model.simulate(commands[held], lasted_s, start))
    instants_s = {"load_angle_rad": load_s, "current_a": current_s}
    taken = {
        name: values[np.searchsorted(cuts_s, instants_s.get(name, motor_s))]
        for name, values in shown.items()
    }
    if rows.filtered_s:
        current_a = low_passed(cuts_s, shown["current_a"], rows.filtered_s)
        taken["current_a"] = current_a[np.searchsorted(cuts_s, current_s)]
    return taken


def _fine(model: Model, asks_s: Array, end_s: float, rows: Rows) -> Array:
    """Instants between which a current is nearly straight: those at which a command comes to act,
    however late, and just after, among them."""
    step_s = max(rows.filtered_s / FILTER_PARTS, rows.period_s / FINEST_PARTS)
    delay = model.effects.get("transport_delay")
    acts_s = asks_s + (float(delay.delay_s) if delay is not None else 0.0)
    cuts_s = np.concatenate([np.arange(0.0, end_s, step_s), acts_s, acts_s + JUMPED_S, [end_s]])
    return _whole_ns(np.minimum(cuts_s, end_s))


def _whole_ns(time_s: Array) -> Array:
    """As the simulation has them: what is at once is on the same side of a command's jump."""
    return np.asarray(np.rint(time_s * 1e9) * 1e-9)


def _shown(done: Simulated) -> dict[str, Array]:
    return {
        "motor_position_rad": done.motor_angle_rad,
        "motor_velocity_rad_s": done.motor_velocity_rad_s,
        "load_angle_rad": done.load_angle_rad,
        "current_a": done.motor_current_a,
    }


def _spans(lacking: Mask, broken: Mask) -> Iterator[tuple[int, int]]:
    """Longest runs of rows without a hole."""
    first = 0
    for k in range(broken.size):
        if lacking[k] or broken[k]:
            last = k if lacking[k] else k + 1
            if last - first >= FEWEST_ROWS:
                yield first, last
            first = k + 1


def _windows(rows: Rows, first: int, last: int, window_s: float) -> Iterator[tuple[int, int]]:
    """Windows of that length, each ending on the row where the next begins."""
    number = np.floor((rows.t_s[first:last] - rows.t_s[first]) / window_s)
    cuts = [first, *(first + np.flatnonzero(np.diff(number)) + 1).tolist(), last - 1]
    for begin, end in pairwise(cuts):
        if end + 1 - begin >= FEWEST_ROWS:
            yield int(begin), int(end) + 1


def _state(rows: Rows, first: int, last: int) -> tuple[float, float]:
    """Motor angle and velocity at row `first`, from a parabola through what lies about it."""
    reach = int(np.clip(round(STATE_S / rows.period_s), 2, STATE_ROWS))
    before = np.flatnonzero(rows.broken[:first][-reach:])
    begin = max(first - reach, 0) + (int(before[-1]) + 1 if before.size else 0)
    about = slice(begin, min(first + reach + 1, last))
    t_s = rows.t_s[about] - rows.t_s[first]
    if rows.has("motor_position_rad"):
        angle = rows.channel("motor_position_rad")[about]
        came = np.isfinite(angle)
        if came.sum() > 3:
            slope = np.polynomial.Polynomial.fit(t_s[came], angle[came], 2)
            return float(slope(0.0)), float(slope.deriv()(0.0))
    if rows.has("motor_velocity_rad_s"):
        velocity = rows.channel("motor_velocity_rad_s")[about]
        came = np.isfinite(velocity)
        if came.sum() > 2:
            line = np.polynomial.Polynomial.fit(t_s[came], velocity[came], 1)
            return 0.0, float(line(0.0))
    return 0.0, 0.0


def _side(rows: Rows, first: int) -> float | None:
    """The load's angle on the motor's scale, halfway between the faces taken as zero twist."""
    if not (rows.has("load_angle_rad") and rows.has("motor_position_rad")):
        return None
    motor, load = rows.channel("motor_position_rad"), rows.channel("load_angle_rad")
    twist = load - motor
    low, high = np.nanpercentile(twist, [2.0, 98.0])
    return float(load[first] - 0.5 * (low + high)) if np.isfinite(twist[first]) else None
