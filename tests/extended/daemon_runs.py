"""What can end a run of the daemon, tried on real processes; longer than the normal suite may be.

pytest tests/extended/daemon_runs.py
"""

import getpass
import json
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import can
import numpy as np
import pytest

from servo_bench.daemon.processes import bus_processes
from servo_bench.recording.mcap_file import load
from servo_bench.rig import RigConfig
from tests.daemon_process import (
    Daemon,
    bus_loop_of,
    kill,
    rows_of,
    runner_of,
    software_rig,
    stands,
    write_bench,
)
from tests.test_run_session import assert_standing, until_stopped

pytestmark = pytest.mark.wire


@pytest.fixture
def rig() -> Iterator[RigConfig]:
    """A software rig that the daemon does not own."""
    with software_rig() as (config, _):
        yield config


def recordings(folder: Path) -> list[Path]:
    """The recordings, the first one first."""
    return sorted((folder / "recordings").glob("*.mcap"))


def stopped_by(recording: Path) -> str:
    """Who asked for the stop, as the recording says it."""
    (stop,) = (event for event in load(recording).events if event.kind == "stop asked")
    return str(stop.data["by"])


def test_a_run_is_played_watched_recorded_and_catalogued(rig: RigConfig, tmp_path: Path) -> None:
    with Daemon(write_bench(tmp_path, rig)) as daemon:
        assert daemon.status()["held"]
        run_id = daemon.submit("short", name="first light", notes="a look")
        with daemon.live() as live:
            daemon.arm()
            frames, states = [], []
            while not states or states[-1] != "idle" or "running" not in states:
                message = live.recv(timeout=30)
                if isinstance(message, bytes):
                    frames.append(rows_of(message))
                else:
                    states.append(json.loads(message)["state"])
        (row,) = daemon.rows()
    seen = list(dict.fromkeys(states))
    assert seen == ["idle", "preparing", "running", "stopping", "analysing"][: len(seen)]
    assert (row["id"], row["state"], row["operator"]) == (run_id, "complete", "tester")
    assert row["notes"] == "a look"
    (path,) = recordings(tmp_path)
    kept = load(path)
    assert kept.provenance["run_id"] == run_id
    live_rows = np.concatenate(frames)
    # what the page showed is what was recorded: the same commands at the same times
    asked_s = (kept["asked_ns"] - kept["asked_ns"][0]) / 1e9
    at = np.searchsorted(asked_s, live_rows[:, 0] - 1e-9)
    np.testing.assert_allclose(asked_s[at], live_rows[:, 0], atol=1e-9)
    np.testing.assert_array_equal(kept["velocity_command_rad_s"][at], live_rows[:, 1])
    np.testing.assert_array_equal(kept["load_angle_rad"][at], live_rows[:, 3])
    assert len(live_rows) > 0.8 * len(kept)


def test_a_run_that_lost_its_daemon_stops_the_rig_where_it_was_told_to(
    rig: RigConfig, tmp_path: Path
) -> None:
    run = 'analyse = false\nwithout_daemon = "stop"\nwithout_daemon_s = 0.3'
    daemon = Daemon(write_bench(tmp_path, rig, run=run))
    with daemon:
        run_id = daemon.play("long")
        runner = runner_of(daemon.bench, run_id)
        daemon.kill()
        wait_for_end(runner)
        daemon.start()
        (row,) = daemon.rows()
    assert row["state"] == "stopped"
    assert_standing(rig)


def wait_for_end(pid: int) -> None:
    """Until a process that is not our child has ended."""
    subprocess.run(["tail", "--pid", str(pid), "-s", "0.05", "-f", "/dev/null"], check=False)


def test_kill_9_of_the_runner_is_seen_the_rig_stands_and_the_queue_is_held(
    rig: RigConfig, tmp_path: Path
) -> None:
    with Daemon(write_bench(tmp_path, rig)) as daemon:
        run_id = daemon.play("long")
        daemon.submit("short")
        kill(runner_of(daemon.bench, run_id))
        over = daemon.wait(stands)
        assert over["state"] == "faulted"
        assert over["held"]
        assert len(over["queue"]) == 1
        assert "was killed" in over["fault"]["sentence"]
        assert_standing(rig)
        (row,) = daemon.rows()
        assert row["state"] == "cut"
        daemon.arm()  # and it goes on
        daemon.wait(lambda status: not status["queue"] and stands(status))
        assert [row["state"] for row in daemon.rows()] == ["complete", "cut"]


