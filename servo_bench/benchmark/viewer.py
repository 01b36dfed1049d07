"""A browser's stand-in for measurements: takes live samples and notes when they came.

    python -m servo_bench.benchmark.viewer URL SECONDS

A process of its own, as a browser is. It prints one JSON object: for every frame the time of its
arrival (CLOCK_MONOTONIC, ns) and the `t_s` of its rows.
"""

import json
import struct
import sys

import numpy as np
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from servo_bench.clock import NS_PER_S, monotonic_ns

HEAD = struct.Struct("<4I")
LOOK_S = 0.5


def view(url: str, seconds: float) -> dict[str, list[object]]:
    """Watch for so long, or until the daemon goes."""
    until_ns = monotonic_ns() + round(seconds * NS_PER_S)
    arrived_ns: list[object] = []
    times_s: list[object] = []
    with connect(url) as live:
        while monotonic_ns() < until_ns:
            try:
                message = live.recv(timeout=LOOK_S)
            except TimeoutError:
                continue
            except ConnectionClosed:
                break
            if isinstance(message, bytes):
                arrived_ns.append(monotonic_ns())
                _, rows, columns, _ = HEAD.unpack_from(message)
                block = np.frombuffer(message, "<f8", offset=HEAD.size).reshape(rows, columns)
                times_s.append(block[:, 0].tolist())
    return {"arrived_ns": arrived_ns, "t_s": times_s}


if __name__ == "__main__":
    sys.stdout.write(json.dumps(view(sys.argv[1], float(sys.argv[2]))))
