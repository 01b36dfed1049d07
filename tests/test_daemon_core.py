"""The daemon's heart without processes: what it is sure of, and what nothing keeps it from."""

import asyncio
import re
import subprocess
import sys
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import pytest

from servo_bench.daemon import active as runs
from servo_bench.daemon import core, ending
from servo_bench.daemon.active import ActiveRun
from servo_bench.daemon.aftermath import Standing
from servo_bench.daemon.api import build_app
from servo_bench.daemon.config import load_bench
from servo_bench.daemon.core import Daemon
from servo_bench.daemon.job import Outcome, RunJob, RunResult
from servo_bench.daemon.log import log
from servo_bench.daemon.machine import Event, State
from servo_bench.daemon.queue import Waiting
from servo_bench.daemon.sockets import listening
from servo_bench.errors import RecordingError
from servo_bench.excitation.experiment import Experiment, Schedule
from servo_bench.rig import load_rig
from servo_bench.run.lock import Holder, take
from tests.asgi_client import AsgiClient
from tests.daemon_process import write_bench

ASKED = Waiting("0123456789abcdef", "a.mcap", "a run", "short", "Ada")


def daemon_of(folder: Path, logger: Any = None, **bench: Any) -> Daemon:
    """A daemon that is not opened."""
    return Daemon(load_bench(write_bench(folder, **bench)), logger or log())


def job_of(daemon: Daemon) -> RunJob:
    return daemon._job(ASKED, daemon.bench.experiments[ASKED.experiment])


def playing(daemon: Daemon, said: RunResult | None = None) -> ActiveRun:
    """A run that the daemon takes for playing, and what its runner says at the end."""
    run = runs.prepare(daemon.bench.state / "runs" / ASKED.id, ASKED, job_of(daemon))
    run.said = said
    daemon._active = run
    daemon.condition.fire(Event.STARTED)
    return run


@pytest.mark.parametrize(
    ("outcome", "error", "says", "standing"),
    [
        ("faulted", "WireError", Standing("It could not be asked.", False), False),
        ("faulted", "WireError", Standing("It is switched off.", True), True),
        ("faulted", "LimitError", None, False),
        ("stopped", "", None, True),
    ],
)
def test_the_rig_is_said_to_stand_after_a_confirmed_end_only(  # noqa: PLR0917
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    outcome: Outcome,
    error: str,
    says: Standing | None,
    standing: bool,
) -> None:
    daemon = daemon_of(tmp_path, rig=load_rig("rigs/paper.toml"))
    monkeypatch.setattr(ending, "_standing", lambda _: says)
    run = playing(daemon, RunResult(outcome, "it ended.", error))
    assert not daemon.stop("Ada")
    asyncio.run(daemon._finish(run))
    client = AsgiClient(build_app(daemon, daemon.bench))
    assert client.post("/api/stop").json()["standing"] is standing
    daemon.condition.arm("Ada")  # somebody has looked at it
    assert client.post("/api/stop").json()["standing"]


class Broken:
    """A logger whose sink is gone."""

    def __getattr__(self, name: str) -> Callable[..., None]:
        def broken(*_: object, **__: object) -> None:
            raise BrokenPipeError

        return broken


def test_a_stop_holds_and_is_heeded_before_anything_is_logged(tmp_path: Path) -> None:
    daemon = daemon_of(tmp_path)
    run = playing(daemon)
    daemon.log = daemon.condition._log = Broken()
    with pytest.raises(BrokenPipeError):
        daemon.stop("Ada")
    assert run.stop_by == "Ada"
    assert daemon.condition.held == "stopped by Ada"
    assert daemon.condition.state is State.STOPPING


