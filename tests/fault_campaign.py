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
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from types import FrameType
from typing import Any

from servo_bench.clock import NS_PER_S
from servo_bench.errors import BenchError, gathered
from servo_bench.excitation.experiment import Experiment, MSequence, RandomBinary
from servo_bench.recording.mcap_file import RecordingWriter, load
from servo_bench.recording.provenance import provenance
from servo_bench.recording.recording import Event
from servo_bench.rig import RigConfig, load_rig
from servo_bench.run.busloop import Player
from servo_bench.run.table import UNPLAYED, SlotTable
from tests.fault_scenarios import GOES_ON, Scenario, scenario
from tests.virtual_rig import WORLDS, RunClock, VirtualRig, install

RIGHT_SHARE = 0.99
HANG_CPU_S = 30
HANG_WALL_S = 600
"""A run waits for nothing in virtual time: only on a crowded machine does it take so long."""
HANG_VIRTUAL_S = 120.0
"""A hundred SDOs to a slave that takes half a second for each are no hang."""
STANDSTILL_RAD_S = 0.02
AFTER_S = 2.0
"""How long after the end of the run the rig is looked at: the drive's own watchdog is 0.3 s."""


class HangError(Exception):
    """A run that did not end."""


@dataclass(slots=True)
class Outcome:
    """What became of one scenario."""

    scenario: Scenario
    cause: str = ""
    text: str = ""
    told: list[str] = field(default_factory=list)
    hung: bool = False
    moving: bool = False
    readable: bool = True
    played: int = 0
    stop_s: float = 0.0

    @property
    def named(self) -> bool:
        """Whether the bench said anything of what happened, where something was to be seen."""
        if self.scenario.right == (GOES_ON,):
            return not self.scenario.names or bool(self.told) or self.cause != GOES_ON
        return self.cause != GOES_ON and bool(self.text)

    @property
    def right(self) -> bool:
        """Whether it said the right thing."""
        if self.cause not in self.scenario.right:
            return False
        if self.cause == GOES_ON:
            return not self.scenario.names or self.scenario.names in self.told
        return self.scenario.names in self.text


@cache
def plan() -> Experiment:
    """Three seconds at 8 ms; long enough for the motor to travel what a stuck encoder hides."""
    return _plan(320)


@cache
def short_plan() -> Experiment:
    """A second and a half at 8 ms, for the wire."""
    return _plan(150)


def _plan(length: int) -> Experiment:
    return Experiment(
        name="faults",
        rig="none",
        period_s=0.008,
        memory=8,
        standstill_s=0.08,
        lead_in=16,
        identification=MSequence(polynomial="2327", amplitude_rad_s=3.0, length=length),
        validation=RandomBinary(kind="random-binary", seed=3, amplitude_rad_s=3.0, length=16),
    )


@cache
def rig_config() -> RigConfig:
    """The paper's rig."""
    return load_rig("rigs/paper.toml")


@cache
def _provenance() -> Any:
    return provenance()


@cache
def _schedule() -> Any:
    return plan().schedule()


def run_scenario(it: Scenario, folder: Path) -> Outcome:
    """Play one scenario to its end and look at what is left."""
    outcome = Outcome(it)
    world = VirtualRig(str(it.seed), seed=it.seed, faults=(it.fault,))
    events: list[Event] = []
    fatal: list[tuple[str, str]] = []

    def tell(kind: str, text: str, **data: Any) -> None:
        events.append(Event(world.now_ns, kind, text))
        outcome.told.append(kind)
        if data.get("fatal"):
            fatal.append((kind, text))

    with SlotTable.create(_schedule().slots) as table:
        try:
            with gathered(), world.axis() as axis:
                player = Player(axis, _schedule(), table, rig_config().limits, RunClock(world))
                player.play(world.now_ns + 8_000_000, tell)
            outcome.cause, outcome.text = GOES_ON, ""
        except BenchError as error:
            name = type(error).__name__
            notes = " ".join([str(error), *getattr(error, "__notes__", ())])
            outcome.cause, outcome.text = fatal[0] if fatal else (name, notes)
        except HangError:
            outcome.hung = True
        outcome.played = int((table.rows["slot"] != UNPLAYED).sum())
        outcome.readable = _recorded(folder, table, events)
    outcome.stop_s = _look_after(world)
    outcome.moving = world.powered or abs(world.velocity_rad_s) > STANDSTILL_RAD_S
    outcome.hung |= world.now_ns > (HANG_VIRTUAL_S + AFTER_S) * NS_PER_S
    del WORLDS[world.name]
    return outcome


def _look_after(world: VirtualRig) -> float:
    """Let the rig be for a while; when the power was off, in seconds after the run's end."""
    begun_ns = world.now_ns
    off_s = AFTER_S if world.powered else 0.0
    while world.now_ns < begun_ns + AFTER_S * NS_PER_S:
        powered = world.powered
        world.pass_until(world.now_ns + 10_000_000)
        if powered and not world.powered:
            off_s = (world.now_ns - begun_ns) / NS_PER_S
    return off_s


