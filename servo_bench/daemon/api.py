"""The API: routes, typed in and out, that ask the daemon and the library. See docs/daemon.md."""

import asyncio
import time
from collections.abc import Coroutine
from typing import Annotated, Any

from fastapi import APIRouter, Depends, FastAPI, Query, Request, Response, WebSocket
from fastapi.responses import FileResponse, HTMLResponse, JSONResponse
from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect

from servo_bench import __version__
from servo_bench.daemon import library
from servo_bench.daemon import models as m
from servo_bench.daemon.answers import answer_errors, daemon_of
from servo_bench.daemon.config import Bench
from servo_bench.daemon.core import Daemon
from servo_bench.daemon.guard import COOKIE, SESSION_S, Guard, Sessions, elsewhere
from servo_bench.daemon.page_files import page_file
from servo_bench.daemon.problems import MEDIA_TYPE, ApiError
from servo_bench.daemon.reference import reference
from servo_bench.daemon.requests import Chosen, laid_out
from servo_bench.daemon.viewers import Viewers
from servo_bench.diagnosis.judging.verdict import Verdict
from servo_bench.recording.mcap_file import load

REFRESH_EVERY_S = 2.0
WORDS_PATIENCE_S = 0.25
"""How long a stop waits for the words that came with it."""
REPORT_POLICY = "default-src 'none'; style-src 'unsafe-inline'; img-src data:; sandbox"
PROBLEMS: dict[int | str, dict[str, Any]] = {
    "default": {
        "model": m.Problem,
        "description": "what went wrong, in words (RFC 9457)",
        "content": {MEDIA_TYPE: {}},
    }
}
Words = Annotated[str, Query(max_length=200)]


def _sessions(request: Request) -> Sessions:
    sessions: Sessions = request.app.state.sessions
    return sessions


Served = Annotated[Daemon, Depends(daemon_of)]
api = APIRouter(prefix="/api", responses=PROBLEMS)


@api.get("/health")
async def health(request: Request) -> m.Health:
    """Whether the daemon answers."""
    since_s: float = request.app.state.since_s
    return m.Health(version=__version__, uptime_s=time.monotonic() - since_s)


@api.post("/login", status_code=204)
async def login(asked: m.LoginRequest, request: Request, response: Response) -> None:
    """Exchange the token for a session's cookie."""
    sessions = _sessions(request)
    if sessions.needed and not sessions.is_token(asked.token):
        raise ApiError(401, "wrong-token", "that is not the token of this daemon.")
    response.set_cookie(
        COOKIE,
        sessions.open(),
        max_age=SESSION_S,
        httponly=True,
        samesite="strict",
        secure=request.url.scheme == "https",
    )


@api.get("/rig")
async def rig(daemon: Served) -> m.RigView:
    """The rig that this daemon owns."""
    bench = daemon.bench
    return m.RigView(
        name=bench.rig.name,
        bus=bench.rig.bus,
        limits=m.LimitsView(**bench.rig.limits.model_dump()),
        simulated=bench.simulated,
        reachable=daemon.reachable,
    )


@api.get("/status")
async def status(daemon: Served) -> m.Status:
    """What the daemon does now."""
    return m.Status.model_validate(daemon.status())


@api.get("/experiments")
async def experiments(daemon: Served) -> list[m.ExperimentView]:
    """What may be played."""
    bench = daemon.bench
    return await run_in_threadpool(
        lambda: [
            _view(name, bench.texts[name], laid_out(one)) for name, one in bench.experiments.items()
        ]
    )


@api.post("/preview")
async def preview(asked: m.PreviewRequest, daemon: Served) -> m.ExperimentView:
    """What an experiment with changes would do: how far, how fast, how long. Nothing waits."""
    changed = await daemon.chosen(asked.experiment, asked.overrides.model_dump(exclude_none=True))
    name = asked.experiment.removesuffix(".toml")
    return _view(name, daemon.bench.texts[name], changed)


def _view(file: str, text: str, found: Chosen) -> m.ExperimentView:
    return m.ExperimentView(
        name=found.experiment.name,
        file=file,
        text=text,
        period_s=found.experiment.period_s,
        seconds=found.duration_s,
        slots=found.slots,
        peak_velocity_rad_s=found.peak_velocity_rad_s,
        peak_travel_rad=found.peak_travel_rad,
    )


@api.post("/runs", status_code=202)
async def submit(asked: m.RunRequest, daemon: Served) -> m.Accepted:
    """Let a run wait for its turn; `position` runs are before it."""
    entry = daemon.new_entry(
        experiment=asked.experiment,
        name=asked.name,
        notes=asked.notes,
        operator=asked.operator,
        overrides=asked.overrides.model_dump(exclude_none=True),
    )
    return m.Accepted(id=entry.id, position=await daemon.submit(entry))


