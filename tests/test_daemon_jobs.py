"""Work on recordings beside the rig: who waits for whom, what is told meanwhile, what it leaves."""

import asyncio
import json
import os
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any, Literal

import pytest

from servo_bench.catalogue import Catalogue
from servo_bench.catalogue.beside import beside, replace
from servo_bench.daemon import jobs as jobs_module
from servo_bench.daemon import work
from servo_bench.daemon.api import build_app
from servo_bench.daemon.config import load_bench
from servo_bench.daemon.core import Daemon
from servo_bench.daemon.job import RESULT, Outcome, RunResult
from servo_bench.daemon.jobs import KEPT, WAITING, Job, Jobs, Kind
from servo_bench.daemon.log import log
from servo_bench.daemon.machine import State
from servo_bench.daemon.problems import ApiError
from servo_bench.daemon.store import write_json
from servo_bench.diagnosis.judging.verdict import Verdict
from servo_bench.errors import RecordingError
from servo_bench.recording.recording import Event
from servo_bench.run.virtual import save
from tests.asgi_client import HOST, AsgiClient
from tests.daemon_process import write_bench
from tests.recording_files import rows, write
from tests.small_runs import small_run
from tests.test_daemon_api import problem, recording
from tests.test_daemon_core import ASKED, daemon_of, left, playing

VERDICT = Verdict.model_validate(
    {
        "verdict": "named",
        "sentence": "There is cogging.",
        "causes": [
            {
                "effect": "cogging",
                "confidence": 0.9,
                "parameters": {
                    "torque_nm": {
                        "value": 0.01,
                        "unit": "N m",
                        "ci95": [0.009, 0.011],
                        "standard_error": 5e-4,
                    }
                },
            }
        ],
    }
)


class ByHand(Jobs):
    """Jobs whose work is done when the test says so."""

    def __init__(self, *given: Any) -> None:
        super().__init__(None, *given)
        self.ends: dict[str, asyncio.Future[tuple[int, str]]] = {}
        self.tells: dict[str, Callable[[str], None]] = {}
        self.begun: list[tuple[str, ...]] = []

    async def _work(
        self, kind: str, *recordings: Path, told: Callable[[str], None] = lambda _: None
    ) -> tuple[int, str]:
        self.ends[kind] = asyncio.get_running_loop().create_future()
        self.tells[kind] = told
        self.begun.append((kind, *(path.name for path in recordings)))
        return await self.ends[kind]


async def begun(jobs: ByHand, kind: Kind | Literal["compare"]) -> None:
    """Until work of that kind is being done."""
    while kind not in jobs.ends:
        await asyncio.sleep(0)


def told_of(job: Job) -> tuple[str, str, str]:
    return job.state, job.progress, job.sentence


def test_an_analysis_and_a_comparison_do_not_wait_for_a_diagnosis(tmp_path: Path) -> None:
    async def look() -> None:
        jobs = ByHand()
        long = jobs.start("diagnose", "a", tmp_path)
        await begun(jobs, "diagnose")
        waits = jobs.start("diagnose", "b", tmp_path)
        quick = jobs.start("analyse", "a", tmp_path)
        await begun(jobs, "analyse")
        jobs.ends["analyse"].set_result((0, "analysed"))
        assert told_of(await jobs.ended(quick)) == ("done", "", "analysed")
        comparing = asyncio.create_task(jobs.compared(tmp_path, tmp_path))
        await begun(jobs, "compare")
        jobs.ends["compare"].set_result((0, "{}"))
        assert await comparing == {}
        assert [job.id for job in jobs.open] == [long.id, waits.id]
        assert jobs.get(waits.id).state == "waiting"
        await jobs.close()

    asyncio.run(look())


