"""The daemon's claims: what it costs the bus loop, how soon a page sees a sample, and a stop acts.

Everything is measured from outside, on a software rig with a bus of its own: the daemon is a
process, the pages are processes, the wire is listened to by a bystander.

    lateness     the same schedule with the daemon, three pages, and analyses one after another
                 beside it, and alone (a plain run): in turn, so that both see the same machine. A C
                 loop on every CPU tells when the machine itself was away: the ratio is of the rows
                 outside of these holes
    sample       from its SYNC to a page's socket (a browser draws it within its next frame)
    stop         from the request to the first frame on the wire that commands zero or quick stop
    start        from exec to the first answer of /api/health, in turn with a process that only
                 imports FastAPI and uvicorn, its reference
    memory       resident memory of the web side after each run, for so long
"""

import json
import logging
import os
import socket
import struct
import subprocess
import sys
import tempfile
import urllib.request
from collections.abc import Callable, Collection, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple

import can
import numpy as np
from websockets.sync.client import connect

from servo_bench.benchmark.lateness import Lateness, period_ns, references_beside
from servo_bench.benchmark.listener import spread_us
from servo_bench.clock import NS_PER_S, monotonic_ns
from servo_bench.errors import BenchError
from servo_bench.excitation.experiment import Experiment, MSequence, RandomBinary
from servo_bench.recording.mcap_file import load
from servo_bench.rig import RigConfig, load_rig
from servo_bench.run.session import run
from sim_rig.process import spawn

RIG = "rigs/paper.toml"
PAGES = 3
AMPLITUDE_RAD_S = 0.5
PERIODS_S = (0.001, 0.002, 0.008)
PATIENCE_S = 180.0
COMMAND = 0x200
ENABLED = 0x0F
_PDO = struct.Struct("<Hi")


class Effort(NamedTuple):
    """How much is measured."""

    seconds: float
    pairs: int
    stops: int
    starts: int
    runs: int
    memory_s: float


SHORT = Effort(seconds=8.0, pairs=1, stops=8, starts=3, runs=3, memory_s=0.0)
FULL = Effort(seconds=20.0, pairs=3, stops=200, starts=20, runs=10, memory_s=3600.0)


def measure(
    effort: Effort,
    told: Callable[[str], None],
    parts: Collection[str],
) -> dict[str, Any]:
    """The parts, ready for JSON. Raises what a run raises, and BenchError where the daemon dies."""
    logging.getLogger("can").setLevel(logging.CRITICAL)  # it tells of every read within a frame
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        paper = load_rig(RIG).on_a_free_port()
        started = stack.enter_context(spawn(paper.simulation_settings()))
        rig = paper.with_bus(**started.bus)
        bench = _write_bench(folder, rig, effort)
        figures: dict[str, Any] = {"effort": effort._asdict()}
        if "start" in parts:
            told("start")
            figures |= _starts(bench, effort)
        for period_s in PERIODS_S if "lateness" in parts else ():
            told(f"lateness at {period_s * 1e3:g} ms")
            figures[f"period_{period_s * 1e3:g}_ms"] = _lateness_or_why(
                bench, rig, period_s, effort
            )
        if "stop" in parts:
            told("stop")
            figures["stop_to_zero_s"] = _spread_s(_stops(bench, rig, effort))
        if "memory" in parts:
            told("memory")
            figures["memory"] = _memory(bench, effort)
    return figures


# -- the bench ------------------------------------------------------------------------------------


def _experiment(period_s: float, seconds: float) -> Experiment:
    """At least one whole period of a sequence, so that it can be analysed."""
    sequence = MSequence(polynomial="2327", amplitude_rad_s=AMPLITUDE_RAD_S)
    chips = sequence.velocity_rad_s().size
    periods = max(1, round(seconds / period_s / chips))
    return Experiment(
        name="daemon benchmark",
        rig=RIG,
        period_s=period_s,
        memory=8,
        standstill_s=0.2,
        lead_in=16,
        identification=sequence.model_copy(update={"periods": periods}),
        validation=RandomBinary(
            kind="random-binary", seed=1, amplitude_rad_s=AMPLITUDE_RAD_S, length=64
        ),
    )


