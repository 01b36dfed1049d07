"""An acceptance plan passes where every limit holds, fails where one does not, and says which."""

import json
import math
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from xml.etree import ElementTree

import pytest
from typer.testing import CliRunner

from servo_bench.check import judge as judging
from servo_bench.check.judge import judge
from servo_bench.check.page import failure_page
from servo_bench.check.plan import Bounds, Plan, load_plan
from servo_bench.cli import app as cli
from servo_bench.cli.check import NOT_PASSED
from servo_bench.errors import ConfigError, RecordingError, WireError
from servo_bench.files import find
from servo_bench.run.virtual import save
from tests.reported_run import HOSTILE, Page
from tests.small_runs import experiment, small_run

HEAD = 'name = "axis"\nexperiment = "small.toml"\n'
EXPERIMENT = """
name = "small"
rig = "rigs/paper.toml"
period_s = 0.008
memory = 9
standstill_s = 0.8
lead_in = 64
[identification]
polynomial = "1021"
amplitude_deg_s = 150
[validation]
kind = "random-binary"
seed = 1
amplitude_deg_s = 150
length = 200
"""


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("check") / "run.mcap"
    save(small_run(1), path)
    return path


def _plan(folder: Path, text: str) -> Path:
    (folder / "small.toml").write_text(EXPERIMENT)
    path = folder / "plan.toml"
    path.write_text(HEAD + text)
    return path


def _check(*words: object) -> tuple[int, str, BaseException | None]:
    done = CliRunner().invoke(cli.app, ["check", *map(str, words)])
    return done.exit_code, done.output, done.exception


def test_a_plan_is_played_in_virtual_time_and_passes(tmp_path: Path) -> None:
    plan = _plan(tmp_path, "[limits]\nvaf_fresh_order3_percent = { least = 80 }\n")
    out = [tmp_path / name for name in ("r.html", "f.json", "j.xml", "run.mcap")]
    code, output, _ = _check(
        plan, "--report", out[0], "--json", out[1], "--junit", out[2], "-o", out[3]
    )
    assert code == 0, output
    assert "axis: passed, 1 of 1." in output
    assert json.loads(out[1].read_text())["passed"] is True
    assert out[3].stat().st_size > 10_000
    page = Page(out[0].read_text(encoding="utf-8"))
    assert "script" not in page.tags
    assert "Acceptance: axis" in page.text
    suite = ElementTree.parse(out[2]).getroot()[0]  # noqa: S314 - our own file
    assert (suite.get("tests"), suite.get("failures"), suite.get("errors")) == ("1", "0", "0")


def test_a_limit_that_does_not_hold_has_its_own_exit_code(tmp_path: Path, file: Path) -> None:
    text = """
[limits]
vaf_fresh_order3_percent = { least = 99.99 }
"run.missed_slots" = { most = 0 }
[fit]
backlash_gap_deg = { least = 1.4, most = 1.6 }
J = { most = 1e-4 }
"""
    junit = tmp_path / "j.xml"
    code, output, _ = _check(_plan(tmp_path, text), "--recording", file, "--junit", junit)
    assert code == NOT_PASSED
    assert "FAILED 2 of 4: vaf_fresh_order3_percent, J." in output
    suite = ElementTree.parse(junit).getroot()[0]  # noqa: S314
    failed = [case.get("name") for case in suite if case.find("failure") is not None]
    assert failed == ["limits.vaf_fresh_order3_percent", "fit.J"]


def test_an_error_keeps_its_exit_code_and_stands_in_the_junit_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object, **__: object) -> None:
        raise WireError("no answer \x00\x1b[31m from node 1")

    monkeypatch.setattr("servo_bench.cli.check.run_virtually", broken)
    plan = _plan(tmp_path, "[limits]\nnoise_rad_s = { most = 1 }\n")
    junit = tmp_path / "j.xml"
    assert isinstance(_check(plan, "--junit", junit)[2], WireError)
    suite = ElementTree.parse(junit).getroot()[0]  # noqa: S314
    error = suite[0].find("error")
    assert error is not None
    assert error.get("type") == "WireError"
    assert "from node 1" in str(error.get("message"))


