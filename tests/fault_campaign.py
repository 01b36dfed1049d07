"""Thousands of seeded faults on the software rig in virtual time, each judged.

    python -m tests.fault_campaign --count 10000 --seed 1 --json OUT
    python -m tests.fault_campaign --wire --count 200 --seed 1 --json OUT     on the real wire

A run of the real master, the real player, and the real slaves for each; then: has it ended within
its time, is the motor off or standing, is the recording readable, is a cause named, the right one?
Exit status 1 where a run hung, a rig was left moving, a recording is unreadable, a cause is
missing, or fewer than 99 % are the right ones.
"""

import argparse
import json
import logging
import math
import os
import platform
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from datetime import UTC, datetime
from functools import cache
from multiprocessing import get_context
from pathlib import Path
from types import FrameType
from typing import Any

from drivers.axis import Axis
from servo_bench.clock import NS_PER_S
from servo_bench.errors import BenchError, gathered
from servo_bench.excitation.experiment import Experiment, MSequence, RandomBinary, Schedule
from servo_bench.recording.mcap_file import RecordingWriter, load
from servo_bench.recording.provenance import provenance
from servo_bench.recording.recording import Event
from servo_bench.rig import RigConfig, load_rig
from servo_bench.run.busloop import Player
from servo_bench.run.table import UNPLAYED, SlotTable
from tests.fault_outcome import Outcome, judged, passes
from tests.fault_scenarios import GOES_ON, Scenario, scenario
from tests.virtual_line import install_lines
from tests.virtual_modbus import VirtualCounterRig, VirtualModbus
from tests.virtual_rig import WORLDS, VirtualRig, install
from tests.virtual_world import RunClock, VirtualWorld

HANG_CPU_S = 30
HANG_WALL_S = 600
"""A run waits for nothing in virtual time: only on a crowded machine does it take so long."""
HANG_WIRE_S = 60
HANG_VIRTUAL_S = 120.0
"""A hundred SDOs to a slave that takes half a second for each are no hang."""
STANDSTILL_RAD_S = 0.02
SHORT, LONG = 130, 320
"""Chips of a run that is to go on, and of one that is to end."""
PLANT = "tests.coasting_plant:coasting"
LOT = 20
AFTER_S = 2.0
"""How long after the end of the run the rig is looked at: the drive's own watchdog is 0.3 s."""


class HangError(Exception):
    """A run that did not end."""


@cache
def plan(chips: int = 320) -> Experiment:
    """Three seconds at 8 ms; long enough for the motor to travel what a stuck encoder hides."""
    return Experiment(
        name="faults",
        rig="none",
        period_s=0.008,
        memory=8,
        standstill_s=0.08,
        lead_in=16,
        identification=MSequence(polynomial="2327", amplitude_rad_s=3.0, length=chips),
        validation=RandomBinary(kind="random-binary", seed=3, amplitude_rad_s=3.0, length=16),
    )


def plan_of(it: Scenario) -> Experiment:
    """What is played: every fault begins within 0.7 s; one that must end the run gets longer."""
    return plan(SHORT if it.right == (GOES_ON,) else LONG)


@cache
def schedule(experiment: Experiment) -> Schedule:
    """Its schedule, made once."""
    return experiment.schedule()


@cache
def rig_config(name: str = "paper") -> RigConfig:
    """A rig of the library."""
    return load_rig(f"rigs/{name}.toml")


def config_of(it: Scenario) -> RigConfig:
    """The rig with the scenario's fault and seed."""
    config = rig_config(it.rig).with_faults(*it.rig_faults)
    simulated = config.simulated
    assert simulated is not None
    seeded = simulated.model_copy(update={"seed": it.seed, "plant": PLANT})
    return config.model_copy(update={"simulated": seeded})


@cache
def _provenance() -> Any:
    return provenance()