def test_a_job_tells_what_it_does_and_is_over_when_what_it_made_can_be_found(
    tmp_path: Path,
) -> None:
    async def look() -> None:
        changes: list[tuple[str, str, str]] = []
        states_when_made: list[str] = []

        async def made() -> None:
            states_when_made.append(jobs.get(job.id).state)

        jobs = ByHand(lambda: changes.append(told_of(jobs.get(job.id)) if job else ()), made)
        job: Any = None
        job = jobs.start("diagnose", "a", tmp_path)
        await begun(jobs, "diagnose")
        assert jobs.start("diagnose", "a", tmp_path).id == job.id  # the same work is one job
        jobs.tells["diagnose"]("round 1: \x1b[2Jscreening")
        assert jobs.get(job.id).progress == "round 1: \N{REPLACEMENT CHARACTER}[2Jscreening"
        jobs.ends["diagnose"].set_result((1, "it cannot be read"))
        assert told_of(await jobs.ended(job)) == ("failed", "", "it cannot be read")
        assert states_when_made == ["running"]
        assert changes[-1] == ("failed", "", "it cannot be read")
        assert jobs.open == ()

    asyncio.run(look())


def test_a_long_job_is_not_forgotten_for_many_short_ones(tmp_path: Path) -> None:
    async def look() -> None:
        jobs = ByHand()
        long = jobs.start("diagnose", "a", tmp_path)
        await begun(jobs, "diagnose")
        first = None
        for number in range(KEPT + 5):
            quick = jobs.start("analyse", str(number), tmp_path)
            await begun(jobs, "analyse")
            jobs.ends.pop("analyse").set_result((0, ""))
            await jobs.ended(quick)
            first = first or quick
        assert jobs.get(long.id).state == "running"
        with pytest.raises(Exception, match="there is no job"):
            jobs.get(first.id)
        await jobs.close()

    asyncio.run(look())


def test_the_daemons_own_analysis_goes_first_however_many_wait(tmp_path: Path) -> None:
    async def look() -> None:
        jobs = ByHand()
        jobs.start("analyse", "first", tmp_path)
        await begun(jobs, "analyse")
        for number in range(WAITING):
            jobs.start("analyse", str(number), tmp_path / str(number))
        await asyncio.sleep(0)
        with pytest.raises(ApiError, match="jobs wait already"):
            jobs.start("analyse", "another", tmp_path)
        with pytest.raises(ApiError, match="jobs wait already"):
            await jobs.compared(tmp_path, tmp_path)
        own = jobs.start("analyse", "own", tmp_path / "own", own=True)
        await asyncio.sleep(0)
        jobs.ends.pop("analyse").set_result((0, ""))
        await begun(jobs, "analyse")
        assert jobs.begun[-1] == ("analyse", "own")
        jobs.ends.pop("analyse").set_result((0, "analysed"))
        assert (await jobs.ended(own)).sentence == "analysed"
        await begun(jobs, "analyse")
        assert jobs.begun[-1] == ("analyse", "0")
        await jobs.close()

    asyncio.run(look())


