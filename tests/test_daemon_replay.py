"""A recording on the page of a real daemon, and what systemd hears of that daemon meanwhile."""

import os
import socket
from collections.abc import Iterator
from pathlib import Path
from queue import SimpleQueue
from threading import Thread

import numpy as np
import pytest
from typer.testing import CliRunner

from servo_bench.cli import app as cli
from servo_bench.run.virtual import save
from tests.daemon_process import PATIENCE_S, Daemon, rows_of, write_bench
from tests.small_runs import small_run

WATCHDOG_S = 0.3


@pytest.fixture
def systemd(monkeypatch: pytest.MonkeyPatch) -> Iterator[SimpleQueue[str]]:
    """What systemd hears, which it reads as it comes; its watchdog is over what is started."""
    name = f"servo-bench-test-{os.getpid()}"
    monkeypatch.setenv("NOTIFY_SOCKET", f"@{name}")
    monkeypatch.setenv("WATCHDOG_USEC", str(round(WATCHDOG_S * 1e6)))
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as listening:
        listening.bind(f"\0{name}")
        said: SimpleQueue[str] = SimpleQueue()

        def read() -> None:
            while text := listening.recv(4096).decode():
                for line in text.splitlines():
                    said.put(line)

        reader = Thread(target=read)
        reader.start()
        yield said
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as ending:
            ending.sendto(b"", f"\0{name}")
        reader.join()


def hear(systemd: SimpleQueue[str], wanted: str) -> list[str]:
    """What is said up to that state, that included; queue.Empty where it never comes."""
    heard: list[str] = []
    while wanted not in heard:
        heard.append(systemd.get(timeout=PATIENCE_S))
    return heard


def test_a_recording_plays_on_the_page_of_a_daemon_that_systemd_watches(
    tmp_path: Path, systemd: SimpleQueue[str]
) -> None:
    bench, path = write_bench(tmp_path), tmp_path / "recordings" / "then.mcap"
    path.parent.mkdir()
    save(small_run(1), path)
    with Daemon(bench) as daemon:
        assert hear(systemd, "READY=1") == ["READY=1"], "nothing is said before it is ready"
        assert f"{daemon.url}" in hear(systemd, "WATCHDOG=1")[0]
        assert hear(systemd, "WATCHDOG=1") == ["WATCHDOG=1"]
        with daemon.live() as page:
            words = ["replay", path, "--to", daemon.url, "--speed", "20"]
            done = CliRunner().invoke(cli.app, list(map(str, words)))
            assert done.exit_code == 0, done.output
            assert "20 times its time" in done.output
            shown = np.empty((0, 6))
            last_s = (small_run(1)["slot"][-1] - small_run(1)["slot"][0]) * small_run(1).period_s
            while not shown.size or shown[-1, 0] < last_s:
                message = page.recv(timeout=PATIENCE_S)
                if isinstance(message, bytes):
                    shown = np.vstack([shown, rows_of(message)])
        assert daemon.rows()[0]["state"] == "complete"
        status = daemon.end()
    assert status == 0
    assert set(hear(systemd, "STOPPING=1")[:-1]) <= {"WATCHDOG=1"}
    # the samples are those of the recording, at its times, in its order
    run = small_run(1)
    at = np.rint(shown[:, 0] / run.period_s).astype(int)
    assert (np.diff(at) > 0).all()
    assert at.size > 100
    np.testing.assert_allclose(shown[:, 0], at * run.period_s, atol=1e-9)
    np.testing.assert_array_equal(shown[:, 1], run["velocity_command_rad_s"][at])
    np.testing.assert_array_equal(shown[:, 3], run["load_angle_rad"][at])
