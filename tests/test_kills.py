"""The whole bench dies, or the way to the drive, with the motor at speed: the drive stops itself.

Other deaths are in `test_run_session` and `test_modbus_wire`; `python -m tests.kill_campaign` plays
all of them, many times.
"""

import os
import shutil
import signal
from pathlib import Path

import pytest

from servo_bench.errors import WireError
from servo_bench.recording.mcap_file import load
from servo_bench.rig import load_rig
from servo_bench.run.session import run
from sim_rig.process import spawn
from tests.kill_campaign import CASES, RIGS, SPEED_RAD_S, bound_s, children, die
from tests.test_run_session import assert_standing, experiment, stop_after

pytestmark = pytest.mark.wire


@pytest.mark.parametrize("death", ["bench", "network"])
def test_the_drive_stops_by_itself_when_nobody_is_left_to_tell_it(
    tmp_path: Path, death: str
) -> None:
    if death == "network" and shutil.which("socat") is None:
        pytest.skip("no socat here: it carries the bytes between bench and rig")
    told = die("canopen", death, tmp_path)
    assert told.speed_rad_s > SPEED_RAD_S / 2, "it was at speed when it happened"
    assert told.last.stands, told
    # the drive was not asked to: it stood no sooner than its own time-out allows
    assert told.stopped_s > 0.1, told


def kill_supervisor() -> None:
    """Kill -9 the supervisor of the run that this process plays."""
    for child in children(os.getpid()):
        if b"servo_bench.run.busloop" in Path(f"/proc/{child}/cmdline").read_bytes():
            for supervisor in children(child):
                os.kill(supervisor, signal.SIGKILL)


def test_a_loop_whose_supervisor_has_died_stops_the_rig(tmp_path: Path) -> None:
    rig = load_rig("rigs/paper.toml").on_a_free_port()
    with spawn(rig.simulation_settings()) as started:
        rig = rig.with_bus(**started.bus)
        kill = stop_after(60, kill_supervisor)
        with pytest.raises(WireError, match="supervisor has not looked"):
            run(experiment(30.0), rig, tmp_path / "run.mcap", progress=kill)
        assert_standing(rig)
    assert len(load(tmp_path / "run.mcap")) > 60


def test_every_death_has_a_bound_that_its_configuration_gives() -> None:
    for protocol, death in CASES:
        rig = load_rig(RIGS[protocol])
        assert bound_s(rig, "loop") < bound_s(rig, "hung") < bound_s(rig, "bench") < 1.0
        assert bound_s(rig, death) <= bound_s(rig, "bench")
