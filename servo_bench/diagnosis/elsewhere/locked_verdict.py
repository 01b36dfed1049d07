"""The verdict on a locked output, in words and in the public schema."""

from collections.abc import Collection

import numpy as np

from servo_bench.diagnosis.elsewhere import gate
from servo_bench.diagnosis.elsewhere.explained import EXPLAINED, share_explained
from servo_bench.diagnosis.elsewhere.locked import LockedFinding
from servo_bench.diagnosis.judging.verdict import Cause, ErrorFigures, Quantity, Verdict

PLAY = "backlash_width"
MUCH = 0.3
"""Share of what was seen that play explains, where runs that it does not foretell are unlike."""
NEXT = (
    "Ramp the torque slowly to either side at two amplitudes, output locked: friction alone opens "
    "a loop that grows with the amplitude, play one of a fixed width."
)
CHECK = (
    "Hold a torque to either side, output locked, and look whether the twist follows: else the "
    "channels are not of one shaft, the output moves, or the sensor slips."
)


def locked_verdict(
    found: LockedFinding,
    without: Collection[str] = (),
    only: Collection[str] = (),
) -> Verdict:
    """Play, where it is not what the map declares and pays beside a linear spring; else none, or
    unknown where the spring does not explain the twist either."""
    before, after = found.held["spring"], found.held["play"]
    tried = PLAY not in without and (not only or PLAY in only)
    pays = tried and found.z >= gate.HELD_Z and found.share >= gate.HELD_SHARE
    fitted, declared = float(found.play.numbers[1]), found.spring.gap_rad
    deviation = float(np.sqrt(found.play.covariance[1, 1]))
    play = max(fitted, 0.0)
    change, least = play - declared, gate.SURE * deviation if declared else 0.0
    named = pays and fitted > -least and abs(change) > least
    error = ErrorFigures(
        before=before,
        after=after if named else before,
        noise_floor=0.0,
        share_explained=float(np.clip(found.share, 0.0, 1.0)) if named else 0.0,
        signal="twist",
        unit="rad",
    )
    if not named:
        as_declared = pays and declared > 0.0
        unlike = tried and not as_declared and found.seen_share > MUCH
        return _unnamed(found, error, tried=tried, unlike=unlike)
    unit = "a" if found.amperes else "nm"
    alone = found.over_hysteresis >= gate.HELD_Z
    rival = () if alone else ("coulomb",)
    told = _declared(declared) + ("" if alone else ", or friction that holds a soft spring")
    return Verdict(
        verdict="named",
        sentence=f"The transmission has {np.rad2deg(play):.2f} deg of play{told}: on data that no "
        f"fit saw the error of the twist falls from {np.rad2deg(before):.3f} to "
        f"{np.rad2deg(after):.3f} deg.",
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


def _declared(gap_rad: float) -> str:
    return f", where the map declares {np.rad2deg(gap_rad):.2f} deg" if gap_rad else ""


def _unnamed(found: LockedFinding, error: ErrorFigures, *, tried: bool, unlike: bool) -> Verdict:
    """Not play: a spring is enough, or the runs are not alike, or it is something else."""
    spring, play = (np.rad2deg(found.held[name]) for name in ("spring", "play"))
    judged = f"({spring:.3g} deg with a spring, {play:.3g} deg with play)"
    if unlike:
        return Verdict(
            verdict="unknown",
            sentence=f"Something gives way, and not alike in every run: play takes "
            f"{100.0 * found.seen_share:.0f} % of the error of a linear spring where it was "
            f"fitted, and does not foretell the runs that no fit saw {judged}.",
            error=error,
            next_run="Repeat the ramps until they are alike; look for what shifts, slips, or "
            "settles.",
        )
    explained = share_explained(found.held["spring"], found.there)
    if explained < EXPLAINED and found.held["spring"] > gate.QUIET * found.noise:
        who = "Neither a linear spring nor play explains" if tried else "No linear spring explains"
        return Verdict(
            verdict="unknown",
            sentence=f"{who} the twist: of {np.rad2deg(found.there):.3g} deg (rms) on data that no "
            f"fit saw {spring:.3g} deg are left with a spring, {play:.3g} deg with play.",
            error=error,
            next_run=CHECK if tried else NEXT,
        )
    gap_deg = np.rad2deg(found.spring.gap_rad)
    given = f" and the map's {gap_deg:.2f} deg of play are" if gap_deg else " is"
    return Verdict(
        verdict="none",
        sentence=f"A linear spring{given} all that these runs need: {'other ' if gap_deg else ''}"
        f"play does not pay on data that no fit saw {judged}.",
        error=error,
        next_run=NEXT,
    )
