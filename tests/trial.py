"""One hidden-effect trial: something is hidden in another hand's axis, and must be named.

    python -m tests.trial --seed 7                          one effect
    python -m tests.trial --seed 7 --kind none|outside|pair|removed
    python -m tests.trial --seed 7 --wide                   in a rig and a run unlike the others'
    python -m tests.trial --seed 7 --effect cogging --multiple 4
    python -m tests.trial --seed 7 --channels load          command and load encoder alone
    python -m tests.trial --seed 7 --wire                   recorded by the bench over a real wire
    python -m tests.trial --seed 7 --wire --bus serial-counter     or modbus-rtu, modbus-tcp
    python -m tests.trial --seed 7 --measured               imported from CSV, without phases

The seed draws effect, size, rig, noise, and excitation. The diagnosis runs in another process,
which is given two recordings and the nominal rig; its verdict is written; then the seal is opened
and the verdict scored. Exit status 1 where it is not right.

Seeds below 2000 are for development, those from 900000 on for campaigns.
"""

import argparse
import json
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any, get_args

from servo_bench.errors import ConfigError
from tests.trials.answering import DIAGNOSE, Answer, Seal, ask, fit_the_truth, write
from tests.trials.drawing import PERIOD_S, SECONDS, Bus, Kind, Question
from tests.trials.handing import hand_over
from tests.trials.names import Channels
from tests.trials.scoring import hidden_numbers, own_effect, score

Line = dict[str, Any]


def run_trial(
    question: Question,
    folder: Path | None = None,
    *,
    command: Sequence[str] = DIAGNOSE,
    forced: bool = False,
) -> Line:
    """Hide, record, diagnose, write the answer, open the seal, score; the trial's line.

    `folder` keeps recordings, verdict, and answer; else they are gone afterwards. With `forced`,
    the true causes are fitted too, once the seal is open.
    """
    if folder is None:
        with tempfile.TemporaryDirectory() as temporary:
            return run_trial(question, Path(temporary), command=command, forced=forced)
    handed_folder = folder / "handed"
    handed_folder.mkdir(parents=True)
    sealed = question.sealed()
    seal, handed = Seal(sealed), hand_over(question, sealed, handed_folder)
    answer = ask(handed, without=question.without(sealed), command=command)
    write(answer, folder / "answer.json")
    truth = seal.open(folder / "answer.json")
    of_truth = None
    if forced and question.kind in {"one", "pair"} and answer.verdict is not None:
        of_truth = fit_the_truth(handed, own_effect(truth))
    return {
        "question": question.numbers(),
        "hidden": hidden_numbers(question, truth),
        "score": score(question, truth, answer.verdict, of_truth).numbers(),
        **_cost(answer),
    }


def _cost(answer: Answer) -> Line:
    return {
        "failure": answer.failure,
        "wall_s": round(answer.wall_s, 3),
        "cpu_s": round(answer.cpu_s, 3),
        "peak_bytes": answer.peak_bytes,
        "verdict_sha256": answer.sha256,
    }


def main(arguments: list[str] | None = None) -> int:
    """The command line; returns its exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.trial",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--kind", choices=get_args(Kind), default="one")
    parser.add_argument("--effect", help="a name of tests.truth.catalogue")
    parser.add_argument("--multiple", type=float, help="of the limit in limits.json")
    parser.add_argument("--channels", choices=get_args(Channels), default="all")
    parser.add_argument("--seconds", type=float, default=SECONDS)
    parser.add_argument("--period-s", type=float, default=PERIOD_S)
    parser.add_argument("--wire", action="store_true")
    parser.add_argument("--bus", choices=get_args(Bus), default="canopen")
    parser.add_argument("--measured", action="store_true", help="handed over as imported CSV")
    parser.add_argument("--wide", action="store_true", help="in a rig and a run unlike the others'")
    parser.add_argument("--forced", action="store_true", help="fit the true causes too, afterwards")
    parser.add_argument("--json", type=Path, help="write the trial's line to this file")
    parser.add_argument("--keep", type=Path, help="keep recordings and verdict in this new folder")
    options = vars(parser.parse_args(arguments))
    out, keep, forced = (options.pop(name) for name in ("json", "keep", "forced"))
    try:
        line = run_trial(Question(**options), keep, forced=forced)
    except ConfigError as error:
        parser.error(str(error))
    text = json.dumps(line, indent=1)
    if out is not None:
        out.write_text(text + "\n")
    sys.stdout.write(text + "\n")
    return 0 if line["score"]["right"] else 1


if __name__ == "__main__":
    sys.exit(main())
