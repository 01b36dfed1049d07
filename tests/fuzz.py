"""A great many cases of what the test command plays ten thousand of: see `tests.fuzz_targets`.

    python -m tests.fuzz --count 1000000 --seed 1 --json OUT

Ends with status 1 where anything but an error of our own tree came out; the smallest case that does
it is printed.
"""

import argparse
import json
import math
import os
import platform
import sys
import time
import traceback
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from hypothesis import HealthCheck, Phase, given, seed, settings

from tests.fuzz_targets import OURS, TARGETS, Target, examples

LOT = 2000
"""Cases of one target in one go: hypothesis remembers them all."""


@dataclass(slots=True)
class Tally:
    """What became of one target's cases."""

    cases: int = 0
    refused: int = 0
    seconds: float = 0.0
    fault: str = ""


def play_lot(target: Target, count: int, number: int, tally: Tally) -> None:
    """So many cases from a seed; a fault is kept in words, with its smallest case."""

    @seed(number)
    @settings(
        max_examples=count,
        deadline=None,
        database=None,
        phases=[Phase.generate, Phase.shrink],
        suppress_health_check=list(HealthCheck),
        print_blob=False,
    )
    @given(target.cases)
    def play(case: Any) -> None:
        tally.cases += 1
        try:
            target.play(case)
        except OURS:
            tally.refused += 1

    began_s = time.process_time()
    try:
        play()
    except Exception as error:  # noqa: BLE001 - that is what is looked for
        notes = "\n".join(getattr(error, "__notes__", ()))
        tally.fault = f"{''.join(traceback.format_exception(error)[-4:])}{notes}"
    tally.seconds += time.process_time() - began_s


def campaign(
    count: int, number: int, within_s: float, only: str = ""
) -> Iterator[dict[str, Tally]]:
    """The targets in turn, a lot of each, so that what fits into the time is spread over all."""
    end_s = time.monotonic() + within_s
    tallies = {name: Tally() for name in TARGETS if only in name}
    goals = {name: examples(TARGETS[name], count) for name in tallies}
    lots = max(math.ceil(goal / LOT) for goal in goals.values())
    for lot in range(lots):
        for place, (name, tally) in enumerate(tallies.items()):
            wanted = goals[name] * (lot + 1) // lots - tally.cases
            if wanted > 0 and not tally.fault and time.monotonic() < end_s:
                play_lot(TARGETS[name], wanted, (number * 1000 + lot) * 100 + place, tally)
        yield tallies


def figures_of(
    tallies: dict[str, Tally], options: argparse.Namespace, wall_s: float
) -> dict[str, Any]:
    """What has come of it so far."""
    return {
        "cases": sum(tally.cases for tally in tallies.values()),
        "asked": options.count,
        "faults": sum(bool(tally.fault) for tally in tallies.values()),
        "seed": options.seed,
        "date": datetime.now(UTC).date().isoformat(),
        "machine": f"{os.cpu_count()} CPUs, shared, {platform.system()}, {platform.machine()}",
        "wall_s": round(wall_s, 1),
        "cpu_s": round(sum(tally.seconds for tally in tallies.values()), 1),
        "targets": {
            name: {"cases": it.cases, "refused": it.refused, "cpu_s": round(it.seconds, 1)}
            for name, it in tallies.items()
        },
    }


def main(arguments: list[str] | None = None) -> int:
    """The command line; returns its exit code."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__)
    parser.add_argument("--count", type=int, default=1_000_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--only", default="", help="targets whose name has this in it")
    parser.add_argument("--within", type=float, default=math.inf, help="seconds; as many as fit")
    options = parser.parse_args(arguments)
    began_s = time.monotonic()
    for tallies in campaign(options.count, options.seed, options.within, options.only):
        figures = figures_of(tallies, options, time.monotonic() - began_s)
        if options.json:  # after every lot: hours of it may be stopped at any time
            options.json.write_text(json.dumps(figures, indent=1) + "\n")
    faults = [f"{name}:\n{tally.fault}" for name, tally in tallies.items() if tally.fault]
    sys.stdout.write("\n\n".join([json.dumps(figures, indent=1), *faults]) + "\n")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
