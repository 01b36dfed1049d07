"""What is wrong with a recording's angles before any model is blamed: wild samples, coarse ones.

A coarse angle lies on a lattice of its quantum, whatever moves: a statement about data, and no fit.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import uniform_filter1d

from servo_bench.diagnosis.comparing.comparison import Comparison, Signal
from servo_bench.diagnosis.comparing.rounding import ROUNDED, rounding_of
from servo_bench.diagnosis.comparing.rows import Array, Mask
from servo_bench.recording.recording import Recording
from sim_rig.model import Model

WILD = 12.0
"""Robust deviations, beyond one and a half gaps, of samples that are wrong alone."""
BURST_S = 0.032
"""How long they are: interference spoils a few words in a row."""
FAST_SHARE, FAST, SPOILT_RAD = 0.99, 4.0, 0.05
"""What most rows turn at most, or the largest command asks of one: by so many times that, and so
much, no angle leaves its neighbours and comes back."""
LEAVES = 0.75
"""Of what it is beyond at last: the step to its first row at least, where its neighbours are alike
to half of that."""
FINEST_QUANTUM_RAD, COARSEST_QUANTUM_RAD = 1.5e-4, 3e-3
FEWEST_ROWS = 200
ANGLES = ("motor_position_rad", "load_angle_rad")
FARTHEST_RAD = 250.0
"""From the middle of its angles, that is looked at: its histogram and spectrum have half a GB. A
word that the line spoilt lies farther off."""
LATTICE, ABOUT_BINS = 5.0, 801
"""Mean of exp(2 pi j y / q) over its own rms at neighbouring q, which chance, and chips of equal
size, bring to less than 4."""
FEWEST_COUNTS = 2.05
"""Of the encoder's own, in a lattice that it is rounded to before: of two nobody tells it."""
HALF = 0.5
"""Of a lattice's clearness: what the command's own steps may have of it; and the least, of what
noise leaves of a true one."""
OVER_NEIGHBOURS, BESIDE = 2.0, np.arange(2, 60)
"""What the simulated angle has of any lattice, over its rms at these neighbours: where it stands
still, it stands on many."""


def wild_samples(comparison: Comparison, model: Model, gap_rad: float) -> int:
    """Load samples that are wrong alone, or a few in a row by the same: beyond what any state of
    the gap allows, and back."""
    levels = [k for k, s in enumerate(comparison.signals) if s.level]
    if not levels or len(comparison.pieces) > 1:
        return 0
    error = comparison.errors(model)[levels[0]]
    floor = comparison.signals[levels[0]].floor
    sigma = max(1.4826 * float(np.nanmedian(np.abs(error))), floor, 1e-12)
    longest = max(1, round(BURST_S / comparison.source.rows.period_s))
    beyond = np.full(longest, WILD * sigma + 1.5 * gap_rad)
    return int(_there_and_back(error, beyond).sum())


def without_spoilt_words(recording: Recording, gap_rad: float) -> Recording:
    """The recording in which an angle that is wrong alone, or a few rows in a row, did not come.

    Only what no motion can be: it leaves its neighbours by several times what the fastest rows of
    this recording turn, and by more than a gap, and is back. Robust fits pass over such a word; by
    what a signal's own size is judged does not, and one turn too many is in hundreds of means.
    """
    longest = max(1, round(BURST_S / recording.period_s))
    channels = dict(recording.channels)
    asked = channels.get("velocity_command_rad_s", np.zeros(1))
    commanded = recording.period_s * float(np.nanmax(np.abs(asked), initial=0.0))
    for name in ANGLES:
        angle = np.array(channels[name], np.float64) if name in channels else np.zeros(0)
        if np.count_nonzero(np.isfinite(angle)) < FEWEST_ROWS:
            continue
        turned = np.abs(np.diff(angle))
        fastest = max(commanded, float(np.nanquantile(turned, FAST_SHARE)))
        rows = np.arange(1.0, longest + 1.0)
        beyond = FAST * fastest * (rows + 1.0) + 1.5 * gap_rad + SPOILT_RAD
        spoilt = _there_and_back(angle, np.asarray(beyond, np.float64))
        if spoilt.any():
            channels[name] = np.where(spoilt, np.nan, angle)
    return replace(recording, channels=channels)


