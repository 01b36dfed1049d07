"""Have the Volterra kernels changed between two runs of the same excitation?

The difference of the two responses, slot by slot, is correlated with the sequence:

    d(t) = y_b(t) - y_a(t)   ->   delta c_m = c_m(b) - c_m(a),   scatter s from the empty shifts

What aliases of higher orders put on a coefficient is alike in both runs and drops out of d, so
that s is the noise of the two runs and nothing else. For each order m, with n coefficients,

    n q / k ~ chi^2(n / k),   q = mean (delta c)^2 / s^2

where k = 2 allows for neighbouring shifts that noise of increments correlates (by -1/2 at most).
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import chi2

from servo_bench.errors import FitError
from servo_bench.excitation.experiment import MSequence
from servo_bench.kernels.filling import extract_filled
from servo_bench.kernels.identification import (
    Identification,
    command_delay,
    locate,
    response_periods,
)
from servo_bench.kernels.response import Response, response_of
from servo_bench.kernels.volterra import Kernels, extract
from servo_bench.recording.recording import Recording
from servo_bench.replay.change import finite

Array = NDArray[np.float64]

CORRELATED = 2.0
"""k: by how much fewer coefficients are independent than there are."""
SAME_AMPLITUDE = 1e-3


@dataclass(frozen=True, slots=True)
class OrderChange:
    """One order: `share` is the rms of its change, noise taken off, over the rms of order 1 of a.

    `gain_share` is the change along the kernel of a: -0.02 is a response two percent smaller.
    `peak_lag` are the lags, in samples, at which the change is largest.
    """

    order: int
    share: float
    gain_share: float
    peak_lag: tuple[int, ...]
    p_value: float

    def numbers(self, changed: bool) -> dict[str, Any]:
        """As plain values."""
        return {
            "order": self.order,
            "share": finite(self.share),
            "gain_share": finite(self.gain_share),
            "peak_lag": list(self.peak_lag),
            "p_value": self.p_value,
            "changed": changed,
        }


@dataclass(frozen=True, slots=True, eq=False)
class KernelChange:
    """Linear kernels of both runs and their difference, rad/s per chip, shape (memory,)."""

    period_s: float
    lags_s: Array
    c1_a: Array
    c1_b: Array
    c1_difference: Array
    standard_error: float
    delay_a: int
    delay_b: int
    orders: tuple[OrderChange, ...]


@dataclass(frozen=True, slots=True, eq=False)
class _Answer:
    """A run's mean period, aligned to its chips."""

    recording: Recording
    response: Response
    found: Identification
    memory: int
    delay: int

    def period(self, delay: int, memory: int) -> tuple[Array, NDArray[np.bool_]]:
        """The mean over the periods, and where every one of them is spoilt; shape (N,) each."""
        periods, spoilt = response_periods(self.response, self.found, memory, delay)
        weight = np.where(spoilt, 0.0, 1.0)
        count = weight.sum(axis=0)
        mean = (periods * weight).sum(axis=0) / np.maximum(count, 1.0)
        return mean, count == 0.0


def kernel_change(a: Recording, b: Recording) -> KernelChange:
    """What has changed. FitError or RecordingError where the two cannot be laid side by side."""
    one, other = _answer(a), _answer(b)
    _check_alike(one, other)
    memory = min(one.memory, other.memory)
    before, spoilt_a = one.period(one.delay, memory)
    after, spoilt_b = other.period(other.delay, memory)
    difference = _kernels(after - before, spoilt_a | spoilt_b, one.found, memory, a.period_s)
    kernels = _kernels(before, spoilt_a, one.found, memory, a.period_s)
    return KernelChange(
        period_s=a.period_s,
        lags_s=kernels.lags_s,
        c1_a=kernels.c1,
        c1_b=kernels.c1 + difference.c1,
        c1_difference=difference.c1,
        standard_error=difference.scatter,
        delay_a=one.delay,
        delay_b=other.delay,
        orders=tuple(_order(m, kernels, difference) for m in (1, 2, 3)),
    )


def _answer(recording: Recording) -> _Answer:
    experiment = recording.experiment
    if experiment is None or not isinstance(experiment.identification, MSequence):
        raise FitError("a run was not identified with a plain M-sequence")
    response = response_of(recording)
    found = locate(response, experiment.identification.polynomial)
    delay = command_delay(response, found, experiment.memory)
    return _Answer(recording, response, found, experiment.memory, delay)


def _check_alike(a: _Answer, b: _Answer) -> None:
    if a.found.polynomial != b.found.polynomial:
        raise FitError(f"they played {a.found.polynomial} and {b.found.polynomial}")
    if abs(a.recording.period_s / b.recording.period_s - 1.0) > 1e-9:
        raise FitError(f"their periods are {a.recording.period_s} and {b.recording.period_s} s")
    levels = ((a.found.amplitude_rad_s, b.found.amplitude_rad_s),)
    for one, other in (*levels, (a.found.bias_rad_s, b.found.bias_rad_s)):
        if abs(one - other) > SAME_AMPLITUDE * a.found.amplitude_rad_s:
            raise FitError(f"they played {one:.6g} and {other:.6g} rad/s, and kernels hold at one")


def _kernels(
    period: Array, spoilt: NDArray[np.bool_], found: Identification, memory: int, period_s: float
) -> Kernels:
    if not spoilt.any():
        amplitude = found.amplitude_rad_s
        return extract(period, found.polynomial, amplitude, memory, period_s=period_s)
    kernels, _ = extract_filled(
        period[None],
        spoilt[None],
        found.polynomial,
        found.amplitude_rad_s,
        memory,
        period_s=period_s,
    )
    return kernels


def _order(order: int, kernels: Kernels, difference: Kernels) -> OrderChange:
    table = (difference.c1, difference.c2, difference.c3)[order - 1]
    before = (kernels.c1, kernels.c2, kernels.c3)[order - 1]
    lags = np.nonzero(before)
    delta, own = table[lags], before[lags]
    noise = difference.scatter**2
    squares = float(np.sum(delta**2))
    if noise > 0.0:
        freedom = delta.size / CORRELATED
        p_value = float(chi2.sf(squares / noise / CORRELATED, freedom))
    else:
        p_value = 0.0 if squares > 0.0 else 1.0
    linear = float(np.sum(kernels.c1**2))
    peak = int(np.argmax(np.abs(delta))) if delta.size else 0
    return OrderChange(
        order=order,
        share=float(np.sqrt(max(squares - delta.size * noise, 0.0) / linear)),
        gain_share=float(delta @ own / (own @ own)) if own.size and own @ own else 0.0,
        peak_lag=tuple(int(axis[peak]) for axis in lags) if delta.size else (),
        p_value=p_value,
    )
