"""The verdict on a locked output, in words and in the public schema."""

from collections.abc import Collection

import numpy as np

from servo_bench.diagnosis.elsewhere import gate
from servo_bench.diagnosis.elsewhere.locked import LockedFinding
from servo_bench.diagnosis.judging.verdict import Cause, ErrorFigures, Quantity, Verdict
from servo_bench.recording.recording import Recording

PLAY = "backlash_width"
MUCH = 0.3
"""Share of what was seen that play explains, where runs that it does not foretell are unlike."""
NEXT = (
    "Ramp the torque slowly to either side at two amplitudes, output locked: friction alone opens "
    "a loop that grows with the amplitude, play one of a fixed width."
)


def locked_verdict(
    found: LockedFinding,
    recording: Recording,
    without: Collection[str] = (),
    only: Collection[str] = (),
) -> Verdict:
    """Play, where it pays beside a linear spring; else none."""
    before, after = found.held["spring"], found.held["play"]
    tried = PLAY not in without and (not only or PLAY in only)
    pays = tried and found.z >= gate.HELD_Z and found.share >= gate.HELD_SHARE
    play = float(found.play.numbers[1])
    named = pays and play > 0.0
    error = ErrorFigures(
        before=before,
        after=after if named else before,
        noise_floor=0.0,
        share_explained=float(np.clip(found.share, 0.0, 1.0)) if named else 0.0,
        signal="twist",
        unit="rad",
    )
    if not named:
        return _unnamed(found, error, unlike=tried and found.seen_share > MUCH)
    nominal = recording.plant.backlash_gap_rad if recording.plant is not None else None
    change = play - (nominal or 0.0)
    deviation = float(np.sqrt(found.play.covariance[1, 1]))
    unit = "a" if found.amperes else "nm"
    alone = found.over_hysteresis >= gate.HELD_Z
    rival = () if alone else ("coulomb",)
    return Verdict(
        verdict="named",
        sentence=f"The transmission has {np.rad2deg(play):.2f} deg of play"
        f"{'' if alone else ', or friction that holds a soft spring'}: on data that no fit saw the "
        f"error of the twist falls from {np.rad2deg(before):.3f} to {np.rad2deg(after):.3f} deg.",
        causes=(
            Cause(
                effect=PLAY,
                parameters={
                    "change_rad": Quantity(
                        value=change,
                        unit="rad",
                        ci95=(change - 1.96 * deviation, change + 1.96 * deviation),
                        standard_error=deviation,
                    )
                },
                confidence=gate.confidence(found.z, found.over_hysteresis),
                ambiguous_with=rival,
                splitting_experiment="" if alone else NEXT,
                evidence=found.z,
                rival="coulomb",
                over_rival=found.over_hysteresis,
            ),
        ),
        error=error,
        next_run="" if alone else NEXT,
        effects={PLAY: {"change_rad": change}},
        nuisances={
            f"compliance_rad_per_{unit}": float(found.play.numbers[0]),
            f"friction_{unit}": found.play.friction_nm,
            f"friction_middle_{unit}": found.play.middle_nm,
            f"crossing_{unit}": found.play.crossing_nm,
        },
    )


def _unnamed(found: LockedFinding, error: ErrorFigures, *, unlike: bool) -> Verdict:
    """Neither play: a spring is enough, or the runs are not alike."""
    spring, play = (np.rad2deg(found.held[name]) for name in ("spring", "play"))
    judged = f"({spring:.3g} deg with a spring, {play:.3g} deg with play)"
    if not unlike:
        return Verdict(
            verdict="none",
            sentence="A linear spring is all that these runs need: play does not pay on data that "
            f"no fit saw {judged}.",
            error=error,
            next_run=NEXT,
        )
    return Verdict(
        verdict="unknown",
        sentence=f"Something gives way, and not alike in every run: play takes "
        f"{100.0 * found.seen_share:.0f} % of the error of a linear spring where it was fitted, "
        f"and does not foretell the runs that no fit saw {judged}.",
        error=error,
        next_run="Repeat the ramps until they are alike; look for what shifts, slips, or settles.",
    )
