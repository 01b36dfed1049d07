"""A locked output: twist against torque.

    twist = c tau + (b/2) s + offset,      s = clip(p / d, -1, 1)

    c    compliance of the transmission
    b    play; p is the torque less what friction holds back, an interval of half width F that the
         torque drags along (play operator), about m where friction is not the same either way
    d    over which torque the play is crossed

A spring alone is the base, with the play that the map declares, if any. Friction without more play
is twist = c p. Source of the operator:
Visintin, Differential Models of Hysteresis (1994), ch. III.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from servo_bench.diagnosis.elsewhere import gate
from servo_bench.diagnosis.elsewhere.shown import Shown
from servo_bench.diagnosis.fitting.foreign_channels import Array, torque_of
from servo_bench.errors import FitError
from servo_bench.recording.recording import Recording

POINTS = 1500
"""Rows that are used of each group of runs."""
FRICTIONS = np.linspace(0.0, 0.9, 19)
MIDDLES = np.linspace(-0.4, 0.4, 9)
CROSSINGS = (0.03, 0.06, 0.1, 0.15, 0.22, 0.3, 0.4)
"""Half width F, middle m and crossing d that are tried, over the largest torque of the runs."""
CROSSED = 0.96
"""Share of the largest torque by which a play must have been crossed, F + |m| + d: of one that was
crossed by halves any width fits. Over 79 recordings of printed gears the play was 0.83 to 1.21 of
the twist's opening without torque so, and 0.95 to 1.50 without that."""
ALIKE_PEAKS = 1.5
"""Runs whose largest torques differ by less are judged together; the gentlest ones tell play."""
BLOCKS = 40


@dataclass(frozen=True)
class Twist:
    """One fit: `numbers` is (compliance, play, offset), errors in rad over the chosen rows. Play of
    `gap_rad` was given, and is no number of it."""

    numbers: Array
    friction_nm: float
    middle_nm: float
    crossing_nm: float
    errors: Array
    covariance: Array
    gap_rad: float = 0.0

    @property
    def rms_rad(self) -> float:
        """Of what it leaves."""
        return float(np.sqrt(np.mean(self.errors**2)))


@dataclass(frozen=True)
class LockedFinding:
    """The rivals, fitted to the first runs, and their errors on the last ones, where the twist is
    as large as `there` and what the spring leaves has so much `noise` (rms from row to row)."""

    spring: Twist
    hysteresis: Twist
    play: Twist
    held: dict[str, float]
    there: float
    noise: float
    z: float
    over_hysteresis: float
    share: float
    shown: Shown
    amperes: bool = False
    """Whether torques are told as the current that makes them."""

    @property
    def seen_share(self) -> float:
        """Share of the error's square that play takes on the runs that it was fitted to."""
        return 1.0 - (self.play.rms_rad / max(self.spring.rms_rad, 1e-300)) ** 2


def judge_locked(recording: Recording, held_out: Recording | None = None) -> LockedFinding:
    """Spring, spring with friction, spring with play. FitError where torque never reversed."""
    torque, twist, run, time_s = _ramp(recording)
    unseen = _ramp(held_out) if held_out is not None else _Ramp(torque, twist, run, time_s)
    seen = np.ones(run.size, bool) if held_out is not None else _first(run)
    judged = np.ones(unseen.run.size, bool) if held_out is not None else ~seen
    _need_reversal(torque[seen])
    grid = _grid(torque)
    gap_rad = _declared_gap_rad(recording)
    plainly = grid if gap_rad else grid[:, :1]
    fits = {
        "spring": _fit(torque, twist, seen, plainly, ("torque",), gap_rad=gap_rad),
        "hysteresis": _fit(torque, twist, seen, grid, ("dragged",), gap_rad=gap_rad),
        "play": _fit(torque, twist, seen, grid, ("torque", "side")),
    }
    left = {name: _errors(fit, name, unseen.torque, unseen.twist) for name, fit in fits.items()}
    errors = {name: values[judged] for name, values in left.items()}
    squares = {name: _blocks(values**2) for name, values in errors.items()}
    before, after = squares["spring"], squares["play"]
    return LockedFinding(
        **fits,
        held={name: float(np.sqrt(np.mean(values**2))) for name, values in errors.items()},
        there=float(np.std(unseen.twist[judged])),
        noise=float(np.sqrt(0.5 * np.mean(np.diff(errors["spring"]) ** 2))),
        z=_z(before - after),
        over_hysteresis=_z(squares["hysteresis"] - after),
        share=float((before.sum() - after.sum()) / max(before.sum(), 1e-300)),
        shown=_shown(_Ramp(*(values[judged] for values in unseen)), errors, recording),
        amperes=_in_amperes(recording),
    )


