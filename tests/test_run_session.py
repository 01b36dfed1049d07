"""Whole runs on the software rig, over real frames between processes; ends of every kind."""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from itertools import chain, repeat
from pathlib import Path

import can
import numpy as np
import pytest

from servo_bench.clock import monotonic_ns
from servo_bench.errors import BenchError, ConfigError, DriveError, LimitError, WireError
from servo_bench.excitation.experiment import Experiment, MSequence, Phase, RandomBinary
from servo_bench.recording.mcap_file import load
from servo_bench.rig import RigConfig, load_rig
from servo_bench.run.session import Status, run
from sim_rig.process import spawn

pytestmark = pytest.mark.wire
STATUSWORD_MASK, OPERATION_ENABLED = 0x6F, 0x27


def experiment(seconds: float = 2.0, amplitude_rad_s: float = 2.0) -> Experiment:
    return Experiment(
        name="short",
        rig="rigs/paper.toml",
        period_s=0.008,
        memory=8,
        standstill_s=0.2,
        lead_in=16,
        identification=MSequence(
            polynomial="2327", amplitude_rad_s=amplitude_rad_s, length=round(seconds / 0.008)
        ),
        validation=RandomBinary(
            kind="random-binary", seed=2, amplitude_rad_s=amplitude_rad_s, length=32
        ),
    )


@pytest.fixture
def rig() -> Iterator[RigConfig]:
    """A software rig of its own on a free port."""
    yield from started()


@pytest.fixture(scope="module")
def untouched_rig() -> Iterator[RigConfig]:
    """One for all who are refused before the drive is asked for anything that lasts."""
    yield from started()


def started() -> Iterator[RigConfig]:
    config = load_rig("rigs/paper.toml").on_a_free_port()
    with spawn(config.simulation_settings()) as running:
        yield config.with_bus(**running.bus)


def assert_standing(rig: RigConfig) -> None:
    """Ask the drive itself, as a stranger would: not enabled, and its encoder stands still."""
    with can.Bus(**rig.bus) as bus:
        word = sdo_read(bus, rig.drive.node_id, 0x6041)
        assert word & STATUSWORD_MASK != OPERATION_ENABLED, hex(word)
        first = sdo_read(bus, rig.drive.node_id, 0x6064)
        assert sdo_read(bus, rig.drive.node_id, 0x6064) == first


def sdo_read(bus: can.BusABC, node_id: int, index: int) -> int:
    """One expedited upload, by hand (CiA 301)."""
    request = bytes([0x40, index & 0xFF, index >> 8, 0, 0, 0, 0, 0])
    bus.send(can.Message(arbitration_id=0x600 + node_id, data=request, is_extended_id=False))
    until_ns = monotonic_ns() + 2_000_000_000
    while monotonic_ns() < until_ns:
        answer = bus.recv(0.5)
        if answer is None or answer.arbitration_id != 0x580 + node_id:
            continue
        if answer.data[1:4] == request[1:4]:  # else it answers the bench, which is leaving
            assert answer.data[0] & 0xE0 == 0x40, answer
            return int.from_bytes(answer.data[4:], "little")
    raise AssertionError(f"no SDO answer from node {node_id}")


def stop_after(slots: int, act: Callable[[], object]) -> Callable[[Status], None]:
    """A progress callback that acts once, when the run has got that far."""
    done: list[object] = []

    def progress(status: Status) -> None:
        if status.slot >= slots and not done:
            done.append(act())

    return progress


def test_a_run_records_what_it_played_and_leaves_the_rig_standing(
    rig: RigConfig, tmp_path: Path
) -> None:
    plan = experiment()
    summary = run(plan, rig, tmp_path / "run.mcap")
    recording = load(tmp_path / "run.mcap")
    schedule = plan.schedule()
    assert summary.played + summary.missed == summary.slots == schedule.slots
    assert len(recording) == summary.played
    slots = recording["slot"]
    np.testing.assert_array_equal(
        recording["velocity_command_rad_s"], schedule.velocity_rad_s[slots]
    )
    np.testing.assert_array_equal(recording["chip"], schedule.chip[slots])
    np.testing.assert_array_equal(recording["phase"], schedule.phase[slots])
    assert recording.experiment == plan
    assert recording.rig == rig
    # the motor goes where the commands lead it, but for what the loop lags and overshoots
    lasted_s = np.diff(recording["asked_ns"]) * 1e-9
    led_rad = np.concatenate(
        ([0.0], np.cumsum(recording["velocity_command_rad_s"][:-1] * lasted_s))
    )
    followed_rad = recording["motor_position_rad"] - recording["motor_position_rad"][0]
    assert np.ptp(led_rad) > 0.1
    # 2 V / wn, and what commands that the rig took late add, each by its own lateness
    late_s = np.abs(lasted_s - plan.period_s).sum()
    assert np.abs(followed_rad - led_rad).max() < 2.0 * 2.0 / 62.5 + 2 * 2.0 * late_s
    # two frames on one bus do not come at the same instant
    assert (recording["encoder_latency_s"] != recording["drive_latency_s"]).all()
    still = recording["load_angle_rad"][recording["phase"] == Phase.STANDSTILL]
    assert np.ptp(still[np.isfinite(still)]) == 0.0
    assert_standing(rig)


