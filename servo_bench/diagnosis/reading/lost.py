"""Commands that the drive never got, and held the one before: whole chips that its motion lacks.

Each leaves the response to one chip in the base's error,

    e(t) = -(c_k - c_{k-1}) h(t - t_k),      h: response of the angle's increments to a chip of one,

and is found chip by chip with a matched filter: whole chips, and few others. That is a statement
about data, and no fit.

With the load's encoder alone the gap blurs that: the load goes through it another time than the
simulation's, and what is left of a chip is no whole one. Each that comes near is put right and the
recording played: one that was lost makes the error smaller wherever the load has been since.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d

from servo_bench.diagnosis.comparing.comparison import Choice, Comparison, compare
from servo_bench.diagnosis.comparing.rows import Array
from servo_bench.recording.recording import Recording
from sim_rig.model import Model

RESPONSE_ROWS = 12
LINEAR = frozenset(
    {
        *("current_loop_lag", "velocity_filter_lag", "transport_delay", "viscous"),
        *("torque_constant_error", "inertia_error", "coupling_compliance"),
        *("proportional_gain_error", "integral_gain_error"),
    }
)
"""What shapes the response to a chip, wherever the shaft is and whichever way it goes: at rest at
angle zero cogging is a spring, which made lost chips 1.2 to 1.35 of whole ones."""
SURE, NEARLY = 0.2, 0.35
"""How far from a whole chip the estimate of a lost one may be; and where it is played."""
LEFT, BLURRED = 0.1, 0.6
"""Of the error's energy over the response, after the lost chip is taken out; and where it is
played."""
CLEAR = 8.0
"""A lost chip's response over its own scatter."""
MOST, AS_HIGH, AS_HIGH_PLAYED = 0.5, 0.25, 0.5
"""Of the chips that stand in the error, the share that is whole ones where commands were lost. What
limits or delays a reversal leaves chips of every size, and some are whole by chance. Those count
that stand as high as such a share of a lost one: beside 20 that stood 270 deviations high, 90 of 15
were cogging and a soft loop's drift."""
TRIES, APART_ROWS, MOST_LOST, WORTH, CAPPED = 8, 48, 0.02, 25.0, 6.0
"""Chips that are played at a time, and how far apart they are put right together; the share of them
that may be lost in all; what one takes of the error's squares at least, in variances; and the
deviations beyond which a row counts no more."""


@dataclass(frozen=True, slots=True)
class LostCommands:
    """Rows whose command was never heard, and how many rows commanded a change."""

    rows: tuple[int, ...]
    changes: int

    @property
    def probability(self) -> float:
        """Per telegram."""
        return len(self.rows) / max(self.changes, 1)

    @property
    def interval(self) -> tuple[float, float]:
        """95 % of a Poisson count."""
        count, spread = len(self.rows), 1.96 * np.sqrt(len(self.rows) + 1.0)
        return max(count - spread, 0.0) / max(self.changes, 1), (count + 1 + spread) / max(
            self.changes, 1
        )


def lost_commands(comparison: Comparison, model: Model) -> LostCommands:
    """Which commands were lost, by the motor's (or load's) increments; only of the closed loop."""
    chips = _chips_of(comparison, model)
    if chips is None:
        return LostCommands((), 0)
    near, clear = np.abs(chips.share - 1.0) < SURE, chips.height > CLEAR
    found = [int(k) for k in chips.rows[near & clear] if chips.left(int(k)) < LEFT]
    lost = [chips.first + k for k in found]
    least = max(CLEAR, AS_HIGH * chips.usual_height(lost))
    if len(lost) <= MOST * chips.standing(least).size:
        lost = []
    return LostCommands(tuple(lost), chips.rows.size)


def lost_by_playing(recording: Recording, model: Model, block: Choice = "auto") -> LostCommands:
    """The same where the load's encoder alone tells of it."""
    chips = _chips_of(compare(recording, model, block), model)
    if chips is None:
        return LostCommands((), 0)
    playing = _Playing(recording, model, block, chips.sigma)
    first, changes, lost = chips, chips.rows.size, list[int]()
    while len(lost) < MOST_LOST * changes:
        found, then = _better(playing, chips, lost)
        if then is None:
            break
        lost += found
        chips = then
    others = chips.standing(AS_HIGH_PLAYED * first.usual_height(lost)).size if lost else 0
    if len(lost) <= MOST * (len(lost) + others):
        lost = []
    return LostCommands(tuple(sorted(lost)), changes)


class _Playing(NamedTuple):
    recording: Recording
    model: Model
    block: Choice
    sigma: float

    def without(self, lost: Iterable[int]) -> "_Chips | None":
        """What is left in the error where these commands were lost."""
        again = compare(heard(self.recording, lost), self.model, self.block)
        return _chips_of(again, self.model, self.sigma)


