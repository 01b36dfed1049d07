"""When the samples begin to see the next command: a logger's clock that falls behind the commands'.

A velocity loop's current jumps with its command. While a command acts after the sample of its own
row, that sample shows the one before; once it acts before, all later samples show it at once:

    e_k = measured - simulated current of row k,    j_k = K_P (r_k - r_{k-1})
    s(a, b) = sum e_k j_k / sum j_k^2  over rows a to b,    the share of a jump that shows at once
    crossing = where one share before it and another after it leave the least of e

A jump that is yet to come is nothing that an error of the simulation could know, so the share rises
there, to where a good part of a jump shows: a drive's ticks show a part of it first and the rest
at the next one, so that a clock which walks by little rises in stairs (0, 0.48, 0.91 of one of
-6.4e-6, twenty seconds apart), but what a drive shows from the start on it shows to the end. A jump
has to do with the commands before it, of which friction that nobody modelled made a share of -0.5,
and of -0.1 at four times the amplitude: such a rise ends at nothing. The angles hardly show it.
"""

import numpy as np

from servo_bench.diagnosis.comparing.comparison import Comparison, Signal
from servo_bench.diagnosis.comparing.rows import Array, Mask
from sim_rig.model import Model

RISE, FEWEST_JUMPS, LEAST_ENERGY = 0.3, 20, 0.02
"""Of the share, at the crossing, and what it is after it; the jumps on either side that it is told
from, and what they have of all jumps' energy."""


def crossing_s(comparison: Comparison, model: Model) -> float | None:
    """Seconds after the recording's first row; None where nothing is crossed, or no current came.

    `model` is the base that is compared; its own delay must not be below zero.
    """
    effort = next((s for s in comparison.signals if s.simulated == "current_a"), None)
    if effort is None or comparison.block != "loop":
        return None
    piece = comparison.longest
    rows = comparison.source.rows
    error = rows.channel(effort.channel)[piece.rows]
    error = error - effort.factor * comparison.source.play(model, piece)["current_a"]
    jump = _jumps(rows.channel("velocity_command_rad_s")[piece.rows], effort, model)
    known = np.isfinite(error) & (jump != 0.0)
    shown = np.where(known, np.nan_to_num(error) * jump, 0.0)
    spent = np.where(known, jump**2, 0.0)
    first = _step(shown, spent, known)
    if first is None:
        return None
    early, late = slice(0, first), slice(first, None)
    before, after = (_share(shown[part], spent[part]) for part in (early, late))
    crossed = min(after - before, after) > RISE
    return float(rows.durations_s[piece.rows][early].sum()) if crossed else None


def _share(shown: Array, spent: Array) -> float:
    return float(shown.sum() / spent.sum())


def _step(shown: Array, spent: Array, known: Mask) -> int | None:
    """Where one share before and another after explain the most; None where jumps are too few."""
    jumps, energy = np.cumsum(known), np.cumsum(spent)
    least = LEAST_ENERGY * energy[-1]
    fewest = np.minimum(jumps, jumps[-1] - jumps) >= FEWEST_JUMPS
    enough = np.flatnonzero(fewest & (np.minimum(energy, energy[-1] - energy) > least))
    if enough.size == 0:
        return None
    here, most = np.cumsum(shown)[enough], energy[enough]
    explained = here**2 / most + (shown.sum() - here) ** 2 / (energy[-1] - most)
    return int(enough[np.argmax(explained)]) + 1


def _jumps(commands_rad_s: Array, effort: Signal, model: Model) -> Array:
    """What a row's command adds to the effort at once, in the channel's unit."""
    per_rad_s = effort.factor * model.nominal.proportional_gain_a_s_per_rad
    return np.asarray(per_rad_s * np.diff(commands_rad_s, prepend=commands_rad_s[:1]))