def _write_bench(folder: Path, rig: RigConfig, effort: Effort) -> Path:
    lasting_s = {f"{period_s * 1e3:g}ms": effort.seconds for period_s in PERIODS_S}
    for name, seconds in (lasting_s | {"short": 1.0, "long": 3000.0}).items():
        period_s = float(name.removesuffix("ms")) * 1e-3 if name in lasting_s else 0.008
        experiment = _experiment(period_s, seconds).model_dump(mode="json", exclude_none=True)
        (folder / f"{name}.toml").write_text(_toml(experiment))
    (folder / "rig.toml").write_text(_toml(rig.model_dump(mode="json", exclude_none=True)))
    bench = folder / "bench.toml"
    bench.write_text(
        'rig = "rig.toml"\nexperiments = ["[128ls]*.toml"]\n[network]\nport = 0\n'
        f"requests_per_second = 10000.0\n[run]\nanalyse = false\ncpu = {_cpu()}\n"
    )
    return bench


def _cpu() -> int:
    """The last one: the loop keeps to it, as in `benchmark cycle`, and the rig to the others."""
    return max(os.sched_getaffinity(0))


def _toml(table: dict[str, Any], prefix: str = "") -> str:
    lines = [f"{k} = {json.dumps(v)}" for k, v in table.items() if not isinstance(v, dict)]
    for key, value in table.items():
        if isinstance(value, dict):
            lines += [f"[{prefix}{key}]", _toml(value, f"{prefix}{key}.")]
    return "\n".join(lines) + "\n"


# -- the daemon, from outside ---------------------------------------------------------------------


class _Client:
    """A daemon's process and a way to ask it."""

    def __init__(self, process: "subprocess.Popen[bytes]", url: str) -> None:
        self.process = process
        self.url = url
        self.live_url = f"ws{url.removeprefix('http')}/api/live"

    def ask(self, path: str, body: dict[str, Any] | None = None) -> dict[str, Any]:
        """GET, or POST where there is a body; the answer's JSON."""
        request = urllib.request.Request(  # noqa: S310 - our own daemon on loopback
            f"{self.url}/api/{path}",
            json.dumps(body).encode() if body is not None else None,
            {"Content-Type": "application/json"},
        )
        with urllib.request.urlopen(request, timeout=PATIENCE_S) as answer:  # noqa: S310
            table: dict[str, Any] = json.load(answer)
            return table

    def play(self, experiment: str) -> str:
        """Let a run begin; its id."""
        asked = {"experiment": experiment, "operator": "benchmark", "confirm": True}
        run_id = str(self.ask("runs", asked)["id"])
        self.ask("arm", {"operator": "benchmark"})
        return run_id

    def wait(self, until: Callable[[dict[str, Any]], bool], patience_s: float) -> None:
        """Follow the status until it is so; BenchError where it never is."""
        until_ns = monotonic_ns() + round(patience_s * NS_PER_S)
        with connect(self.live_url) as live:
            while monotonic_ns() < until_ns:
                message = live.recv(timeout=patience_s)
                if isinstance(message, str) and until(status := json.loads(message)):
                    return
                if isinstance(message, str) and status["state"] == "faulted":
                    raise BenchError(f"the daemon's run failed: {status['fault']}")
        raise BenchError(f"the daemon did not get there within {patience_s:g} s: {status}")


def _is_over(run_id: str) -> Callable[[dict[str, Any]], bool]:
    return lambda status: (
        status["state"] == "idle" and (status["last"] or {"id": ""})["id"] == run_id
    )


@contextmanager
def _daemon(bench: Path) -> Iterator[_Client]:
    """A daemon that says to our own socket, in systemd's way, that it is ready."""
    name = f"servo-bench-benchmark-{os.getpid()}"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(f"\0{name}")
        systemd.settimeout(PATIENCE_S)
        process = subprocess.Popen(
            [sys.executable, "-m", "servo_bench.daemon", bench],
            stderr=subprocess.DEVNULL,
            env={**os.environ, "NOTIFY_SOCKET": f"@{name}"},
        )
        try:
            ready = systemd.recv(4096).decode()
            yield _Client(process, ready.rsplit(" ", 1)[1].strip())
        finally:
            process.terminate()
            process.wait(PATIENCE_S)


