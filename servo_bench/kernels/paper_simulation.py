"""The paper's simulation (sections III and IV): a second-order system, a play, and its kernels.

    G(s) = (2 zeta wn s + wn^2) / (s^2 + 2 zeta wn s + wn^2)      equation 14, "zero"
    G(s) = wn^2 / (s^2 + 2 zeta wn s + wn^2)                      "no zero"

zeta = 0.4, wn = 1, dt = 0.5 s, then a play of width W = 0.8 and slope 1 on the output, driven by
+-1 from f(x) = 15341. The paper does not say which of the two it simulated, so both are. The hold
is exact, hence lag 0 of every kernel is zero. The play lives in continuous time: fed with the
samples alone it would miss the turns between them (without the zero that costs order 1 most of a
point of VAF). The memory of 18 samples is the largest in
which 15341 keeps all elements of order 3 apart.

It lives here and not in the software rig, for it needs nothing of one: it has no drive, no
encoder, and no unit, and its results are the truth that the kernels are checked against.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import cont2discrete, lfilter

from servo_bench.excitation.msequence import m_sequence
from servo_bench.kernels.comparison import Comparison, compare
from servo_bench.kernels.predict import predict, vaf_percent
from servo_bench.kernels.volterra import Kernels, extract

Array = NDArray[np.float64]

POLYNOMIAL = "15341"
DAMPING_RATIO = 0.4
NATURAL_FREQUENCY_RAD_S = 1.0
PERIOD_S = 0.5
PLAY_WIDTH = 0.8
SUBSTEPS = 20
MEMORY = 18
SETTLING_SAMPLES = 200
DRAW_SAMPLES = 20_000
SEEDS = tuple(range(1, 10))


@dataclass(frozen=True, slots=True, eq=False)
class PlantSimulation:
    """One plant: its kernels, its period (figure 4), and its VAF on inputs the fit never saw.

    `period` is the identification period. The fresh figures have one entry for each seed: the
    VAF against the noise-free output of that draw of random binary input.
    """

    kernels: Kernels
    period: Comparison
    fresh_order1_percent: Array
    fresh_order3_percent: Array

    def numbers(self) -> dict[str, float]:
        """The four VAF, in percent; the fresh ones are medians over the draws."""
        return {
            "order1_same": self.period.vaf_order1_percent,
            "order1_fresh": float(np.median(self.fresh_order1_percent)),
            "order3_same": self.period.vaf_order3_percent,
            "order3_fresh": float(np.median(self.fresh_order3_percent)),
        }


@dataclass(frozen=True, slots=True, eq=False)
class PaperResult:
    """Both plants, and the seeds of the fresh draws.

    Figure 2 is `kernels.g1` over `kernels.lags_s`, figure 3 `kernels.g3_section(1)`, figure 4 a
    window of `period`.
    """

    zero: PlantSimulation
    no_zero: PlantSimulation
    seeds: tuple[int, ...]

    def numbers(self) -> dict[str, Any]:
        """Everything that is a number, ready for JSON; VAF in percent."""
        return {
            "simulation": {"zero": self.zero.numbers(), "no_zero": self.no_zero.numbers()},
            "memory": MEMORY,
            "polynomial": POLYNOMIAL,
            "period_s": PERIOD_S,
            "seeds": list(self.seeds),
            "draw_samples": DRAW_SAMPLES,
        }


def simulate_paper(seeds: tuple[int, ...] = SEEDS) -> PaperResult:
    """Simulate, extract, predict; one fresh draw of DRAW_SAMPLES chips for each seed."""
    return PaperResult(
        zero=_simulation(seeds, zero=True),
        no_zero=_simulation(seeds, zero=False),
        seeds=seeds,
    )


def plant_output(chips: NDArray[np.number], *, zero: bool) -> Array:
    """The plant's output samples from rest, shape (..., n) -> (..., n); sample t is before chip t.

    The play follows G's output between the samples too, on SUBSTEPS points of each period: in
    0.5 s that output has at most one extremum, so the period's highest and lowest point and its
    end are all that the play can feel.
    """
    wn, zeta = NATURAL_FREQUENCY_RAD_S, DAMPING_RATIO
    numerator = np.array([2.0 * zeta * wn, wn**2] if zero else [wn**2])
    denominator = np.array([1.0, 2.0 * zeta * wn, wn**2])
    b, a, _ = cont2discrete((numerator, denominator), PERIOD_S / SUBSTEPS, method="zoh")
    held = np.repeat(np.asarray(chips, np.float64), SUBSTEPS, axis=-1)
    fine = np.asarray(lfilter(b.ravel(), a, held, axis=-1)).reshape(*chips.shape, SUBSTEPS)
    return _play(fine.max(axis=-1), fine.min(axis=-1), fine[..., 0])


def _play(highest: Array, lowest: Array, start: Array) -> Array:
    """Output of a play of full width W where each period starts, all arrays (..., n).

    Slope 1, from zero: y is pushed up by x - W/2 and down by x + W/2, and rests between them.
    """
    half = PLAY_WIDTH / 2.0
    push_up = np.moveaxis(highest, -1, 0) - half
    push_down = np.moveaxis(lowest, -1, 0) + half
    ends = np.moveaxis(start, -1, 0)
    output = np.zeros_like(ends)
    y = output[0]
    for t in range(1, len(ends)):
        y = np.minimum(np.maximum(y, push_up[t - 1]), push_down[t - 1])
        y = np.minimum(np.maximum(y, ends[t] - half), ends[t] + half)
        output[t] = y
    return np.moveaxis(output, 0, -1)


def _simulation(seeds: tuple[int, ...], *, zero: bool) -> PlantSimulation:
    chips = m_sequence(POLYNOMIAL).astype(np.float64)
    settled = plant_output(np.tile(chips, 2), zero=zero)[chips.size :]
    kernels = extract(settled, POLYNOMIAL, 1.0, MEMORY, period_s=PERIOD_S)
    draws = np.stack([_random_chips(seed) for seed in seeds])
    outputs = plant_output(draws, zero=zero)[:, SETTLING_SAMPLES:]
    fresh = [
        [
            vaf_percent(output, predict(kernels, draw, order)[SETTLING_SAMPLES:])
            for draw, output in zip(draws, outputs, strict=True)
        ]
        for order in (1, 3)
    ]
    return PlantSimulation(
        kernels=kernels,
        period=compare(kernels, settled, chips, chips),
        fresh_order1_percent=np.array(fresh[0]),
        fresh_order3_percent=np.array(fresh[1]),
    )


def _random_chips(seed: int) -> Array:
    rng = np.random.default_rng(seed)
    return rng.choice(np.array([-1.0, 1.0]), SETTLING_SAMPLES + DRAW_SAMPLES)