def _recorded(folder: Path, table: SlotTable, events: Sequence[Event]) -> bool:
    """Write what the session would have written, and read it back."""
    rows = table.rows[table.rows["slot"] != UNPLAYED].copy()
    if not rows.size:
        return True  # a run that ended before its first sample leaves no file
    out = folder / "run.mcap"
    with RecordingWriter(out, plan(), rig_config(), _provenance(), 125.0) as writer:
        writer.samples(rows)
        for event in events:
            writer.event(event)
    recording = load(out)
    out.unlink()
    return len(recording) == rows.size and len(recording.events) >= len(events)


def wire_campaign(count: int, seed: int, within_s: float = math.inf) -> list[Outcome]:
    """The same scenarios on the real wire, one rig of its own processes for each."""
    from tests.wire_faults import run_on_wire  # noqa: PLC0415 - it stands on this module

    logging.getLogger("can").setLevel(logging.ERROR)
    end_s = time.monotonic() + within_s
    return [
        run_on_wire(scenario(seed, number), _schedule())
        for number in range(count)
        if time.monotonic() <= end_s
    ]


def _hang(_number: int, _frame: FrameType | None) -> None:
    raise HangError


def campaign(count: int, seed: int, within_s: float = math.inf) -> list[Outcome]:
    """Run the scenarios 0 to `count` of a seed, or as many as can be begun within that time."""
    install()
    outcomes: list[Outcome] = []
    end_s = time.monotonic() + within_s
    signals = (signal.SIGALRM, signal.SIGPROF)
    before = [signal.signal(number, _hang) for number in signals]
    try:
        with tempfile.TemporaryDirectory() as folder:
            for number in range(count):
                if time.monotonic() > end_s:
                    break
                signal.alarm(HANG_WALL_S)
                signal.setitimer(signal.ITIMER_PROF, HANG_CPU_S)
                outcomes.append(run_scenario(scenario(seed, number), Path(folder)))
    finally:
        signal.alarm(0)
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        for number, handler in zip(signals, before, strict=True):
            signal.signal(number, handler)
    return outcomes


def judged(outcomes: Sequence[Outcome]) -> dict[str, Any]:
    """The figures of a campaign."""
    total = len(outcomes)
    kinds: dict[str, Counter[str]] = {}
    for outcome in outcomes:
        counts = kinds.setdefault(outcome.scenario.kind, Counter())
        counts["runs"] += 1
        counts["right"] += outcome.right
        counts["goes on"] += outcome.cause == GOES_ON
    return {
        "scenarios": total,
        "hung": sum(outcome.hung for outcome in outcomes),
        "left_moving": sum(outcome.moving for outcome in outcomes),
        "unreadable": sum(not outcome.readable for outcome in outcomes),
        "unnamed": sum(not outcome.named for outcome in outcomes),
        "right": sum(outcome.right for outcome in outcomes),
        "right_share": sum(outcome.right for outcome in outcomes) / total,
        "worst_stop_s": max(outcome.stop_s for outcome in outcomes),
        "kinds": {kind: dict(counts) for kind, counts in sorted(kinds.items())},
        "wrong": [asdict(outcome) for outcome in outcomes if not outcome.right][:50],
    }


def passes(figures: dict[str, Any]) -> bool:
    """Whether a campaign is as it must be."""
    flaws = ("hung", "left_moving", "unreadable", "unnamed")
    return not any(figures[flaw] for flaw in flaws) and figures["right_share"] >= RIGHT_SHARE


def main(arguments: list[str] | None = None) -> int:
    """The command line; returns its exit code."""
    parser = argparse.ArgumentParser(prog="python -m tests.fault_campaign", description=__doc__)
    parser.add_argument("--count", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--wire", action="store_true", help="real processes and real time")
    parser.add_argument("--within", type=float, default=math.inf, help="seconds; as many as fit")
    options = parser.parse_args(arguments)
    started_s = time.monotonic()
    play = wire_campaign if options.wire else campaign
    figures = judged(play(options.count, options.seed, options.within))
    figures["seed"] = options.seed
    figures["wire"] = options.wire
    figures["date"] = datetime.now(UTC).date().isoformat()
    figures["machine"] = f"{os.cpu_count()} CPUs, shared, {platform.system()}, {platform.machine()}"
    figures["wall_s"] = round(time.monotonic() - started_s, 1)
    text = json.dumps(figures, indent=1)
    if options.json:
        options.json.write_text(text + "\n")
    sys.stdout.write(text + "\n")
    return 0 if passes(figures) else 1


if __name__ == "__main__":
    sys.exit(main())
