"""A trial hides, records, asks another process, writes the answer, and only then looks."""

import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from servo_bench.diagnosis.judging.extended import rig_text
from servo_bench.errors import ConfigError
from servo_bench.excitation.experiment import Experiment, Phase
from servo_bench.recording.mcap_file import load
from servo_bench.recording.recording import Recording
from servo_bench.rig import load_rig
from tests.trial import main, run_trial
from tests.trials import told
from tests.trials.answering import Seal, SealError, ask
from tests.trials.drawing import CAN_BE_REMOVED, NUISANCES, Kind, Question
from tests.trials.handing import Handed, hand_over, nominal_rig
from tests.trials.names import right_names
from tests.truth.hidden import record
from tests.truth.rigs import drawn

TOLD = (sys.executable, told.__file__)
SECONDS = 8.0
KINDS: tuple[Kind, ...] = ("one", "none", "outside", "pair", "removed")


def quick(seed: int = 1001, kind: Kind = "one", **more: Any) -> Question:
    asked: dict[str, Any] = {"seed": seed, "kind": kind, "seconds": SECONDS, **more}
    return Question(**asked)


def handed_to(folder: Path, question: Question) -> Handed:
    return hand_over(question, question.sealed(), folder)


def python(text: str) -> tuple[str, ...]:
    return (sys.executable, "-c", text)


def experiment_of(recording: Recording) -> Experiment:
    assert recording.experiment is not None
    return recording.experiment


@pytest.mark.parametrize("kind", KINDS)
def test_a_seed_repeats_its_trial_and_another_draws_another(kind: Kind) -> None:
    one, again, other = quick(1001, kind), quick(1001, kind), quick(1002, kind)
    assert one.sealed().open() == again.sealed().open()
    assert (one.nominal, one.plan) == (again.nominal, again.plan)
    assert one.plan != other.plan
    assert one.sealed().open().noise_seed != other.sealed().open().noise_seed


def test_two_records_of_one_axis_differ_in_sequence_amplitude_and_noise(tmp_path: Path) -> None:
    handed = handed_to(tmp_path, quick())
    recordings = load(handed.seen), load(handed.held_out)
    assert {experiment_of(r).identification.kind for r in recordings} == {
        "field",
        "multi-amplitude",
    }
    peaks = [np.abs(r["velocity_command_rad_s"]).max() for r in recordings]
    assert peaks[1] < 0.95 * peaks[0]
    still = [r["load_angle_rad"][r["phase"] == Phase.STANDSTILL] for r in recordings]
    rows = min(angle.size for angle in still)
    assert not np.array_equal(still[0][:rows], still[1][:rows])


def test_what_the_command_sizes_has_one_size_for_both_records() -> None:
    def angles(effect: str, sized_for_rad_s: float | None) -> NDArray[np.float64]:
        asked = quick(1003, effect=effect)
        held_out = asked.plan.held_out
        played = record(asked.sealed(), held_out, asked.nominal, sized_for_rad_s=sized_for_rad_s)
        return np.array(played["load_angle_rad"])

    both_rad_s = quick(1003).plan.velocity_rad_s
    assert both_rad_s > 1.05 * quick(1003).plan.held_out.schedule().peak_velocity_rad_s
    assert not np.array_equal(angles("command_offset", both_rad_s), angles("command_offset", None))
    assert np.array_equal(angles("cogging", both_rad_s), angles("cogging", None))


@pytest.mark.parametrize("seed", range(1010, 1020))
def test_every_rig_is_turned_round_and_its_gap_is_crossed(seed: int) -> None:
    question = Question(seed=seed)
    schedule = question.plan.seen.schedule()
    assert schedule.duration_s == pytest.approx(question.seconds, abs=0.02)
    assert schedule.peak_travel_rad > 2.0 * np.pi
    steps = np.abs(np.diff(schedule.velocity_rad_s))
    assert steps.max() * schedule.period_s > question.nominal.backlash_gap_rad
    assert np.unique(np.round(schedule.velocity_rad_s, 6)).size > 5
    sized = [Question(seed=seed, seconds=s).plan.velocity_rad_s for s in (12.0, 44.0)]
    assert sized[0] == pytest.approx(sized[1])  # the wire's plant does not know how long it plays