def _starts(bench: Path, effort: Effort) -> dict[str, Any]:
    """Starts and their reference, in turn, and how many times as long a start is."""
    starts_s, imports_s = [], []
    for _ in range(effort.starts):
        imports_s.append(_import_s())
        starts_s.append(_start_s(bench))
    return {
        "start_s": _spread_s(starts_s),
        "import_fastapi_uvicorn_s": _spread_s(imports_s),
        "start_to_import_ratio_p50": float(np.median(starts_s) / np.median(imports_s)),
    }


def _import_s() -> float:
    begun_ns = monotonic_ns()
    subprocess.run([sys.executable, "-c", "import fastapi, uvicorn"], check=True)
    return (monotonic_ns() - begun_ns) / NS_PER_S


def _start_s(bench: Path) -> float:
    begun_ns = monotonic_ns()
    with _daemon(bench) as client:
        client.ask("health")
        return (monotonic_ns() - begun_ns) / NS_PER_S


# -- what is measured -----------------------------------------------------------------------------


def _lateness_or_why(
    bench: Path, rig: RigConfig, period_s: float, effort: Effort
) -> dict[str, Any]:
    """As `_lateness`; why not, where this machine cannot play the software rig at that period."""
    try:
        return _lateness(bench, rig, period_s, effort)
    except BenchError as error:
        return {"not_played": str(error)}


def _lateness(bench: Path, rig: RigConfig, period_s: float, effort: Effort) -> dict[str, Any]:
    """Lateness with everything beside it and alone, and the samples' way to the pages."""
    name = f"{period_s * 1e3:g}ms"
    experiment = _experiment(period_s, effort.seconds)
    alone: list[Lateness] = []
    beside: list[Lateness] = []
    ways_s: list[float] = []
    missed = {"alone": 0, "beside": 0}
    jobs = 0
    for pair in range(effort.pairs):
        out = bench.parent / "recordings" / f"alone-{name}-{pair}.mcap"
        out.parent.mkdir(exist_ok=True)
        with references_beside(experiment) as references:
            missed["alone"] += run(experiment, rig, out, cpu=_cpu()).missed
            alone.append(Lateness.of(load(out), references, period_ns(experiment)))
        kept, ways, skipped, analyses = _watched(bench, name, experiment)
        beside.append(kept)
        ways_s += ways
        missed["beside"] += skipped
        jobs += analyses
    loose, busy = Lateness.together(alone), Lateness.together(beside)
    return {
        "alone": loose.figures(),
        "beside": busy.figures(),
        **{
            f"ratio_p{mark}": float(
                np.percentile(busy.clean_s, mark) / np.percentile(loose.clean_s, mark)
            )
            for mark in (50, 99)
        },
        "missed": missed,
        "analyses_beside": jobs,
        "sample_to_page_s": _spread_s(ways_s),
    }


def _watched(
    bench: Path, name: str, experiment: Experiment
) -> tuple[Lateness, list[float], int, int]:
    """A run with pages and analyses beside it: lateness, the samples' ways, missed, analyses."""
    duration_s = experiment.schedule().duration_s
    with _daemon(bench) as client, ExitStack() as stack:
        (reference, *_) = client.ask("runs?q=alone")["runs"]
        watch_s = duration_s + 4.0
        pages = [
            stack.enter_context(
                subprocess.Popen(
                    [
                        *(sys.executable, "-m", "servo_bench.benchmark.viewer"),
                        *(client.live_url, str(watch_s)),
                    ],
                    stdout=subprocess.PIPE,
                )
            )
            for _ in range(PAGES)
        ]
        references = stack.enter_context(references_beside(experiment))
        run_id = client.play(name)
        analyses = _analyse_until_over(client, reference["id"], run_id, duration_s + PATIENCE_S)
        seen = [json.loads(page.communicate()[0]) for page in pages]
        recording = load(bench.parent / "recordings" / client.ask(f"runs/{run_id}")["file"])
        missed = int(client.ask(f"runs/{run_id}")["missed"])
        kept = Lateness.of(recording, references, period_ns(experiment))
    start_ns = int(recording["asked_ns"][0])
    ways_s = [
        (arrived_ns - start_ns) / NS_PER_S - time_s
        for page in seen
        for arrived_ns, times_s in zip(page["arrived_ns"], page["t_s"], strict=True)
        for time_s in times_s
    ]
    return kept, ways_s, missed, analyses


