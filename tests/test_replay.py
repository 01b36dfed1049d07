"""A recording played again: into a rig, and through the analysis of today."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from typer.testing import CliRunner

from servo_bench.cli import app as cli
from servo_bench.errors import ConfigError, LimitError, RecordingError, WireError
from servo_bench.estimators.study import study
from servo_bench.excitation.experiment import Experiment, experiment_from_table
from servo_bench.kernels.analysis import analyse
from servo_bench.kernels.response import response_of
from servo_bench.recording.mcap_file import load
from servo_bench.recording.recording import Recording
from servo_bench.replay.against import against
from servo_bench.replay.command import held_commands, order_of
from servo_bench.replay.difference import difference
from servo_bench.replay.through import reanalyse
from servo_bench.replay.to_page import Daemon, show
from servo_bench.rig import RigConfig, load_rig
from servo_bench.run.virtual import run_virtually, save
from tests.small_runs import experiment, noisy_rig, paper_rig, small_run


def _elsewhere(run: Recording, **channels: NDArray[np.float64]) -> Recording:
    """The same run as a stranger would bring it: times and values, no experiment, no rig."""
    kept = {name: run[name] for name in ("velocity_command_rad_s", "load_angle_rad")}
    t_s = np.arange(len(run)) * run.period_s
    return replace(run, channels={"t_s": t_s, **kept, **channels}, experiment=None, rig=None)


@pytest.fixture(scope="module")
def file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("replay") / "run.mcap"
    save(small_run(1), path)
    return path


def _call(*words: object) -> tuple[int, str, BaseException | None]:
    done = CliRunner().invoke(cli.app, ["replay", *map(str, words)])
    return done.exit_code, done.output, done.exception


def test_the_same_rig_answers_the_same_to_the_bit() -> None:
    replayed = against(small_run(1), noisy_rig(1))
    assert replayed.again
    assert all(signal.rms == 0.0 for signal in replayed.difference.signals)


def test_another_seed_differs_by_the_sensors_noise_alone() -> None:
    found = {s.name: s for s in against(small_run(1), noisy_rig(2)).difference.signals}
    assert found["command"].rms == 0.0
    assert found["load velocity"].rms == pytest.approx(found["load velocity"].floor, rel=0.3)


def test_a_wider_gap_shows_in_the_load_and_not_in_the_motor() -> None:
    wide = noisy_rig(2, backlash_gap_rad=0.06)
    found = {s.name: s for s in against(small_run(1), wide).difference.signals}
    assert found["load velocity"].rms > 5.0 * found["load velocity"].floor
    assert found["motor velocity"].rms == pytest.approx(found["motor velocity"].floor, rel=0.3)
    assert found["load velocity"].phases["standstill"] == found["load velocity"].floor
    largest = found["load velocity"]
    assert largest.largest_s == pytest.approx(largest.largest_slot * 0.008)


def test_commands_from_elsewhere_are_played_as_they_came() -> None:
    run = small_run(1)
    replayed = against(_elsewhere(run), noisy_rig(1))
    assert not replayed.again
    played = replayed.recording
    assert played["velocity_command_rad_s"][0] == 0.0  # rests before the first command
    assert np.array_equal(
        played["velocity_command_rad_s"][1 : 1 + len(run)], run["velocity_command_rad_s"]
    )
    assert np.array_equal(played["velocity_command_rad_s"][-2:], [0.0, 0.0])
    found = {signal.name: signal for signal in replayed.difference.signals}
    assert found["command"].rms == 0.0, "each command beside itself"
    assert found["load velocity"].rms < 0.1 * found["load velocity"].rms_a


@pytest.mark.parametrize("begin", [0.0, 0.5, 1.5, 7.49])
def test_times_that_begin_between_two_periods_are_periods_all_the_same(begin: float) -> None:
    run = small_run(1)
    jitter = np.random.default_rng(4).uniform(-0.3, 0.3, len(run))
    shifted = replace(
        _elsewhere(run), channels={**_elsewhere(run).channels, "t_s": _times(begin + jitter)}
    )
    np.testing.assert_array_equal(held_commands(shifted), run["velocity_command_rad_s"])


def _times(shift_periods: NDArray[np.float64]) -> NDArray[np.float64]:
    """Of a run's rows, shifted by so much of a period; the first without its own jitter."""
    at = np.arange(shift_periods.size) + shift_periods
    at[0] = np.median(shift_periods)
    return np.asarray(0.008 * at)


@pytest.mark.parametrize("wild", [np.nan, np.inf, 1.7e9])
def test_one_wild_time_is_told_and_takes_no_memory(wild: float) -> None:
    run = _elsewhere(small_run(1))
    t_s = 0.008 * np.arange(len(run))
    t_s[100:] += wild
    strange = replace(run, channels={**run.channels, "t_s": t_s})
    with pytest.raises(RecordingError, match=r"row 100|at most"):
        held_commands(strange)
    with pytest.raises(RecordingError, match=r"row 100|wild"):
        response_of(strange)