def test_a_stop_that_the_operator_asks_leaves_a_readable_recording(
    rig: RigConfig, tmp_path: Path
) -> None:
    asked: list[bool] = []
    names = chain(["", ""], repeat("Ada (smoke)"))  # a name that comes later than the stop
    summary = run(
        experiment(30.0),
        rig,
        tmp_path / "run.mcap",
        progress=stop_after(80, lambda: asked.append(True)),
        stop=lambda: bool(asked),
        stopped_by=lambda: next(names),
    )
    assert summary.stopped_early
    recording = load(tmp_path / "run.mcap")
    assert 80 <= len(recording) < 30.0 / 0.008
    (stop,) = (event for event in recording.events if event.kind == "stop asked")
    assert (stop.text, stop.data) == ("by Ada (smoke)", {"by": "Ada (smoke)"})
    assert_standing(rig)


def start_program(rig: RigConfig, folder: Path, out: Path) -> "subprocess.Popen[str]":
    """`servo-bench run` as a process of its own; returns when the drive has been enabled."""
    plan = experiment(60.0)
    job = folder / "job.json"
    job.write_text(
        json.dumps({"experiment": plan.model_dump(mode="json"), "rig": rig.model_dump(mode="json")})
    )
    process = subprocess.Popen(
        [sys.executable, "-m", "tests.played_run", job, out], stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert process.stdout.readline().startswith("playing"), "the run never began"
    return process


@pytest.mark.parametrize(
    ("number", "named"),
    [
        (signal.SIGINT, "(Ctrl-C)"),
        pytest.param(signal.SIGTERM, "(SIGTERM)", marks=pytest.mark.long),
    ],
)
def test_a_signal_stops_the_rig_and_leaves_a_readable_recording(
    rig: RigConfig, tmp_path: Path, number: signal.Signals, named: str
) -> None:
    out = tmp_path / "run.mcap"
    with start_program(rig, tmp_path, out) as process:
        process.send_signal(number)
        assert process.wait(15) == 0
    recording = load(out)
    assert len(recording) > 50
    (stop,) = (event.text for event in recording.events if event.kind == "stop asked")
    assert stop.endswith(named)
    assert_standing(rig)


def test_kill_9_of_the_bench_stops_the_rig_and_loses_at_most_a_second(
    rig: RigConfig, tmp_path: Path
) -> None:
    out = tmp_path / "run.mcap"
    with start_program(rig, tmp_path, out) as process:
        assert process.stdout is not None
        for line in process.stdout:
            slot = int(line.split()[1])
            if slot > 300:
                break
        process.kill()
        process.wait()
    with can.Bus(**rig.bus) as bus:
        until_stopped(bus, rig)
    kept = load(out, allow_cut=True)
    assert kept.cut
    assert kept["slot"].max() >= slot - 125
    assert_standing(rig)


def until_stopped(bus: can.BusABC, rig: RigConfig, within_s: float = 3.0) -> None:
    """Wait until the drive itself says that it is no longer enabled."""
    until_ns = monotonic_ns() + round(within_s * 1e9)
    while sdo_read(bus, rig.drive.node_id, 0x6041) & STATUSWORD_MASK in (OPERATION_ENABLED, 0x07):
        assert monotonic_ns() < until_ns, f"the drive was still moving after {within_s} s"


def signal_bus_process(number: signal.Signals) -> None:
    """Signal the bus loop of the run that this process plays."""
    children = Path(f"/proc/self/task/{os.getpid()}/children").read_text().split()
    for child in children:
        if b"servo_bench.run.busloop" in Path(f"/proc/{child}/cmdline").read_bytes():
            os.kill(int(child), number)


def test_kill_9_of_the_bus_process_is_named_and_its_supervisor_stops_the_drive(
    rig: RigConfig, tmp_path: Path
) -> None:
    kill = stop_after(200, lambda: signal_bus_process(signal.SIGKILL))
    with pytest.raises(WireError, match=r"killed by SIGKILL.*supervisor: stopped and disabled"):
        run(experiment(30.0), rig, tmp_path / "run.mcap", progress=kill)
    assert load(tmp_path / "run.mcap")["slot"].max() >= 200 - 125  # a second at most is lost
    assert_standing(rig)


def test_a_bus_process_that_hangs_is_ended_by_its_supervisor(
    rig: RigConfig, tmp_path: Path
) -> None:
    patient = rig.drive.model_copy(update={"heartbeat_timeout_s": 30.0})  # it will not do it
    hang = stop_after(80, lambda: signal_bus_process(signal.SIGSTOP))
    with pytest.raises(WireError, match=r"begun no slot for .*supervisor: stopped and disabled"):
        run(
            experiment(30.0),
            rig.model_copy(update={"drive": patient}),
            tmp_path / "run.mcap",
            progress=hang,
        )
    recording = load(tmp_path / "run.mcap")
    assert len(recording) >= 80
    kinds = [event.kind for event in recording.events]
    assert kinds.index("trip") < kinds.index("supervisor's stop") < kinds.index("error")
    assert_standing(rig)


def test_a_stop_before_the_first_slot_leaves_no_file(rig: RigConfig, tmp_path: Path) -> None:
    summary = run(experiment(), rig, tmp_path / "run.mcap", stop=lambda: True)
    assert (summary.played, summary.stopped_early) == (0, True)
    assert list(tmp_path.iterdir()) == []
    assert_standing(rig)


def test_a_bus_process_whose_session_has_died_before_it_began_does_nothing() -> None:
    loop = [sys.executable, "-m", "servo_bench.run.busloop", str(os.getpid() + 1)]
    ended = subprocess.run(loop, input="a job", capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stdout, ended.stderr) == (1, "", "")


def test_leaving_a_limit_stops_the_rig_and_keeps_the_recording(
    rig: RigConfig, tmp_path: Path
) -> None:
    limits = rig.limits.model_copy(update={"velocity_rad_s": 2.05})
    tight = rig.model_copy(update={"limits": limits})  # the loop's overshoot goes beyond
    with pytest.raises(LimitError, match="velocity reached"):
        run(experiment(), tight, tmp_path / "run.mcap")
    kept = load(tmp_path / "run.mcap")
    assert "error" in [event.kind for event in kept.events]
    assert_standing(rig)


REFUSALS: list[tuple[type[BenchError], str, dict[str, dict[str, object]]]] = [
    (WireError, r"drive 5 does not answer", {"drive": {"node_id": 5}}),
    (WireError, r"encoder 9 does not answer", {"encoder": {"node_id": 9}}),
    (DriveError, r"product", {"drive": {"product_code": 7}}),
    (ConfigError, r"no file eds/none.eds", {"drive": {"eds": "eds/none.eds"}}),
    (LimitError, r"Nothing was enabled", {"limits": {"velocity_rad_s": 0.1}}),
    (WireError, r"127.0.0.1", {"bus": {"port": 9}}),
]


@pytest.mark.long
def test_no_module_out_of_the_working_folder_gets_into_the_bus_process(
    rig: RigConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "can.py").write_text("raise SystemExit('a stranger')")
    assert run(experiment(0.2), rig, tmp_path / "run.mcap").played > 0


@pytest.mark.parametrize(("error", "words", "change"), REFUSALS, ids=[row[1] for row in REFUSALS])
def test_what_cannot_be_played_is_refused_and_leaves_no_file(
    untouched_rig: RigConfig,
    tmp_path: Path,
    error: type[BenchError],
    words: str,
    change: dict[str, dict[str, object]],
) -> None:
    table = untouched_rig.model_dump(mode="json")
    for name, keys in change.items():
        table[name] |= keys
    with pytest.raises(error, match=words):
        run(experiment(), RigConfig.model_validate(table), tmp_path / "run.mcap")
    assert list(tmp_path.iterdir()) == []
    assert_standing(untouched_rig)


def test_a_period_that_the_drive_refuses_is_said_with_both_numbers(
    untouched_rig: RigConfig, tmp_path: Path
) -> None:
    slow = experiment().model_copy(update={"period_s": 0.2})
    with pytest.raises((DriveError, ConfigError), match=r"0x60C2|period"):
        run(slow, untouched_rig, tmp_path / "run.mcap")
    assert_standing(untouched_rig)


def test_kernels_that_the_sequence_cannot_give_are_refused_before_the_run(
    rig: RigConfig, tmp_path: Path
) -> None:
    long = experiment().model_copy(update={"memory": 16})
    with pytest.raises(ConfigError, match="memory = 16"):
        run(long, rig, tmp_path / "run.mcap")
    assert_standing(rig)


def test_an_existing_output_is_never_written_over(rig: RigConfig, tmp_path: Path) -> None:
    out = tmp_path / "run.mcap"
    out.write_text("mine")
    with pytest.raises(BenchError, match="exists"):
        run(experiment(), rig, out)
    assert out.read_text() == "mine"
