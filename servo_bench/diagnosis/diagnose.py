"""Recordings in, verdict out: `finding` has the stages, `judgement` writes the verdict."""

from collections.abc import Collection, Sequence

from servo_bench.diagnosis.comparing.comparison import Choice
from servo_bench.diagnosis.elsewhere import diagnose_open, is_open
from servo_bench.diagnosis.judging.judgement import verdict_of
from servo_bench.diagnosis.judging.undecided import check_one_rig
from servo_bench.diagnosis.judging.verdict import Verdict
from servo_bench.diagnosis.searching.finding import Finding, find_causes, nothing_told
from servo_bench.diagnosis.searching.rounds import Told
from servo_bench.errors import ConfigError
from servo_bench.recording.recording import Recording
from sim_rig.model import Model


def diagnose(
    recordings: Sequence[Recording],
    *,
    model: Model | None = None,
    held_out: Recording | None = None,
    without: Collection[str] = (),
    only: Collection[str] = (),
    block: Choice = "auto",
    report: Told = nothing_told,
) -> Verdict:
    """What the simulation of this rig gets wrong.

    Data from elsewhere (an effort and its motion, or a locked output, and no rig) are judged
    against a plain motor; see `elsewhere`.

    `model` is what is believed before (else the recording's own rig); `without` takes effects out
    of the catalogue, `only` leaves nothing but these; gain is measured on `held_out`, else on the
    recordings' own validation. Raises FitError where the data cannot be judged at all, ConfigError
    where no model is known, or where the recordings' own differ.
    """
    if model is None and recordings and all(is_open(one) for one in recordings):
        return diagnose_open(recordings, held_out=held_out, without=without, only=only)
    finding = investigate(
        recordings,
        model=model,
        held_out=held_out,
        without=without,
        only=only,
        block=block,
        report=report,
    )
    return verdict_of(finding)


def investigate(
    recordings: Sequence[Recording],
    *,
    model: Model | None = None,
    held_out: Recording | None = None,
    without: Collection[str] = (),
    only: Collection[str] = (),
    block: Choice = "auto",
    report: Told = nothing_told,
) -> Finding:
    """The same, with everything that a verdict and its page are written from."""
    return find_causes(
        recordings,
        model or believed(recordings, held_out),
        held_out=held_out,
        block=block,
        without=without,
        only=only,
        report=report,
    )


def believed(recordings: Sequence[Recording], held_out: Recording | None = None) -> Model:
    """The model that the recordings' own rig files state. ConfigError where the first has none, or
    where they differ."""
    rig = recordings[0].rig if recordings else None
    if rig is None:
        raise ConfigError(
            "the recording says nothing of its rig: give --rig RIG.toml, or --model MODEL.toml "
            "with [nominal]."
        )
    check_one_rig(recordings, held_out)
    return rig.model()
