"""Where a run is recorded that was played for its figures, by a command without an `--out`."""

import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from servo_bench.errors import BenchError


@contextmanager
def recorded_at(out: Path | None, name: str) -> Iterator[Path]:
    """`out`; else a file that is gone afterwards, unless an error ended what was done with it: then
    the recording may show why, so that it stays, and the error says where."""
    if out is not None:
        yield out
        return
    folder = Path(tempfile.mkdtemp(prefix="servo-bench-"))
    target, kept = folder / name, False
    try:
        yield target
    except BenchError as error:
        kept = target.exists()
        if kept:
            error.add_note(f"What was recorded is kept: {target}")
        raise
    finally:
        if not kept:
            shutil.rmtree(folder, ignore_errors=True)
