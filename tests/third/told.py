"""A trial from its seed to its line: recorded, diagnosed in another process, opened, scored.

    right     null: "none"; outside: "unknown"; else every hidden cause is named and nothing else is

A cause counts as named where a verdict gives its name or says that it cannot tell its own from it
(`ambiguous_with`). Sizes are beside that: each parameter, what it should be, whether it is within
the trial's tolerance.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from tests.third.asked import Trial, asked
from tests.third.commands import runs
from tests.third.recorded import record, write
from tests.third.rigs import rig_toml

DIAGNOSE = (sys.executable, "-c", "from servo_bench.cli.app import main; main()", "diagnose")
ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MPLBACKEND": "agg"}
TIMEOUT_S = 1800.0
LAST_WORDS = 600
RECORDED_NS, BETWEEN_NS = 1_795_700_000_000_000_000, 90_000_000_000
"""UTC of the first recording (2026-11-26), and how much later the second one is made."""

Line = dict[str, Any]


class Score(NamedTuple):
    """What a verdict is worth: hidden causes that it missed, names of what is not there, sizes."""

    right: bool
    missed: tuple[str, ...]
    spurious: tuple[str, ...]
    sizes: tuple[Line, ...]
    sizes_right: bool


def hand_over(trial: Trial, folder: Path) -> None:
    """Write id.mcap, holdout.mcap and rig.toml: all that a diagnosis gets to see."""
    (folder / "rig.toml").write_text(rig_toml(trial.rig), encoding="utf-8")
    zero_rad, world = None, trial.world
    for k, (name, experiment) in enumerate(zip(("id", "holdout"), runs(trial.rig), strict=True)):
        start = trial.starts[k]._replace(zero_rad=zero_rad)
        take = record(trial.rig, world, experiment, trial.take_seeds[k], start)
        zero_rad, utc_ns = take.zero_rad, RECORDED_NS + k * BETWEEN_NS
        write(folder / f"{name}.mcap", trial.rig, experiment, take.rows, utc_ns)


def diagnose(folder: Path) -> tuple[Line | None, str]:
    """The verdict of `servo-bench diagnose` on what was handed over; None and why without one."""
    arguments = ("id.mcap", "--holdout", "holdout.mcap", "--rig", "rig.toml")
    try:
        done = subprocess.run(
            [*DIAGNOSE, *arguments, "--json", "verdict.json"],
            cwd=folder,
            env={**os.environ, **ONE_THREAD},
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=TIMEOUT_S,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return None, f"not done within {TIMEOUT_S:g} s"
    if done.returncode != 0:
        return None, f"exit code {done.returncode}: {(done.stdout + done.stderr)[-LAST_WORDS:]}"
    return json.loads((folder / "verdict.json").read_text(encoding="utf-8")), ""


def score(trial: Trial, verdict: Mapping[str, Any] | None) -> Score:
    """Judge a verdict by what was hidden; None, a failed diagnosis, is wrong."""
    causes = [] if verdict is None else verdict["causes"]
    classes = [{cause["effect"], *cause["ambiguous_with"]} for cause in causes]
    wanted = {expected.effect for expected in trial.expected}
    missed = tuple(sorted(wanted - set().union(*classes)))
    spurious = tuple(
        cause["effect"]
        for cause, names in zip(causes, classes, strict=True)
        if wanted.isdisjoint(names)
    )
    sizes = tuple(_sizes(trial, causes))
    right_verdict = {"null": "none", "outside": "unknown"}.get(trial.kind, "named")
    return Score(
        right=verdict is not None
        and verdict["verdict"] == right_verdict
        and not (missed or spurious),
        missed=missed,
        spurious=spurious,
        sizes=sizes,
        sizes_right=all(size["within"] for size in sizes),
    )


def _sizes(trial: Trial, causes: list[Line]) -> list[Line]:
    """Of each hidden cause that was named as itself: its size as told, and as it is."""
    found = []
    for expected in trial.expected:
        for cause in causes:
            if cause["effect"] == expected.effect and expected.parameter in cause["parameters"]:
                told = cause["parameters"][expected.parameter]["value"]
                within = abs(told - expected.value) <= expected.tolerance
                found.append({**expected._asdict(), "told": told, "within": within})
    return found


def run_trial(seed: int, folder: Path | None = None) -> Line:
    """The trial of a seed, as a line for JSON; `folder`, an empty one, keeps its files."""
    if folder is None:
        with tempfile.TemporaryDirectory() as temporary:
            return run_trial(seed, Path(temporary))
    hand_over(asked(seed), folder)
    began_s = time.monotonic()
    verdict, failure = diagnose(folder)
    seconds = time.monotonic() - began_s
    trial = asked(seed)  # only now: nothing that was hidden has been looked at before
    return {
        "seed": seed,
        "kind": trial.kind,
        "rig": trial.rig.name,
        "hidden": [hidden._asdict() for hidden in trial.hidden],
        "score": score(trial, verdict)._asdict(),
        "verdict": _shortened(verdict),
        "failure": failure,
        "seconds": round(seconds, 1),
    }


def _shortened(verdict: Mapping[str, Any] | None) -> Line | None:
    """What a line keeps of a verdict."""
    if verdict is None:
        return None
    kept = ("verdict", "sentence", "causes", "error", "undecided", "notes")
    return {key: verdict[key] for key in kept}