def test_a_faster_encoder_holds_each_chip(tmp_path: Path) -> None:
    question = quick(seconds=4.0, period_s=0.001)
    seen = load(handed_to(tmp_path, question).seen)
    assert seen.period_s == 0.001
    commands = seen["velocity_command_rad_s"][seen["phase"] == Phase.IDENTIFICATION]
    assert (np.diff(commands.reshape(-1, 8), axis=1) == 0.0).all()


def test_a_wide_trial_is_drawn_from_far_more_and_is_the_same_each_time(tmp_path: Path) -> None:
    asked = [quick(seed=seed, wide=True, seconds=20.0) for seed in range(1001, 1031)]
    plans = [question.plan for question in asked]
    assert plans == [replace(question).plan for question in asked]
    assert {p.seen.period_s for p in plans} == {p.held_out.period_s for p in plans}
    assert len({p.seen.period_s for p in plans}) == 4
    assert {p.seen.identification.kind for p in plans} == {"m-sequence", "field", "from-recording"}
    inertias = [question.nominal.inertia_kg_m2 for question in asked]
    assert max(inertias) > 10.0 * min(inertias)
    slow = next(q for q in asked if q.plan.seen.period_s == 0.016)
    assert load(handed_to(tmp_path, slow).seen).period_s == 0.016


def test_a_rig_file_says_what_is_nominal_and_nothing_else(tmp_path: Path) -> None:
    rig = nominal_rig(drawn(1001))
    path = tmp_path / "rig.toml"
    path.write_text(rig_text(rig))
    assert load_rig(path) == rig
    assert "simulated" not in path.read_text()


def test_with_the_load_encoder_alone_no_motor_channel_is_handed_over(tmp_path: Path) -> None:
    seen = load(handed_to(tmp_path, quick(channels="load")).seen)
    assert np.isnan(seen["motor_position_rad"]).all()
    assert np.isnan(seen["motor_torque_nm"]).all()
    assert np.isfinite(seen["load_angle_rad"]).all()


def test_measured_data_have_a_clock_and_sensors_and_no_phases(tmp_path: Path) -> None:
    """The same numbers as the run's, from a row on that the seed chose."""
    for folder in ("run", "other"):
        (tmp_path / folder).mkdir()
    run = load(handed_to(tmp_path / "run", quick()).seen)
    other = load(handed_to(tmp_path / "other", quick(measured=True)).seen)
    assert set(other.channels) == {
        *("t_s", "velocity_command_rad_s", "load_angle_rad"),
        *("motor_position_rad", "motor_torque_nm"),
    }
    assert other.rig is None
    cut = len(run) - len(other)
    assert 0 < cut < 0.13 * len(run)
    for name in set(other.channels) - {"t_s"}:
        np.testing.assert_allclose(other[name], run[name][cut:], rtol=1e-7, atol=1e-12)


@pytest.mark.parametrize("kind", ["one", "pair", "outside"])
def test_the_diagnoser_is_told_neither_seed_nor_cause(kind: Kind, tmp_path: Path) -> None:
    question = quick(1023, kind)
    truth = question.sealed().open()
    run_trial(question, tmp_path / "kept", command=TOLD)
    answer = json.loads((tmp_path / "kept" / "answer.json").read_text())
    told_of = "\n".join(answer["verdict"]["notes"])
    assert "seen.mcap" in told_of
    for cause in truth.causes:
        assert cause not in told_of
    assert str(truth.noise_seed) not in told_of
    assert str(question.seed) not in told_of
    assert "tests.trial" not in told_of.replace(str(tmp_path), "")