@pytest.mark.parametrize("ended", ["os.close(2)", "sys.stderr.close()", "os.dup2(gone, 2)"])
def test_a_log_that_nobody_takes_any_more_raises_nothing(ended: str) -> None:
    program = (
        "import logging, os, sys\n"
        "from servo_bench.daemon.log import configure, log\n"
        "configure(); log().info('first')\n"
        "read, gone = os.pipe(); os.close(read)\n"
        f"{ended}\n"
        "for n in range(3): log().warning('more' * 5000, n=n); logging.warning('theirs')\n"
        "os._exit(0)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr.count("first")) == (0, 1), done.stderr


@pytest.mark.parametrize("error", [ValueError("strange"), RecordingError("damaged"), OSError(5)])
def test_whatever_the_catalogue_does_a_run_ends(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    daemon = daemon_of(tmp_path)

    def refresh() -> None:
        raise error

    monkeypatch.setattr(daemon.catalogue, "refresh", refresh)
    run = playing(daemon, RunResult("complete", "complete."))
    asyncio.run(daemon._finish(run))
    assert daemon.condition.state is State.IDLE
    assert run.ended.is_set()
    asyncio.run(daemon.refresh())


def test_a_run_whose_end_cannot_be_found_out_is_a_fault_and_not_stuck(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    daemon = daemon_of(tmp_path)
    run = playing(daemon)
    (run.folder / "result.json").write_text("{")
    asyncio.run(daemon._finish(run))
    assert daemon.condition.state is State.FAULTED
    assert run.ended.is_set()
    assert not daemon.stop("Ada")


def left(daemon: Daemon) -> Path:
    """The folder of a run that was prepared, and no more."""
    return runs.prepare(daemon.bench.state / "runs" / ASKED.id, ASKED, job_of(daemon)).folder


@pytest.mark.parametrize(
    ("waits", "begun", "told"),
    [
        (True, False, None),
        (False, False, "before it could begin; nothing moved"),
        (True, True, "was killed"),
    ],
)
def test_a_run_that_was_only_prepared_keeps_its_place(
    tmp_path: Path, waits: bool, begun: bool, told: str | None
) -> None:
    folder = left(first := daemon_of(tmp_path))
    if waits:
        first.queue.add(ASKED)
    if begun:
        listening(folder).close()

    async def look() -> None:
        daemon = daemon_of(tmp_path)
        await daemon.open("http://127.0.0.1:1")
        assert [entry.id for entry in daemon.queue] == ([ASKED.id] if told is None else [])
        assert daemon.condition.state is (State.FAULTED if begun else State.IDLE)
        sentence = (daemon.condition.last or {"sentence": ""})["sentence"]
        assert (told or "") in sentence
        assert bool(sentence) == (told is not None)
        assert not folder.exists()
        await daemon.close()

    asyncio.run(look())


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        ({"colour": 1}, "(?s)could not begin: .*colour"),
        ([], "could not begin"),
        ({"periods": "\ud800"}, "could not begin"),
    ],
)
def test_an_entry_of_another_version_is_refused_and_the_watch_goes_on(
    tmp_path: Path, overrides: Any, words: str
) -> None:
    daemon = daemon_of(tmp_path)
    daemon.queue.add(replace(ASKED, overrides=overrides))
    daemon.condition.arm("Ada")

    async def look() -> None:
        await daemon._look()
        assert daemon.condition.state is State.FAULTED
        assert re.search(words, daemon.status()["fault"]["sentence"])
        assert list(daemon.queue) == []
        daemon.condition.arm("Ada")
        await daemon._look()
        assert daemon.condition.state is State.IDLE

    asyncio.run(look())


@pytest.mark.parametrize("error", [OSError("no such socket"), ValueError("strange")])
def test_a_runner_that_nobody_could_stop_is_ended(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    """Whether the rig stands is not known then; on a rig that is its own."""
    daemon = daemon_of(tmp_path, rig=load_rig("rigs/paper.toml"))
    daemon._rig_lock = take(tmp_path / "rig.lock", Holder("the test"))
    daemon.queue.add(ASKED)
    daemon.condition.arm("Ada")
    told: list[str] = []

    class Runner:
        def terminate(self) -> None:
            told.append("end")

    async def launch(run: ActiveRun, *_: object) -> None:
        run.process = cast("Any", Runner())
        raise error

    monkeypatch.setattr(runs, "launch", launch)
    asyncio.run(daemon._look())
    daemon._rig_lock.release()
    assert told == ["end"]
    assert daemon.condition.state is State.FAULTED
    assert not daemon.stop("Ada")


def test_nothing_that_it_meets_ends_the_watch(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    daemon = daemon_of(tmp_path)
    daemon.condition.arm("Ada")
    monkeypatch.setattr(core, "WATCH_EVERY_S", 0.0)
    looks: list[str | None] = []
    enough = asyncio.Event()

    async def strange() -> None:
        looks.append(daemon.condition.held)
        if len(looks) == 3:
            enough.set()
        raise ValueError("strange")

    async def look() -> None:
        monkeypatch.setattr(daemon, "_look", strange)
        tasks = [asyncio.create_task(work) for work in (daemon._watch(), enough.wait())]
        await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)

    asyncio.run(look())
    assert looks[:2] == [None, "stopped by a fault of the daemon"]


def test_a_schedule_is_laid_out_once_and_beside_the_event_loop(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    daemon = daemon_of(tmp_path)
    client = AsgiClient(build_app(daemon, daemon.bench))
    threads: list[threading.Thread] = []
    schedule = Experiment.schedule

    def noted(plan: Experiment) -> Schedule:
        threads.append(threading.current_thread())
        return schedule(plan)

    monkeypatch.setattr(Experiment, "schedule", noted)
    asked = {"experiment": "short", "operator": "Ada", "confirm": True}
    assert client.post("/api/preview", json={"experiment": "short"}).status_code == 200
    assert client.post("/api/runs", json=asked).status_code == 202
    assert len(threads) == 2
    assert threading.main_thread() not in threads


def test_what_is_too_long_for_the_rig_is_refused_without_laying_it_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    daemon = daemon_of(tmp_path)
    client = AsgiClient(build_app(daemon, daemon.bench))
    monkeypatch.setattr(Experiment, "schedule", None)
    long = {"experiment": "short", "overrides": {"standstill_s": 3600.0}}
    answer = client.post("/api/preview", json=long)
    assert answer.status_code == 422
    assert "the rig's limit is" in answer.json()["detail"]


def test_one_schedule_is_laid_out_at_a_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    daemon = daemon_of(tmp_path)
    inside: list[int] = [0]

    async def beside(*_: object) -> None:
        inside[0] += 1
        assert inside[0] == 1
        for _turn in range(5):
            await asyncio.sleep(0)
        inside[0] -= 1

    async def look() -> None:
        monkeypatch.setattr(core.asyncio, "to_thread", beside)
        asking = [asyncio.create_task(daemon.chosen("short", {})) for _ in range(4)]
        await asyncio.sleep(0)
        asking[1].cancel()
        done = await asyncio.gather(*asking, return_exceptions=True)
        assert [one for one in done if one is not None] == [done[1]]

    asyncio.run(look())
