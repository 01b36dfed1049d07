"""Hidden causes in a third hand's rigs: how often a diagnosis is right about them.

    python -m tests.third --seed 0 --json OUT.jsonl                one trial
    python -m tests.third --seed 0 --count 20 --json OUT.jsonl     and the next ones
    python -m tests.third --seed 7 --json OUT.jsonl --keep FOLDER  keeps recordings and verdicts

A seed draws a rig, what is hidden in it, and all noise. The diagnosis runs in another process that
is given two recordings and the rig's file; what was hidden is opened when its verdict is written. A
line a trial is added to OUT.jsonl as each ends. Exit status 1 where a trial was not right.
"""

import argparse
import json
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path

from tests.third.told import Line, run_trial


def _lines(seeds: range, jobs: int, keep: Path | None) -> Iterator[Line]:
    """The trials as they end, so many at a time: each waits for a process of its own."""
    with ThreadPoolExecutor(jobs) as pool:
        yield from (
            ended.result()
            for ended in as_completed([pool.submit(_kept, seed, keep) for seed in seeds])
        )


def _kept(seed: int, keep: Path | None) -> Line:
    if keep is None:
        return run_trial(seed)
    folder = keep / str(seed)
    folder.mkdir(parents=True)
    return run_trial(seed, folder)


def _progress(line: Line) -> str:
    names = [cause["effect"] for cause in (line["verdict"] or {"causes": ()})["causes"]]
    mark = "right" if line["score"]["right"] else "WRONG"
    hidden = ", ".join(hidden["effect"] for hidden in line["hidden"]) or "nothing"
    told = ", ".join(names) or (line["verdict"] or {"verdict": "failed"})["verdict"]
    where = f"{line['seed']} {line['kind']} on {line['rig']}"
    return f"{where}: {mark}, {hidden} was told as {told} ({line['seconds']:.0f} s)\n"


def main(arguments: list[str] | None = None) -> int:
    """The command line; returns its exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.third",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--seed", type=int, required=True, help="the first one")
    parser.add_argument("--count", type=int, default=1, help="how many seeds from there on")
    parser.add_argument("--jobs", type=int, default=2, help="trials at a time")
    parser.add_argument("--json", type=Path, required=True, help="lines are added to this file")
    parser.add_argument("--keep", type=Path, help="keep each trial's files in a folder in here")
    options = parser.parse_args(arguments)
    seeds, right = range(options.seed, options.seed + options.count), True
    with options.json.open("a", encoding="utf-8") as file:
        for line in _lines(seeds, options.jobs, options.keep):
            file.write(json.dumps(line) + "\n")
            file.flush()
            sys.stderr.write(_progress(line))
            right &= line["score"]["right"]
    return 0 if right else 1


if __name__ == "__main__":
    sys.exit(main())