@contextmanager
def _world(it: Scenario) -> Iterator[tuple[VirtualWorld, Callable[[], Axis]]]:
    """The scenario's rig, and its master to be entered."""
    name = str(it.seed)
    if it.rig == "paper":
        world = VirtualRig(name, seed=it.seed, faults=it.rig_faults)
        yield world, world.axis
        del WORLDS[name]
    elif it.rig == "serial-counter":
        counter = VirtualCounterRig(name, config_of(it))
        yield counter, counter.axis_with_counter
        counter.close()
        del WORLDS[name]
    else:
        modbus = VirtualModbus(name, config_of(it))
        yield modbus, modbus.axis
        modbus.close()


def run_scenario(it: Scenario, folder: Path) -> Outcome:
    """Play one scenario to its end and look at what is left."""
    with _world(it) as (world, axis):
        return _run(it, folder, world, axis)


def _run(it: Scenario, folder: Path, world: VirtualWorld, open_axis: Callable[[], Axis]) -> Outcome:
    outcome = Outcome(it)
    events: list[Event] = []
    played = schedule(plan_of(it))

    def tell(kind: str, text: str, **data: Any) -> None:
        events.append(Event(world.now_ns, kind, text))
        outcome.tell(kind, text, **data)

    with SlotTable.create(played.slots) as table:
        try:
            with gathered(), open_axis() as axis:
                clock = RunClock(world, *it.stall)
                player = Player(axis, played, table, rig_config(it.rig).limits, clock)
                player.play(world.now_ns + 8_000_000, tell)
            outcome.ended(None)
        except BenchError as error:
            outcome.ended(error)
        except HangError:
            outcome.hung = True
        outcome.played = int((table.rows["slot"] != UNPLAYED).sum())
        outcome.readable = recorded(folder, it, table, events)
    outcome.stop_s = look_after(world)
    outcome.moving = world.powered or abs(world.velocity_rad_s) > STANDSTILL_RAD_S
    outcome.hung |= world.now_ns > (HANG_VIRTUAL_S + AFTER_S) * NS_PER_S
    return outcome


def look_after(world: VirtualWorld) -> float:
    """Let the rig be for a while, or until it stands for good; when the power was off, in s."""
    begun_ns = world.now_ns
    off_s = AFTER_S if world.powered else 0.0
    while world.now_ns < begun_ns + AFTER_S * NS_PER_S:
        powered = world.powered
        if not powered and world.velocity_rad_s == 0.0:
            break
        world.pass_until(world.now_ns + 10_000_000)
        if powered and not world.powered:
            off_s = (world.now_ns - begun_ns) / NS_PER_S
    return off_s


def recorded(folder: Path, it: Scenario, table: SlotTable, events: Sequence[Event]) -> bool:
    """Write what the session would have written, and read it back."""
    rows = table.rows[table.rows["slot"] != UNPLAYED].copy()
    if not rows.size:
        return True  # a run that ended before its first sample leaves no file
    out = folder / f"{os.getpid()}.mcap"
    with RecordingWriter(out, plan_of(it), rig_config(it.rig), _provenance(), 125.0) as writer:
        writer.samples(rows)
        for event in events:
            writer.event(event)
    recording = load(out)
    out.unlink()
    return len(recording) == rows.size and len(recording.events) >= len(events)


def _hang(_number: int, _frame: FrameType | None) -> None:
    raise HangError


@contextmanager
def _judging_hangs() -> Iterator[None]:
    signals = (signal.SIGALRM, signal.SIGPROF)
    before = [signal.signal(number, _hang) for number in signals]
    try:
        yield
    finally:
        signal.alarm(0)
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        for number, handler in zip(signals, before, strict=True):
            signal.signal(number, handler)


