"""Workers end with what started them, however that ended."""

import os
import select
import signal
import subprocess
import sys
from pathlib import Path

WAIT_MS = 20_000
STARTER = """
import os, threading
from servo_bench.jobs import executor
if __name__ == "__main__":
    with executor(1) as pool:
        print(pool.submit(os.getpid).result(), flush=True)
        threading.Event().wait()
"""


def test_a_worker_whose_starter_was_killed_ends(tmp_path: Path) -> None:
    script = tmp_path / "starter.py"
    script.write_text(STARTER)
    with subprocess.Popen([sys.executable, script], stdout=subprocess.PIPE, text=True) as starter:
        assert starter.stdout is not None
        worker = os.pidfd_open(int(starter.stdout.readline()))
        starter.send_signal(signal.SIGKILL)
    waiting = select.poll()
    waiting.register(worker, select.POLLIN)
    assert waiting.poll(WAIT_MS), "the worker went on"
    os.close(worker)
