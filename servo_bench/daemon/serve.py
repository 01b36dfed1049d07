"""The daemon as a process: socket, HTTP server, signals, systemd; the order in which they end.

On SIGTERM and SIGINT the rig is stopped first, and the page can still be asked meanwhile; only
when the rig stands does the server end. A second signal changes nothing.
"""

import asyncio
import signal
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress

import uvicorn

from servo_bench.daemon.api import build_app
from servo_bench.daemon.config import Bench
from servo_bench.daemon.core import Daemon
from servo_bench.daemon.log import Log, configure, log
from servo_bench.daemon.notify import notify, watchdog_s
from servo_bench.errors import ConfigError

STARTED_LOOK_S = 0.01
GRACEFUL_S = 2
PING_S = 5.0


class _Server(uvicorn.Server):
    """uvicorn without its signal handling: the rig comes first."""

    @contextmanager
    def capture_signals(self) -> Iterator[None]:
        """Leave the signals to `_serve`."""
        yield


def serve(bench: Bench) -> None:
    """Serve until a signal comes; BusyError or ConfigError where that cannot begin."""
    configure()
    with _bound(bench) as bound:
        asyncio.run(_serve(bench, bound, log()))


async def _serve(bench: Bench, bound: socket.socket, logger: Log) -> None:
    url = _url(bench, bound)
    daemon = Daemon(bench, logger)
    ended = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGTERM, signal.SIGINT):
        loop.add_signal_handler(number, ended.set)
    await daemon.open(url)
    server = _Server(_settings(bench, daemon))
    serving = asyncio.create_task(server.serve(sockets=[bound]))
    try:
        while not server.started and not serving.done():
            await asyncio.sleep(STARTED_LOOK_S)
        notify("READY=1", f"STATUS=rig {bench.rig.name}, {url}")
        logger.info("ready", url=url, rig=bench.rig.name, simulated=bench.simulated)
        async with asyncio.TaskGroup() as tasks:
            beating = tasks.create_task(_beat())
            await _first(ended, serving)
            notify("STOPPING=1", "STATUS=stopping the rig")
            logger.info("stopping")
            await daemon.close()
            server.should_exit = True
            await serving
            beating.cancel()
    finally:
        server.should_exit = True
        with suppress(asyncio.CancelledError):
            await serving
    logger.info("ended")


async def _first(ended: asyncio.Event, serving: "asyncio.Task[None]") -> None:
    waiting = asyncio.create_task(ended.wait())
    await asyncio.wait([waiting, serving], return_when=asyncio.FIRST_COMPLETED)
    waiting.cancel()


async def _beat() -> None:
    """Tell systemd's watchdog that the event loop turns; for ever, where one watches."""
    every_s = watchdog_s()
    while every_s is not None:
        notify("WATCHDOG=1")
        await asyncio.sleep(every_s / 3.0)


def _settings(bench: Bench, daemon: Daemon) -> uvicorn.Config:
    return uvicorn.Config(
        build_app(daemon, bench),
        log_config=None,
        access_log=False,
        server_header=False,
        proxy_headers=False,
        lifespan="off",
        timeout_graceful_shutdown=GRACEFUL_S,
        ws_max_size=4096,
        ws_ping_interval=PING_S,
        ws_ping_timeout=PING_S,
        ws_per_message_deflate=False,  # samples hardly shrink, and it would cost time
        ssl_certfile=bench.certificate,
        ssl_keyfile=bench.key,
    )


def _bound(bench: Bench) -> socket.socket:
    host, port = bench.network.host, bench.network.port
    try:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
        bound = socket.socket(family, socket.SOCK_STREAM)
        bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        bound.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        bound.bind((host, port))
    except OSError as error:
        raise ConfigError(
            f"cannot listen on {host}:{port}: {error.strerror}. Another daemon may be there "
            "already; stop it, or give another network.port."
        ) from error
    return bound


def _url(bench: Bench, bound: socket.socket) -> str:
    """Where this machine reaches the daemon."""
    host, port = bound.getsockname()[:2]
    if host in ("0.0.0.0", "::"):  # noqa: S104 - told, not bound
        host = "127.0.0.1"
    shown = f"[{host}]" if ":" in host else host
    return f"{bench.scheme}://{shown}:{port}"
