"""Many hidden-effect trials: how often the diagnosis is right, and whether it knows how often.

    python -m tests.campaign --json OUT.json --seeds 10 --nulls 300 --outside 150 --pairs 30
    python -m tests.campaign --json OUT.json --multiple 2 --multiple 4 --multiple 8 --seeds 10
    python -m tests.campaign --json OUT.json --wide ...       in rigs and runs unlike the others'
    python -m tests.campaign --json OUT.json --resume ...          goes on where it was killed
    python -m tests.campaign --json OUT.json --scheduler tcp://HOST:8786 ...     on a Dask cluster

Beside OUT.json it writes OUT.jsonl, a line a trial, as each ends; OUT.json has the figures of all
lines, and OUT.png a picture of them. A trial is killed and counted as failed after 15 minutes.
A cluster's workers are started in this folder (`tests` must be importable there).
"""

import argparse
import json
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, Future, as_completed
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, get_args

from servo_bench.errors import ConfigError
from servo_bench.jobs import executor
from servo_bench.recording.provenance import provenance
from tests.trial import run_trial
from tests.trials.answering import DIAGNOSE
from tests.trials.asking import ASKED, Campaign
from tests.trials.drawing import PERIOD_S, SECONDS, Question
from tests.trials.figures import Line, figures
from tests.trials.lines import Lines
from tests.trials.names import Channels
from tests.trials.picture import draw
from tests.trials.seeds import JUDGING_FROM

AHEAD = 64
"""Trials that wait in the executor: enough for every worker, and few to cancel."""


def run(
    questions: Sequence[Question],
    pool: Executor,
    lines: Lines,
    *,
    command: Sequence[str] = DIAGNOSE,
    forced: bool = False,
    tell: Callable[[Line, int, int], None] = lambda _line, _done, _of: None,
) -> None:
    """Ask what has no line yet; each line is on the disk before the next is waited for.

    A trial whose own machinery fails (no memory, no disk) raises: it is no answer.
    """
    answered = lines.answered()
    waiting = [question for question in questions if question not in answered]
    total, done = len(waiting), 0
    running: set[Future[Line]] = set()
    while waiting or running:
        while waiting and len(running) < AHEAD:
            question = waiting.pop(0)
            running.add(pool.submit(run_trial, question, command=tuple(command), forced=forced))
        ended = next(as_completed(running))
        running.remove(ended)
        line, done = ended.result(), done + 1
        lines.append(line)
        tell(line, done, total)


def summary(lines: Sequence[Line], campaign: dict[str, Any]) -> dict[str, Any]:
    """The campaign's JSON: what was asked, when and by what, and the figures."""
    facts = provenance()
    versions = {key: facts[key] for key in ("servo_bench", "python", "numpy", "machine")}
    date = datetime.now(UTC).date().isoformat()
    return {"date": date, "versions": versions, "campaign": campaign, **figures(lines)}


def _progress(line: Line, done: int, total: int) -> None:
    question, score = Question(**line["question"]), line["score"]
    mark = "right" if score["right"] else f"WRONG: {score['top']}"
    sys.stderr.write(f"{done}/{total} {question.label}: {mark} ({line['wall_s']:.0f} s)\n")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m tests.campaign",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--json", type=Path, required=True, help="figures; .jsonl, .png beside it")
    parser.add_argument("--effects", help="names of tests.truth.catalogue, with commas")
    parser.add_argument("--seeds", type=int, default=10, help="trials of each effect and size")
    parser.add_argument("--multiple", type=float, action="append", default=[])
    parser.add_argument("--nulls", type=int, default=0)
    parser.add_argument("--outside", type=int, default=0)
    parser.add_argument("--pairs", type=int, default=0)
    parser.add_argument("--removed", type=int, default=0)
    parser.add_argument("--channels", choices=get_args(Channels), action="append")
    parser.add_argument("--first-seed", type=int, default=JUDGING_FROM)
    parser.add_argument("--seconds", type=float, default=SECONDS)
    parser.add_argument("--period-s", type=float, default=PERIOD_S)
    parser.add_argument("--measured", action="store_true", help="handed over as imported CSV")
    parser.add_argument("--wide", action="store_true", help="in rigs and runs unlike the others'")
    parser.add_argument("--forced", action="store_true", help="fit the true causes too: two fits")
    parser.add_argument("--jobs", type=int, help="processes (default: one a core)")
    parser.add_argument("--scheduler", help="tcp://HOST:PORT of a Dask scheduler")
    parser.add_argument("--resume", action="store_true", help="go on with OUT.jsonl")
    return parser


def main(arguments: list[str] | None = None) -> int:
    """The command line; returns its exit code."""
    parser = _parser()
    options = parser.parse_args(arguments)
    asked = Campaign(
        effects=options.effects.split(",") if options.effects else ASKED,
        seeds=options.seeds,
        multiples=options.multiple,
        nulls=options.nulls,
        outside=options.outside,
        pairs=options.pairs,
        removed=options.removed,
        channels=options.channels or ["all"],
        first_seed=options.first_seed,
        seconds=options.seconds,
        period_s=options.period_s,
        measured=options.measured,
        wide=options.wide,
    )
    out, began_s = options.json, time.monotonic()
    try:
        questions = asked.questions()
        file = Lines(out.with_suffix(".jsonl"), resume=options.resume)
        with file as lines, executor(options.jobs, options.scheduler) as pool:
            run(questions, pool, lines, forced=options.forced, tell=_progress)
    except ConfigError as error:
        parser.error(str(error))
    how = {
        name: value
        for name, value in vars(options).items()
        if name not in {"json", "resume", "jobs", "scheduler"}
    }
    found = summary(lines.lines, {**how, "wall_s": round(time.monotonic() - began_s, 1)})
    out.write_text(json.dumps(found, indent=1) + "\n")
    draw(found, out.with_suffix(".png"))
    return 0


if __name__ == "__main__":
    sys.exit(main())
