"""The true model fitted to the same data: the diagnosis with the true causes forced, once open.

    python -m tests.trials.fitted_truth seen.mcap holdout.mcap rig.toml OUT.json EFFECT [EFFECT ...]

Writes a verdict like any other; its error after is what no diagnosis could better by much.
"""

import json
import sys
from pathlib import Path

from servo_bench.diagnosis.diagnose import diagnose
from servo_bench.recording.mcap_file import load
from servo_bench.rig import load_rig


def main(seen: str, held_out: str, rig: str, out: str, *effects: str) -> None:
    """Fit these effects and nothing else."""
    verdict = diagnose(
        [load(seen)], model=load_rig(rig).model(), held_out=load(held_out), only=effects
    )
    Path(out).write_text(json.dumps(verdict.numbers()))


if __name__ == "__main__":
    main(*sys.argv[1:])