def _first(run: Array) -> NDArray[np.bool_]:
    """What a fit may see: all but the last third of the runs, or of the only one."""
    numbers = np.unique(run)
    if numbers.size > 1:
        return np.asarray(~np.isin(run, numbers[-max(1, numbers.size // 3) :]))
    return np.asarray(np.arange(run.size) < run.size - run.size // 3)


def _declared_gap_rad(recording: Recording) -> float:
    """What the map tells of play, zero where it tells none."""
    return (recording.plant and recording.plant.backlash_gap_rad) or 0.0


def _in_amperes(recording: Recording) -> bool:
    """Whether the torque is a current whose motor nobody has described."""
    plant = recording.plant
    known = plant is not None and plant.torque_constant_nm_per_a is not None
    return torque_of(recording) == "current_a" and not known


def _shown(ramp: "_Ramp", errors: Mapping[str, Array], recording: Recording) -> Shown:
    models = (ramp.twist - errors["spring"], ramp.twist - errors["play"])
    told = (ramp.time_s, ramp.torque, ramp.twist, *models)
    effort = ("current", "A") if _in_amperes(recording) else ("torque", "N m")
    return Shown("twist", "rad", *effort, *told)


class _Ramp(NamedTuple):
    """Torque, twist, run and time of rows, each of shape (rows,)."""

    torque: Array
    twist: Array
    run: Array
    time_s: Array


def _ramp(recording: Recording) -> _Ramp:
    """The gentlest runs, thinned alike."""
    name, plant = torque_of(recording), recording.plant
    per_unit = plant.axis_nm_per_a if plant is not None else None
    factor = per_unit if name == "current_a" and per_unit is not None else 1.0
    torque = factor * np.asarray(recording[name], dtype=np.float64)
    twist = np.asarray(recording["motor_position_rad"], dtype=np.float64)
    run = np.asarray(recording["run"] if "run" in recording else np.zeros(torque.size))
    known = np.isfinite(torque) & np.isfinite(twist)
    peaks = {n: float(np.abs(torque[known & (run == n)]).max(initial=0.0)) for n in np.unique(run)}
    least = min((p for p in peaks.values() if p > 0.0), default=0.0)
    chosen = [n for n, peak in peaks.items() if 0.0 < peak < ALIKE_PEAKS * least]
    rows = np.flatnonzero(known & np.isin(run, chosen))
    _need_reversal(torque[rows])
    rows = rows[:: max(1, rows.size // POINTS)]
    time_s = np.asarray(recording["t_s"], np.float64)
    return _Ramp(torque[rows], twist[rows], run[rows], time_s[rows])


def _need_reversal(torque: Array) -> None:
    """FitError where it never turns round, or hardly a row is there."""
    if torque.size < gate.FEWEST_BLOCKS or torque.min() >= 0.0 or torque.max() <= 0.0:
        raise FitError(
            f"{torque.size} rows of torque and twist, and play shows when torque reverses: record "
            "slow ramps to either side, twice at least, with the output locked."
        )


def _grid(torque: Array) -> Array:
    """(friction, middle) pairs, shape (2, pairs); the first is without friction."""
    largest = float(np.abs(torque).max())
    pairs = [(f, m) for f in FRICTIONS for m in MIDDLES if f + abs(m) < 0.95]
    pairs.sort(key=lambda pair: (pair[0], abs(pair[1])))
    return largest * np.array(pairs).T


def dragged(torque: Array, friction_nm: Array, middle_nm: Array) -> Array:
    """The play operator on a torque for many half widths at once; shape (samples, pairs)."""
    found = np.empty((torque.size, friction_nm.size))
    now = np.clip(0.0, torque[0] - middle_nm - friction_nm, torque[0] - middle_nm + friction_nm)
    for k, value in enumerate(torque - 0.0):
        here = value - middle_nm
        now = np.minimum(np.maximum(now, here - friction_nm), here + friction_nm)
        found[k] = now
    return found


def _fit(
    torque: Array,
    twist: Array,
    seen: NDArray[np.bool_],
    grid: Array,
    kind: tuple[str, ...],
    *,
    gap_rad: float = 0.0,
) -> Twist:
    moved = dragged(torque, grid[0], grid[1])
    largest = float(np.abs(torque).max())
    crossed = "side" in kind or gap_rad > 0.0
    fits = [
        _solved(
            torque, moved[:, k], twist, seen, (float(f), float(m), d), kind=kind, gap_rad=gap_rad
        )
        for k, (f, m) in enumerate(grid.T)
        for d in _crossings(float(f + abs(m)), largest, crossed=crossed)
    ]
    return min(fits, key=lambda fit: fit.rms_rad)


def _crossings(held_nm: float, largest_nm: float, *, crossed: bool) -> list[float]:
    """Torques over which a play may be crossed, where friction holds back so much."""
    tried = [share * largest_nm for share in CROSSINGS]
    if not crossed:
        return tried[:1]
    return [d for d in tried if held_nm + d <= CROSSED * largest_nm]


def _solved(
    torque: Array,
    moved: Array,
    twist: Array,
    seen: NDArray[np.bool_],
    shape: tuple[float, float, float],
    *,
    kind: tuple[str, ...],
    gap_rad: float,
) -> Twist:
    matrix = _matrix(torque, moved, shape[2], kind)[seen]
    left = (twist - gap_rad * _side(moved, shape[2]))[seen]
    inverse = np.linalg.pinv(matrix.T @ matrix)
    found = inverse @ (matrix.T @ left)
    errors = left - matrix @ found
    scores = np.stack([_blocks(column * errors) for column in matrix.T], axis=1)
    return Twist(found, *shape, errors, inverse @ (scores.T @ scores) @ inverse, gap_rad)


def _matrix(torque: Array, moved: Array, crossing_nm: float, kind: tuple[str, ...]) -> Array:
    made = {
        "torque": torque,
        "dragged": moved,
        "side": _side(moved, crossing_nm),
    }
    return np.stack([*(made[name] for name in kind), np.ones(torque.size)], axis=1)


def _side(moved: Array, crossing_nm: float) -> Array:
    """Where in a play of width one it lies."""
    return np.asarray(0.5 * np.clip(moved / crossing_nm, -1.0, 1.0))


def _errors(fit: Twist, name: str, torque: Array, twist: Array) -> Array:
    moved = dragged(torque, np.array([fit.friction_nm]), np.array([fit.middle_nm]))[:, 0]
    kinds = {"spring": ("torque",), "hysteresis": ("dragged",), "play": ("torque", "side")}
    made = _matrix(torque, moved, fit.crossing_nm, kinds[name]) @ fit.numbers
    return np.asarray(twist - made - fit.gap_rad * _side(moved, fit.crossing_nm))


def _blocks(values: Array) -> Array:
    return np.array([part.sum() for part in np.array_split(values, BLOCKS)])


def _z(gain: Array) -> float:
    spread = float(gain.std(ddof=1)) / np.sqrt(gain.size)
    return float(gain.mean()) / spread if spread > 0.0 else 0.0