def test_a_run_ends_with_many_jobs_open_and_with_none_that_can_be_begun(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def look() -> None:
        daemon = daemon_of(tmp_path, run="analyse = true")
        daemon.jobs = jobs = ByHand()
        for number in range(WAITING + 1):
            jobs.start("analyse", str(number), tmp_path)
        await begun(jobs, "analyse")
        await daemon._finish(playing(daemon, RunResult("complete", "complete.")))
        assert daemon.condition.state is State.ANALYSING
        while jobs.open[-1].run != ASKED.id:
            await asyncio.sleep(0)
        await asyncio.sleep(0)
        jobs.ends.pop("analyse").set_result((0, ""))
        await begun(jobs, "analyse")
        assert jobs.begun[-1] == ("analyse", "a.mcap")
        jobs.ends.pop("analyse").set_result((0, "analysed"))
        await asyncio.gather(*daemon._tasks)
        assert daemon.condition.state is State.IDLE
        monkeypatch.setattr(jobs, "start", None)
        await daemon._finish(playing(daemon, RunResult("complete", "complete.")))
        await asyncio.gather(*daemon._tasks, return_exceptions=True)
        assert daemon.condition.state is State.IDLE
        await jobs.close()

    asyncio.run(look())


@pytest.mark.parametrize(
    ("outcome", "analyse", "analysed"),
    [("complete", True, True), ("stopped", True, True), ("complete", False, False)]
    + [(outcome, True, False) for outcome in ("nothing", "faulted", "cut")],
)
def test_a_run_that_ended_without_a_daemon_is_analysed_by_the_next_one(
    tmp_path: Path, outcome: Outcome, analyse: bool, analysed: bool
) -> None:
    folder = left(daemon_of(tmp_path))
    write_json(folder / RESULT, asdict(RunResult(outcome, "it ended.")))

    async def look() -> None:
        daemon = daemon_of(tmp_path, run=f"analyse = {str(analyse).lower()}")
        daemon.jobs = jobs = ByHand()
        await daemon.open("http://127.0.0.1:1")
        await asyncio.sleep(0)
        await asyncio.sleep(0)
        assert [(job.kind, job.run) for job in jobs.open] == [("analyse", ASKED.id)] * analysed
        if analysed:
            await begun(jobs, "analyse")
            jobs.ends["analyse"].set_result((0, "well."))
            await jobs.ended(jobs.open[0])
            await asyncio.sleep(0)
            assert daemon.status()["last"]["sentence"] == "it ended. Analysis: well."
        assert not folder.exists()
        await daemon.close()

    asyncio.run(look())


def test_an_analysis_that_the_daemons_end_cut_off_is_done_by_the_next_one(tmp_path: Path) -> None:
    async def look() -> None:
        daemon = daemon_of(tmp_path, run="analyse = true")
        daemon.jobs = jobs = ByHand()
        run = playing(daemon, RunResult("complete", "complete."))
        write_json(run.folder / RESULT, asdict(RunResult("complete", "complete.")))
        await daemon._finish(run)
        await begun(jobs, "analyse")
        await daemon.close()
        following = daemon_of(tmp_path, run="analyse = true")
        following.jobs = jobs = ByHand()
        await following.open("http://127.0.0.1:1")
        await begun(jobs, "analyse")
        assert jobs.begun == [("analyse", "a.mcap")]
        await following.close()

    asyncio.run(look())


def test_a_comparison_is_done_once_for_all_who_ask_and_ended_when_they_have_gone(
    tmp_path: Path,
) -> None:
    async def look() -> None:
        jobs = ByHand()
        pair = (tmp_path / "a", tmp_path / "b")
        asking = [asyncio.create_task(jobs.compared(*pair)) for _ in range(3)]
        await begun(jobs, "compare")
        waits = asyncio.create_task(jobs.compared(tmp_path, tmp_path))
        await asyncio.sleep(0)
        asking[0].cancel()
        await asyncio.wait(asking[:1])
        jobs.ends.pop("compare").set_result((0, '{"same": 1}'))
        assert [await task for task in asking[1:]] == [{"same": 1}] * 2
        await begun(jobs, "compare")
        abandoned = jobs.ends.pop("compare")
        waits.cancel()
        await asyncio.wait([waits])
        again = asyncio.create_task(jobs.compared(tmp_path, tmp_path))
        await begun(jobs, "compare")
        assert abandoned.cancelled()
        await jobs.close()
        with pytest.raises(ApiError, match="the daemon ends"):
            await again

    asyncio.run(look())


def test_work_that_is_killed_says_what_it_did_last(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    script = tmp_path / "python"
    script.write_text("#!/bin/sh\necho base fit\necho round 1: screening\nkill -9 $$\n")
    script.chmod(0o755)
    assert "SIGKILL while it did this: round 1: screening" in ended_with(script, monkeypatch)
    assert "No such file" in ended_with(tmp_path / "gone", monkeypatch)


def ended_with(python: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """The sentence of a job whose process is this program."""

    async def look() -> Job:
        jobs = Jobs(None)
        return await jobs.ended(jobs.start("diagnose", "a", Path("x.mcap")))

    monkeypatch.setattr(jobs_module.sys, "executable", str(python))
    job = asyncio.run(look())
    assert job.state == "failed"
    return job.sentence


class Served:
    """A daemon over one recording, and a client of it."""

    def __init__(self, folder: Path, content: bytes) -> None:
        bench = load_bench(write_bench(folder))
        self.path = bench.recordings / "reference.mcap"
        self.path.write_bytes(content)
        self.daemon = Daemon(bench, log())
        self.client = AsgiClient(build_app(self.daemon, bench))
        (row,) = self.client.get("/api/runs").json()["runs"]
        self.run_id = str(row["id"])
        self.url = f"/api/runs/{self.run_id}"


@pytest.fixture
def served(tmp_path: Path) -> Served:
    return Served(tmp_path, recording().read_bytes())


def test_a_verdict_is_given_in_its_public_schema_with_its_page(served: Served) -> None:
    for path in ("diagnosis", "diagnosis/page"):
        words = problem(served.client.get(f"{served.url}/{path}"), 404)
        assert "diagnose the run first" in words
    Catalogue(served.path.parent).store_diagnosis(served.run_id, VERDICT.numbers())
    replace(beside(served.path).diagnosis_page, b"<h1>why</h1>")
    answer = served.client.get(f"{served.url}/diagnosis")
    assert Verdict.model_validate_json(answer.content) == VERDICT
    page = served.client.get(f"{served.url}/diagnosis/page")
    assert page.text == "<h1>why</h1>"
    assert "sandbox" in page.headers["content-security-policy"]
    shown = served.client.get(served.url).json()
    assert shown["diagnosis"] == VERDICT.numbers()
    assert shown["has_diagnosis_page"]
    row = served.client.get("/api/runs", params={"q": "cogging"}).json()["runs"][0]
    assert (row["verdict"], row["causes"]) == ("named", ["cogging"])


@pytest.mark.parametrize("text", ["{", "[]", '{"verdict": "named", "sentence": "x"}', "{}"])
def test_a_verdict_that_is_none_is_said_and_the_run_is_shown_all_the_same(
    served: Served, text: str
) -> None:
    beside(served.path).diagnosis.write_text(text)
    words = problem(served.client.get(f"{served.url}/diagnosis"), 422)
    assert "reference.mcap.diagnosis.json" in words
    assert str(served.path.parent) not in words
    assert served.client.get(served.url).json()["diagnosis"] is None


FOREIGN = (
    '{"run": 7}',
    '{"flags": 7, "memory": 9}',
    '{"vaf_same_order3_percent": NaN, "run": 7, "flags": "ab", "\\ud800": "\\udfff", "deep": %s}'
    % ("[" * 200 + "]" * 200),
)


@pytest.mark.parametrize("text", FOREIGN)
def test_what_somebody_else_has_beside_a_recording_is_no_analysis(
    served: Served, text: str
) -> None:
    places = beside(served.path)
    places.figures.write_text(text)
    places.report.write_bytes(b"\xff theirs")
    shown = served.client.get(served.url)
    assert shown.status_code == 200, shown.text
    (row,) = served.client.get("/api/runs").json()["runs"]
    if "vaf" in text:
        return  # it calls itself one
    assert (shown.json()["kernels"], shown.json()["has_report"]) == (None, False)
    assert row["figures"] == {}
    for path in ("report", "analysis"):
        assert "analyse the run first" in problem(served.client.get(f"{served.url}/{path}"), 404)


def test_a_report_of_somebody_else_is_not_overwritten(served: Served) -> None:
    places = beside(served.path)
    places.report.write_text("theirs")
    with pytest.raises(RecordingError, match="holds no report of an analysis"):
        work.analyse(served.path)
    assert places.report.read_text() == "theirs"


def test_notes_and_events_that_are_no_unicode_are_shown_all_the_same(tmp_path: Path) -> None:
    strange = Event(1, "note", "\ud800", {"\ud800": ["\udfff", {"a": None}]})
    made = write(tmp_path / "made.mcap", rows(20), (strange,))
    served = Served(tmp_path, made.read_bytes())
    beside(served.path).notes.write_text(
        '{"notes": "a \\ud800", "tags": [], "operator": "\\ud800"}'
    )
    shown = served.client.get(served.url)
    assert shown.status_code == 200, shown.text
    assert shown.json()["notes"] == "a ?"
    served.daemon.catalogue.refresh()
    (row,) = served.client.get("/api/runs").json()["runs"]
    assert row["notes"] == "a ?"


def test_a_recording_whose_name_is_no_unicode_is_fetched(served: Served) -> None:
    odd = Path(os.fsdecode(os.fsencode(served.path.parent) + b"/odd-\xff.mcap"))
    served.path.rename(odd)
    served.daemon.catalogue.refresh()
    (row,) = served.client.get("/api/runs").json()["runs"]
    fetched = served.client.get(f"/api/runs/{row['id']}/recording")
    assert fetched.content == odd.read_bytes()


def test_the_description_has_the_verdicts_own_schema(served: Served) -> None:
    described = served.client.get("/openapi.json").json()
    answer = described["paths"]["/api/runs/{run_id}/diagnosis"]["get"]["responses"]["200"]
    name = answer["content"]["application/json"]["schema"]["$ref"].rsplit("/", 1)[1]
    own = Verdict.model_json_schema(mode="serialization")
    shown = described["components"]["schemas"][name]
    assert set(shown["properties"]) == set(own["properties"])


def test_a_diagnosis_is_asked_for_where_there_is_a_run_that_is_over(
    served: Served, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[tuple[object, ...]] = []

    def start(*given: object) -> Job:
        asked.append(given)
        return Job("7", "diagnose", served.run_id)

    monkeypatch.setattr(served.daemon.jobs, "start", start)
    answer = served.client.post(f"{served.url}/diagnose")
    assert (answer.status_code, answer.json()) == (202, {"job": "7"})
    assert asked == [("diagnose", served.run_id, served.path)]
    problem(served.client.post("/api/runs/0123456789abcdef/diagnose"), 404)
    monkeypatch.setattr(served.daemon, "_active", Playing(served.run_id))
    for kind in ("diagnose", "analyse"):
        words = problem(served.client.post(f"{served.url}/{kind}"), 409)
        assert "Ask when it is over" in words
    assert len(asked) == 1


def test_a_comparison_is_ended_when_its_client_goes(served: Served) -> None:
    async def look() -> None:
        served.daemon.jobs = jobs = ByHand()
        app = build_app(served.daemon, served.daemon.bench)
        gone = asyncio.Event()
        messages: asyncio.Queue[dict[str, Any]] = asyncio.Queue()

        async def receive() -> dict[str, Any]:
            await gone.wait()
            return {"type": "http.disconnect"}

        query = f"a={served.run_id}&b={served.run_id}".encode()
        asking = asyncio.create_task(app(scope(query), receive, messages.put))
        await begun(jobs, "compare")
        gone.set()
        await asking
        assert jobs.ends["compare"].cancelled()
        assert (await messages.get())["status"] == 408

    asyncio.run(look())


def scope(query: bytes) -> dict[str, Any]:
    """A GET of a comparison, as a server hands it on."""
    return {
        "type": "http",
        "asgi": {"version": "3.0"},
        "http_version": "1.1",
        "scheme": "http",
        "method": "GET",
        "path": "/api/compare",
        "raw_path": b"/api/compare",
        "query_string": query,
        "root_path": "",
        "headers": [(b"host", HOST.encode())],
        "client": ("127.0.0.1", 5000),
        "server": ("127.0.0.1", 8420),
    }


class Playing:
    """A run that plays, as far as that question goes."""

    def __init__(self, run_id: str) -> None:
        self.asked = type("Asked", (), {"id": run_id})


@pytest.mark.long
def test_a_recording_is_truly_diagnosed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """From the file to the verdict in the catalogue, on seconds of data."""
    save(small_run(), tmp_path / "made.mcap")
    served = Served(tmp_path, (tmp_path / "made.mcap").read_bytes())
    capsys.readouterr()
    sentence = work.diagnose(served.path)
    told = capsys.readouterr().out.splitlines()
    assert {"base fit", "data hygiene", "joint fit on everything"} <= set(told), "its progress"
    verdict = Verdict.model_validate(json.loads(served.client.get(f"{served.url}/diagnosis").text))
    assert sentence == f"{verdict.verdict}: {verdict.sentence}"
    assert verdict.signature is not None
    assert verdict.sentence in served.client.get(f"{served.url}/diagnosis/page").text
    served.daemon.catalogue.refresh()
    (run,) = served.daemon.catalogue.search().runs
    assert (run.verdict, run.causes) == (verdict.verdict, verdict.names)