@api.get("/runs")
async def search(
    daemon: Served,
    request: Request,
    *,
    q: Words = "",
    tag: Words = "",
    limit: Annotated[int, Query(ge=1, le=500)] = 50,
    offset: Annotated[int, Query(ge=0, le=10_000_000)] = 0,
) -> m.RunPage:
    """Recordings in whose texts every word of `q` occurs, the latest first."""
    await _refreshed(request, daemon)
    found = await run_in_threadpool(daemon.catalogue.search, q or None, tag or None, limit, offset)
    rows = [m.RunRow.model_validate(run.row()) for run in found.runs]
    return m.RunPage(total=found.total, runs=rows)


@api.get("/runs/{run_id}")
async def run(daemon: Served, run_id: m.RunId) -> m.RunDetail:
    """One recording, with what its analysis says."""
    found = await run_in_threadpool(library.detail, daemon.catalogue, run_id)
    return m.RunDetail.model_validate(found)


@api.patch("/runs/{run_id}")
async def annotate(daemon: Served, run_id: m.RunId, asked: m.Annotation) -> m.RunRow:
    """Write notes or tags beside a recording; of two who do so at once the later one stays."""
    await run_in_threadpool(library.run_of, daemon.catalogue, run_id)
    changed = await run_in_threadpool(daemon.catalogue.annotate, run_id, asked.notes, asked.tags)
    return m.RunRow.model_validate(changed.row())


@api.get("/runs/{run_id}/recording", response_class=FileResponse)
async def recording(daemon: Served, run_id: m.RunId) -> FileResponse:
    """The recording itself (MCAP)."""
    path = await run_in_threadpool(library.path_of, daemon.catalogue, run_id)
    name = path.name.encode(errors="replace").decode()  # a file's name may be any bytes
    return FileResponse(path, media_type="application/octet-stream", filename=name)


@api.get("/runs/{run_id}/report", response_class=HTMLResponse)
async def report(daemon: Served, run_id: m.RunId) -> HTMLResponse:
    """The report of its analysis, one HTML page."""
    return await _page_beside(daemon, run_id, "report")


@api.get("/runs/{run_id}/diagnosis")
async def diagnosis(daemon: Served, run_id: m.RunId) -> Verdict:
    """The verdict of its diagnosis, in the public schema."""
    return await run_in_threadpool(library.verdict_of, daemon.catalogue, run_id)


@api.get("/runs/{run_id}/diagnosis/page", response_class=HTMLResponse)
async def diagnosis_page(daemon: Served, run_id: m.RunId) -> HTMLResponse:
    """The page of its diagnosis, one HTML page."""
    return await _page_beside(daemon, run_id, "diagnosis_page")


async def _page_beside(daemon: Daemon, run_id: str, kind: str) -> HTMLResponse:
    """A page that our own work has made, where no script can run."""
    path = await run_in_threadpool(library.companion, daemon.catalogue, run_id, kind)
    headers = {"Content-Security-Policy": REPORT_POLICY}
    return HTMLResponse(await run_in_threadpool(path.read_bytes), headers=headers)


@api.get("/runs/{run_id}/analysis", response_class=JSONResponse)
async def analysis(daemon: Served, run_id: m.RunId) -> Response:
    """The figures of its analysis, in SI units."""
    path = await run_in_threadpool(library.companion, daemon.catalogue, run_id, "figures")
    return Response(await run_in_threadpool(path.read_bytes), media_type="application/json")


@api.get("/runs/{run_id}/samples")
async def samples(
    daemon: Served,
    run_id: m.RunId,
    channels: Annotated[str, Query(min_length=1, max_length=1000)] = "load_angle_rad",
    points: Annotated[int, Query(ge=1, le=library.MOST_POINTS)] = 2000,
) -> m.Samples:
    """Channels of a recording, thinned to blocks with their least and largest values."""
    path = await run_in_threadpool(library.path_of, daemon.catalogue, run_id)
    names = tuple(name.strip() for name in channels.split(",") if name.strip())
    found = await run_in_threadpool(library.samples, path, names, points)
    return m.Samples.model_validate(found)


@api.post("/runs/{run_id}/analyse", status_code=202)
async def analyse(daemon: Served, run_id: m.RunId) -> m.JobStarted:
    """Analyse a recording (again): figures and report beside it."""
    path = await run_in_threadpool(library.path_of, daemon.catalogue, run_id)
    return m.JobStarted(job=daemon.start_job("analyse", run_id, path).id)


@api.post("/runs/{run_id}/diagnose", status_code=202)
async def diagnose(daemon: Served, run_id: m.RunId) -> m.JobStarted:
    """Say (again) what the rig's simulation gets wrong: a verdict and its page beside it."""
    path = await run_in_threadpool(library.path_of, daemon.catalogue, run_id)
    return m.JobStarted(job=daemon.start_job("diagnose", run_id, path).id)


@api.get("/jobs/{job_id}")
async def job(daemon: Served, job_id: Annotated[str, m.Field(max_length=64)]) -> m.JobView:
    """How a piece of work gets on."""
    return m.JobView.model_validate(daemon.jobs.get(job_id), from_attributes=True)


