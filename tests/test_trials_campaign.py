"""Many trials: seeds that stay, lines that survive a kill, the same figures by any executor."""

import json
import subprocess
import sys
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from matplotlib.image import imread

from servo_bench.errors import ConfigError
from servo_bench.jobs import executor
from tests.campaign import main, run, summary
from tests.trials import told
from tests.trials.asking import ASKED, Campaign
from tests.trials.drawing import NUISANCES, question_from
from tests.trials.lines import Lines
from tests.trials.measuring import bench
from tests.trials.picture import draw
from tests.trials.seeds import DEVELOPMENT_BELOW, JUDGING_FROM

TOLD = (sys.executable, told.__file__)
ROOT = Path(__file__).parent.parent

SMALL = Campaign(
    effects=("cogging",), seeds=1, nulls=2, outside=1, pairs=1, first_seed=1200, seconds=4.0
)
"""Its seeds are for development although a campaign's blocks reach beyond: nothing is judged."""

CAMPAIGN_THAT_TELLS = """
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from tests.campaign import run
from tests.test_trials_campaign import SMALL, TOLD
from tests.trials.lines import Lines

def tell(line, done, of):
    print(done, flush=True)
    if done == 2:
        sys.stdin.read()

with ThreadPoolExecutor(1) as pool, Lines(Path(sys.argv[1]), resume=False) as lines:
    run(SMALL.questions(), pool, lines, command=TOLD, tell=tell)
"""


def ran(path: Path, pool: Executor, *, resume: bool = False) -> list[dict[str, Any]]:
    with Lines(path, resume=resume) as lines:
        run(SMALL.questions(), pool, lines, command=TOLD)
        return lines.lines


def without_cost(lines: list[dict[str, Any]]) -> list[dict[str, Any]]:
    kept = [{k: line[k] for k in ("question", "hidden", "score")} for line in lines]
    return sorted(kept, key=lambda line: int(line["question"]["seed"]))


def test_a_campaign_of_a_fixed_list_is_the_same_each_time() -> None:
    questions = SMALL.questions()
    assert questions == SMALL.questions()
    assert len(questions) == len(set(questions)) == 5
    assert [question_from(json.loads(json.dumps(q.numbers()))) for q in questions] == questions


def test_a_trial_keeps_its_seed_whatever_is_asked_beside_it() -> None:
    few = set(Campaign(seeds=2, nulls=3).questions())
    many = set(Campaign(seeds=5, nulls=30, outside=20, pairs=20, removed=20).questions())
    assert few < many
    seeds = [q.seed for q in many]
    assert len(set(seeds)) == len(seeds)
    sized = Campaign(seeds=100, multiples=(2.0, 4.0, 8.0)).questions()
    assert len({q.seed for q in sized}) == len(sized)
    assert {q.seed for q in sized}.isdisjoint(seeds)


def test_judging_never_uses_a_seed_of_development() -> None:
    judged = Campaign(seeds=100, nulls=300, outside=150, pairs=30, removed=80).questions()
    assert min(q.seed for q in judged) >= JUDGING_FROM > DEVELOPMENT_BELOW
    with pytest.raises(ValueError, match="is for judging"):
        bench(JUDGING_FROM)


def test_every_effect_is_asked_as_often_and_outsiders_in_turn() -> None:
    asked = Campaign(seeds=3, outside=30).questions()
    per_effect = {name: sum(q.effect == name for q in asked) for name in ASKED}
    assert set(per_effect.values()) == {3}
    assert not any(q.effect in NUISANCES for q in asked)
    named = Campaign(effects=NUISANCES, seeds=1).questions()
    assert {q.effect for q in named} == set(NUISANCES)
    outsiders = [q.effect for q in asked if q.kind == "outside"]
    assert len(set(outsiders)) == 15
    assert len(outsiders) == 30


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({"effects": ("coging",)}, "--effects coging: the truth has"),
        ({"multiples": (3.0,)}, "the limit is multiplied by 2, 4, 8"),
        ({"seeds": 101}, "100 seeds of its own"),
        ({"nulls": -1}, "-1 trials of kind none"),
    ],
)
def test_a_campaign_that_cannot_be_asked_says_why(asked: dict[str, Any], said: str) -> None:
    with pytest.raises(ConfigError, match=said):
        Campaign(**asked).questions()


