"""Small foreign files, their maps, and the folder of measured data, for the tests of the import."""

import os
from pathlib import Path

import pytest

from servo_bench.foreign.importing import read_foreign
from servo_bench.foreign.maps import load_map
from servo_bench.recording.recording import Recording

ROOT = Path(__file__).parent.parent
REALDATA = Path(os.environ.get("SERVO_BENCH_REALDATA", ROOT.parent / "shared" / "realdata"))

TIME = '[[channel]]\nrole = "time"\ncolumn = "t"\nunit = "s"\n'
CURRENT = '[[channel]]\nrole = "current"\ncolumn = "i"\nunit = "A"\n'
PLAIN = TIME + CURRENT
ROWS = "t,i\n0,1\n0.5,2\n1,4\n"


def imported(folder: Path, content: str | bytes, map_text: str, file: str = "a.csv") -> Recording:
    """The recording of a file with that content by that map (its name is added)."""
    path = folder / file
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    plan = folder / "map.toml"
    plan.write_text('name = "test"\n' + map_text)
    return read_foreign(path, load_map(plan))


def measured(name: str) -> Path:
    """A file of the measured data; the test is skipped, with the reason, where it is absent."""
    path = REALDATA / name
    if not path.is_file():
        pytest.skip(f"{path} is not there: set SERVO_BENCH_REALDATA to the folder that holds it")
    return path
