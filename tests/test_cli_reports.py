"""`analyse` and `paper` as an operator calls them."""

import json
import os
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from servo_bench.cli import app as cli
from servo_bench.cli import paper as paper_command
from servo_bench.errors import ConfigError, FitError, RecordingError
from servo_bench.kernels.paper_simulation import PaperResult, simulate_paper
from servo_bench.recording.mcap_file import RecordingWriter
from tests.played_rig import rows_of
from tests.reported_run import Page, flat, short_run

FACTS = {"servo_bench": "0", "clock_monotonic_ns": "0", "clock_utc_ns": "1700000000000000000"}


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    run = short_run()
    assert run.experiment is not None
    assert run.rig is not None
    path = tmp_path_factory.mktemp("recorded") / "run.mcap"
    with RecordingWriter(path, run.experiment, run.rig, FACTS, 1.0 / run.period_s) as writer:
        writer.samples(rows_of(run))
    return path


def _call(*words: str | Path) -> tuple[int, str, BaseException | None]:
    done = CliRunner().invoke(cli.app, [str(word) for word in words])
    return done.exit_code, done.output, done.exception


def test_analyse_writes_what_was_asked_for_and_prints_the_main_figures(
    recording: Path, tmp_path: Path
) -> None:
    report, figures = tmp_path / "out.html", tmp_path / "out.json"
    paper = ("--estimator", "correlation")  # what the others give: tests/test_estimators_study.py
    code, output, _ = _call("analyse", recording, *paper, "--report", report, "--json", figures)
    assert code == 0
    numbers = json.loads(figures.read_text())
    assert Page(report.read_text(encoding="utf-8")).figures() == flat(numbers)
    assert f"{numbers['vaf_fresh_order1_percent']:.2f} %" in output
    assert f"{numbers['vaf_fresh_order3_percent']:.2f} %" in output
    assert "0 of 4963 slots missed" in output


def test_analyse_alone_only_prints(recording: Path) -> None:
    before = sorted(recording.parent.iterdir())
    code, output, _ = _call("analyse", recording, "--memory", "6", "--estimator", "correlation")
    assert code == 0
    assert "noise ceiling" in output
    assert sorted(recording.parent.iterdir()) == before


@pytest.mark.parametrize("option", ["--report", "--json"])
def test_an_output_that_is_there_is_refused_before_anything_is_read(
    tmp_path: Path, option: str
) -> None:
    there = tmp_path / "there"
    there.write_text("precious")
    _, _, error = _call("analyse", tmp_path / "no-such.mcap", option, there)
    assert isinstance(error, ConfigError)
    assert "exists already" in str(error)
    assert there.read_text() == "precious"


def test_a_recording_that_is_not_there_is_said(tmp_path: Path) -> None:
    _, _, error = _call("analyse", tmp_path / "no-such.mcap")
    assert isinstance(error, RecordingError)
    assert "no-such.mcap" in str(error)


def test_a_file_that_is_no_recording_ends_with_its_exit_code_and_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "notes.txt"
    path.write_text("not a recording")
    report = tmp_path / "out.html"
    monkeypatch.setattr(sys, "argv", ["servo-bench", "analyse", str(path), "--report", str(report)])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == RecordingError.exit_code
    told = capsys.readouterr().err
    assert told.startswith("error:")
    assert "notes.txt is not an MCAP file" in told
    assert not report.exists()


def test_a_memory_beyond_the_polynomials_is_refused(recording: Path) -> None:
    _, _, error = _call("analyse", recording, "--memory", "19")
    assert isinstance(error, FitError)


def test_an_output_without_a_place_is_said_before_anything_is_read(tmp_path: Path) -> None:
    nothing, out = tmp_path / "nothing.mcap", tmp_path / "out.json"
    _, _, error = _call("analyse", nothing, "--json", tmp_path / "no" / "out.json")
    assert isinstance(error, ConfigError)
    assert "cannot be written: its folder is not there" in str(error)
    _, _, error = _call("analyse", nothing, "--json", out, "--report", out)
    assert isinstance(error, ConfigError)
    assert "named for two outputs" in str(error)


def test_a_folder_that_nobody_may_write_into_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "access", lambda *_: False)  # root may write into every folder
    _, _, error = _call("analyse", tmp_path / "nothing.mcap", "--json", tmp_path / "out.json")
    assert isinstance(error, ConfigError)
    assert "nobody may write" in str(error)


def test_paper_writes_figures_and_report(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(paper_command, "simulate_paper", lambda: simulate_paper(seeds=(1,)))
    report, figures = tmp_path / "paper.html", tmp_path / "paper.json"
    code, output, _ = _call("paper", "--report", report, "--json", figures)
    assert code == 0
    numbers = json.loads(figures.read_text())
    assert (numbers["memory"], numbers["polynomial"]) == (18, "15341")
    for plant in ("zero", "no_zero"):
        found = numbers["simulation"][plant]
        assert {"order1_fresh", "order3_same", "order3_fresh"} <= set(found)
        assert f"{found['order3_fresh']:.2f} %" in output
    assert Page(report.read_text(encoding="utf-8")).figures() == flat(numbers)


def test_paper_refuses_an_existing_output_before_it_computes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def never() -> PaperResult:
        raise AssertionError("computed")

    monkeypatch.setattr(paper_command, "simulate_paper", never)
    there = tmp_path / "there.json"
    there.write_text("{}")
    _, _, error = _call("paper", "--json", there)
    assert isinstance(error, ConfigError)
    assert there.read_text() == "{}"


@pytest.mark.long
def test_estimators_are_judged_side_by_side(recording: Path, tmp_path: Path) -> None:
    report, figures = tmp_path / "out.html", tmp_path / "out.json"
    words = ("--estimator", "correlation,play", "--report", report, "--json", figures)
    code, output, _ = _call("analyse", recording, *words)
    assert code == 0
    numbers = json.loads(figures.read_text())
    page = Page(report.read_text(encoding="utf-8"))
    assert page.figures() == flat(numbers)
    assert set(numbers["estimators"]) == set(numbers["against_grey_box"]) == {"correlation", "play"}
    assert numbers["grey_box"]["vaf_fresh_percent"] > 99.0
    assert "against a model, not against data" in page.text
    assert "agreement with it proves nothing" in page.text
    assert f"{numbers['estimators']['play']['vaf_fresh_percent']:.2f} %" in output
    _, _, error = _call("analyse", recording, "--estimator", "magic")
    assert isinstance(error, ConfigError)
    assert "no estimator 'magic': choose one of" in str(error)