@pytest.mark.long
def test_a_killed_campaign_goes_on_and_ends_as_if_it_had_not_been(tmp_path: Path) -> None:
    path, whole = tmp_path / "killed.jsonl", tmp_path / "whole.jsonl"
    process = subprocess.Popen(
        [sys.executable, "-c", CAMPAIGN_THAT_TELLS, str(path)],
        cwd=ROOT,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
    )
    assert process.stdout is not None
    assert [process.stdout.readline() for _ in range(2)] == [b"1\n", b"2\n"]
    process.kill()
    process.communicate()
    before = path.read_bytes()
    assert before.count(b"\n") == 2
    path.write_bytes(before + before[: len(before) // 4])  # a third line, cut
    with ThreadPoolExecutor(1) as pool:
        resumed = ran(path, pool, resume=True)
        assert path.read_bytes().startswith(before)
        assert without_cost(resumed) == without_cost(ran(whole, pool))
        assert without_cost(ran(path, pool, resume=True)) == without_cost(resumed)
    assert path.read_bytes().count(b"\n") == len(SMALL.questions())


def test_lines_are_never_begun_anew_over_others(tmp_path: Path) -> None:
    path = tmp_path / "lines.jsonl"
    path.write_text("mine\nand mine\nand mine\n")
    with pytest.raises(ConfigError, match="give --resume"):
        Lines(path, resume=False)
    with pytest.raises(ConfigError, match="nothing was changed"):
        Lines(path, resume=True)
    assert path.read_text() == "mine\nand mine\nand mine\n"


def test_a_picture_is_drawn_of_the_figures(tmp_path: Path) -> None:
    with ThreadPoolExecutor(1) as pool:
        lines = ran(tmp_path / "lines.jsonl", pool)
    found = summary(lines, {"first_seed": 1200})
    assert found["trials"] == len(lines)
    assert json.loads(json.dumps(found, allow_nan=False)) == found
    draw(found, tmp_path / "picture.png")
    assert imread(tmp_path / "picture.png").shape[1] > 600
    pairs = [line for line in lines if line["question"]["kind"] == "pair"]
    assert pairs
    for none in ([], pairs):
        draw(summary(none, {}), tmp_path / "empty.png")
        assert not (tmp_path / "empty.png").exists()


def test_the_command_line_says_what_is_wrong_with_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for options, said in (
        (["--effects", "coging"], "--effects coging"),
        (["--jobs", "0"], "at least one process"),
        (["--jobs", "2", "--scheduler", "tcp://127.0.0.1:1"], "Give one of the two"),
    ):
        with pytest.raises(SystemExit) as ended:
            main(["--json", str(tmp_path / f"{len(said)}.json"), "--seeds", "1", *options])
        assert ended.value.code == 2
        assert said in capsys.readouterr().err


def test_processes_of_this_machine_do_jobs() -> None:
    with executor(1) as pool:
        assert [pool.submit(abs, -k).result() for k in range(3)] == [0, 1, 2]


def test_leaving_an_executor_cancels_what_has_not_begun() -> None:
    futures: list[Future[int]] = []

    def interrupted() -> None:
        with executor(1) as pool:
            futures.extend(pool.submit(pow, 2, k) for k in range(200))
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert any(future.cancelled() for future in futures)
    assert all(future.done() for future in futures)


def test_a_cluster_that_is_not_installed_is_said_in_words(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with (
        pytest.raises(ConfigError, match=r"servo-bench\[cluster\]"),
        executor(scheduler="tcp://h:1"),
    ):
        pass
