"""`servo-bench diagnose`: one short trial from the file to the page, and everything that is bad."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from typer.testing import CliRunner

from servo_bench.cli import app as cli
from servo_bench.diagnosis.concluding import conclude
from servo_bench.diagnosis.diagnose import diagnose
from servo_bench.diagnosis.fitting.model_file import load_model, model_text
from servo_bench.diagnosis.judging.extended import extended_rig, rig_text
from servo_bench.diagnosis.judging.undecided import (
    RECOMMENDED,
    REPEAT,
    check_alike,
    check_one_rig,
    open_questions,
    undecided,
    what_next,
    without_the_motor_s_angle,
)
from servo_bench.diagnosis.judging.verdict import Verdict
from servo_bench.errors import ConfigError, FitError
from servo_bench.recording.mcap_file import load
from servo_bench.recording.recording import Recording
from servo_bench.report.diagnosis_page import diagnosis_report
from servo_bench.rig import SimulatedConfig, load_rig
from sim_rig.model import Model
from sim_rig.settings import Nominal
from tests.reported_run import HOSTILE, Page
from tests.trials.drawing import Question
from tests.trials.handing import Handed, hand_over

SECONDS, SEED, STRENGTH_NM = 10.0, 1001, 0.01


class Done(NamedTuple):
    """What the command left."""

    output: str
    verdict: Verdict
    page: str
    rig: Path
    handed: Handed


@pytest.fixture(scope="module")
def handed(tmp_path_factory: pytest.TempPathFactory) -> Handed:
    question = Question(seed=SEED, effect="cogging", seconds=SECONDS)
    return hand_over(question, question.sealed(), tmp_path_factory.mktemp("trial"))


@pytest.fixture(scope="module")
def done(handed: Handed) -> Done:
    folder = handed.seen.parent
    out = {name: folder / f"out.{name}" for name in ("json", "html", "toml")}
    words = ["diagnose", handed.seen, "--holdout", handed.held_out, "--rig", handed.rig]
    words += ["--only", "cogging,torque_ripple", "--json", out["json"], "--report", out["html"]]
    found = CliRunner().invoke(cli.app, [str(w) for w in (*words, "--rig-out", out["toml"])])
    assert found.exit_code == 0, found.output
    verdict = Verdict.model_validate_json(out["json"].read_bytes())
    return Done(found.output, verdict, out["html"].read_text(), out["toml"], handed)


def run(*words: object) -> str:
    """The words of the error that the command ends with."""
    found = CliRunner().invoke(cli.app, ["diagnose", *map(str, words)])
    assert found.exception is not None
    assert not isinstance(found.exception, SystemExit), found.output
    return str(found.exception)


def test_the_hidden_cause_is_named_and_told(done: Done) -> None:
    assert done.verdict.names == ("cogging",)
    assert done.verdict.sentence in done.output.replace("\n", " ")
    assert done.verdict.error is not None
    assert done.verdict.error.after < done.verdict.error.before


def test_the_picture_needs_no_model_of_the_cause(done: Done) -> None:
    signature = done.verdict.signature
    assert signature is not None
    assert signature.locked_to == "position"
    cogging = done.verdict.effects["cogging"]
    assert signature.lines[0].order == pytest.approx(cogging["order"], abs=0.3)
    assert signature.block == "controller or mechanics"
    assert all(0.0 <= share <= 1.0 for share in signature.shares.values())


def test_the_page_is_whole_and_has_the_sentence_first(done: Done) -> None:
    page = Page(done.page)
    assert done.page.index(done.verdict.sentence[:40]) < done.page.index("<svg")
    assert "script" not in page.tags
    assert page.tags.count("svg") >= 3
    assert "http://" not in done.page.replace("http://www.w3.org", "")


def test_the_extended_rig_is_the_verdicts_model(done: Done) -> None:
    rig = load_rig(done.rig)
    nominal = Nominal(**done.verdict.nominal)
    told = Model.from_table(nominal, done.verdict.effects)
    commands = np.repeat([3.0, -3.0, 1.0], 40)
    mine, theirs = rig.model().simulate(commands, 0.008), told.simulate(commands, 0.008)
    np.testing.assert_array_equal(mine.load_angle_rad, theirs.load_angle_rad)
    plain = load_rig(done.handed.rig)
    kept = {"nominal", "effects", "simulated"}
    assert rig.model_dump(exclude=kept) == plain.model_dump(exclude=kept)
    settings = rig.simulation_settings()
    assert dict(settings.effects) == done.verdict.effects


def test_a_software_rigs_own_secret_does_not_act_beside_the_verdict() -> None:
    secret = SimulatedConfig(seed=3, effects={"coulomb": {"torque_nm": 0.01}}, backlash_gap_rad=0.1)
    rig = load_rig("rigs/paper.toml").model_copy(update={"simulated": secret})
    nominal = {k: float(v) for k, v in rig.nominal.model_dump().items()}
    effects = {"cogging": {"torque_nm": STRENGTH_NM}}
    verdict = Verdict(verdict="none", sentence="", nominal=nominal, effects=effects)
    extended = extended_rig(rig, verdict)
    assert extended.simulation_settings().effects == effects
    assert extended.simulated is not None
    assert extended.simulated.backlash_gap_rad is None
    assert extended.simulated.seed == 3


def test_a_rigs_text_reads_back_the_same_whatever_its_name_is(tmp_path: Path) -> None:
    rig = load_rig("rigs/paper.toml").model_copy(update={"name": HOSTILE + "\n\t\\ größe"})
    path = tmp_path / "rig.toml"
    path.write_text(rig_text(rig))
    assert load_rig(path) == rig


def test_the_schema_is_the_verdicts() -> None:
    found = CliRunner().invoke(cli.app, ["diagnose", "--schema"])
    assert json.loads(found.output) == Verdict.model_json_schema()


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (("--without", "nonsense"), "no effect is called nonsense"),
        (("--only", "cogging", "--without", "cogging"), "leave nothing to try"),
    ],
)
def test_what_the_operator_gets_wrong_is_refused(
    handed: Handed, options: tuple[str, ...], told: str
) -> None:
    assert told in run(handed.seen, *options)


def test_no_recording_is_refused() -> None:
    assert "no recording is given" in run()


def test_nothing_is_overwritten(handed: Handed) -> None:
    assert "exists already" in run(handed.seen, "--json", handed.rig)


def _without(recording: Recording, *names: str) -> Recording:
    kept = {name: values for name, values in recording.channels.items() if name not in names}
    return replace(recording, channels=kept)


def _effort_left_at_zero(recording: Recording) -> Recording:
    """As a servo logs that has the register and never fills it."""
    driven = _without(recording, "velocity_command_rad_s")
    empty = np.zeros_like(recording["motor_torque_nm"])
    return replace(driven, channels={**driven.channels, "motor_torque_nm": empty})


def _standing(recording: Recording) -> Recording:
    still = {
        name: np.zeros_like(values) if name.endswith(("_rad", "_rad_s")) else values
        for name, values in recording.channels.items()
    }
    return replace(recording, channels=still)


@pytest.mark.parametrize(
    ("spoil", "told"),
    [
        (lambda r: _without(r, "load_angle_rad", "motor_position_rad"), "load_angle_rad"),
        (lambda r: _without(r, "velocity_command_rad_s", "motor_torque_nm"), "command"),
        (_effort_left_at_zero, "motor_torque_nm never changed"),
        (_standing, "stayed at zero"),
    ],
)
def test_what_cannot_be_decided_is_said_and_which_run_would(
    handed: Handed, spoil: Callable[[Recording], Recording], told: str
) -> None:
    recording = spoil(load(handed.seen))
    verdict = undecided(FitError("nothing can be fitted"), [recording])
    assert verdict.verdict == "unknown"
    assert any(told in sentence for sentence in verdict.undecided)
    assert "design diagnosis" in verdict.next_run
    assert "nothing can be fitted" in diagnosis_report(verdict, None, None, recording)


@pytest.mark.parametrize(
    ("gone", "told"),
    [
        ((), []),
        (("motor_position_rad",), ["by its torque and by what reaches", "record its position"]),
        (
            ("motor_position_rad", "motor_torque_nm", "motor_current_a"),
            ["angle and current, ", "integrator holds", "record its position"],
        ),
    ],
)
def test_a_motor_s_angle_that_did_not_come_is_asked_for(
    handed: Handed, gone: tuple[str, ...], told: list[str]
) -> None:
    recording = load(handed.seen)
    speed = {"motor_velocity_rad_s": np.gradient(recording["motor_position_rad"])}
    recording = replace(recording, channels={**recording.channels, **speed})
    said = list(without_the_motor_s_angle(_without(recording, *gone)))
    assert len(said) == len(told)
    assert all(words in sentence for words, sentence in zip(told, said, strict=True))


def test_short_recordings_are_as_long_as_all_of_them(handed: Handed) -> None:
    short = load(handed.seen)
    short = replace(short, channels={n: v[:700] for n, v in short.channels.items()})
    alone, both = (undecided(FitError("no"), [short] * count) for count in (1, 2))
    assert any("5.6 s were recorded" in sentence for sentence in alone.undecided)
    assert not any("were recorded" in sentence for sentence in both.undecided)


def test_a_short_recording_that_fails_tells_why_and_that_it_is_short(handed: Handed) -> None:
    """The failure is the reason: a longer one would end in it as well."""
    short = load(handed.seen)
    short = replace(short, channels={n: v[:700] for n, v in short.channels.items()})
    told = undecided(FitError("the recording's slots do not rise"), [short])
    reason, length = told.sentence.index("slots do not rise. "), told.sentence.index("5.6 s were")
    assert reason < length
    assert "Record what is missing" not in told.next_run


def test_data_of_another_bench_are_judged_by_a_model_of_five_numbers(tmp_path: Path) -> None:
    """No bus, no drive, no limits: a CSV file, a map, and what the drawing says."""
    asked = Question(seed=1507, effect="transport_delay", seconds=8.0, measured=True)
    files = hand_over(asked, asked.sealed(), tmp_path)
    nominal = load_rig(files.rig).model()
    believed, mended = tmp_path / "believed.toml", tmp_path / "mended.toml"
    believed.write_text(model_text(nominal))
    words = ["diagnose", files.seen, "--model", believed, "--model-out", mended]
    words += ["--only", "transport_delay"]
    words += ["--json", tmp_path / "verdict.json"]
    done = CliRunner().invoke(cli.app, [str(w) for w in words])
    assert done.exit_code == 0, done.output
    delay_s = asked.sealed().open().drawn[0].size
    assert load_model(mended).effects["transport_delay"].delay_s == pytest.approx(delay_s, rel=0.1)
    both = CliRunner().invoke(cli.app, [str(w) for w in [*words, "--rig", files.rig]])
    assert both.exit_code != 0
    assert "given both" in str(both.exception)


def test_a_recording_that_cannot_be_fitted_ends_in_a_verdict(
    handed: Handed, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "verdict.json"
    monkeypatch.setattr("servo_bench.cli.diagnose.load", lambda path: _standing(load(path)))
    words = ["diagnose", handed.seen, "--rig", handed.rig, "--json", out]
    words += ["--report", tmp_path / "page.html", "--rig-out", tmp_path / "rig.toml"]
    found = CliRunner().invoke(cli.app, [str(w) for w in words])
    assert found.exit_code == 0, found.output
    verdict = Verdict.model_validate_json(out.read_bytes())
    assert verdict.verdict == "unknown"
    assert verdict.undecided
    assert not (tmp_path / "rig.toml").exists()
    with pytest.raises(ConfigError, match="no model"):
        extended_rig(load_rig(handed.rig), verdict)


def test_recordings_of_different_signals_are_refused(handed: Handed) -> None:
    recording = load(handed.seen)
    with pytest.raises(ConfigError, match="recording 2 has"):
        check_alike([recording, _without(recording, "motor_torque_nm")])
    with pytest.raises(ConfigError, match=r"and the held-out recording of 0\.001 s"):
        check_alike([recording], replace(recording, period_s=0.001))


def test_recordings_of_two_rigs_are_refused_where_nobody_says_which_is_meant(
    handed: Handed, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = load_rig(handed.rig)
    heavy = rig.nominal.model_copy(update={"inertia_kg_m2": 12.0 * rig.nominal.inertia_kg_m2})
    mine = replace(load(handed.seen), rig=rig)
    other = replace(load(handed.held_out), rig=rig.model_copy(update={"nominal": heavy}))
    with pytest.raises(ConfigError, match=r"inertia_kg_m2 = .* that of recording 2 .*--rig"):
        conclude([mine, other])
    with pytest.raises(ConfigError, match=r"inertia_kg_m2 = .* that of the held-out recording"):
        conclude([mine], held_out=other)
    with pytest.raises(ConfigError, match="held-out recording"):
        diagnose([mine], held_out=other)
    check_one_rig([mine, replace(other, rig=None), replace(mine, rig=rig)], mine)
    files = {handed.seen: mine, handed.held_out: other}
    monkeypatch.setattr("servo_bench.cli.diagnose.load", files.__getitem__)
    assert "that of the held-out recording" in run(handed.seen, "--holdout", handed.held_out)


@pytest.mark.parametrize(
    ("command", "single"),
    [([-3.0, 3.0], True), ([-2.0, 4.0], True), ([-4.0, -2.0, 0.0, 2.0, 4.0], False)],
)
def test_one_size_of_command_leaves_a_question_open(command: list[float], single: bool) -> None:
    values = np.random.default_rng(3).choice(command, 400)
    recording = Recording({"velocity_command_rad_s": values}, 0.001, None, None, {})
    assert any("single size" in s for s in open_questions(recording)) is single


def test_after_whatever_is_open_or_unknown_there_is_a_next_run() -> None:
    many, one = (np.tile(np.repeat(levels, 3), 300) for levels in ([-4.0, -2.0, 2.0], [3.0, -3.0]))
    turns, rocks = (
        Recording(
            {"velocity_command_rad_s": it, "load_angle_rad": 0.008 * np.cumsum(it)},
            0.008,
            None,
            None,
            {},
        )
        for it in (many, one)
    )
    none = Verdict(verdict="none", sentence="")
    unknown = none.model_copy(update={"verdict": "unknown"})
    split = unknown.model_copy(update={"next_run": "with another load"})
    assert what_next(none, turns) == ""
    assert what_next(unknown, turns) == REPEAT
    assert what_next(none, rocks) == what_next(unknown, rocks) == RECOMMENDED
    assert what_next(split, rocks) == "with another load"
