"""Recordings as a diagnosis weighs them: whitened errors of any model, seen and held out.

Every angle is compared over increments between means of 1, 6, 36 and 216 rows, and as it is, so
that a slow error counts beside a quick one; each signal is weighed by its sensor's floor or, where
that is more, by the robust deviation that its error still has. The cost of a model is

    F = sum rho(e / sigma),    rho(x) = 2 k^2 (sqrt(1 + (x/k)^2) - 1),   k = 2

over points that overlap and hang together: differences of F are judged by their scatter over
blocks of the recording, never by a chi-square table. Source: Huber, Robust Statistics (1981).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from servo_bench.diagnosis.comparing.allowance import SCALES, allowed
from servo_bench.diagnosis.comparing.comparison import Choice, Comparison, compare
from servo_bench.diagnosis.comparing.rows import Array, Mask, resting_rows, rows_of
from servo_bench.recording.recording import Recording
from sim_rig.model import Model

KNEE = 2.0
ASKED = 0.6
BLOCK_GROUPS = 2
"""A block is so many groups of `comparison` (0.25 s each)."""
BEYOND_DOUBT = 1e3
"""Largest advantage over its scatter that is told: blocks that agree fully have no scatter."""
RAN_AWAY = 1e12
"""Of any signal in SI: a loop that is not stable gets there, and its squares to no number."""
RESTING = 0.25
"""Of a quick look's rows, that the rest before any motion may take."""
COARSE = 4.0
"""How many times longer the simulation's steps are while candidates are tried."""


@dataclass(frozen=True, eq=False)
class Evidence:
    """What is compared: `fitted` recordings, and those that judge (their held-out points)."""

    fitted: tuple[Comparison, ...]
    judging: tuple[Comparison, ...]
    fitted_whole: bool = False

    def seen(self, models: Sequence[Model], *, coarse: bool = True) -> list["Errors"]:
        """Errors at the fitted points, model by model."""
        masks = [c.seen | c.held_out if self.fitted_whole else c.seen for c in self.fitted]
        return self._errors(self.fitted, masks, models, coarse)

    def held_out(self, models: Sequence[Model], *, coarse: bool = True) -> list["Errors"]:
        """Errors at the points that no fit saw."""
        return self._errors(self.judging, [c.held_out for c in self.judging], models, coarse)

    def after(self, models: Sequence[Model], *, coarse: bool = True) -> list["Errors"]:
        """Errors at points that are for fitting and come after those that are fitted: of a quick
        look, what follows the beginning; else none."""
        masks = [
            judge.seen & (judge.group > fitted.group.max(initial=0))
            for fitted, judge in zip(self.fitted, self.judging, strict=True)
        ]
        return self._errors(self.judging, masks, models, coarse)

    @staticmethod
    def _errors(
        comparisons: Sequence[Comparison],
        masks: Sequence[Mask],
        models: Sequence[Model],
        coarse: bool,
    ) -> list["Errors"]:
        if coarse:
            models = [coarser(model) for model in models]
        played = [c.errors_of(models) for c in comparisons]
        return [
            Errors(comparisons, masks, [rows[k] for rows in played]) for k in range(len(models))
        ]

    @cached_property
    def floors(self) -> Array:
        """The sensors' floors, shape (signals,): the largest over the fitted recordings."""
        floors = [[s.floor for s in c.signals] for c in self.fitted]
        return np.asarray(np.max(floors, axis=0), np.float64)

    @cached_property
    def allowed(self) -> Array:
        """What a right simulation may miss, in the signals' units, shape (signals,)."""
        known = [one.seen.sum() for one in self.fitted]
        squares = [allowed(one) ** 2 for one in self.fitted]
        return np.asarray(np.sqrt(np.average(squares, axis=0, weights=known)))

    def deviation(self, errors: "Errors") -> Array:
        """What errors are weighed by, shape (signals,): their robust deviation, within bounds.

        No less than the sensor's floor; and no more than `ASKED` of what a right simulation may
        miss, or a signal that is all wrong would count no more than one that is a little.
        """
        most = np.maximum(self.floors, ASKED * self.allowed)
        return np.asarray(np.clip(errors.robust(), self.floors, most))

    @property
    def names(self) -> tuple[str, ...]:
        """The signals' names, in order."""
        return tuple(s.name for s in self.fitted[0].signals)

    @property
    def is_of_the_load_alone(self) -> bool:
        """Whether nothing but the load's encoder tells of the motor."""
        return self.fitted[0].is_of_the_load_alone


