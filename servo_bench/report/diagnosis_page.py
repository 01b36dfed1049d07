"""The page of a diagnosis: one sentence, before and after, the evidence, what to measure next."""

from collections.abc import Iterator
from typing import Any, NamedTuple

from servo_bench.diagnosis.elsewhere import Shown
from servo_bench.diagnosis.judging.picture import CLIP, Track, track_of
from servo_bench.diagnosis.judging.verdict import Cause, Verdict
from servo_bench.diagnosis.searching.contenders import Contender, Round
from servo_bench.diagnosis.searching.finding import Finding
from servo_bench.recording.recording import Recording
from servo_bench.report.diagnosis_elsewhere import draw_shown
from servo_bench.report.diagnosis_figures import (
    Judged,
    draw_before_after,
    draw_evidence,
    draw_signature,
    judged,
)
from servo_bench.report.diagnosis_kernels import KernelStory, draw_kernels, kernel_story
from servo_bench.report.html import rendered
from servo_bench.report.plates import Plate
from servo_bench.report.style import drawn
from servo_bench.report.wording import Row, numbers, percent

NO_KERNELS = (
    "Left out: kernels can be told from whole periods of an M-sequence, an inverse-repeat, a field "
    "or a multi-amplitude sequence, with the load's angle, and this recording has not all of that."
)
CLIPPED = 0.005
"""Share of the error that is drawn smaller than it is, from which on that is said."""
EMPTY: dict[str, Any] = {
    **dict.fromkeys(("gains", "before_after", "evidence", "evidence_words", "signature"), ()),
    **dict.fromkeys(("shares", "kernel_rows", "kernel_plates"), ()),
    "share": "",
}


class CauseRow(NamedTuple):
    """One parameter of one cause."""

    name: str
    remark: str
    value: str
    interval: str
    confidence: str
    first: bool


class Gain(NamedTuple):
    """One signal's rms before and after."""

    name: str
    unit: str
    before: str
    after: str
    floor: str
    factor: str


def diagnosis_report(
    verdict: Verdict, finding: Finding | None, shown: Shown | None, recording: Recording
) -> str:
    """The page, self-contained; of data from elsewhere with what they have `shown`, and where
    nothing could be fitted its words alone."""
    experiment, rig = recording.experiment, recording.rig
    seconds = len(recording) * recording.period_s
    return rendered(
        "diagnosis.html.j2",
        title=experiment.name if experiment else "a recording",
        about=f"Rig {rig.name if rig else 'not named'}; {seconds:.0f} s at "
        f"{recording.period_s * 1e3:g} ms; verdict: {verdict.verdict}",
        verdict=verdict,
        warnings=[*verdict.notes, *verdict.undecided],
        causes=[row for cause in verdict.causes for row in _cause_rows(cause)],
        next_run=verdict.next_run,
        no_kernels=NO_KERNELS if finding is not None else "",
        limits=[
            (
                f"{limit.effect}.{limit.parameter}",
                *(_number(v, limit.unit) for v in (limit.detectable, limit.cramer_rao)),
                _number(limit.ratio, ""),
            )
            for limit in verdict.limit
        ],
        numbers=numbers(verdict.numbers()),
        **{**EMPTY, **(_found(verdict, finding) if finding is not None else _elsewhere(shown))},
    )


def _elsewhere(shown: Shown | None) -> dict[str, Any]:
    """What data from elsewhere can show."""
    if shown is None:
        return {}
    plate = Plate(
        drawn(
            "before-after",
            2.9,
            lambda figure: draw_shown(figure, shown),
            "Measured signal, plain and extended model, and their errors",
        ),
        "Before and after",
        "Rows that no fit saw: what was measured, the plain model, and its best extension.",
    )
    return {"before_after": [plate]}


def _found(verdict: Verdict, finding: Finding) -> dict[str, Any]:
    """What only a finding can show."""
    found, story, track = judged(finding), kernel_story(finding), track_of(finding)
    return {
        "gains": [_gain(*row) for row in found.rms()],
        "share": _share(verdict),
        "before_after": [_before_after(found)],
        "evidence": list(_evidence(verdict, finding)),
        "evidence_words": list(_evidence_words(verdict, finding)),
        "signature": [
            Plate(
                drawn(
                    "signature",
                    4.4,
                    lambda figure: draw_signature(figure, track),
                    "The error by velocity, by order, after an edge, and in time",
                ),
                "Where the error is",
                f"{track.signal.name}, measured less simulated by the base: nominal values, and "
                f"what every rig has beside its drawing.{_clipped(track)}",
            )
        ],
        "shares": _shares(verdict),
        "kernel_rows": story.rows() if story is not None else (),
        "kernel_plates": [_kernels(story)] if story is not None else (),
    }


def _clipped(track: Track) -> str:
    if track.clipped_share < CLIPPED:
        return ""
    return (
        f" {percent(100.0 * track.clipped_share, 0)} of it is larger than {CLIP:g} robust standard "
        "deviations, and drawn as that: blows and jumps stand higher than here."
    )


def _before_after(found: Judged) -> Plate:
    return Plate(
        drawn(
            "before-after",
            3.0,
            lambda figure: draw_before_after(figure, found),
            "Measured signal, nominal and extended simulation",
        ),
        "Before and after",
        "A stretch that no fit saw. The simulations get the commands alone.",
    )


