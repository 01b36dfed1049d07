"""The daemon as a process of its own, on a software rig of its own, and a client to ask it.

Nothing here knows how the daemon works inside: it is started, asked over HTTP, watched over its
WebSocket, and killed.
"""

import json
import os
import signal
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from queue import Queue
from threading import Thread
from typing import Any, Self

import httpx
import numpy as np
from numpy.typing import NDArray
from websockets.sync.client import ClientConnection, connect

from servo_bench.catalogue import Catalogue
from servo_bench.rig import RigConfig, load_rig
from sim_rig.process import SpawnedRig, spawn

PATIENCE_S = 120.0  # a machine that is shared may give a process nothing for long
SHORT = """
name = "{name}"
rig = "rigs/paper.toml"
period_s = {period_s}
memory = 8
standstill_s = 0.1
lead_in = 16

[identification]
kind = "m-sequence"
polynomial = "2327"
amplitude_rad_s = 1.0
length = {length}

[validation]
kind = "random-binary"
seed = 2
amplitude_rad_s = 1.0
length = 8
"""


def write_bench(
    folder: Path,
    rig: RigConfig | None = None,
    *,
    seconds: dict[str, float] | None = None,
    period_s: float = 0.008,
    more: str = "",
    network: str = "port = 0",
    run: str = "analyse = false",
) -> Path:
    """A bench file with experiments of so many seconds; on `rig`, or simulated per run."""
    (folder / "experiments").mkdir(exist_ok=True)
    for name, lasting_s in (seconds or {"short": 1.0, "long": 120.0}).items():
        text = SHORT.format(name=name, period_s=period_s, length=round(lasting_s / period_s))
        (folder / "experiments" / f"{name}.toml").write_text(text)
    rig_line = 'rig = "rigs/paper.toml"\nsimulated = true'
    if rig is not None:
        (folder / "rig.toml").write_text(rig_text(rig))
        rig_line = 'rig = "rig.toml"'
    bench = folder / "bench.toml"
    names = ", ".join(f'"experiments/{name}.toml"' for name in seconds or ("short", "long"))
    bench.write_text(
        f"{rig_line}\nexperiments = [{names}]\n{more}\n[network]\n{network}\n[run]\n{run}\n"
    )
    return bench


def rig_text(rig: RigConfig) -> str:
    """A rig as its file."""
    return _toml(rig.model_dump(mode="json", exclude_none=True))


def _toml(table: dict[str, Any], prefix: str = "") -> str:
    plain = {key: value for key, value in table.items() if not isinstance(value, dict)}
    lines = [f"{key} = {json.dumps(value)}" for key, value in plain.items()]
    for key, value in table.items():
        if isinstance(value, dict):
            lines += [f"[{prefix}{key}]", _toml(value, f"{prefix}{key}.")]
    return "\n".join(lines) + "\n"


@contextmanager
def software_rig() -> Iterator[tuple[RigConfig, SpawnedRig]]:
    """A software rig that outlives any daemon, on a free port."""
    config = load_rig("rigs/paper.toml").on_a_free_port()
    with spawn(config.simulation_settings()) as started:
        yield config.with_bus(**started.bus), started


