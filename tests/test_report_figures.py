"""Figures of analyses and recordings that lack something are drawn, or say what is missing."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import matplotlib as mpl
import numpy as np
import pytest
from numpy.typing import NDArray

from servo_bench.kernels.analysis import analyse
from servo_bench.kernels.volterra import extract
from servo_bench.recording.recording import MISSING, Recording
from servo_bench.report.analysis_plates import run_plates
from servo_bench.report.html import analysis_report
from servo_bench.report.kernel_figures import (
    EXPERIMENT,
    draw_second_kernel,
    draw_third_kernel,
    third_kernel_limit,
)
from servo_bench.report.style import drawn, symmetric_limit
from servo_bench.report.wording import ceiling, numbers, settings, small_percent
from tests.played_rig import Rig, experiment, recording_of, rows_of
from tests.reported_run import Page, short_run


def _with(run: Recording, **channels: NDArray[Any]) -> Recording:
    return replace(run, channels={**run.channels, **channels})


def _without_standstill() -> Recording:
    plan = experiment("15341", memory=18, fresh=256).model_copy(update={"standstill_s": 0.0})
    return Rig().record(plan)


def _without_device_time() -> Recording:
    run = short_run()
    return _with(run, device_time_us=np.full(len(run), MISSING))


def _all_on_time() -> Recording:
    run = short_run()
    return _with(run, lateness_s=np.zeros(len(run)))


def _one_row_missing() -> Recording:
    run = short_run()
    kept = np.arange(len(run)) != 2000
    return replace(run, channels={name: run[name][kept].copy() for name in run.channels})


def _answers_missing() -> Recording:
    run = short_run()
    drive = run["drive_latency_s"].copy()
    drive[500:505] = np.nan
    drive[700] = 2.0 * run.period_s
    return _with(run, drive_latency_s=drive)


def _with_nothing_that_can_be_left_out() -> Recording:
    run = short_run()
    needed = ("slot", "velocity_command_rad_s", "load_angle_rad", "phase")
    return Recording(
        channels={name: run[name] for name in needed},
        period_s=run.period_s,
        experiment=run.experiment,
        rig=None,
        provenance={},
    )


@pytest.mark.parametrize(
    ("make", "said"),
    [
        pytest.param(*(_without_standstill, "noise ceiling not known"), marks=pytest.mark.long),
        pytest.param(*(_without_device_time, "nominal clock"), marks=pytest.mark.nightly),
        pytest.param(*(_all_on_time, "0 µs"), marks=pytest.mark.nightly),
        pytest.param(*(_one_row_missing, "1 of 4963 slots were missed"), marks=pytest.mark.long),
        pytest.param(*(_answers_missing, "answers missing: 5"), marks=pytest.mark.long),
        (_with_nothing_that_can_be_left_out, "lateness_s was not recorded"),
    ],
)
def test_a_run_that_lacks_something_still_has_its_report(
    make: Callable[[], Recording], said: str
) -> None:
    run = make()
    page = Page(analysis_report(analyse(run), run))
    assert page.tags.count("svg") == 8
    assert said in page.text


def test_without_a_validation_the_report_says_that_nothing_judges() -> None:
    run = short_run()
    end = 100 + 256 + 4095 + 1
    short = recording_of(rows_of(run)[:end], None)
    page = Page(analysis_report(analyse(short, memory=18, polynomial="15341"), short))
    assert page.tags.count("svg") == 6
    assert "no held-out output judges them" in page.text
    assert "Figure 10" not in page.text
    assert "does not say what was played" in page.text


@pytest.mark.parametrize("memory", [1, 2, 3])
def test_kernels_of_the_shortest_memories_can_be_drawn(memory: int) -> None:
    response = np.random.default_rng(memory).normal(size=4095)
    kernels = extract(response, "15341", 2.0, memory, period_s=0.008)
    limit = third_kernel_limit(kernels, EXPERIMENT)
    second = drawn("a", 2.0, lambda f: draw_second_kernel(f, kernels, EXPERIMENT, limit), "second")
    third = drawn("b", 2.0, lambda f: draw_third_kernel(f, kernels, EXPERIMENT, limit), "third")
    assert "own scale" in second
    assert ("no element" in third) == (memory < 3)


def test_a_recording_without_rows_has_empty_figures() -> None:
    run = short_run()
    empty = recording_of(rows_of(run)[:0], None)
    plates = run_plates(analyse(run), empty)
    assert all("was not recorded" in plate.svg for plate in plates)


def test_text_in_a_figure_is_escaped_and_never_mathematics() -> None:
    svg = drawn("x", 1.0, lambda f: f.subplots().set_title("a < b & $c^2$"), 'an "x"')
    assert "a &lt; b &amp; $c^2$" in svg
    assert 'aria-label="an &#34;x&#34;"' in svg


def test_drawing_leaves_no_trace_in_the_style_of_others() -> None:
    before = dict(mpl.rcParams)
    drawn("x", 1.0, lambda f: f.subplots().plot([1.0, 2.0]), "x")
    assert dict(mpl.rcParams) == before


def test_the_same_figure_is_the_same_text() -> None:
    def once() -> str:
        return drawn("x", 1.0, lambda f: f.subplots().plot([1.0, 3.0, 2.0], "x"), "x")

    assert once() == once()


def test_wording_keeps_small_and_large_numbers_readable() -> None:
    assert small_percent(0.00123456) == "0.00123 %"
    assert small_percent(5.5) == "5.50 %"
    assert ceiling(99.9987) == "above 99.99 %"
    assert ceiling(99.5) == "99.50 %"
    assert symmetric_limit(np.array([np.nan, -3.0, 2.0])) == 3.0
    assert symmetric_limit(np.array([np.nan])) == 1.0


def test_settings_are_shown_in_readers_units_and_figures_as_they_are() -> None:
    table = {"limits": {"travel_rad": np.pi, "tune": True, "gap_rad": None, "nodes": 3}}
    shown = [(row.name, row.value, row.unit) for row in settings(table)]
    assert shown == [
        ("limits.travel", "180", "deg"),
        ("limits.tune", "true", ""),
        ("limits.gap", "none", ""),
        ("limits.nodes", "3", ""),
    ]
    assert numbers({"a": {"b": 0.1 + 0.2}})[0].value == "0.30000000000000004"