class Errors:
    """One model's errors over several recordings."""

    def __init__(
        self, comparisons: Sequence[Comparison], masks: Sequence[Mask], errors: Sequence[Array]
    ) -> None:
        rows = []
        groups = []
        offset = 0
        for comparison, mask, error in zip(comparisons, masks, errors, strict=True):
            weighed = error * _weights(comparison)
            rows.append(np.where(mask & np.isfinite(comparison.measured), weighed, np.nan))
            groups.append(comparison.group // BLOCK_GROUPS + offset)
            offset += int(comparison.group.max(initial=0)) // BLOCK_GROUPS + 1
            if not (np.abs(error[np.isfinite(comparison.measured)]) < RAN_AWAY).all():
                rows[-1] = np.full_like(rows[-1], np.inf)
        self.rows: Array = np.concatenate(rows, axis=1)
        self.group: NDArray[np.int64] = np.concatenate(groups)

    @property
    def ran_away(self) -> bool:
        """Whether the model could not be simulated."""
        return bool(np.isinf(self.rows).any())

    def robust(self) -> Array:
        """1.4826 times the median size of every signal's error, shape (signals,); zero where none
        of its points came."""
        return np.array([1.4826 * median_of(np.abs(row)) for row in self.rows])

    def rms(self) -> Array:
        """Root mean square of every signal's error; shape (signals,)."""
        return np.asarray(np.sqrt(np.nanmean(self.rows**2, axis=1)))

    def white(self, sigma: Array) -> Array:
        """Known points over sigma, one long row; zero where nothing is known."""
        white = np.nan_to_num(self.rows / sigma[:, None], nan=0.0, posinf=1e6)
        return np.asarray(white.ravel())

    def costs(self, sigma: Array) -> Array:
        """rho by block, shape (blocks,)."""
        rho = robust_cost(self.white(sigma)).reshape(self.rows.shape).sum(axis=0)
        return np.bincount(self.group, rho).astype(np.float64)

    def cost(self, sigma: Array) -> float:
        """F."""
        return float(robust_cost(self.white(sigma)).sum())

    @property
    def points(self) -> int:
        """How many points are known."""
        return int(np.isfinite(self.rows).sum())


def coarser(model: Model) -> Model:
    """The model in steps that are long enough to compare candidates."""
    return replace(model, longest_step_s=COARSE * model.longest_step_s)


def median_of(values: Array) -> float:
    """Of those that came; zero where none did."""
    came = values[~np.isnan(values)]
    return float(np.median(came)) if came.size else 0.0


def changed_by(evidence: Evidence, model: Model, others: Sequence[Model]) -> Array:
    """Largest robust change of every signal that one of `others` makes, shape (signals,); none of a
    signal without a point, nor by a model that ran away, nor of one."""
    here, *there = evidence.seen([model, *others])
    largest = np.zeros(len(evidence.names))
    if here.ran_away:
        return largest
    for errors in there:
        changed = np.abs(errors.rows - here.rows)
        known = np.isfinite(changed).any(axis=1)
        if not errors.ran_away:
            change = 1.4826 * np.nanmedian(changed[known], axis=1)
            largest[known] = np.maximum(largest[known], change)
    return largest


def robust_cost(white: Array) -> Array:
    """rho, point by point."""
    return np.asarray(2.0 * KNEE**2 * (np.sqrt(1.0 + (white / KNEE) ** 2) - 1.0))


def block_z(better: Array, worse: Array) -> float:
    """z-score of the mean advantage over blocks, by signed roots; 0 where there is none at all.

    Roots, because the advantage of a rare event (a limit that is reached) lies in few blocks.
    """
    gained = worse - better
    gained = gained[(worse != 0.0) | (better != 0.0)]
    if gained.size < 3 or not gained.any():
        return 0.0
    roots = np.sign(gained) * np.sqrt(np.abs(gained))
    mean, least = float(roots.mean()), float(np.abs(roots).max()) / BEYOND_DOUBT
    return float(mean / max(float(roots.std(ddof=1)), least) * np.sqrt(roots.size))


def _weights(comparison: Comparison) -> Array:
    increments = np.array([s.increments and s.stride == 1 for s in comparison.signals])
    return np.where(increments[:, None], comparison.weight, 1.0)


def evidence_of(
    recordings: Sequence[Recording], model: Model, *, block: Choice = "auto"
) -> Evidence:
    """Weigh these recordings; FitError and ConfigError as `compare`."""
    fitted = tuple(compare(r, model, block, scales=SCALES) for r in recordings)
    return Evidence(fitted, fitted)


def quick_evidence(
    recordings: Sequence[Recording], model: Model, rows: int, *, block: Choice = "auto"
) -> Evidence:
    """Only the recordings' beginnings are fitted; judged by what is held out of them, to its end.

    A validation is played from the recording's start, because clocks and warmth count from there.
    What is no longer than its own beginning, and has no validation, is fitted as a whole is.
    """
    if any("phase" not in r and len(r) <= rows for r in recordings):
        return evidence_of(recordings, model, block=block)
    short = [beginning(r, rows) for r in recordings]
    judging = evidence_of(recordings, model, block=block).fitted
    fitted = tuple(compare(r, model, judging[0].block, scales=SCALES) for r in short)
    return Evidence(fitted, judging, fitted_whole=True)


def _kept_back(recording: Recording) -> int:
    """The first row that judges: the validation's, or where there is none the last quarter's."""
    held_out = rows_of(recording).held_out
    return int(np.argmax(held_out)) if held_out.any() else len(recording)


def beginning(recording: Recording, rows: int) -> Recording:
    """The first rows of a recording, none of those that judge, for quick looks.

    A rest that is longer than `RESTING` of them, before anything moves, comes beside.
    """
    rows += max(resting_rows(recording) - round(RESTING * rows), 0)
    rows = min(rows, _kept_back(recording))
    if len(recording) <= rows:
        return recording
    return replace(recording, channels={n: v[:rows] for n, v in recording.channels.items()})
