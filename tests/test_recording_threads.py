"""Recordings read by several threads at once, as the daemon does for its pages."""

import subprocess
import sys
from pathlib import Path

RECORDING = Path(__file__).parent.parent / "recordings" / "nominal.mcap"
PROGRAM = """
import sys
from concurrent.futures import ThreadPoolExecutor
from servo_bench.recording.mcap_file import load

def total(_):
    return float(load(sys.argv[1])["velocity_command_rad_s"].sum())

with ThreadPoolExecutor(4) as pool:
    found = set(pool.map(total, range(40)))
print(len(found))
"""


def test_threads_that_read_at_once_all_read_the_same() -> None:
    """A decompressor's memory is one thread's: shared, it ended the whole process by SIGSEGV."""
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM, RECORDING], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout) == (0, "1\n"), done.stderr[-1000:]
