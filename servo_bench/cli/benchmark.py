"""`servo-bench benchmark …`: the bench's claims, measured on this machine."""

from collections.abc import Mapping
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.pretty import pprint

from servo_bench.benchmark import cycle as cycle_benchmark
from servo_bench.benchmark import experiment as experiment_benchmark
from servo_bench.benchmark import kernels as kernels_benchmark
from servo_bench.benchmark import model as model_benchmark
from servo_bench.benchmark import recording as recording_benchmark
from servo_bench.benchmark import volterra as volterra_benchmark
from servo_bench.benchmark.sweep import measure_all
from servo_bench.benchmark.volterra import SEEDS
from servo_bench.cli.output import check_outputs, write_json
from servo_bench.cli.progress import run_progress
from servo_bench.recording.provenance import provenance
from servo_bench.run.realtime import PRIORITY


class DaemonPart(StrEnum):
    """What of the daemon's benchmark is measured."""

    START = "start"
    LATENESS = "lateness"
    STOP = "stop"
    MEMORY = "memory"


app = typer.Typer(no_args_is_help=True, help="Measure the bench, with a reference beside it.")
PAPER_RIG = "rigs/paper.toml"
Json = Annotated[Path | None, typer.Option("--json", help="Write the figures to this file.")]


@app.command()
def cycle(
    *,
    period_s: Annotated[float, typer.Option(min=1e-4, help="Period of the bus loop.")] = 0.008,
    seconds: Annotated[float, typer.Option(min=1.0, help="How long to play.")] = 60.0,
    priority: Annotated[
        int, typer.Option(min=0, max=99, help="SCHED_FIFO priority; 0 for none.")
    ] = PRIORITY,
    cpu: Annotated[int | None, typer.Option(help="CPU for both loops; default the last.")] = None,
    rig: Annotated[str, typer.Option(help="Rig file, e.g. rigs/modbus-tcp.toml.")] = PAPER_RIG,
    cases: Annotated[
        bool, typer.Option("--cases", help="Every bus and period that the bench claims, in turn.")
    ] = False,
    json: Json = None,
) -> None:
    """The bus loop's punctuality beside a C loop on the same CPU, and what a listener sees."""
    check_outputs(json)
    console = Console(stderr=True)
    if cases:
        say = partial(console.print, markup=False)
        _show(measure_all(seconds=seconds, priority=priority, cpu=cpu, begin=say), json)
        return
    with run_progress(console) as progress:
        figures = cycle_benchmark.measure(
            period_s=period_s,
            seconds=seconds,
            priority=priority,
            cpu=cpu,
            rig_name=rig,
            progress=progress,
        )
    _show(figures, json)


@app.command()
def experiment(
    *,
    name: Annotated[str, typer.Option(help="Experiment file.")] = "experiments/paper.toml",
    json: Json = None,
) -> None:
    """The paper's experiment on the software rig over the real wire: VAF against its target."""
    check_outputs(json)
    with run_progress(Console(stderr=True)) as progress:
        figures = experiment_benchmark.measure(name, progress=progress)
    _show(figures, json)


@app.command()
def kernels(
    *, seed: Annotated[int, typer.Option(min=0, help="Seed of the draws.")] = 1, json: Json = None
) -> None:
    """Time of extraction and prediction, and the paper's figures."""
    check_outputs(json)
    _show(kernels_benchmark.measure(seed), json)


@app.command()
def recording(
    *, seed: Annotated[int, typer.Option(min=0, help="Seed of the rows.")] = 1, json: Json = None
) -> None:
    """Time to read 131 s at 8 ms, beside the mcap library's own reader."""
    check_outputs(json)
    _show(recording_benchmark.measure(seed), json)


@app.command()
def model(
    *,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the commands.")] = 1,
    json: Json = None,
) -> None:
    """The simulation beside a hand-written loop, its start-up, and its step halving."""
    check_outputs(json)
    _show(model_benchmark.measure(seed), json)


@app.command()
def volterra(
    *,
    seed: Annotated[int, typer.Option(min=0, help="First seed of the noise.")] = SEEDS[0],
    seeds: Annotated[int, typer.Option(min=1, help="How many seeds.")] = len(SEEDS),
    plants: Annotated[
        str, typer.Option(help="Module of the plants to identify.")
    ] = volterra_benchmark.PLANTS,
    json: Json = None,
) -> None:
    """Every estimator on plants outside its class, on input it never saw; and the transforms."""
    check_outputs(json)
    _show(volterra_benchmark.measure(range(seed, seed + seeds), plants), json)


@app.command()
def daemon(
    *,
    full: Annotated[
        bool, typer.Option("--full", help="200 stops and an hour of runs, instead of 3 minutes.")
    ] = False,
    only: Annotated[
        list[DaemonPart] | None, typer.Option("--only", help="This part; may be repeated.")
    ] = None,
    minutes: Annotated[
        float | None, typer.Option(min=0.0, help="How long memory is watched, over runs.")
    ] = None,
    json: Json = None,
) -> None:
    """What the daemon costs the bus loop; its start, its stop, a sample's way to a page."""
    from servo_bench.benchmark import daemon as daemon_benchmark  # noqa: PLC0415 - an extra

    check_outputs(json)
    console = Console(stderr=True)
    effort = daemon_benchmark.FULL if full else daemon_benchmark.SHORT
    if minutes is not None:
        effort = effort._replace(memory_s=60.0 * minutes)
    parts = tuple(part.value for part in only or DaemonPart)
    _show(daemon_benchmark.measure(effort, lambda what: console.print(f"{what} ..."), parts), json)


def _show(figures: Mapping[str, Any], json: Path | None) -> None:
    """Print the figures; write them with when, where and with which versions they were taken."""
    pprint(dict(figures), expand_all=True)
    if json is not None:
        write_json(json, {"measured": provenance(), **figures})
