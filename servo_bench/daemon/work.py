"""One piece of work on recordings, as a process: its last line of output says how it ended.

    python -m servo_bench.daemon.work analyse CPUS RECORDING     figures and report beside it
    python -m servo_bench.daemon.work diagnose CPUS RECORDING    verdict and its page beside it
    python -m servo_bench.daemon.work compare CPUS BEFORE AFTER  what has changed, as JSON

The lines before the last say what is being done.

CPUS are the CPUs that it may use, with commas. It is as nice as can be.
"""

import json
import os
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from servo_bench.catalogue.beside import beside, make_way_for_figures, replace, replace_json
from servo_bench.diagnosis.concluding import conclude
from servo_bench.errors import BenchError
from servo_bench.kernels.analysis import Analysis
from servo_bench.kernels.analysis import analyse as analyse_recording
from servo_bench.recording.mcap_file import load
from servo_bench.replay.compare import compare as compare_recordings
from servo_bench.report.diagnosis_page import diagnosis_report
from servo_bench.report.html import analysis_report
from servo_bench.report.wording import percent

NICENESS = 19


def analyse(path: Path) -> str:
    """Write report and figures beside a recording; the main figure in a sentence."""
    make_way_for_figures(path)
    recording = load(path, allow_cut=True)
    analysis = analyse_recording(recording)
    places = beside(path)
    report = analysis_report(analysis, recording).encode()
    replace_json(places.figures, {**analysis.numbers(), **_curves(analysis)})
    replace(places.report, report)  # last: without figures beside it, it would be somebody else's
    validation = analysis.validation
    fresh = validation.velocity.vaf_order3_percent if validation else None
    return f"kernels to order 3 predict {percent(fresh)} of the held-out velocity."


def _curves(analysis: Analysis) -> dict[str, Any]:
    """The kernels' coefficients, rad/s per chip: orders 1, shape (M,), and 2, shape (M, M)."""
    kernels = analysis.kernels
    return {
        "lags_s": kernels.lags_s.tolist(),
        "c1_rad_s": kernels.c1.tolist(),
        "c2_rad_s": kernels.c2.tolist(),
    }


def compare(before: Path, after: Path) -> str:
    """Figures and sentences of the comparison, one line of JSON."""
    comparison = compare_recordings(load(before, allow_cut=True), load(after, allow_cut=True))
    table = {**comparison.numbers(), "sentences": comparison.sentences()}
    return json.dumps(table, allow_nan=False)


def diagnose(path: Path) -> str:
    """Write the verdict and its page beside a recording; the verdict in a sentence.

    What is believed of the rig is what the recording itself states.
    """
    recording = load(path, allow_cut=True)
    found = conclude([recording], report=_say)
    verdict = found.verdict
    places = beside(path)
    replace(places.diagnosis_page, diagnosis_report(*found, recording).encode())
    replace_json(places.diagnosis, verdict.numbers())  # last: who finds it finds its page
    return f"{verdict.verdict}: {verdict.sentence}"


WORK: Mapping[str, Callable[..., str]] = {
    "analyse": analyse,
    "diagnose": diagnose,
    "compare": compare,
}


def _say(words: str) -> None:
    sys.stdout.write(" ".join(words.split()) + "\n")
    sys.stdout.flush()


def main(kind: str, cpus: str, *recordings: str) -> int:
    """Do the work and say its sentence; 0 done, 1 with the reason where it cannot be done."""
    os.setpriority(os.PRIO_PROCESS, 0, NICENESS)  # whatever the daemon's own is
    os.sched_setaffinity(0, {int(cpu) for cpu in cpus.split(",")})
    paths = [Path(recording) for recording in recordings]
    try:
        sentence = WORK[kind](*paths)
    except BenchError as error:
        _say(str(error).replace(f"{paths[0].parent}/", ""))
        return 1
    _say(sentence)
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
