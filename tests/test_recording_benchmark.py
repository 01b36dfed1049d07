"""The benchmark of the reader, small: the shape of its answer, and that both readers agree."""

import json

from servo_bench.benchmark.recording import measure


def test_both_readers_give_the_same_numbers() -> None:
    figures = measure(3, rows=300, repeats=1)
    assert figures["equal"] is True
    assert figures["rows"] == 300
    assert min(figures[key] for key in ("load_ms", "reference_ms", "write_us_per_row")) > 0
    assert json.loads(json.dumps(figures)) == figures
