"""One HTML page: the judgement of a plan, or the runs of a test that failed.

The look, the plates, and the tables are those of `servo_bench.report`; only the head is of here.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined

from servo_bench import __version__
from servo_bench.check.judge import Judgement
from servo_bench.errors import BenchError
from servo_bench.kernels.analysis import Analysis, analyse
from servo_bench.kernels.quality import run_quality
from servo_bench.recording.recording import Recording
from servo_bench.report.analysis_plates import kernel_plates, run_plates, validation_plates
from servo_bench.report.html import headline
from servo_bench.report.main_numbers import condition_rows, run_rows
from servo_bench.report.plates import Plate
from servo_bench.report.wording import Row, event_rows, settings

EVENTS_SHOWN = 50


@dataclass(frozen=True, slots=True, eq=False)
class RunView:
    """A run as the page shows it."""

    title: str
    headline: str
    run: Sequence[Row]
    conditions: Sequence[Row]
    plates: Sequence[Plate]
    events: Sequence[tuple[str, str, str, str]]
    rig: Sequence[Row]


def judgement_page(judgement: Judgement, recording: Recording) -> str:
    """The report of a check, as HTML."""
    return _rendered(
        "check.html.j2",
        title=judgement.plan.name,
        sentence=judgement.sentence,
        passed=judgement.passed,
        findings=judgement.findings,
        runs=[run_view(recording, judgement.analysis)],
    )


def failure_page(title: str, text: str, recordings: Sequence[Recording]) -> str:
    """The page of a failed test: what pytest says, and each run that it made; the last in full."""
    views = [run_view(recording) for recording in recordings[-1:]]
    before = [run_view(recording, plates=False) for recording in recordings[:-1]]
    return _rendered("failure.html.j2", title=title, text=text, runs=[*before, *views])


def run_view(
    recording: Recording, analysis: Analysis | None = None, *, plates: bool = True
) -> RunView:
    """A recording for the page; one that cannot be analysed is shown without kernels."""
    try:
        found = analysis or analyse(recording)
    except BenchError as error:
        return _view(recording, f"No kernels: {error}", (), ())
    drawn: list[Plate] = []
    if plates:
        drawn += kernel_plates(found)
        drawn += validation_plates(found.validation) if found.validation else ()
        drawn += run_plates(found, recording)
    return _view(recording, headline(found), condition_rows(found), drawn)


def _view(
    recording: Recording, sentence: str, conditions: Sequence[Row], plates: Sequence[Plate]
) -> RunView:
    experiment, rig = recording.experiment, recording.rig
    start_ns = recording.events[0].time_ns if recording.events else 0
    return RunView(
        title=f"{experiment.name if experiment else 'run'} on {rig.name if rig else 'a rig'}",
        headline=sentence,
        run=run_rows(run_quality(recording), recording),
        conditions=conditions,
        plates=plates,
        events=event_rows(recording.events[:EVENTS_SHOWN], start_ns),
        rig=settings(rig.model_dump(mode="json")) if rig else [],
    )


def _rendered(template: str, **values: Any) -> str:
    loaders = [PackageLoader("servo_bench.check"), PackageLoader("servo_bench.report")]
    environment = Environment(
        loader=ChoiceLoader(loaders),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(template).render(version=__version__, **values)
