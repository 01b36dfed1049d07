"""Compiled where it may be, plain Python where it must be, and never yesterday's code.

    law      a function of numbers that is compiled into whoever calls it
    kernel   the outer loop, compiled once and kept on disk

numba's disk cache looks only at the file of the cached function: an edited law in another file
would go on giving its old answers. So a kernel whose laws live elsewhere closes over a fingerprint
of their files, and numba's key holds what a function closes over. NUMBA_DISABLE_JIT=1 runs it all
in plain Python, to the same numbers.
"""

import hashlib
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, TypeVar, cast

import numba

F = TypeVar("F", bound=Callable[..., Any])


def law(function: F) -> F:
    """Compiled into its callers."""
    return cast(F, numba.njit(forceinline=True, error_model="numpy")(function))


def kernel(function: F) -> F:
    """Compiled by itself and cached; closes over the `fingerprint` of laws in other files."""
    return cast(F, numba.njit(cache=True, error_model="numpy")(function))


def fingerprint(files: Iterable[Path]) -> int:
    """A number above zero that another text gives another of."""
    digest = hashlib.sha256()
    for path in sorted(files):
        digest.update(path.name.encode() + b"\0" + path.read_bytes() + b"\0")
    return 1 + int.from_bytes(digest.digest()[:7], "big")