class Daemon:
    """A daemon's process and a client of it; leaving the block ends it."""

    def __init__(self, bench: Path) -> None:
        self.bench = bench
        self.start()

    def start(self) -> None:
        """Start it and wait until it says that it is ready."""
        self.said: Queue[dict[str, Any]] = Queue()
        self.process = subprocess.Popen(
            [sys.executable, "-m", "servo_bench.daemon", self.bench],
            stderr=subprocess.PIPE,
            text=True,
        )
        self._reader = Thread(target=self._read)
        self._reader.start()
        self.url: str = self.hear("ready")["url"]
        self.client = httpx.Client(base_url=self.url, timeout=PATIENCE_S)

    def _read(self) -> None:
        assert self.process.stderr is not None
        for line in self.process.stderr:
            self.said.put(json.loads(line) if line.startswith("{") else {"event": line})
        self.said.put({"event": "gone"})

    def hear(self, event: str) -> dict[str, Any]:
        """The next line of the log of that kind; AssertionError where it ends without one."""
        heard = []
        while not heard or heard[-1]["event"] != "gone":
            heard.append(self.said.get(timeout=PATIENCE_S))
            if heard[-1]["event"] == event:
                return heard[-1]
        raise AssertionError(f"the daemon never said {event!r}: {heard}")

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.end()

    def end(self) -> int:
        """SIGTERM, and its exit status."""
        if self.process.poll() is None:
            self.process.terminate()
        return self._gone()

    def kill(self) -> None:
        """kill -9 of the web side alone."""
        self.process.kill()
        self._gone()

    def _gone(self) -> int:
        status = self.process.wait(60)
        self.client.close()
        self._reader.join(PATIENCE_S)
        if self.process.stderr is not None:
            self.process.stderr.close()
        return status

    def status(self) -> dict[str, Any]:
        """GET /api/status."""
        return dict(self.client.get("/api/status").raise_for_status().json())

    def submit(self, experiment: str, operator: str = "tester", **more: Any) -> str:
        """Let a run wait; its id."""
        body = {"experiment": experiment, "operator": operator, "confirm": True, **more}
        answer = self.client.post("/api/runs", json=body)
        assert answer.status_code == 202, answer.text
        return str(answer.json()["id"])

    def arm(self) -> None:
        """Let the queue go on."""
        self.client.post("/api/arm", json={"operator": "tester"}).raise_for_status()

    def play(self, experiment: str, **more: Any) -> str:
        """Submit, arm, and wait until the rig moves; the run's id."""
        run_id = self.submit(experiment, **more)
        self.arm()
        self.wait(lambda status: moves(status, run_id))
        return run_id

    def wait(
        self, until: Callable[[dict[str, Any]], bool], within_s: float = PATIENCE_S
    ) -> dict[str, Any]:
        """Follow the status over a WebSocket until it is as wanted."""
        end_s = time.monotonic() + within_s
        with self.live() as live:
            while True:
                message = live.recv(timeout=within_s)
                if isinstance(message, str):
                    status: dict[str, Any] = json.loads(message)
                    if until(status):
                        return status
                    assert time.monotonic() < end_s, status

    def rows(self) -> list[dict[str, Any]]:
        """The catalogue, the latest run first."""
        return list(self.client.get("/api/runs").raise_for_status().json()["runs"])

    def rows_all(self) -> list[dict[str, Any]]:
        """The whole catalogue, read anew from the files first."""
        Catalogue(self.bench.parent / "recordings").refresh()
        found: list[dict[str, Any]] = []
        while True:
            page = self.client.get("/api/runs", params={"limit": 500, "offset": len(found)}).json()
            found += page["runs"]
            if not page["runs"]:
                return found

    def live(self) -> ClientConnection:
        """A WebSocket as a page opens it."""
        return connect(self.url.replace("http", "ws", 1) + "/api/live")


def moves(status: dict[str, Any], run_id: str) -> bool:
    """Whether that run plays and its first slots have been seen."""
    run = status["run"]
    return status["state"] == "running" and run["id"] == run_id and run["slot"] > 10


def stands(status: dict[str, Any]) -> bool:
    """Whether no run is under way."""
    return status["run"] is None and status["state"] in ("idle", "faulted")


def rows_of(frame: bytes) -> NDArray[np.float64]:
    """A binary frame's rows, by the published layout; shape (n, 6)."""
    magic, count, columns, zero = struct.unpack_from("<4I", frame)
    assert (magic, columns, zero) == (0x53424C56, 6, 0)
    assert len(frame) == 16 + 8 * count * columns
    return np.frombuffer(frame, "<f8", offset=16).reshape(count, columns)


def child_of(pid: int, module: str) -> int | None:
    """The process id of the living child of `pid` that runs a Python module."""
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            fields = (folder / "stat").read_text().rsplit(")", 1)[1].split()
            words = (folder / "cmdline").read_bytes().split(b"\0")
        except OSError:
            continue
        if int(fields[1]) == pid and module.encode() in words and fields[0] != "Z":
            return int(folder.name)
    return None


def runner_of(bench: Path, run_id: str) -> int:
    """The process id of a run's runner, as it wrote it."""
    return int(
        json.loads((bench.parent / "state/runs" / run_id / "runner.json").read_text())["pid"]
    )


def bus_loop_of(runner: int) -> int:
    """The process id of a runner's bus loop."""
    found = child_of(runner, "servo_bench.run.busloop")
    assert found is not None, "the runner has no bus loop"
    return found


def kill(pid: int, number: signal.Signals = signal.SIGKILL) -> None:
    """Signal one process."""
    os.kill(pid, number)
