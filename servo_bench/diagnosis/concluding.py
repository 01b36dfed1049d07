"""Recordings in, a verdict out, whatever they are: the one way for all that ask for a diagnosis.

Data that were read and cannot be judged end in the verdict "unknown", which says why; only what
the one who asks can mend (no rig, recordings that do not go together) is an error.
"""

from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np

from servo_bench.diagnosis.comparing.rows import filtered
from servo_bench.diagnosis.diagnose import believed, investigate
from servo_bench.diagnosis.elsewhere import Shown, is_open, judge_open
from servo_bench.diagnosis.judging.excitations import check_apart, same_commands
from servo_bench.diagnosis.judging.judgement import verdict_of
from servo_bench.diagnosis.judging.picture import picture
from servo_bench.diagnosis.judging.undecided import (
    REPEAT,
    check_alike,
    check_one_rig,
    few_seconds,
    open_questions,
    undecided,
    what_next,
)
from servo_bench.diagnosis.judging.verdict import Verdict
from servo_bench.diagnosis.searching.finding import Finding, nothing_told
from servo_bench.diagnosis.searching.rounds import Told
from servo_bench.errors import FitError
from servo_bench.recording.recording import Recording
from servo_bench.rig import RigConfig
from sim_rig.errors import SimRigError
from sim_rig.model import Model

FAILED = (FitError, SimRigError, np.linalg.LinAlgError)
"""What an estimate may end in; stated in the verdict."""


class Concluded(NamedTuple):
    """The verdict, and what it was written from, where the data could be judged."""

    verdict: Verdict
    finding: Finding | None
    shown: Shown | None = None
    """Of data from elsewhere: what their picture shows."""


def conclude(
    recordings: Sequence[Recording],
    *,
    rig: RigConfig | None = None,
    model: Model | None = None,
    held_out: Recording | None = None,
    without: Collection[str] = (),
    only: Collection[str] = (),
    report: Told = nothing_told,
) -> Concluded:
    """The verdict on recordings of one rig, with the error's picture and its open questions.

    `model` is what is believed, else that of `rig`, else of the recordings' own; the others are as
    in `diagnose`.
    ConfigError where no rig is known and the data are not from elsewhere, or where the recordings
    do not go together, are the same, or tell of rigs that differ and nobody says which is meant.
    """
    if rig is None and model is None:
        check_one_rig(recordings, held_out)
    if rig is not None:  # what is known of the drive now, nobody may have known at the recording
        by_s = rig.drive.torque_filter_s
        recordings = [filtered(one, by_s) for one in recordings]
        held_out = filtered(held_out, by_s) if held_out is not None else None
    config = rig if rig is not None else recordings[0].rig
    if model is None and config is not None:
        model = config.model()
    elsewhere = model is None and all(is_open(one) for one in recordings)
    check_alike(recordings, held_out, one_period=not elsewhere)
    check_apart(recordings, held_out)
    if model is None and not elsewhere:
        model = believed(recordings)
    still = (*same_commands(recordings, held_out), *few_seconds(recordings))
    try:
        if model is None:
            judged = judge_open(recordings, held_out=held_out, without=without, only=only)
            return Concluded(_open_still(_sent_on(judged.verdict), still), None, judged.shown)
        finding = investigate(
            recordings, model=model, held_out=held_out, without=without, only=only, report=report
        )
        report("writing the verdict")
        return Concluded(_open_still(_told(finding, without, only), still), finding)
    except FAILED as error:
        return Concluded(undecided(error, recordings), None)


def _told(finding: Finding, without: Collection[str], only: Collection[str]) -> Verdict:
    """The verdict on a finding, with its picture and what this excitation leaves open."""
    verdict = verdict_of(finding)
    first = finding.recordings[0]
    more = {
        "signature": picture(finding),
        "notes": (*verdict.notes, *_asked(without, only)),
        "undecided": (*verdict.undecided, *open_questions(first)),
        "next_run": what_next(verdict, first),
    }
    return verdict.model_copy(update=more)


def _sent_on(verdict: Verdict) -> Verdict:
    """On data from elsewhere, which no excitation of ours made: the unexplained once more."""
    if verdict.next_run or verdict.verdict != "unknown":
        return verdict
    return verdict.model_copy(update={"next_run": REPEAT})


def _asked(without: Collection[str], only: Collection[str]) -> tuple[str, ...]:
    """Where not the whole catalogue was."""
    named = [f"only {', '.join(sorted(only))}"] if only else []
    named += [f"not {', '.join(sorted(without))}"] if without else []
    return (f"Asked of the catalogue, as ordered: {'; '.join(named)}.",) if named else ()


def _open_still(verdict: Verdict, more: tuple[str, ...]) -> Verdict:
    """The verdict, with what else is open."""
    return verdict.model_copy(update={"undecided": (*verdict.undecided, *more)})
