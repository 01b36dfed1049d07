"""A bystander on the bus: takes down when SYNCs and answers passed, by the bus's own stamps.

    python -m servo_bench.benchmark.listener     (bus and number of SYNCs as JSON on stdin)

A process of its own, so that it sees what any third party would. It ends by itself after the
given number of SYNCs, or when they have ended, and prints one JSON object.
"""

import json
import logging
import math
import sys
import time

import can
import numpy as np

SYNC = 0x80
ANSWERS = {kind + node for kind in (0x180, 0x280, 0x380, 0x480) for node in range(1, 128)}
PATIENCE_S = 10.0
SILENCE_S = 2.0
"""No SYNC for so long: the run is over, with fewer of them than were planned."""


def listen(bus_options: dict[str, str | int | float | bool], syncs: int) -> dict[str, list[float]]:
    """SYNC times and, per COB-ID, the first answer's time after each SYNC; seconds of bus time."""
    sync_s: list[float] = []
    answers_s: dict[int, list[float]] = {}
    end_s = math.inf  # heartbeats go on when the run is over
    with can.Bus(**bus_options) as bus:  # type: ignore[arg-type]
        while len(sync_s) < syncs and time.monotonic() < end_s:
            message = bus.recv(PATIENCE_S)
            if message is None:
                break
            if message.arbitration_id == SYNC:
                sync_s.append(message.timestamp)
                end_s = time.monotonic() + SILENCE_S
            elif message.arbitration_id in ANSWERS and sync_s:
                after_s = message.timestamp - sync_s[-1]
                answers_s.setdefault(message.arbitration_id, []).append(after_s)
    return {"sync_s": sync_s} | {f"0x{cob_id:03X}": after for cob_id, after in answers_s.items()}


def spread_us(values_s: list[float]) -> dict[str, float]:
    """Percentiles of a list of seconds, in microseconds."""
    if not values_s:
        return {}
    marks = np.percentile(np.array(values_s) * 1e6, (50, 99, 99.9, 100))
    return dict(zip(("p50_us", "p99_us", "p99.9_us", "max_us"), marks.tolist(), strict=True))


if __name__ == "__main__":
    logging.getLogger("can").setLevel(logging.CRITICAL)  # "incomplete message": it waits for more
    job = json.loads(sys.stdin.readline())
    sys.stdout.write(json.dumps(listen(job["bus"], job["syncs"])))
