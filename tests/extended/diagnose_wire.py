"""A rig that is what its file says, over every wire that it can hang on: the diagnosis says so.

A drive on a serial line has its command later than it was asked, a counter of its own is read
beside it, and answers are lost: the rows tell, and nothing else may be seen in the error.
"""

from pathlib import Path

import pytest

from servo_bench.diagnosis.diagnose import diagnose
from servo_bench.excitation.experiment import Experiment
from servo_bench.excitation.sequences import FieldSequence, RandomUniform
from servo_bench.recording.mcap_file import load
from servo_bench.rig import Limits, load_rig
from servo_bench.run.session import run
from sim_rig.process import spawn

pytestmark = pytest.mark.wire
FACTS = {"source": "a test", "command": "servo-bench run"}
PLAYED = Experiment(
    name="beside",
    rig="rig.toml",
    period_s=0.008,
    memory=16,
    standstill_s=1.0,
    lead_in=64,
    identification=FieldSequence(
        kind="field", field=5, degree=4, amplitude_rad_s=4.0, periods=2, bias_rad_s=0.6
    ),
    validation=RandomUniform(
        kind="random-uniform", seed=3, amplitude_rad_s=3.0, length=600, bias_rad_s=-0.6
    ),
)


@pytest.mark.parametrize(
    ("wire", "floors"), [("modbus-rtu", 3.0), ("modbus-tcp", 3.0), ("serial-counter", 20.0)]
)
def test_a_rig_that_is_what_its_file_says_has_no_cause_over(
    wire: str, floors: float, tmp_path: Path
) -> None:
    """The software counter reads when its process is let: some tenths of a millisecond apart."""
    limits = Limits(velocity_rad_s=20.0, travel_rad=400.0, run_time_s=60.0)
    rig = load_rig(f"rigs/{wire}.toml").on_a_free_port().model_copy(update={"limits": limits})
    path = tmp_path / "run.mcap"
    with spawn(rig.simulation_settings()) as started:
        run(PLAYED, rig.with_bus(**started.bus), path, facts=FACTS)
    verdict = diagnose([load(path)])
    assert (verdict.verdict, verdict.causes) == ("none", ()), verdict.sentence
    assert verdict.error is not None
    assert verdict.error.after < floors * verdict.error.noise_floor
