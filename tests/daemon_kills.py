"""A campaign of kill -9: each of the daemon's processes in turn, at random moments of a run.

    python -m tests.daemon_kills --count 200 --seed 1 --json docs/figures/daemon-kills.json

After each kill, and the restart of what has to be restarted, it holds:

    the rig stands        asked from the drive itself, by a stranger
    at most a second lost every slot that was seen live until a second before the kill is recorded
    the catalogue         lists every recording, with the state that it must have
    the queue             is held, and goes on when it is armed
"""

import argparse
import json
import os
import platform
import sys
import tempfile
import time
import traceback
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import can
import numpy as np

from servo_bench.recording.mcap_file import load
from servo_bench.rig import RigConfig
from tests.daemon_process import (
    Daemon,
    bus_loop_of,
    kill,
    runner_of,
    software_rig,
    stands,
    write_bench,
)
from tests.test_run_session import assert_standing, until_stopped

VICTIMS = ("web side", "runner", "bus process", "web side and runner", "all three")
STATES = {
    "web side": "stopped",
    "runner": "cut",
    "bus process": "faulted",
    "web side and runner": "cut",
    "all three": "cut",
}
PERIOD_S = 0.008
SLOTS_PER_S = round(1.0 / PERIOD_S)


def one_kill(
    daemon: Daemon, rig: RigConfig, victim: str, rng: np.random.Generator
) -> dict[str, Any]:
    """Play, kill, restart, and check; what was measured. AssertionError where something is lost."""
    folder = daemon.bench.parent / "recordings"
    before = set(folder.glob("*.mcap"))
    run_id = daemon.play("long")
    runner = runner_of(daemon.bench, run_id)
    loop = bus_loop_of(runner)
    wait_slots = int(rng.integers(0, 3 * SLOTS_PER_S))
    seen = daemon.wait(lambda status: status["run"]["slot"] >= wait_slots)["run"]["slot"]
    begun_s = time.monotonic()
    if victim == "all three":
        kill(loop)
    if victim in ("runner", "web side and runner", "all three"):
        kill(runner)
    if victim == "bus process":
        kill(loop)
    if victim not in ("runner", "bus process"):
        daemon.kill()
        daemon.start()
    if victim == "web side":
        daemon.client.post("/api/stop", json={"operator": "campaign"}).raise_for_status()
    over = daemon.wait(stands, within_s=60.0)
    took_s = time.monotonic() - begun_s
    assert over["held"], over
    with can.Bus(**rig.bus) as bus:
        until_stopped(bus, rig)
    assert_standing(rig)
    (path,) = set(folder.glob("*.mcap")) - before
    kept = load(path, allow_cut=True)
    last = int(kept["slot"].max(initial=-1))  # none: it was killed in its first half second
    assert last >= seen - SLOTS_PER_S, (seen, last)
    rows = {row["id"]: row for row in daemon.rows_all()}
    assert rows[run_id]["state"] == STATES[victim], rows[run_id]
    assert len(rows) == len(before) + 1
    gaps = int((np.diff(kept["slot"]) - 1).sum())
    return {
        "victim": victim,
        "slot_seen": seen,
        "slot_kept": last,
        "gaps": gaps,
        "stands_after_s": round(took_s, 2),
    }


def campaign(count: int, seed: int) -> dict[str, Any]:
    """So many kills, each victim in turn; figures of them all.

    What does not hold is told with the figures, and the campaign ends with it: the rig is then no
    longer in the state from which the next kill begins.
    """
    rng = np.random.default_rng(seed)
    done: list[dict[str, Any]] = []
    with (
        tempfile.TemporaryDirectory() as name,
        software_rig() as (rig, _),
        Daemon(write_bench(Path(name), rig)) as daemon,
    ):
        for number in range(count):
            try:
                done.append(one_kill(daemon, rig, VICTIMS[number % len(VICTIMS)], rng))
            except Exception:  # noqa: BLE001 - whatever it is, it is told with the figures
                failed = f"{VICTIMS[number % len(VICTIMS)]}: {traceback.format_exc()}"
                return figures(done, seed, failed)
            sys.stdout.write(f"{number + 1}/{count} {json.dumps(done[-1])}\n")
            sys.stdout.flush()
    return figures(done, seed)


def figures(done: list[dict[str, Any]], seed: int, failed: str = "") -> dict[str, Any]:
    """What a campaign found, and where it was made."""
    return {
        "date": datetime.now(UTC).date().isoformat(),
        "machine": f"{os.cpu_count()} CPUs, shared, {platform.system()}, {platform.machine()}",
        "seed": seed,
        "kills": len(done),
        "failed": failed,
        "victims": {
            victim: _of([kill for kill in done if kill["victim"] == victim]) for victim in VICTIMS
        },
    }


def _of(kills: list[dict[str, Any]]) -> dict[str, Any]:
    lost_s = [max(0, kill["slot_seen"] - kill["slot_kept"]) * PERIOD_S for kill in kills]
    after_s = [kill["stands_after_s"] for kill in kills]
    return {
        "kills": len(kills),
        "largest_loss_s": round(max(lost_s, default=0.0), 3),
        "slots_missing_before_the_end": sum(kill["gaps"] for kill in kills),
        "over_after_s": {
            "median": float(np.median(after_s)) if after_s else None,
            "worst": max(after_s, default=None),
        },
    }


def main() -> int:
    """Read the options and run; 1 where something did not hold."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    found = campaign(options.count, options.seed)
    text = json.dumps(found, indent=1) + "\n"
    if options.json:
        options.json.write_text(text)
    sys.stdout.write(text)
    sys.stdout.write(found["failed"])
    return 1 if found["failed"] else 0


if __name__ == "__main__":
    sys.exit(main())