def spoilt_words(recording: Recording, gap_rad: float, names: Sequence[str] = ANGLES) -> int:
    """How many of these angles `without_spoilt_words` takes for such."""
    kept = without_spoilt_words(recording, gap_rad)
    there = [name for name in names if name in recording]
    gone = [np.isfinite(recording[name]) & np.isnan(kept[name]) for name in there]
    return sum(int(np.count_nonzero(one)) for one in gone)


def _there_and_back(values: Array, beyond: Array) -> Mask:
    """Where so many rows in a row, 1 to `beyond.size`, leave their neighbours to one side by more
    than that, and those are alike; shape (rows,)."""
    found = np.zeros(values.size, np.bool_)
    left = np.abs(np.diff(values)) > LEAVES * float(beyond.min())
    starts = np.flatnonzero(left) + 1
    for rows, least_off in enumerate(beyond.tolist(), 1):
        at = starts[starts + rows < values.size]
        before, after = values[at - 1], values[at + rows]
        off = values[at[:, None] + np.arange(rows)] - 0.5 * (before + after)[:, None]
        least = np.where(np.abs(np.sign(off).sum(axis=1)) == rows, np.abs(off).min(axis=1), 0.0)
        back = np.abs(after - before) < 0.5 * least
        for first in at[back & (least > least_off)]:
            found[first : first + rows] = True
    return found


@dataclass(frozen=True, slots=True)
class Lattice:
    """The load angle's quantum and how clear the lattice is (0 to 1)."""

    quantum_rad: float
    standard_error_rad: float
    clearness: float


def lattice(comparison: Comparison, model: Model) -> Lattice | None:
    """The coarsest lattice that the load angle lies on, beyond the encoder's own counts.

    Chips of equal size put the angle itself on something like one: where the simulated angle lies
    on it too, it is the command's. Where that drifts off it, or by chance, it is less clear than
    the sensor's noise would leave one that the encoder makes.
    """
    rows, piece = comparison.source.rows, comparison.longest
    if not rows.has("load_angle_rad") or comparison.block != "loop":
        return None
    angle = rows.channel("load_angle_rad")[piece.rows]
    shown = np.asarray(comparison.source.play(model, piece)["load_angle_rad"])
    looked_at = _near_the_middle(angle)
    shown, angle = shown[looked_at], angle[looked_at]
    travel = float(np.ptp(angle)) if angle.size else 0.0
    if angle.size < FEWEST_ROWS or travel < 20 * COARSEST_QUANTUM_RAD:
        return None
    lowest, highest = 1.0 / COARSEST_QUANTUM_RAD, 1.0 / FINEST_QUANTUM_RAD
    own = _own_quantum(rows.recording, angle)
    if own > 0.0:
        highest = min(highest, 1.0 / (FEWEST_COUNTS * own))
    if highest <= lowest:
        return None
    frequencies, score = _spectrum(angle, travel, highest, own)
    about = np.sqrt(uniform_filter1d(score**2, ABOUT_BINS))
    stands_out = (frequencies >= lowest) & (frequencies <= highest) & (score > LATTICE * about)
    if not stands_out.any():
        return None
    frequency = float(frequencies[stands_out][np.argmax(score[stands_out])])
    centred = angle - angle.mean()
    frequency, clear, step = _refined(centred, frequency, travel)
    # a lattice is as clear at its multiples, and bins may lie better there
    for coarser in frequency / np.arange(2, int(frequency / lowest) + 1):
        at = np.abs(frequencies - coarser) < 1.0 / travel
        if score[at].max(initial=0.0) > HALF * clear:
            found = _refined(centred, coarser, travel)
            frequency, clear, step = max((frequency, clear, step), found, key=lambda it: it[1])
    of_command = _of_command(shown, frequency, travel)
    expected = _as_clear_as(1.0 / frequency, comparison.signals, rows.period_s)
    binned = float(score[stands_out].max())  # where the bins alone make it, the angle has it not
    if of_command > HALF * clear or clear < HALF * max(expected, binned):
        return None
    return Lattice(1.0 / frequency, _spread(centred, clear, float(step)) / frequency**2, clear)


