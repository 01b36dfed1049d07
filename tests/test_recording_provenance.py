"""Where a recording says that it came from."""

from itertools import count
from pathlib import Path

from servo_bench.recording.provenance import (
    ClockPair,
    clock_pair,
    command_text,
    provenance,
    utc_offset_ns,
)


def test_the_clock_pair_is_the_tightest_reading() -> None:
    """Read on clocks that tick at each look, once with a hole of 1000 ns in between."""
    ticks = count(100, 10)
    holes = iter([1000] * 5 + [0] + [1000] * 20)

    def monotonic() -> int:
        return next(ticks)

    def utc() -> int:
        now_ns = next(ticks)
        for _ in range(next(holes) // 10):
            next(ticks)
        return now_ns + 7_000_000

    pair = clock_pair(monotonic, utc)
    assert pair.uncertainty_ns == 10
    assert pair.utc_ns - pair.monotonic_ns == 7_000_000


def test_the_facts_are_text_and_hold_the_clocks() -> None:
    facts = provenance(ClockPair(5, 1_700_000_000_000_000_007, 3), ["/x/servo-bench", "run"])
    assert all(isinstance(value, str) and value for value in facts.values())
    assert {"servo_bench", "python", "numpy", "canopen", "python-can", "mcap"} < facts.keys()
    assert facts["command"] == "servo-bench run"
    assert facts["utc"] == "2023-11-14T22:13:20+00:00"
    assert utc_offset_ns(facts) == 1_700_000_000_000_000_002


def test_nobodys_home_is_in_the_command() -> None:
    words = ["/home/ann/bin/servo-bench", "run", "--out=/home/ann/a.mcap", "b"]
    assert command_text(words, Path("/home/ann")) == "servo-bench run --out=~/a.mcap b"
    assert command_text([], Path("/home/ann")) == ""


def test_facts_without_clocks_move_no_time() -> None:
    assert utc_offset_ns({}) == 0
    assert utc_offset_ns({"clock_utc_ns": "x", "clock_monotonic_ns": "1"}) == 0


def test_a_name_that_is_no_utf_8_is_still_written() -> None:
    name = b"caf\xe9.mcap".decode(errors="surrogateescape")
    told = command_text(["servo-bench", "run", name], Path("/home/ann"))
    assert told.encode() == b"servo-bench run caf?.mcap"
