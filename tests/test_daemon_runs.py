"""One run through the daemon over real processes and a real wire, its web side killed meanwhile."""

from pathlib import Path

import numpy as np
import pytest

from servo_bench.recording.mcap_file import load
from tests.daemon_process import Daemon, rows_of, software_rig, stands, write_bench
from tests.test_run_session import assert_standing

pytestmark = pytest.mark.wire


def test_a_run_is_watched_found_again_after_a_crash_recorded_and_catalogued(
    tmp_path: Path,
) -> None:
    with software_rig() as (rig, _):
        bench = write_bench(tmp_path, rig, seconds={"short": 3.0, "long": 60.0})
        with Daemon(bench) as daemon:
            assert daemon.status()["held"]
            run_id = daemon.play("short", name="first light", notes="a look")
            waiting = daemon.submit("long", operator="second")
            with daemon.live() as live:
                frame = b""
                while not frame:
                    message = live.recv(timeout=30)
                    frame = message if isinstance(message, bytes) else b""
            daemon.kill()
            daemon.start()
            found = daemon.status()
            assert found["run"] is None or found["run"]["id"] == run_id
            assert found["held"]
            over = daemon.wait(stands)
            assert [entry["id"] for entry in over["queue"]] == [waiting]
            (row,) = daemon.rows()
        assert_standing(rig)
    assert (row["id"], row["state"], row["operator"]) == (run_id, "complete", "tester")
    assert row["notes"] == "a look"
    (path,) = (tmp_path / "recordings").glob("*.mcap")
    kept = load(path)
    assert kept.experiment is not None
    assert len(kept) + row["missed"] == kept.experiment.schedule().slots
    assert kept.provenance["run_id"] == run_id
    # what the page showed is what was recorded: the same commands at the same times
    shown = rows_of(frame)
    asked_s = (kept["asked_ns"] - kept["asked_ns"][0]) / 1e9
    at = np.searchsorted(asked_s, shown[:, 0] - 1e-9)
    np.testing.assert_allclose(asked_s[at], shown[:, 0], atol=1e-9)
    np.testing.assert_array_equal(kept["velocity_command_rad_s"][at], shown[:, 1])
    np.testing.assert_array_equal(kept["load_angle_rad"][at], shown[:, 3])