@api.get("/compare")
async def compare(daemon: Served, request: Request, a: m.RunId, b: m.RunId) -> dict[str, Any]:
    """Has the rig changed between run `a` and run `b`: kernels, noise, parameters."""
    paths = [
        await run_in_threadpool(library.path_of, daemon.catalogue, run_id) for run_id in (a, b)
    ]
    return await _while_wanted(request, daemon.jobs.compared(*paths))


async def _while_wanted(
    request: Request, work: Coroutine[Any, Any, dict[str, Any]]
) -> dict[str, Any]:
    """What the work gives; ended where the client has gone. Takes the request's messages."""

    async def gone() -> None:
        while (await request.receive())["type"] != "http.disconnect":
            pass

    working, leaving = asyncio.create_task(work), asyncio.create_task(gone())
    try:
        await asyncio.wait([working, leaving], return_when=asyncio.FIRST_COMPLETED)
        if not working.done():
            raise ApiError(408, "gone", "nobody waits for the answer any more.")
        return await working
    finally:
        for task in (working, leaving):
            task.cancel()
        await asyncio.gather(working, leaving, return_exceptions=True)


@api.post(
    "/stop",
    openapi_extra={
        "requestBody": {
            "content": {"application/json": {"schema": m.StopRequest.model_json_schema()}}
        }
    },
)
async def stop(daemon: Served, request: Request) -> m.Stopped:
    """Stop the rig now and hold the queue. Needs no turn, and may be asked any number of times.

    It is heeded whatever its body is: words that do not fit are cut, or left.
    """
    asked = m.StopRequest.in_bytes(await _words(request, daemon.bench.network.max_body_bytes))
    standing = daemon.stop(asked.words(elsewhere=elsewhere(request.client)))
    return m.Stopped(standing=standing, state=daemon.condition.state)


async def _words(request: Request, most: int) -> bytes:
    """A stop's body; nothing where it is too long, or does not come."""
    body = b""
    try:
        async with asyncio.timeout(WORDS_PATIENCE_S):
            async for part in request.stream():
                body += part
                if len(body) > most:
                    return b""
    except (TimeoutError, ClientDisconnect):
        return b""
    return body


@api.post("/arm")
async def arm(daemon: Served, asked: m.ArmRequest) -> m.Status:
    """Clear a fault and let the queue go on: somebody has looked at the rig."""
    daemon.arm(asked.operator, asked.seen)
    return m.Status.model_validate(daemon.status())


@api.delete("/queue/{run_id}", status_code=204)
async def cancel(daemon: Served, run_id: m.RunId) -> None:
    """Take a run out of the queue."""
    daemon.cancel(run_id)


@api.post("/replay", status_code=202)
async def replay(daemon: Served, asked: m.ReplayRequest) -> m.Status:
    """Show a recording on the page, as if it were played."""
    path = await run_in_threadpool(library.path_of, daemon.catalogue, asked.run)
    loaded = await run_in_threadpool(load, path, allow_cut=True)
    daemon.play_back(asked.run, loaded, asked.speed, asked.start_s)
    return m.Status.model_validate(daemon.status())


@api.delete("/replay", status_code=204)
async def end_replay(daemon: Served) -> None:
    """Show the rig again."""
    daemon.end_play_back()


async def _refreshed(request: Request, daemon: Daemon) -> None:
    """Bring the catalogue up to date, but not for every request."""
    state = request.app.state
    now_s = time.monotonic()
    if now_s - state.refreshed_s > REFRESH_EVERY_S:
        state.refreshed_s = now_s
        await daemon.refresh()


def build_app(daemon: Daemon, bench: Bench) -> FastAPI:
    """The application; `daemon` is opened and closed by whoever serves it."""
    app = FastAPI(
        title="servo-bench",
        version=__version__,
        description="The bench is not a safety function: a rig needs a hard-wired emergency stop.",
        openapi_url="/openapi.json",
        docs_url=None,
        redoc_url=None,
    )
    sessions = Sessions(bench.token)
    app.state.daemon, app.state.sessions = daemon, sessions
    app.state.since_s, app.state.refreshed_s = time.monotonic(), -REFRESH_EVERY_S
    app.include_router(api)
    viewers = Viewers(daemon)

    @app.websocket("/api/live")
    async def live(socket: WebSocket) -> None:
        await viewers.serve(socket)

    @app.get("/docs", include_in_schema=False, response_class=HTMLResponse)
    async def docs() -> str:
        return reference(app.openapi())

    @app.get("/{path:path}", include_in_schema=False)
    async def page(path: str) -> FileResponse:
        file, media_type = page_file(path)
        return FileResponse(file, headers={"Cache-Control": "no-cache"}, media_type=media_type)

    app.add_middleware(Guard, bench=bench, sessions=sessions)
    answer_errors(app)
    return app
