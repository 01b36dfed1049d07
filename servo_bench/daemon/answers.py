"""What is answered where something goes wrong: one place for every route. See `problems`."""

from collections.abc import Awaitable, Callable
from pathlib import Path

from fastapi import FastAPI, Request, Response
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from starlette.exceptions import HTTPException

from servo_bench.daemon.core import Daemon
from servo_bench.daemon.problems import DISK_FULL, MEDIA_TYPE, problem, problem_of
from servo_bench.errors import BenchError, disk_is_full


def daemon_of(request: Request) -> Daemon:
    """The daemon that this application serves."""
    daemon: Daemon = request.app.state.daemon
    return daemon


def answer_errors(app: FastAPI) -> None:
    """Let every error of this application be answered so."""
    answers: dict[type[Exception], Callable[..., Awaitable[Response]]] = {
        BenchError: _bench_error,
        RequestValidationError: _invalid,
        HTTPException: _http_error,
        OSError: _os_error,
        Exception: _our_fault,
    }
    for kind, answer in answers.items():
        app.add_exception_handler(kind, answer)


def _problem(request: Request, status: int, slug: str, detail: str) -> JSONResponse:
    body = problem(status, slug, detail, request.url.path)
    return JSONResponse(body, status, media_type=MEDIA_TYPE)


async def _bench_error(request: Request, error: BenchError) -> Response:
    status, slug = problem_of(error)
    return _problem(request, status, slug, _without_folders(request, str(error)))


async def _invalid(request: Request, error: RequestValidationError) -> Response:
    lines = [
        f"{'.'.join(str(part) for part in item['loc'])}: {item['msg']}" for item in error.errors()
    ]
    return _problem(request, 422, "invalid", "; ".join(lines[:20]))


async def _http_error(request: Request, error: HTTPException) -> Response:
    answer = _problem(request, error.status_code, "http", str(error.detail))
    answer.headers.update(error.headers or {})
    return answer


async def _os_error(request: Request, error: OSError) -> Response:
    if not disk_is_full(error):
        return await _our_fault(request, error)
    words = "the disk is full, and this needs some of it. Make room, then ask again."
    return _problem(request, *DISK_FULL, words)


async def _our_fault(request: Request, error: Exception) -> Response:
    daemon_of(request).log.error("unexpected", path=request.url.path, exc_info=error)
    words = "this is a fault of the daemon, which goes on; its log says more."
    return _problem(request, 500, "unexpected", words)


def _without_folders(request: Request, words: str) -> str:
    """An error's words without where on this machine the recordings are."""
    bench = daemon_of(request).bench
    for folder in (bench.recordings, bench.state):
        words = words.replace(f"{folder}/", "").replace(str(folder), Path(folder).name)
    return words
