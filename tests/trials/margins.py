"""How far beyond its own limit each hidden cause was, and how many were named from where on.

    python -m tests.trials.margins OUT.jsonl         after a campaign; writes OUT-margins.json

A campaign hides causes at the sizes that rigs have. Those of limits.json are medians of three rigs;
here the limit is that of the trial itself, its rig, its run, and its phases, from the truth alone,
as `measuring` says. The margin is sqrt(evidence/lambda): the size over its limit, where a cause is
linear in it; that of a limit is how far out what it cuts off stands; `UNSTABLE` where the loop is.
"""

import argparse
import json
import math
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tests.trials.drawing import Question, question_from
from tests.trials.figures import share
from tests.trials.measuring import bench_of, change_of, margin, nuisance_changes
from tests.truth.catalogue import BY_NAME

MULTIPLES = (1.0, 2.0, 4.0, 8.0)
"""Of its own limit, from which on causes are counted."""
UNSTABLE = 1e9


def margin_of(question: Question) -> float:
    """Of a trial that hides one cause, whose verdict is written."""
    where, truth = bench_of(question), question.sealed().open()
    hiding = BY_NAME[truth.drawn[0].name]
    change = change_of(where, hiding, truth)
    return margin(where, hiding, question.channels, nuisance_changes(where), change)


def counted(trials: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """The share that was named, of those that are so many times their own limit."""
    return {
        f"{multiple:g}": share(t["right"] for t in trials if t["margin"] >= multiple)
        for multiple in MULTIPLES
    }


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure the margins of a campaign's single causes."""
    parser = argparse.ArgumentParser(prog="python -m tests.trials.margins")
    parser.add_argument("lines", type=Path, help="a campaign's OUT.jsonl")
    path: Path = parser.parse_args(arguments).lines
    lines = [json.loads(text) for text in path.read_text().splitlines()]
    trials = []
    for line in (line for line in lines if line["question"]["kind"] == "one"):
        question = question_from(line["question"])
        far = margin_of(question)
        trials.append(
            {
                "seed": question.seed,
                "cause": line["hidden"]["causes"][0],
                "margin": float(f"{far:.4g}") if math.isfinite(far) else UNSTABLE,
                "right": line["score"]["right"],
            }
        )
        sys.stderr.write(f"{trials[-1]}\n")
    out = path.with_name(f"{path.stem}-margins.json")
    out.write_text(json.dumps({"named_from": counted(trials), "trials": trials}, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
