"""Makes the reference recordings anew: runs over the wire, then the cut file and the manifest.

    python -m tests.make_recordings nominal
    python -m tests.make_recordings hidden-effect
    python -m tests.make_recordings cut

The hidden effect is a backlash gap that the recording's own rig file does not name, played by the
independent plant of tests/truth.
"""

import sys
from pathlib import Path

from servo_bench.excitation.experiment import load_experiment
from servo_bench.rig import RigConfig, load_rig
from servo_bench.run.session import run
from sim_rig.process import spawn

FOLDER = Path(__file__).parent.parent / "recordings"
HIDDEN_GAP_RAD = 0.0345575  # 1.98 degrees where the rig file says 1.5
CUT_AT = 0.6


def record(name: str, truth: RigConfig) -> None:
    """Play the demo experiment on a software rig that is `truth`; the file says nominal."""
    plan = load_experiment("experiments/demo.toml")
    nominal = load_rig(plan.rig).model_copy(update={"simulated": None})
    with spawn(truth.simulation_settings()) as started:
        run(plan, nominal.with_bus(**started.bus), FOLDER / name)


def main(which: str) -> None:
    """Make one of the three."""
    rig = load_rig("rigs/paper.toml").on_a_free_port()
    if rig.simulated is None:
        raise ValueError("the paper's rig has a [simulated] table")
    if which == "nominal":
        record("nominal.mcap", rig)
    elif which == "hidden-effect":
        hidden = {"plant": "tests.truth.toy_plant:make", "backlash_gap_rad": HIDDEN_GAP_RAD}
        truth = rig.model_copy(update={"simulated": rig.simulated.model_copy(update=hidden)})
        record("hidden-effect.mcap", truth)
    elif which == "cut":
        whole = (FOLDER / "nominal.mcap").read_bytes()
        (FOLDER / "cut.mcap").write_bytes(whole[: round(len(whole) * CUT_AT)])
    else:
        raise SystemExit(f"{which}: choose nominal, hidden-effect, or cut")


if __name__ == "__main__":
    main(sys.argv[1])
