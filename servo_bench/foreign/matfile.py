"""MAT files read in a process of their own: scipy's reader crashes on some damaged ones.

    python -m servo_bench.foreign.matfile < FILE.mat > FILE.npz

The child imports nothing of the bench, may use MEMORY_BYTES, and hands its arrays back as NPZ, the
fields of a struct under their path (`log.rows.t`; MATLAB allows no dot in a name). What is no array
of numbers or text comes back as the text that says what it was.
"""

import io
import resource
import subprocess
import sys
from collections.abc import Iterator, Mapping
from typing import Any, cast

import numpy as np
import scipy.io
from numpy.typing import NDArray

MEMORY_BYTES = 4 * 2**30
TIMEOUT_S = 120.0
ROOT = "v."
"""Before every name on its way between the processes: one may be called `file`."""


class MatError(Exception):
    """The bytes are no MAT file, or a damaged one."""


def arrays_of(data: bytes) -> dict[str, Any]:
    """The variables of a MAT file of version 4 to 7, structs as nested tables; MatError if none."""
    try:
        done = subprocess.run(
            [sys.executable, "-P", "-m", __name__],  # -P: not from the working folder
            input=data,
            capture_output=True,
            timeout=TIMEOUT_S,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        raise MatError(f"it could not be read within {TIMEOUT_S:.0f} s") from error
    if done.returncode != 0:
        said = done.stderr.decode(errors="replace").strip().splitlines()
        crashed = done.returncode < 0 or not said
        raise MatError("the reader crashed on it" if crashed else said[-1])
    root: dict[str, Any] = {}
    with np.load(io.BytesIO(done.stdout), allow_pickle=False) as archive:
        for name in archive.files:
            *folders, leaf = name.removeprefix(ROOT).split(".")
            node = root
            for folder in folders:
                node = node.setdefault(folder, {})
            node[leaf] = archive[name]
    return root


def _flat(values: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, NDArray[Any]]]:
    for name, value in values.items():
        if name.startswith("__"):
            continue
        if isinstance(value, Mapping):
            yield from _flat(value, f"{above}{name}.")
            continue
        array = np.asarray(value) if isinstance(value, np.generic | np.ndarray | int | float) else 0
        plain = isinstance(array, np.ndarray) and array.dtype.kind in "biufcU"
        yield above + name, np.asarray(array if plain else type(value).__name__)


def _child() -> None:
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    # it takes an open file too, which its stubs do not say
    data = cast("Any", io.BytesIO(sys.stdin.buffer.read()))
    found = dict(_flat(scipy.io.loadmat(data, simplify_cells=True), ROOT))
    packed = io.BytesIO()
    np.savez(packed, **cast("dict[str, Any]", found))
    sys.stdout.buffer.write(packed.getvalue())


if __name__ == "__main__":
    _child()