def test_an_experiment_from_a_recording_survives_its_table() -> None:
    plan = order_of(_elsewhere(small_run(1)), "rig").experiment
    again = experiment_from_table(json.loads(plan.model_dump_json()), "test")
    assert again == plan
    assert np.array_equal(again.schedule().velocity_rad_s, plan.schedule().velocity_rad_s)


def test_a_skipped_slot_holds_the_command_before_it() -> None:
    run = small_run(1)
    kept = np.delete(np.arange(len(run)), [300, 301])
    gap = replace(run, channels={name: run[name][kept] for name in run.channels})
    held = held_commands(gap)
    assert held.size == len(run)
    assert held[300] == held[301] == run["velocity_command_rad_s"][299]


def test_an_edited_command_is_not_taken_for_the_experiments() -> None:
    run = small_run(1)
    edited = run["velocity_command_rad_s"] * 0.5
    changed = replace(run, channels={**run.channels, "velocity_command_rad_s": edited})
    plan = order_of(changed, "rig").experiment
    assert plan.name == "replay"
    assert plan.schedule().peak_velocity_rad_s == pytest.approx(float(np.abs(edited).max()))


def test_the_rigs_limits_hold() -> None:
    rig = noisy_rig(1)
    tight = rig.model_copy(update={"limits": rig.limits.model_copy(update={"travel_rad": 0.1})})

    def never(_plan: Experiment, _rig: RigConfig) -> Recording:
        raise AssertionError("played")

    with pytest.raises(LimitError, match="travel"):
        against(_elsewhere(small_run(1)), tight, run_virtually)
    bare = replace(_elsewhere(small_run(1)), channels={"t_s": np.arange(3.0)})
    with pytest.raises(RecordingError, match="no velocity command"):
        against(bare, rig, never)


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_command_that_is_no_number_is_refused(bad: float) -> None:
    commands = small_run(1)["velocity_command_rad_s"].copy()
    commands[7] = bad
    with pytest.raises(RecordingError, match="not finite"):
        order_of(_elsewhere(small_run(1), velocity_command_rad_s=commands), "rig")


def test_runs_that_share_nothing_are_told() -> None:
    run = small_run(1)
    with pytest.raises(RecordingError, match="share no signal"):
        difference(run, replace(run, channels={"slot": run["slot"]}))


def test_figures_of_the_same_code_are_the_same() -> None:
    run = small_run(1)
    found = reanalyse(run, json.loads(json.dumps(analyse(run).numbers())))
    assert found.changes == ()
    assert found.reasons == ("Every figure is as it was.",)


def test_what_the_commands_write_is_compared_by_the_analysis_own_figures() -> None:
    run = small_run(1)
    analysis = analyse(run)
    written = {**study(run, analysis).numbers(), "lags_s": [0.0], "c1_rad_s": [1.0]}
    found = reanalyse(run, json.loads(json.dumps(written)))
    assert found.changes == ()
    assert found.compared > 20


def test_another_memory_explains_everything() -> None:
    run = small_run(1)
    found = reanalyse(run, analyse(run, memory=6).numbers())
    assert {"memory", "vaf_fresh_order3_percent"} <= {change.name for change in found.changes}
    assert "memory 6 (now 9)" in found.reasons[0]
    assert "everything" in found.reasons[0]


def test_another_version_and_another_recording_are_told_apart() -> None:
    run = small_run(1)
    numbers = analyse(run).numbers()
    old = {**numbers, "vaf_fresh_order3_percent": 12.0}
    older = reanalyse(run, {**old, "servo_bench": "0.0.1"})
    assert "servo-bench 0.0.1, and this is" in older.reasons[0]
    assert "between two releases" in reanalyse(run, old).reasons[0]
    other = {**old, "run": {**numbers["run"], "slots": 7}}
    assert "another recording" in reanalyse(run, other).reasons[0]
    with pytest.raises(RecordingError, match="not those of an analysis"):
        reanalyse(run, {"a": 1})


def test_through_the_analyser_from_the_command_line(file: Path) -> None:
    _, _, error = _call(file, "--through", "analyser")
    assert isinstance(error, RecordingError)
    assert "no figures of then" in str(error)
    file.with_suffix(".json").write_text(json.dumps(analyse(load(file)).numbers()))
    code, output, _ = _call(file, "--through", "analyser")
    assert code == 0
    assert "Every figure is as it was" in output


def test_against_a_rig_from_the_command_line(file: Path, tmp_path: Path) -> None:
    out, figures = tmp_path / "new.mcap", tmp_path / "out.json"
    code, output, _ = _call(file, "--against", "rigs/paper.toml", "-o", out, "--json", figures)
    assert code == 0, output
    assert "slots of both runs" in output
    assert len(load(out)) == len(small_run(1))
    assert json.loads(figures.read_text())["same_experiment"] is True