def _analyse_until_over(client: _Client, reference: str, run_id: str, patience_s: float) -> int:
    """One analysis after another until the run is over; how many were begun."""
    jobs: set[str] = set()

    def over(status: dict[str, Any]) -> bool:
        jobs.add(str(client.ask(f"runs/{reference}/analyse", {})["job"]))
        return _is_over(run_id)(status)

    client.wait(over, patience_s)
    return len(jobs)


def _stops(bench: Path, rig: RigConfig, effort: Effort) -> list[float]:
    """Seconds from each stop request to zero on the wire."""
    found = []
    options: dict[str, Any] = dict(rig.bus)
    with _daemon(bench) as client, can.Bus(**options) as bus:
        for _ in range(effort.stops):
            run_id = client.play("long")
            client.wait(lambda status: (status["run"] or {"slot": 0})["slot"] > 40, PATIENCE_S)
            while bus.recv(0.0) is not None:
                pass  # what passed meanwhile
            asked_ns = monotonic_ns()
            client.ask("stop", {})
            found.append((_zero_ns(bus, rig) - asked_ns) / NS_PER_S)
            client.wait(_is_over(run_id), PATIENCE_S)
    return found


def _zero_ns(bus: can.BusABC, rig: RigConfig) -> int:
    """When the next command passed that is zero, or takes the drive out of operation."""
    wanted = COMMAND + getattr(rig.drive, "node_id", 1)
    until_ns = monotonic_ns() + round(PATIENCE_S * NS_PER_S)
    while monotonic_ns() < until_ns:
        message = bus.recv(1.0)
        if message is not None and message.arbitration_id == wanted:
            controlword, velocity = _PDO.unpack_from(message.data)
            if velocity == 0 or controlword & ENABLED != ENABLED:
                return monotonic_ns()
    raise BenchError("no zero command passed on the bus after a stop was asked.")


def _memory(bench: Path, effort: Effort) -> dict[str, Any]:
    """Resident memory of the web side, MB, after each run; so many runs, and for so long."""
    resident_mb: list[float] = []
    ended_s: list[float] = []
    begun_ns = monotonic_ns()
    with _daemon(bench) as client:
        while len(resident_mb) < effort.runs or ended_s[-1] < effort.memory_s:
            client.wait(_is_over(client.play("short")), PATIENCE_S)
            resident_mb.append(_resident_mb(client.process.pid))
            ended_s.append((monotonic_ns() - begun_ns) / NS_PER_S)
    middle = len(resident_mb) // 2
    later = np.polyfit(ended_s[middle:], resident_mb[middle:], 1) if middle > 1 else None
    return {
        "seconds": ended_s[-1],
        "runs": len(resident_mb),
        "first_mb": resident_mb[0],
        "middle_mb": resident_mb[middle],
        "last_mb": resident_mb[-1],
        "most_mb": max(resident_mb),
        "growth_mb_per_hour_second_half": None if later is None else 3600.0 * float(later[0]),
    }


def _resident_mb(pid: int) -> float:
    with suppress(OSError):
        pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
        return pages * os.sysconf("SC_PAGE_SIZE") / 1e6
    return float("nan")


def _spread_s(values_s: list[float]) -> dict[str, float]:
    return {
        name.removesuffix("_us") + "_s": value * 1e-6 for name, value in spread_us(values_s).items()
    }
