"""The compiled page as machine code in a file of its own, loaded without the compiler.

Importing numba takes longer than everything else that a simulation needs, and only compiling
needs it. The file's name holds the hash of the page's text and of what made code from it: numba,
llvmlite and numpy, their settings, the processor. What is torn, or does not link, is not used.

The entry is a C function of one argument,

    answer = entry(words)          1 complete, 0 not, below zero: the page raised

words, 8 bytes each: of an array its address and shape, of a number itself, in `run`'s order.
"""

import ctypes
import hashlib
import importlib.util
import os
import struct
import sys
import tempfile
from functools import cache
from itertools import count
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from llvmlite import __version__ as llvmlite_version  # type: ignore[import-untyped]
from llvmlite import binding

from sim_rig.model.state import Array

_WORDS = struct.Struct("=" + "qq" * 5 + "qqq" + "q" + "d" + "qqq")
_ENTRY = ctypes.CFUNCTYPE(ctypes.c_int32, ctypes.c_char_p)
_FLOATS = np.dtype(np.float64)
_NO_BYTES = ctypes.c_char * 0


class MachineCode(NamedTuple):
    """An object file, and its function that is `run`."""

    entry: str
    code: bytes


class LinkedRun:
    """`run` of a page. Like the compiled function, it holds no lock of the interpreter."""

    def __init__(self, library: Any, entry: str) -> None:
        self._library = library  # gone, it takes the code with it
        self._call = _ENTRY(library[entry])

    def __call__(  # noqa: PLR0917 - as the page has it
        self,
        rig: Array,
        parameters: Array,
        state: Array,
        slot_commands_rad_s: Array,
        slot_durations_s: Array,
        given: Array,
        mode: int,
        longest_step_s: float,
        rows: Array,
    ) -> bool:
        """Play the slots. TypeError for an array that the page cannot work on as it is."""
        answer: int = self._call(
            _WORDS.pack(
                *(*_words(rig, 1), *_words(parameters, 1), *_words(state, 1)),
                *(*_words(slot_commands_rad_s, 1), *_words(slot_durations_s, 1)),
                *(*_words(given, 2), mode, longest_step_s, *_words(rows, 2)),
            )
        )
        if answer < 0:
            raise RuntimeError("the compiled page raised an error: it has none to raise.")
        return answer == 1


def _words(array: Any, dimensions: int) -> tuple[int, ...]:
    """What the entry is told of an array: memory of its own, writable, row after row."""
    if array.dtype != _FLOATS or array.ndim != dimensions:
        raise TypeError(
            f"an array of {array.dtype} of shape {array.shape}: the page takes float64 of "
            f"{dimensions} dimension(s)."
        )
    return (ctypes.addressof(_NO_BYTES.from_buffer(array)), *array.shape)


def file_beside(page: Path, compiler: Path) -> Path:
    """Where the machine code of a page is kept, made by this compiler of ours for this machine."""
    made_by = (
        *(llvmlite_version, np.__version__, _numba()),
        *(compiler.read_bytes(), Path(__file__).read_bytes()),
        *(sys.version, binding.get_process_triple(), binding.get_host_cpu_name(), _features()),
        *sorted(item for item in os.environ.items() if item[0].startswith("NUMBA_")),
    )
    digest = hashlib.sha256(repr(made_by).encode()).hexdigest()
    return page.with_name(f"{page.stem}_{digest[:20]}.o")


def _features() -> str:
    try:
        return str(binding.get_host_cpu_features().flatten())
    except RuntimeError:  # not every processor is asked for them
        return ""


def _numba() -> bytes:
    """What tells one numba from another, without importing it."""
    found = importlib.util.find_spec("numba")
    folders = found.submodule_search_locations if found is not None else None
    version = Path(folders[0]) / "_version.py" if folders else None
    if version is not None and version.is_file():
        return version.read_bytes()
    from importlib.metadata import version as installed  # noqa: PLC0415 - slow to import

    return installed("numba").encode()


def kept(file: Path) -> MachineCode | None:
    """What `keep` wrote; None where there is nothing, or not all of it."""
    try:
        digest, entry, code = file.read_bytes().split(b"\n", 2)
    except (OSError, ValueError):
        return None
    if digest != _digest(entry, code):
        return None
    return MachineCode(entry.decode(), code)


def keep(file: Path, made: MachineCode) -> None:
    """Write it whole or not at all; a disk that is full only makes the next start slower."""
    entry = made.entry.encode()
    try:
        handle, name = tempfile.mkstemp(dir=file.parent, suffix=".part")
        with os.fdopen(handle, "wb") as part:
            part.write(b"\n".join((_digest(entry, made.code), entry, made.code)))
        Path(name).replace(file)
    except OSError:
        return


def _digest(entry: bytes, code: bytes) -> bytes:
    return hashlib.sha256(entry + b"\n" + code).hexdigest().encode()


def linked(made: MachineCode) -> LinkedRun | None:
    """Its `run`; None where the linker refuses it."""
    library = binding.JITLibraryBuilder().add_object_img(made.code)
    library.add_current_process().export_symbol(made.entry)
    try:
        return LinkedRun(library.link(_linker(), f"page {next(_NUMBERS)}"), made.entry)
    except RuntimeError:
        return None


_NUMBERS = count()


@cache
def _linker() -> Any:
    """One a process, to its end: libraries may not outlive it."""
    binding.initialize_native_target()
    binding.initialize_native_asmprinter()
    return binding.create_lljit_compiler(suppress_errors=True)