def test_only_a_permission_leads_to_the_rigs_own_bus(
    file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The bus of rigs/paper.toml is never opened without it, and is where it leads with it."""
    opened: list[object] = []

    def play(*_: object, simulated: bool, **__: object) -> object:
        opened.append(simulated)
        raise WireError("nobody is there")

    monkeypatch.setattr("servo_bench.cli.replay.play", play)
    assert _call(file, "--against", "rigs/paper.toml")[0] == 0
    assert opened == []
    _call(file, "--against", "rigs/paper.toml", "--wire")
    _call(file, "--against", "rigs/paper.toml", "--permit-real-rig")
    assert opened == [True, False]


def test_what_a_run_recorded_that_was_ended_is_kept_and_said(
    file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    targets: list[Path] = []

    def play(_experiment: object, _rig: object, target: Path, *_: object, **__: object) -> None:
        targets.append(target)
        if len(targets) > 1:
            target.write_bytes(b"why")
        raise LimitError("velocity reached 3 rad/s")

    monkeypatch.setattr("servo_bench.cli.replay.play", play)
    nothing, ended = (_call(file, "--against", "rigs/paper.toml", "--wire")[2] for _ in range(2))
    assert "kept" not in str(nothing)
    assert not targets[0].parent.exists()
    assert str(ended) == f"velocity reached 3 rad/s What was recorded is kept: {targets[1]}"
    assert targets[1].read_bytes() == b"why"
    shutil.rmtree(targets[1].parent)


@pytest.mark.parametrize(
    "words",
    [
        (),
        ("--to", "http://127.0.0.1:1", "--through", "analyser"),
        ("--against", "rigs/paper.toml", "--wire", "--permit-real-rig"),
        ("--to", "file:///etc/passwd"),
        ("--to", "127.0.0.1"),
    ],
)
def test_orders_that_make_no_sense(file: Path, words: tuple[str, ...]) -> None:
    assert isinstance(_call(file, *words)[2], ConfigError)


def test_the_daemon_is_asked_for_the_run_of_that_name_and_size(
    file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[tuple[str, str, object]] = []
    size = file.stat().st_size

    def ask(_: Daemon, method: str, path: str, body: object = None) -> object:
        asked.append((method, path, body))
        return {"runs": [{"id": "other", "bytes": 1}, {"id": "right", "bytes": size}]}

    monkeypatch.setattr(Daemon, "ask", ask)
    assert show(Daemon("http://127.0.0.1:8420"), file, 2.0, 1.5) == "right"
    assert asked[0][:2] == ("GET", f"runs?limit=500&q={file.name}")
    assert asked[1] == ("POST", "replay", {"run": "right", "speed": 2.0, "start_s": 1.5})
    monkeypatch.setattr(Daemon, "ask", lambda *_: {"runs": []})
    with pytest.raises(RecordingError, match="has no recording"):
        show(Daemon("http://127.0.0.1:8420"), file, 1.0, 0.0)


@pytest.mark.parametrize("url", ["http://127.0.0.1:84x0", "http://[::1", "ftp://a", "http://"])
def test_what_is_no_address_is_refused(url: str) -> None:
    with pytest.raises(ConfigError, match="no daemon's address"):
        Daemon(url)


def test_nobody_at_the_address_is_told() -> None:
    with pytest.raises(WireError, match="no daemon answers"):
        Daemon("http://127.0.0.1:1").ask("GET", "health")


def test_a_rig_on_modbus_cannot_be_played_in_virtual_time() -> None:
    with pytest.raises(ConfigError, match="virtual time speaks CANopen"):
        run_virtually(experiment(), load_rig("rigs/modbus-tcp.toml"))


def test_virtual_time_repeats_to_the_bit() -> None:
    again = run_virtually(experiment(), noisy_rig(1))
    for name in again.channels:
        assert np.array_equal(again[name], small_run(1)[name], equal_nan=True)
    assert again.rig is not None
    assert again.rig.nominal == paper_rig().nominal


def test_virtual_time_is_the_model_to_half_a_count() -> None:
    """The slaves on the virtual bus against the offline simulation at the times of the asks."""
    rig = paper_rig()
    run = run_virtually(experiment(), rig)
    asked_s = np.diff(run["asked_ns"]) * 1e-9
    done = rig.model().simulate(run["velocity_command_rad_s"], np.append(asked_s, run.period_s))
    count_rad = 2.0 * np.pi / 65536
    off = run["load_angle_rad"] - done.load_angle_rad
    assert np.abs(off - off[0]).max() < count_rad
    assert run.provenance["time"] == "virtual"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--through", "analyser", "-o", "x.mcap"), "go with --against"),
        (("--through", "analyser", "--wire"), "go with --against"),
        (("--against", "rigs/paper.toml", "--figures", "a.json"), "--through compares"),
    ],
)
def test_an_option_of_another_way_is_refused(file: Path, words: tuple[str, ...], said: str) -> None:
    _, _, error = _call(file, *words)
    assert isinstance(error, ConfigError)
    assert said in str(error)
