"""The one compiled loop: telegrams and samples, period by period, step by step."""

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tests.truth.compiling import fingerprint, kernel
from tests.truth.drive import Rig, control, taken_up
from tests.truth.effects import Effects
from tests.truth.motion import stepped
from tests.truth.nuisances import Nuisances
from tests.truth.state import State, fixed, warmth

LAWS = (
    *("drive.py", "effects.py", "mechanics.py", "motion.py", "nuisances.py", "state.py"),
    *("stepping.py", "transmission.py"),
)
"""The files whose text the compiled loop is made of."""

MOTOR_RAD, MOTOR_RAD_S, CURRENT_A, LOAD_RAD, CREEP_RAD = range(5)
"""Columns of what is sampled."""

COLUMNS = 5

ROUNDING = 1e-6
"""Of a step: what a sample's time may miss it by and yet be after it."""

Floats = NDArray[np.float64]
Run = Callable[
    [Rig, Nuisances, Effects, Floats, Floats, Floats, Floats, Floats, State, Floats],
    tuple[State, int],
]


def build(files_fingerprint: int) -> Run:
    """The loop; closes over the fingerprint so that its cache knows the laws' text."""

    @kernel
    def run(
        rig: Rig,
        nuisances: Nuisances,
        effects: Effects,
        table: Floats,
        noise_nm: Floats,
        edge_s: Floats,
        edge_rad_s: Floats,
        sample_s: Floats,
        state: State,
        sampled: Floats,
    ) -> tuple[State, int]:
        edges = 0 * files_fingerprint
        ticks = 0
        h = nuisances.loop_period_s / nuisances.substeps
        known = fixed(rig, nuisances, effects, h)
        step, noise, creep, drive, rotor, driver, load = state
        warm = warmth(rig, nuisances, effects, step * h)
        for row in range(sample_s.size):
            until = math.floor(sample_s[row] / h + ROUNDING)
            while step < until:
                if (step + nuisances.loop_phase) % nuisances.substeps == 0:
                    t = step * h
                    telegram = drive.telegram_rad_s
                    next_pick = drive.next_pick_s
                    if t >= next_pick - 1e-9:
                        while edges < edge_s.size and edge_s[edges] <= t + 1e-9:
                            telegram = edge_rad_s[edges]
                            edges += 1
                        if effects.command_resampling_s > 0.0:
                            next_pick += effects.command_resampling_s
                    drive = taken_up(drive, telegram, next_pick)
                    drive = control(rig, nuisances, effects, drive, rotor.rad, rotor.rad_s)
                    warm = warmth(rig, nuisances, effects, t)
                    noise = 0.0 if math.isnan(telegram) else noise_nm[ticks]
                    ticks += 1
                    if effects.creep_rad_per_nm != 0.0:
                        share = 1.0 - math.exp(-nuisances.loop_period_s / effects.creep_s)
                        torque = warm.torque_constant_nm_per_a * rotor.current_a
                        creep += share * (effects.creep_rad_per_nm * torque - creep)
                rotor, driver, load = stepped(
                    nuisances,
                    effects,
                    known,
                    warm,
                    table,
                    rotor,
                    driver,
                    load,
                    drive.reference_a,
                    noise,
                    h,
                )
                step += 1
            rest = sample_s[row] - step * h
            sampled[row, 0] = rotor.rad + rest * rotor.rad_s
            sampled[row, 1] = rotor.rad_s
            sampled[row, 2] = rotor.current_a
            sampled[row, 3] = load.rad + rest * load.rad_s
            sampled[row, 4] = creep
        return State(step, noise, creep, drive, rotor, driver, load), edges

    return run


run = build(fingerprint(Path(__file__).parent / name for name in LAWS))
