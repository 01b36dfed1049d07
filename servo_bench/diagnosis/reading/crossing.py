"""When the samples begin to see the next command: a logger's clock that falls behind the commands'.

A velocity loop's current jumps with its command. While a command acts after the sample of its own
row, that sample shows the one before; once it acts before, all later samples show it at once:

    e_k = measured - simulated current of row k,    j_k = K_P (r_k - r_{k-1})
    crossing = argmax over c of  sum_{k >= c} (2 e_k j_k - j_k^2)

A jump that is yet to come is nothing that an error of the simulation could know, so the sum grows
by j^2 after the crossing and falls by it before. The angles hardly show it. A sample that sees the
next command from the start on is no clock's doing, but the drive's.
"""

import numpy as np

from servo_bench.diagnosis.comparing.comparison import Comparison, Signal
from servo_bench.diagnosis.comparing.rows import Array
from sim_rig.model import Model

LACKING, THERE, FEWEST_JUMPS = 0.5, 0.2, 20
"""Shares of the jumps' energy that must lack before the crossing, and be there after it: a drive's
current shows a half of a jump at the first of its ticks and the rest at the next ones, so that a
clock which walks by little has most of its record between them (0.37 of -7.6e-6)."""


def crossing_s(comparison: Comparison, model: Model) -> float | None:
    """Seconds after the recording's first row; None where nothing is crossed, or no current came.

    `model` is the base that is compared; its own delay must not be below zero.
    """
    effort = next((s for s in comparison.signals if s.simulated == "current_a"), None)
    if effort is None or comparison.block != "loop":
        return None
    piece = comparison.pieces[0].piece
    rows = comparison.source.rows
    error = rows.channel(effort.channel)[piece.rows]
    error = error - effort.factor * comparison.source.play(model, piece)["current_a"]
    jump = _jumps(rows.channel("velocity_command_rad_s")[piece.rows], effort, model)
    known = np.isfinite(error) & (jump != 0.0)
    gained = np.where(known, 2.0 * np.nan_to_num(error) * jump - jump**2, 0.0)
    spent = np.where(known, jump**2, 0.0)
    first = int(np.argmax(np.cumsum(gained[::-1])[::-1]))
    early, late = slice(0, first), slice(first, None)
    if min(known[early].sum(), known[late].sum()) < FEWEST_JUMPS:
        return None
    there = gained[late].sum() > THERE * spent[late].sum()
    lacking = gained[early].sum() < -LACKING * spent[early].sum()
    return float(rows.durations_s[piece.rows][early].sum()) if there and lacking else None


def _jumps(commands_rad_s: Array, effort: Signal, model: Model) -> Array:
    """What a row's command adds to the effort at once, in the channel's unit."""
    per_rad_s = effort.factor * model.nominal.proportional_gain_a_s_per_rad
    return np.asarray(per_rad_s * np.diff(commands_rad_s, prepend=commands_rad_s[:1]))