def in_virtual_time(numbers: Sequence[int], seed: int, end_s: float) -> list[Outcome]:
    """Some of a seed's scenarios, those that can be begun before `end_s` of the host's clock."""
    install()
    install_lines()
    outcomes: list[Outcome] = []
    memory = "/dev/shm" if Path("/dev/shm").is_dir() else None  # noqa: S108 - else the disk counts
    with _judging_hangs(), tempfile.TemporaryDirectory(dir=memory) as folder:
        for number in numbers:
            if time.monotonic() > end_s:
                break
            signal.alarm(HANG_WALL_S)
            signal.setitimer(signal.ITIMER_PROF, HANG_CPU_S)
            outcomes.append(run_scenario(scenario(seed, number), Path(folder)))
    return outcomes


def on_the_wire(numbers: Sequence[int], seed: int, end_s: float) -> list[Outcome]:
    """The same scenarios on the real wire, one rig of its own processes for each."""
    from tests.wire_faults import run_on_wire  # noqa: PLC0415 - it stands on this module

    logging.getLogger("can").setLevel(logging.ERROR)
    outcomes: list[Outcome] = []
    with _judging_hangs(), tempfile.TemporaryDirectory() as folder:
        for number in numbers:
            if time.monotonic() > end_s:
                break
            signal.alarm(HANG_WIRE_S)
            outcomes.append(run_on_wire(scenario(seed, number), Path(folder)))
    return outcomes


def numbers_of(options: argparse.Namespace) -> list[int]:
    """Which scenarios of the seed are asked for."""
    return [
        number
        for number in range(options.first, options.first + options.count)
        if options.only in (it := scenario(options.seed, number)).kind
        and (it.seen_from_outside or not options.wire)
    ]


def campaign(options: argparse.Namespace) -> Iterator[list[Outcome]]:
    """The scenarios' outcomes, lot after lot; none that could not be begun within the time."""
    end_s = time.monotonic() + options.within
    numbers = numbers_of(options)
    lots = [numbers[begin : begin + LOT] for begin in range(0, len(numbers), LOT)]
    play = on_the_wire if options.wire else in_virtual_time
    if options.workers == 1:
        for lot in lots:
            yield play(lot, options.seed, end_s)
        return
    with ProcessPoolExecutor(options.workers, get_context("spawn")) as pool:
        for done in [pool.submit(play, lot, options.seed, end_s) for lot in lots]:
            yield done.result()


def main(arguments: list[str] | None = None) -> int:
    """The command line; returns its exit code."""
    parser = argparse.ArgumentParser(prog="python -m tests.fault_campaign", description=__doc__)
    parser.add_argument("--count", type=int, default=10_000)
    parser.add_argument("--first", type=int, default=0, help="number of the first scenario")
    parser.add_argument("--only", default="", help="rigs and kinds whose name has this in it")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--wire", action="store_true", help="real processes and real time")
    parser.add_argument("--workers", type=int, default=1, help="processes; 1 is this one alone")
    parser.add_argument("--within", type=float, default=math.inf, help="seconds; as many as fit")
    options = parser.parse_args(arguments)
    if not numbers_of(options):
        parser.error(f"no scenario of these has {options.only!r} in its kind")
    started_s = time.monotonic()
    outcomes: list[Outcome] = []
    for lot in campaign(options):
        outcomes += lot
        figures = judged(outcomes) | _circumstances(options, time.monotonic() - started_s)
        if options.json:  # after every lot: a campaign may be stopped at any time
            options.json.write_text(json.dumps(figures, indent=1) + "\n")
    sys.stdout.write(json.dumps(figures, indent=1) + "\n")
    return 0 if passes(figures) else 1


def _circumstances(options: argparse.Namespace, wall_s: float) -> dict[str, Any]:
    return {
        "asked": options.count,
        "seed": options.seed,
        "wire": options.wire,
        "workers": options.workers,
        "date": datetime.now(UTC).date().isoformat(),
        "machine": f"{os.cpu_count()} CPUs, shared, {platform.system()}, {platform.machine()}",
        "wall_s": round(wall_s, 1),
    }


if __name__ == "__main__":
    sys.exit(main())