def test_a_removed_cause_is_taken_from_the_diagnoser_with_its_whole_class(tmp_path: Path) -> None:
    question = quick(1031, "removed", effect="inertia_error")
    sealed = question.sealed()
    without = question.without(sealed)
    assert set(without) == right_names("inertia_error", "all") >= {"torque_constant_error"}
    handed = hand_over(question, sealed, tmp_path)
    answer = ask(handed, without=without, command=TOLD)
    assert answer.verdict is not None
    for name in without:
        assert f"--without {name}" in answer.verdict.notes[0]


def test_the_seal_opens_for_a_written_answer_only(tmp_path: Path) -> None:
    seal = Seal(quick().sealed())
    path = tmp_path / "answer.json"
    with pytest.raises(SealError, match="opens after the verdict is written"):
        seal.open(path)
    for text, why in (("{", "holds no answer"), ("{}", "neither a verdict nor a failure")):
        path.write_text(text)
        with pytest.raises(SealError, match=why):
            seal.open(path)
    path.write_text('{"verdict": null, "failure": "crashed"}')
    assert seal.open(path).causes


@pytest.mark.parametrize(
    ("command", "said"),
    [
        (python("raise SystemExit('no idea')"), "exit code 1: no idea"),
        (python("pass"), "no valid verdict was written"),
        (python("import os; os.kill(os.getpid(), 9)"), "exit code -9"),
        (python("import pathlib; pathlib.Path('verdict.json').write_text('{}')"), "sentence"),
        (
            python("import pathlib; pathlib.Path('verdict.json').write_text('[[[')"),
            "no valid verdict was written",
        ),
    ],
)
def test_a_diagnosis_that_fails_is_an_answer_and_wrong(command: tuple[str, ...], said: str) -> None:
    line = run_trial(quick(kind="none"), command=command)
    assert said in line["failure"]
    assert line["score"]["verdict"] == "failed"
    assert not line["score"]["right"]


def test_a_diagnosis_that_hangs_is_killed(tmp_path: Path) -> None:
    handed = handed_to(tmp_path, quick(kind="none"))
    answer = ask(handed, command=python("import signal; signal.pause()"), timeout_s=0.3)
    assert "killed" in answer.failure
    assert answer.verdict is None


def test_time_and_memory_are_the_diagnosis_own(tmp_path: Path) -> None:
    handed = handed_to(tmp_path, quick(kind="none"))
    small = ask(handed, command=python("pass"))
    large = ask(handed, command=python("block = b'x' * 200_000_000; sum(range(8_000_000))"))
    after = ask(handed, command=python("pass"))
    assert large.peak_bytes > small.peak_bytes + 150_000_000
    assert after.peak_bytes < small.peak_bytes + 50_000_000


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({"effect": "coging"}, "cannot hide 'coging'"),
        ({"kind": "none", "effect": "cogging"}, "it hides what the seed says"),
        ({"kind": "removed", "effect": "gravity"}, "cannot hide 'gravity'"),
        ({"multiple": 4.0}, "limits are those of one named effect"),
        ({"wire": True, "effect": "cogging"}, "the seed alone says what is hidden"),
        ({"bus": "modbus-rtu"}, "Give --wire too"),
        ({"wide": True, "wire": True}, "draws its own period and rig"),
        ({"wide": True, "period_s": 0.001}, "draws its own period and rig"),
    ],
)
def test_a_question_that_cannot_be_asked_says_why(asked: dict[str, Any], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        quick(**asked)


def test_what_stands_alone_can_be_removed() -> None:
    assert "gravity" not in CAN_BE_REMOVED
    assert len(CAN_BE_REMOVED) >= 24
    assert not set(NUISANCES) & set(CAN_BE_REMOVED)  # no verdict names them, removed or not


def test_a_run_too_short_says_so(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["--seed", "1001", "--seconds", "0.5"])
    assert ended.value.code == 2
    assert "degree" in capsys.readouterr().err