def _better(
    playing: _Playing, chips: "_Chips", lost: Sequence[int]
) -> tuple[Sequence[int], "_Chips | None"]:
    """Further rows without whose commands the error is smaller, and what it has then: those that
    are far enough apart at once, where that is better than the best one alone."""
    tried = {k: playing.without([*lost, k]) for k in chips.blurred(lost)}
    able = {k: then for k, then in tried.items() if then and chips.cost - then.cost > WORTH}
    best = sorted(able, key=lambda k: able[k].cost)
    if not best:
        return (), None
    apart = [k for n, k in enumerate(best) if all(abs(k - j) > APART_ROWS for j in best[:n])]
    together = playing.without([*lost, *apart]) if len(apart) > 1 else None
    if together and together.cost < able[best[0]].cost:
        return apart, together
    return best[:1], able[best[0]]


def heard(recording: Recording, lost: Iterable[int]) -> Recording:
    """The recording with the commands that the drive heard, where those of some rows were lost."""
    rows = sorted(lost)
    if not rows:
        return recording
    commands = np.array(recording["velocity_command_rad_s"], np.float64)
    for row in rows:
        commands[row] = commands[row - 1]
    return replace(recording, channels={**recording.channels, "velocity_command_rad_s": commands})


class _Chips(NamedTuple):
    """The commands' changes in an error, and what the error has of each.

    `rows` of the piece, which begins at `first`; `share` of a whole chip; `sigma` the error's
    deviation, and in such: `height` of a whole one's response, `matched` of what is there at every
    row, and the error itself.
    """

    first: int
    sigma: float
    error: Array
    response: Array
    jumps: Array
    rows: NDArray[np.intp]
    share: Array
    height: Array
    matched: Array

    @property
    def cost(self) -> float:
        """Of the whole error, each row's capped."""
        return float(np.sum(np.minimum(np.abs(self.error), CAPPED) ** 2))

    def left(self, k: int) -> float:
        """Of the error's energy over the response, without the whole chip of a row."""
        there = self.error[k : k + self.response.size]
        left = there + self.jumps[k] * self.response[: there.size]
        return float(left @ left) / max(float(there @ there), 1e-300)

    def usual_height(self, rows: Sequence[int]) -> float:
        """Of some of the recording's rows: the median; 0 of none."""
        there = self.height[np.isin(self.rows, np.asarray(rows, np.intp) - self.first)]
        return float(np.median(there)) if there.size else 0.0

    def standing(self, least: float) -> Array:
        """How high each chip of whatever size stands, where the error looks most like one within a
        response's length, and by more than that."""
        highest = self.matched == maximum_filter1d(self.matched, RESPONSE_ROWS + 1)
        return np.asarray(self.matched[highest & (self.matched > least)])

    def blurred(self, known: Iterable[int]) -> list[int]:
        """The recording's rows that look most like a lost command's, none of the known ones."""
        near, clear = np.abs(self.share - 1.0) < NEARLY, self.height > CLEAR
        rows = [int(k) for k in self.rows[near & clear] if self.first + int(k) not in set(known)]
        left = sorted((self.left(k), k) for k in rows)
        return [self.first + k for share, k in left if share < BLURRED][:TRIES]


def _chips_of(comparison: Comparison, model: Model, sigma: float | None = None) -> _Chips | None:
    """None of what is not played in its loop, or in pieces; `sigma` its own where none is given."""
    rows, piece = comparison.source.rows, comparison.longest
    if comparison.block != "loop" or len(comparison.pieces) > 1:
        return None
    commands = rows.channel("velocity_command_rad_s")[piece.rows]
    quick = [k for k, s in enumerate(comparison.signals) if s.increments and s.stride == 1]
    best = next(
        (k for k in quick if comparison.signals[k].channel == "motor_position_rad"), quick[0]
    )
    error = comparison.errors(model)[best]
    known = np.isfinite(error) & np.isfinite(comparison.measured[best])
    error = np.where(known, error, 0.0)
    if sigma is None:
        floor = comparison.signals[best].floor
        sigma = max(1.4826 * float(np.median(np.abs(error[known]))), floor)
    response = _pulse(model, rows.period_s)
    jumps = np.diff(commands, prepend=commands[0])
    change = np.abs(jumps) > 1e-6 * max(float(np.abs(commands).max(initial=0.0)), 1e-12)
    matched = np.correlate(np.append(error, np.zeros(response.size - 1)), response, "valid")
    energy = float(response @ response)
    amount = matched[: jumps.size] / energy
    usable = np.flatnonzero(change[: amount.size])
    root = float(np.sqrt(energy)) / sigma
    return _Chips(
        first=int(piece.first),
        sigma=sigma,
        error=error / sigma,
        response=response / sigma,
        jumps=jumps,
        rows=usable,
        share=-amount[usable] / jumps[usable],
        height=np.abs(jumps[usable]) * root,
        matched=np.abs(amount) * root,
    )


def _pulse(model: Model, period_s: float) -> Array:
    """Increments of the motor's angle after a chip of 1 rad/s, over the period; shape (rows,)."""
    command = np.zeros(RESPONSE_ROWS + 1)
    command[0] = 1.0
    done = model.without(*(model.effects.keys() - LINEAR)).simulate(command, period_s)
    return np.diff(done.motor_angle_rad) / period_s
