"""The diagnosis, in a process of its own that is given files and nothing else.

It runs in the folder with the files, and what it writes is the answer: a verdict, or a failure in
words. Then the answer is written down, and only a written answer opens the seal.
"""

import hashlib
import json
import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from servo_bench.diagnosis.judging.verdict import Verdict
from tests.trials.handing import Handed
from tests.truth.hidden import HiddenTruth, Sealed

DIAGNOSE = (sys.executable, "-c", "from servo_bench.cli.app import main; main()", "diagnose")
"""`servo-bench diagnose`, by the Python that runs the trial."""
FIT_TRUTH = (sys.executable, "-m", "tests.trials.fitted_truth")
ROOT = Path(__file__).parent.parent.parent

TIMEOUT_S = 900.0
ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "MPLBACKEND": "agg"}
LAST_WORDS = 600
LOOK_EVERY_S = 0.1
KIB = 1024


class SealError(Exception):
    """Somebody wanted to see the truth before the answer was written."""


@dataclass(frozen=True, slots=True)
class Answer:
    """What came of a diagnosis: `verdict`, or `failure` in words; time and largest memory."""

    verdict: Verdict | None
    failure: str
    wall_s: float
    cpu_s: float
    peak_bytes: int
    sha256: str

    def numbers(self) -> dict[str, Any]:
        """For JSON."""
        verdict = None if self.verdict is None else self.verdict.numbers()
        figures = {k: v for k, v in _shallow(self).items() if k != "verdict"}
        return {**figures, "verdict": verdict}


def _shallow(answer: Answer) -> dict[str, Any]:
    return {name: getattr(answer, name) for name in Answer.__dataclass_fields__}


class Seal:
    """Opens for a written answer."""

    __slots__ = ("__sealed",)

    def __init__(self, sealed: Sealed) -> None:
        self.__sealed = sealed

    def open(self, written: Path) -> HiddenTruth:
        """The truth; SealError where the answer is not in its file yet."""
        try:
            answer = json.loads(written.read_text())
        except (OSError, ValueError) as error:
            raise SealError(
                f"{written} holds no answer ({error}): the seal opens after the verdict is written"
            ) from error
        if not isinstance(answer, dict) or not {"verdict", "failure"} <= set(answer):
            raise SealError(f"{written} holds no answer: it has neither a verdict nor a failure")
        return self.__sealed.open()


def ask(
    handed: Handed,
    *,
    without: Sequence[str] = (),
    command: Sequence[str] = DIAGNOSE,
    timeout_s: float = TIMEOUT_S,
) -> Answer:
    """Diagnose the files by another process, in their folder; every failure is an answer too."""
    folder = handed.seen.parent
    out = folder / "verdict.json"
    arguments = [handed.seen.name, "--holdout", handed.held_out.name, "--rig", handed.rig.name]
    arguments += ["--json", out.name]
    for effect in without:
        arguments += ["--without", effect]
    ended = _run([*command, *arguments], folder, timeout_s)
    text = out.read_bytes() if out.is_file() else b""
    verdict, failure = None, ended.failure
    if not failure:
        try:
            verdict = Verdict.model_validate_json(text)
        except ValidationError as error:
            failure = f"no valid verdict was written: {error}"
    return Answer(
        verdict,
        failure[-LAST_WORDS:],
        ended.wall_s,
        ended.cpu_s,
        ended.peak_bytes,
        hashlib.sha256(text).hexdigest(),
    )


def fit_the_truth(handed: Handed, effects: Sequence[str]) -> float | None:
    """The held-out error of the true model fitted to the same data; None where that failed."""
    folder = handed.seen.parent
    out = folder / "truth.json"
    files = [handed.seen.name, handed.held_out.name, handed.rig.name, out.name]
    with_tests = {"PYTHONPATH": str(ROOT)}
    ended = _run([*FIT_TRUTH, *files, *effects], folder, TIMEOUT_S, with_tests)
    if ended.failure:
        return None
    error = Verdict.model_validate_json(out.read_bytes()).error
    return None if error is None else error.after


@dataclass(frozen=True, slots=True)
class _Ended:
    failure: str
    wall_s: float
    cpu_s: float
    peak_bytes: int


def _run(
    command: Sequence[str],
    folder: Path,
    timeout_s: float,
    environment: Mapping[str, str] = ONE_THREAD,
) -> _Ended:
    """Run to the end or to the time limit; its own time and memory, not its siblings'.

    Memory is the process's own high-water mark, looked at every tenth of a second: what wait4 says
    includes the parent, whose memory a child shares until it has become another program.
    """
    began_s = time.monotonic()
    with (folder / "output.txt").open("wb") as output:
        process = subprocess.Popen(
            command,
            cwd=folder,
            env={**os.environ, **ONE_THREAD, **environment},
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        in_time, peak_bytes = _wait(process.pid, timeout_s)
        if not in_time:
            os.killpg(process.pid, signal.SIGKILL)
        _, status, used = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    said = (folder / "output.txt").read_text(errors="replace").strip()
    failure = ""
    if not in_time:
        failure = f"not done within {timeout_s:g} s, and killed. {said}"
    elif process.returncode != 0:
        failure = f"exit code {process.returncode}: {said}"
    wall_s = time.monotonic() - began_s
    return _Ended(failure, wall_s, used.ru_utime + used.ru_stime, peak_bytes)


def _wait(pid: int, timeout_s: float) -> tuple[bool, int]:
    """Whether the process ended in time, and its peak memory; it is left to be waited for."""
    deadline_s, peak_bytes = time.monotonic() + timeout_s, 0
    descriptor = os.pidfd_open(pid)
    try:
        while time.monotonic() < deadline_s:
            ended, _, _ = select.select([descriptor], [], [], LOOK_EVERY_S)
            peak_bytes = max(peak_bytes, _high_water_bytes(pid))
            if ended:
                return True, peak_bytes
    finally:
        os.close(descriptor)
    return False, peak_bytes


def _high_water_bytes(pid: int) -> int:
    """VmHWM; zero for a process that has ended."""
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return next((int(line.split()[1]) * KIB for line in lines if line.startswith("VmHWM")), 0)


def write(answer: Answer, path: Path) -> None:
    """Write the answer down, and make sure that it stays."""
    with path.open("x") as file:
        file.write(json.dumps(answer.numbers(), indent=1) + "\n")
        file.flush()
        os.fsync(file.fileno())