def _evidence(verdict: Verdict, finding: Finding) -> Iterator[Plate]:
    """For every cause that was found its round, in the verdict or not; else the first round, with
    nothing chosen."""
    chosen: list[tuple[Round, Contender | None]] = [
        (n.round, n.contender) for n in finding.named if n.missed_z is None
    ]
    if not chosen and finding.rounds:
        chosen = [(finding.rounds[0], None)]
    none = "no other cause was accepted" if verdict.causes else "nothing was convincing"
    rivals = {cause.effect: cause.rival for cause in verdict.causes}
    for number, (played, contender) in enumerate(chosen, 1):
        if contender is None:
            what = none
        elif contender.effect in rivals:
            what = f"the evidence for {contender.effect}"
        else:
            what = f"{contender.effect}, which has no name in the verdict"
        rival = rivals.get(contender.effect) if contender else None
        yield _round_plate(number, played, contender, what, rival=rival)


def _round_plate(
    number: int, played: Round, contender: Contender | None, what: str, *, rival: str | None
) -> Plate:
    return Plate(
        drawn(
            f"evidence-{number}",
            2.7,
            lambda figure: draw_evidence(figure, played, contender, rival),
            f"Screening and fits: {what}",
        ),
        f"Search {number}: {what.replace('_', ' ')}",
        "Left: what each effect could explain at its best size, the numbers that every rig leaves "
        "open solved along. Middle: the cost that is left after full fits, on data seen and held "
        "out. Right: the advantage block by block; a cause that is right gains in most of them.",
    )


def _evidence_words(verdict: Verdict, finding: Finding) -> Iterator[str]:
    yield from _in_the_data(finding)
    beside = {n.effect: n.beside for n in finding.named}
    for cause in verdict.causes:
        if cause.evidence is None:
            continue
        text = f"{_name(cause.effect)} gains over a simulation without it by {cause.evidence:.1f} "
        text += "standard deviations of the blocks' scatter"
        if cause.rival is not None and cause.over_rival is not None:
            text += _beside_its_rival(_name(cause.rival), cause.over_rival)
        if beside.get(cause.effect):
            text += (
                f", both with {_name(beside[cause.effect])}, which was as good alone and changes "
                "something else: it may be there or not"
            )
        yield text + "."


def _beside_its_rival(rival: str, over: float) -> str:
    """By how much it leads; or why one that fits better is not named."""
    if over >= 0.0:
        return f", and over its best rival, {rival}, by {over:.1f}"
    return (
        f"; {rival} fits better by {-over:.1f}, but assumes more to change the same, or is not "
        "beyond chance on what no fit saw"
    )


def _in_the_data(finding: Finding) -> Iterator[str]:
    """Causes that no fit has found, because they stand in the data themselves."""
    grid, lost = finding.lattice, finding.lost
    if grid is not None:
        yield (
            f"The load's angle lies on steps of {grid.quantum_rad:.4g} rad, at a clearness of "
            f"{grid.clearness:.2f}: 1 where every sample does, 0 where none of them cares."
        )
    yield from (one.sentence for one in finding.readings)
    if lost.rows:
        yield (
            f"{len(lost.rows)} of {lost.changes} changes of the command left out the response to a "
            "whole chip, as if the drive never had them."
        )


def _cause_rows(cause: Cause) -> Iterator[CauseRow]:
    remark = (
        f"or {', '.join(_name(n) for n in cause.ambiguous_with)}" if cause.ambiguous_with else ""
    )
    sure = percent(100.0 * cause.confidence, 0)
    if not cause.parameters:
        yield CauseRow(_name(cause.effect), remark, "", "", sure, first=True)
    for number, (name, q) in enumerate(cause.parameters.items()):
        low, high = q.ci95
        unit = "" if q.unit == "1" else f" {q.unit}"
        yield CauseRow(
            name=f"{_name(cause.effect)}: {_name(name)}",
            remark=remark if number == 0 else "",
            value=f"{q.value:.4g}{unit}",
            interval="chosen" if q.is_chosen else f"{low:.4g} … {high:.4g}",
            confidence=sure if number == 0 else "",
            first=number == 0,
        )


def _gain(name: str, unit: str, before: float, after: float, floor: float) -> Gain:
    factor = f"{before / after:.2g}" if after > 0.0 else "-"
    return Gain(name, unit, f"{before:.3g}", f"{after:.3g}", f"{floor:.2g}", factor)


def _share(verdict: Verdict) -> str:
    if verdict.error is None:
        return ""
    return (
        f"Of the {verdict.error.signal}'s explainable error (above its sensor's floor) "
        f"{100 * verdict.error.share_explained:.0f} % is removed."
    )


def _shares(verdict: Verdict) -> list[Row]:
    if verdict.signature is None:
        return []
    return [Row(n, percent(100.0 * s, 1)) for n, s in verdict.signature.shares.items()]


def _kernels(story: KernelStory) -> Plate:
    return Plate(
        drawn(
            "kernels",
            2.3,
            lambda figure: draw_kernels(figure, story),
            "Measured, nominal, and extended kernels",
        ),
        "Kernels",
        "Coefficients of the load's velocity. Orders 2 and 3: each element, simulated over "
        "measured; on the line the simulation has it. Crosses: nominal; plus signs: extended.",
    )


def _name(effect: str) -> str:
    return effect.replace("_", " ")


def _number(value: float | None, unit: str) -> str:
    return "not known" if value is None else f"{value:.3g} {unit}".strip()
