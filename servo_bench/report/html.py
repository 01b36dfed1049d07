"""Reports as one self-contained HTML file: no script, no other resource, made for A4 and screens.

Templates are jinja2 with autoescape on; the only markup that passes unescaped is SVG that
`style.drawn` made. A content security policy in the page forbids everything that is not in it.
"""

from collections.abc import Mapping
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

from servo_bench import __version__
from servo_bench.estimators.study import Study
from servo_bench.kernels.analysis import Analysis
from servo_bench.kernels.paper_simulation import PaperResult
from servo_bench.recording.recording import Recording
from servo_bench.report.analysis_plates import (
    kernel_plates,
    run_plates,
    study_plates,
    validation_plates,
)
from servo_bench.report.distortion_words import distortion_sentences
from servo_bench.report.estimator_tables import (
    estimator_rows,
    judged_words,
    simulated_table,
    trust_sentence,
)
from servo_bench.report.main_numbers import (
    condition_rows,
    prediction_rows,
    run_rows,
    sequence_words,
)
from servo_bench.report.paper_plates import PLANTS, paper_plates
from servo_bench.report.plates import Plate
from servo_bench.report.wording import ceiling, event_rows, numbers, percent, settings

EVENTS_SHOWN = 200
WARNED_EVENTS = 5
ORDINARY_EVENTS = frozenset({"playing", "stopping", "slot skipped"})
"""Events of every run, and those that are counted as missed slots."""


def analysis_report(analysis: Analysis, recording: Recording, study: Study | None = None) -> str:
    """The report of one experiment, as HTML; with what several estimators make of it."""
    experiment, rig = recording.experiment, recording.rig
    events = event_rows(recording.events[:EVENTS_SHOWN], _start_ns(recording))
    return rendered(
        "analysis.html.j2",
        title=experiment.name if experiment else "experiment",
        rig=rig.name if rig else "a rig that the recording does not name",
        period_ms=f"{recording.period_s * 1e3:g}",
        kernels=analysis.kernels,
        sequence=sequence_words(analysis),
        headline=headline(analysis),
        estimators=estimator_rows(study) if study else [],
        judged=judged_words(),
        simulated=simulated_table(study) if study else None,
        trust=trust_sentence(study) if study else "",
        distortion=distortion_sentences(analysis),
        warnings=_warnings(analysis, recording),
        answers_known="drive_latency_s" in recording,
        predictions=prediction_rows(analysis),
        conditions=condition_rows(analysis),
        run=run_rows(analysis.quality, recording),
        plates=[
            *kernel_plates(analysis, study.posterior if study else None),
            *(study_plates(study) if study else ()),
            *(validation_plates(analysis.validation) if analysis.validation else ()),
        ],
        run_plates=run_plates(analysis, recording),
        experiment=settings(experiment.model_dump(mode="json")) if experiment else [],
        rig_rows=settings(rig.model_dump(mode="json")) if rig else [],
        provenance=sorted(recording.provenance.items()),
        events=events,
        events_left=len(recording.events) - len(events),
        numbers=numbers((study or analysis).numbers()),
    )


def paper_report(result: PaperResult) -> str:
    """The report of the paper's simulation, as HTML."""
    figures = result.numbers()
    plates: list[Plate] = paper_plates(result)
    half = len(plates) // 2
    return rendered(
        "paper.html.j2",
        headline=paper_headline(result),
        memory=figures["memory"],
        polynomial=figures["polynomial"],
        draws=len(result.seeds),
        draw_samples=figures["draw_samples"],
        plants=[
            (PLANTS[key], figures["simulation"][key], shown)
            for key, shown in (("zero", plates[:half]), ("no_zero", plates[half:]))
        ],
        numbers=numbers(figures),
    )


def headline(analysis: Analysis) -> str:
    """The result of an experiment in one sentence."""
    quality = analysis.quality
    order = analysis.kernels.order
    missed = f"{quality.missed_slots} of {quality.slots} slots missed"
    top = f"noise ceiling {ceiling(analysis.noise_ceiling_percent)}"
    if analysis.validation is None:
        same = analysis.identification
        return (
            f"Order-{order} kernels agree with the data they were identified from to "
            f"{percent(same.vaf_order3_percent, 1)} VAF (linear alone "
            f"{percent(same.vaf_order1_percent, 1)}); no held-out output judges them; {top}; "
            f"{missed}."
        )
    fresh = analysis.validation.velocity
    return (
        f"Order-{order} kernels predict the held-out output to "
        f"{percent(fresh.vaf_order3_percent, 1)} VAF (linear alone "
        f"{percent(fresh.vaf_order1_percent, 1)}); {top}; {missed}."
    )


def paper_headline(result: PaperResult) -> str:
    """The result of the simulation in one sentence."""
    zero, no_zero = result.zero.numbers(), result.no_zero.numbers()
    return (
        f"Order-3 kernels predict fresh input to {percent(zero['order3_fresh'], 1)} VAF with the "
        f"zero in G(s) (linear alone {percent(zero['order1_fresh'], 1)}), and to "
        f"{percent(no_zero['order3_fresh'], 1)} without it (linear alone "
        f"{percent(no_zero['order1_fresh'], 1)})."
    )


def _warnings(analysis: Analysis, recording: Recording) -> list[str]:
    """What a reader must see first: the flags, and unusual events."""
    quality = analysis.quality
    found = list(analysis.flags)
    if quality.missed_slots:
        found.append(f"{quality.missed_slots} of {quality.slots} slots were missed.")
    if quality.missing_drive_answers:
        found.append(f"{quality.missing_drive_answers} answers of the drive did not come.")
    if quality.late_answers:
        found.append(f"{quality.late_answers} answers came later than one period.")
    odd = [event for event in recording.events if event.kind not in ORDINARY_EVENTS]
    found += [f"{event.kind}: {event.text}" for event in odd[:WARNED_EVENTS]]
    if len(odd) > WARNED_EVENTS:
        found.append(f"{len(odd) - WARNED_EVENTS} more events: see the list at the end.")
    return found


def _start_ns(recording: Recording) -> int:
    if "asked_ns" in recording and len(recording):
        return int(recording["asked_ns"][0])
    return recording.events[0].time_ns if recording.events else 0


def rendered(template: str, **values: Any) -> str:
    """A template of this package with its values; StrictUndefined where one is missing."""
    environment = Environment(
        loader=PackageLoader("servo_bench.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["percent"] = percent
    shared: Mapping[str, Any] = {"version": __version__, **values}
    return environment.get_template(template).render(shared)