def test_kill_9_of_the_bus_process_is_a_fault_and_the_drive_itself_says_that_it_stands(
    rig: RigConfig, tmp_path: Path
) -> None:
    with Daemon(write_bench(tmp_path, rig)) as daemon:
        run_id = daemon.play("long")
        kill(bus_loop_of(runner_of(daemon.bench, run_id)))
        over = daemon.wait(stands)
    assert over["state"] == "faulted"
    assert "killed by SIGKILL" in over["fault"]["sentence"]
    assert "Asked afterwards, the drive says" in over["fault"]["sentence"]
    assert_standing(rig)


def test_a_bus_process_that_hangs_is_stopped_by_its_supervisor(
    rig: RigConfig, tmp_path: Path
) -> None:
    with Daemon(write_bench(tmp_path, rig)) as daemon:
        run_id = daemon.play("long")
        kill(bus_loop_of(runner_of(daemon.bench, run_id)), signal.SIGSTOP)
        over = daemon.wait(stands)
    assert over["state"] == "faulted"
    assert "hangs" in over["fault"]["sentence"]
    assert_standing(rig)


def test_where_the_supervisor_hangs_as_well_the_daemon_sees_it_within_a_second(
    rig: RigConfig, tmp_path: Path
) -> None:
    with Daemon(write_bench(tmp_path, rig)) as daemon:
        run_id = daemon.play("long")
        hanging = bus_processes(runner_of(daemon.bench, run_id))
        assert len(hanging) == 2
        for pid in hanging:
            kill(pid, signal.SIGSTOP)
        seen = daemon.wait(lambda status: not status["bus_alive"])
        assert "silence" in seen["held_reason"]
        with can.Bus(**rig.bus) as bus:
            until_stopped(bus, rig)  # by itself: it misses its master
        for pid in hanging:
            with suppress(ProcessLookupError):
                kill(pid)
        assert daemon.wait(stands, within_s=60.0)["state"] == "faulted"
    assert_standing(rig)


def test_sigterm_stops_the_rig_first_and_leaves_a_whole_recording(
    rig: RigConfig, tmp_path: Path
) -> None:
    with Daemon(write_bench(tmp_path, rig)) as daemon:
        daemon.play("long")
        assert daemon.end() == 0
    assert stopped_by(recordings(tmp_path)[0]) == "the daemon's shutdown"
    assert not list((tmp_path / "state/runs").iterdir())
    assert_standing(rig)


def test_stop_works_from_the_command_line_with_and_without_a_daemon(
    rig: RigConfig, tmp_path: Path
) -> None:
    daemon = Daemon(write_bench(tmp_path, rig))
    command = [
        *(sys.executable, "-m", "servo_bench.cli.app", "stop"),
        *("--config", str(daemon.bench)),
    ]
    with daemon:
        daemon.play("long")
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert (done.returncode, done.stdout) == (0, ""), done.stderr
        assert "the queue is held" in done.stderr
        assert "at a terminal" in daemon.wait(stands)["held_reason"]
        run_id = daemon.play("long")
        runner = runner_of(daemon.bench, run_id)
        daemon.kill()
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        assert "1 run(s) were told" in done.stderr
        wait_for_end(runner)
        daemon.start()
    for recording in recordings(tmp_path):
        assert stopped_by(recording) == f"{getpass.getuser()} at a terminal"
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 3
    assert "emergency stop" in done.stderr


def test_a_second_daemon_and_a_second_master_are_refused_with_the_holders_name(
    rig: RigConfig, tmp_path: Path
) -> None:
    other = tmp_path / "other"
    other.mkdir()
    second = write_bench(other, rig)
    with Daemon(write_bench(tmp_path, rig)) as daemon:
        for bench in (daemon.bench, second):  # the same folder, and the same rig
            done = subprocess.run(
                [sys.executable, "-m", "servo_bench.daemon", bench],
                capture_output=True,
                text=True,
                check=False,
            )
            assert done.returncode == 9
            assert f"process {daemon.process.pid}" in done.stderr
            assert daemon.url in done.stderr


def test_a_rig_that_does_not_answer_is_a_fault_in_words(tmp_path: Path) -> None:
    with software_rig() as (config, _):
        pass  # it has gone again
    with Daemon(write_bench(tmp_path, config)) as daemon:
        daemon.submit("short")
        daemon.arm()
        over = daemon.wait(lambda status: status["fault"] is not None and stands(status))
        assert over["state"] == "faulted"
        assert str(config.bus["port"]) in over["fault"]["sentence"]
        assert daemon.client.get("/api/rig").json()["reachable"] is False
        assert daemon.rows() == []
        daemon.arm()
        assert daemon.status()["state"] == "idle"