def _refined(centred: Array, frequency: float, travel: float) -> tuple[float, float, float]:
    """Where within half a bin a lattice is clearest, 1/rad, how clear, and the grid's step."""
    near, step = np.linspace(frequency - 0.5 / travel, frequency + 0.5 / travel, 101, retstep=True)
    clear = np.abs(np.exp(2j * np.pi * np.outer(near, centred)).mean(axis=1))
    return float(near[np.argmax(clear)]), float(clear.max()), float(step)


def _near_the_middle(angle: Array) -> Mask:
    """Rows whose angle came and is no farther from the others than is looked at, shape (rows,)."""
    came = np.isfinite(angle)
    if not came.any():
        return came
    near = np.abs(angle - np.median(angle[came])) < FARTHEST_RAD
    return np.asarray(came & near)


def _of_command(shown: Array, frequency: float, travel: float) -> float:
    """How clear the lattice is in the simulated angle; nothing where it is no clearer than by
    chance."""
    near = frequency + np.concatenate([[0.0], BESIDE, -BESIDE]) / travel
    clear, *beside = [abs(np.exp(2j * np.pi * f * shown).mean()) for f in near]
    rms = float(np.sqrt(np.mean(np.square(beside))))
    return float(clear) if clear > OVER_NEIGHBOURS * rms else 0.0


def _as_clear_as(quantum_rad: float, signals: Sequence[Signal], period_s: float) -> float:
    """What the sensor's noise s leaves of a lattice: exp(-(2 pi s/q)^2 / 2), s from its floor."""
    shown = next(s for s in signals if s.channel == ROUNDED)
    one_quantum = np.sqrt(12.0) * rounding_of(shown, quantum_rad, period_s)
    return float(np.exp(-0.5 * (2.0 * np.pi * shown.floor / one_quantum) ** 2))


def _spread(centred: Array, clear: float, step: float) -> float:
    """Standard deviation of a lattice's frequency, 1/rad, sought on a grid of such steps.

    Phases 2 pi f y scatter by (1 - c^2)/(2 c^2) about a line of slope 2 pi df over the angles y.
    """
    phase_rad = np.sqrt(max(1.0 - clear**2, 1e-6) / 2.0) / clear
    slope = phase_rad / (2.0 * np.pi * np.sqrt(float(centred @ centred)))
    return float(np.hypot(slope, step / np.sqrt(12.0)))


def _spectrum(angle: Array, travel: float, highest: float, own: float) -> tuple[Array, Array]:
    """|mean exp(2 pi j f y)| over f, 1/rad, from a fine histogram of the angle.

    Its bins are a whole part of the encoder's own counts, or so many of them: others would make a
    lattice of the two.
    """
    width = 0.2 / highest
    if own > 0.0:
        width = own / np.ceil(own / width) if own > width else own * np.floor(width / own)
    bins = int(np.ceil(1.05 * travel / width)) + 1
    place = np.rint((angle - angle.min()) / width).astype(np.int64)
    counted = np.bincount(place, minlength=bins).astype(np.float64)
    spectrum = np.abs(np.fft.rfft(counted)) / angle.size
    return np.asarray(np.fft.rfftfreq(counted.size, width), np.float64), spectrum


def _own_quantum(recording: Recording, angle: Array) -> float:
    """The encoder's own count: as its rig's file has it, else what its steps are multiples of.

    What is rounded twice, to its own counts at last, has steps of four of them, say, and of five.
    """
    counts = recording.rig.load_counts_per_revolution if recording.rig is not None else None
    if counts is not None and "load_angle_counts" in recording:
        return 2.0 * np.pi / counts
    steps = np.diff(np.unique(angle))
    steps = np.sort(steps[steps > 1e-9 * np.ptp(angle)])
    if not steps.size:
        return 0.0
    usual = steps[steps < 3.0 * steps[0]]
    apart = np.diff(usual)
    return float(min(np.median(usual), apart[apart > 1e-3 * steps[0]].min(initial=np.inf)))
