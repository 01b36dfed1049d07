"""Which measured Volterra kernels the nominal simulation misses, and which the extended recovers.

Both models are played over the recording's own commands, and their kernels are extracted as the
measured ones are, with the same aliases. An element stands out where it is above four times the
sensor's noise in it and above a twentieth of its order's largest; it is missed where the simulation
differs from it by more than that.
"""

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from servo_bench.diagnosis.comparing.rows import Array
from servo_bench.diagnosis.judging.picture import kernels_of
from servo_bench.diagnosis.searching.finding import Finding
from servo_bench.kernels.volterra import Kernels
from servo_bench.recording.recording import Recording
from servo_bench.report.style import ACTUAL, MUTED, ORDER_1, ORDER_3, caption_axes
from sim_rig.model import Model

DEVIATIONS, LEAST_SHARE = 4.0, 0.05
ORDERS = ("first", "second", "third")


class KernelRow(NamedTuple):
    """One order: elements that stand out, of them missed by each model, and both distances.

    A distance is the rms of the difference over that of the measured elements that stand out.
    """

    name: str
    there: int
    missed_nominal: int
    missed_extended: int
    distance_nominal: float
    distance_extended: float


@dataclass(frozen=True, slots=True, eq=False)
class KernelStory:
    """The same kernels, measured and simulated twice; `noise` is that of a coefficient, rad/s."""

    measured: Kernels
    nominal: Kernels
    extended: Kernels
    noise: float

    def rows(self) -> list[KernelRow]:
        """By order."""
        return [self._row(name, order) for order, name in enumerate(ORDERS, 1)]

    def _row(self, name: str, order: int) -> KernelRow:
        own = coefficients(self.measured, order)
        largest = float(np.abs(own).max(initial=0.0))
        bound = max(DEVIATIONS * self.noise, LEAST_SHARE * largest)
        there = np.abs(own) > bound
        size = float(np.linalg.norm(own[there])) or 1.0
        apart = [np.abs(coefficients(k, order) - own)[there] for k in (self.nominal, self.extended)]
        missed = [int((a > bound).sum()) for a in apart]
        distances = [float(np.linalg.norm(a)) / size for a in apart]
        return KernelRow(name, int(there.sum()), missed[0], missed[1], *distances)


def coefficients(kernels: Kernels, order: int) -> Array:
    """Every identified coefficient of an order, in rad/s, shape (elements,)."""
    array = (kernels.c1, kernels.c2, kernels.c3)[order - 1]
    lags = np.indices(array.shape)
    upper = np.ones(array.shape, np.bool_)
    for one, other in pairwise(lags):
        upper &= one <= other
    return np.nan_to_num(np.asarray(array[upper], np.float64))


def kernel_story(finding: Finding) -> KernelStory | None:
    """None where the excitation, the channels, or the block do not let kernels be told."""
    recording, comparison = finding.recordings[0], finding.whole.fitted[0]
    measured = kernels_of(recording)
    if measured is None or comparison.block != "loop":
        return None
    played = [
        kernels_of(_played(finding, recording, model))
        for model in (finding.nominal, finding.final.model)
    ]
    if played[0] is None or played[1] is None:
        return None
    samples = measured.identification.measured.size * measured.kernels.periods
    noise = measured.noise_rad_s if np.isfinite(measured.noise_rad_s) else 0.0
    return KernelStory(
        measured.kernels, played[0].kernels, played[1].kernels, noise / float(np.sqrt(samples))
    )


def _played(finding: Finding, recording: Recording, model: Model) -> Recording:
    """The recording with the load's angle that a model gives to the same commands."""
    comparison = finding.whole.fitted[0]
    angle = np.array(recording["load_angle_rad"], np.float64)
    for points in comparison.pieces:
        shown = comparison.source.play(model, points.piece)["load_angle_rad"]
        lacking = ~np.isfinite(angle[points.piece.rows])
        angle[points.piece.rows] = np.where(lacking, np.nan, shown)
    return replace(recording, channels={**recording.channels, "load_angle_rad": angle})


def draw_kernels(figure: Figure, story: KernelStory) -> None:
    """First kernel; then both simulations' elements of orders 2 and 3 against the measured ones."""
    first, second, third = figure.subplots(1, 3)
    lags = story.measured.lags_s * 1e3
    three = (
        (story.measured, ACTUAL, "o", "measured"),
        (story.nominal, ORDER_1, "x", "nominal"),
        (story.extended, ORDER_3, "+", "extended"),
    )
    for kernels, colour, marker, label in three:
        first.plot(lags, kernels.c1, color=colour, marker=marker, linewidth=0.8, label=label)
    first.legend(loc="upper right", fontsize=7.0)
    caption_axes(first, "first kernel", "τ (ms)", "A g₁ (rad/s)")
    for axes, order in ((second, 2), (third, 3)):
        own = coefficients(story.measured, order)
        for kernels, colour, marker, _ in three[1:]:
            there = coefficients(kernels, order)
            axes.plot(own, there, color=colour, marker=marker, linestyle="", markersize=2.5)
        reach = float(np.abs(own).max(initial=0.0)) or 1.0
        axes.plot([-reach, reach], [-reach, reach], color=MUTED, linewidth=0.7)
        name = ("second", "third")[order - 2]
        caption_axes(axes, f"{name} kernel", "measured (rad/s)", "simulated (rad/s)")