def test_only_a_permission_leads_to_the_rigs_own_bus(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened: list[bool] = []

    def play(*_: object, simulated: bool, **__: object) -> None:
        opened.append(simulated)
        raise WireError("nobody is there")

    monkeypatch.setattr("servo_bench.cli.check.play", play)
    _check(_plan(tmp_path, 'time = "wall"\n[limits]\nnoise_rad_s = { most = 1 }\n'))
    _check(tmp_path / "plan.toml", "--permit-real-rig")
    assert opened == [True, False]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "nothing would be judged"),
        ("[limits]\nnoise_rad_s = {}\n", "least, most, or both"),
        ("[limits]\nnoise_rad_s = { least = 2, most = 1 }\n", "is above"),
        ("[limits]\nnoise_rad_s = 3\n", "noise_rad_s"),
        ("[limits]\nnoise_rad_s = { most = nan }\n", "noise_rad_s"),
        ("limits = 7\n", "limits"),
        ("[limits]\nnoise_rad_s = { most = 1 }\nnoise_deg_s = { most = 1 }\n", "given twice"),
        ("[verdict]\nallowed = []\n", "allowed"),
        ('[verdict]\nallowed = ["nome"]\n', "no diagnosis says 'nome'.* Is 'none' meant"),
        ('[verdict]\nallowed = ["none", "coulom"]\n', "Is 'coulomb' meant"),
        ('time = "sometimes"\n[limits]\nnoise_rad_s = { most = 1 }\n', "time"),
        ('rig = "no-such.toml"\n[limits]\nnoise_rad_s = { most = 1 }\n', "no-such.toml"),
    ],
)
def test_a_plan_that_makes_no_sense_says_where(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        load_plan(_plan(tmp_path, text))


def test_a_recording_of_something_else_is_not_judged(tmp_path: Path, file: Path) -> None:
    plan = _plan(tmp_path, "[limits]\nnoise_rad_s = { most = 1e9 }\n")
    assert _check(plan, "--recording", file)[0] == 0
    for words in (("-o", tmp_path / "new.mcap"), ("--permit-real-rig",)):
        assert isinstance(_check(plan, "--recording", file, *words)[2], ConfigError)
    (tmp_path / "small.toml").write_text(EXPERIMENT.replace("= 150", "= 100"))
    error = _check(plan, "--recording", file)[2]
    assert isinstance(error, ConfigError)
    assert "commands something else than 'small'" in str(error)
    other = _plan(tmp_path, 'rig = "rig.toml"\n[limits]\nnoise_rad_s = { most = 1e9 }\n')
    paper = find("rigs/paper.toml").read_text(encoding="utf-8")
    (tmp_path / "rig.toml").write_text(paper.replace('name = "paper"', 'name = "another"'))
    error = _check(other, "--recording", file)[2]
    assert isinstance(error, ConfigError)
    assert "is of the rig 'paper', and the plan is for 'another'" in str(error)


def test_readers_units_are_those_of_the_figure(tmp_path: Path) -> None:
    plan, played, _ = load_plan(_plan(tmp_path, "[limits]\nnoise_deg_s = { most = 180 }\n"))
    assert plan.limits == {"noise_rad_s": Bounds(most=math.pi)}
    assert played.identification == experiment().identification


def test_of_an_event_that_never_came_there_were_none() -> None:
    plan = Plan(name="p", experiment="e", limits={"run.events.slot skipped": Bounds(most=0.0)})
    (finding,) = judge(plan, small_run(1)).findings
    assert (finding.value, finding.passed) == (0.0, True)


@pytest.mark.parametrize(("name", "words"), [("no_such", "no figure"), ("timebase", "no number")])
def test_a_figure_that_cannot_be_limited(name: str, words: str) -> None:
    plan = Plan(name="p", experiment="e", limits={name: Bounds(most=1.0)})
    with pytest.raises(ConfigError, match=words):
        judge(plan, small_run(1))


@dataclass(frozen=True)
class _Verdict:
    verdict: str
    causes: tuple[Any, ...] = ()

    def numbers(self) -> dict[str, Any]:
        return {"verdict": self.verdict}


@pytest.mark.parametrize(
    ("verdict", "allowed", "passed"),
    [
        (_Verdict("none"), ("none",), True),
        (_Verdict("unknown"), ("none",), False),
        (_Verdict("named", (SimpleNamespace(effect="coulomb"),)), ("none",), False),
        (_Verdict("named", (SimpleNamespace(effect="coulomb"),)), ("none", "coulomb"), True),
    ],
)
def test_the_verdict_must_be_allowed(
    monkeypatch: pytest.MonkeyPatch, verdict: _Verdict, allowed: tuple[str, ...], passed: bool
) -> None:
    monkeypatch.setattr(judging, "verdict_of", lambda _: verdict)
    plan = Plan.model_validate({"name": "p", "experiment": "e", "verdict": {"allowed": allowed}})
    assert judge(plan, small_run(1)).passed is passed


def test_a_bound_holds_at_its_ends_and_never_for_nan() -> None:
    bounds = Bounds(least=1.0, most=2.0)
    assert [bounds.hold(v) for v in (0.999, 1.0, 2.0, 2.001, float("nan"))] == [
        *(False, True, True, False, False)
    ]


def test_a_recording_that_is_none_is_refused(tmp_path: Path) -> None:
    plan = _plan(tmp_path, "[limits]\nnoise_rad_s = { most = 1 }\n")
    assert isinstance(_check(plan, "--recording", tmp_path / "no.mcap")[2], RecordingError)


def test_a_failures_page_escapes_what_it_is_told() -> None:
    page = Page(failure_page(HOSTILE, HOSTILE, []))
    assert "script" not in page.tags
    assert HOSTILE in page.text
