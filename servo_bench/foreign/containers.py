"""JSON, MAT, NPZ and Parquet files as one nested value each, and nothing executed on the way."""

import importlib
import io
import json
import struct
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from servo_bench.errors import ConfigError, RecordingError
from servo_bench.foreign.maps import FileLayout
from servo_bench.foreign.matfile import MatError, arrays_of
from servo_bench.foreign.tables import ABSENT, MAX_BYTES, TreeTable, lookup

HDF5 = b"\x89HDF\r\n\x1a\n"
MISSING_PYARROW = (
    "Parquet needs the package pyarrow, which is not installed. Install it: "
    "pip install 'servo-bench[parquet]'"
)
# What the libraries raise for damaged files; MemoryError for a size that a damaged header declares.
_DAMAGE = (
    *(ValueError, TypeError, KeyError, IndexError, AttributeError, OverflowError, EOFError),
    *(OSError, MemoryError, RecursionError, RuntimeError, UnicodeError),
    *(struct.error, zlib.error),
)


def read_json(path: Path, data: bytes, layout: FileLayout) -> TreeTable:
    """Records (a list of objects) or columns (an object of lists) at the layout's `table`."""
    try:
        root = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise RecordingError(
            f"{path} is not JSON: {error}. Mend it, or give its format."
        ) from error
    return _tree(path, root, layout)


def read_mat(path: Path, data: bytes, layout: FileLayout) -> TreeTable:
    """Variables and structs of a MAT file, versions 4 to 7."""
    if data[:512].find(b"MATLAB 7.3") == 0 or HDF5 in (data[:8], data[512:520]):
        raise RecordingError(
            f"{path} is a MAT file of version 7.3 (HDF5), and versions up to 7 can be read. Save "
            "it in MATLAB with save('NAME.mat', '-v7')."
        )
    try:
        root = arrays_of(data)
    except MatError as error:
        raise RecordingError(
            f"{path} is not a MAT file, or is damaged: {error}. Save it again in MATLAB with "
            "save('NAME.mat', '-v7')."
        ) from error
    return _tree(path, root, layout)


def read_npz(path: Path, data: bytes, layout: FileLayout) -> TreeTable:
    """The arrays of an NPZ file; one that holds Python objects is refused."""
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            unpacked = sum(entry.file_size for entry in archive.infolist())
            if unpacked > MAX_BYTES:
                raise RecordingError(
                    f"{path} unpacks to {unpacked / 2**20:.0f} MiB, and {MAX_BYTES // 2**20} are "
                    "read at once. Save fewer columns, or part of them."
                )
            root = {
                entry.filename.removesuffix(".npy"): _npy(archive.read(entry), entry.filename)
                for entry in archive.infolist()
            }
    except (zipfile.BadZipFile, *_DAMAGE) as error:
        raise RecordingError(
            f"{path} is not an NPZ file of plain arrays, or is damaged: {error}. Save the arrays "
            "again with numpy.savez, as numbers and not as objects."
        ) from error
    return _tree(path, root, layout)


def _npy(data: bytes, name: str) -> np.ndarray[Any, np.dtype[Any]]:
    """One array; its header is checked against its bytes before memory is asked for."""
    file = io.BytesIO(data)
    major, _ = np.lib.format.read_magic(file)
    read = (
        np.lib.format.read_array_header_1_0 if major == 1 else np.lib.format.read_array_header_2_0
    )
    shape, _, dtype = read(file)
    if dtype.hasobject:
        raise ValueError(f"{name} holds Python objects")
    count = 1
    for size in shape:
        count *= size
    if count * dtype.itemsize != len(data) - file.tell():
        raise ValueError(f"{name} declares {shape} of {dtype} and holds other bytes")
    file.seek(0)
    array: np.ndarray[Any, np.dtype[Any]] = np.lib.format.read_array(file, allow_pickle=False)
    return array


def read_parquet(path: Path, data: bytes, layout: FileLayout) -> TreeTable:
    """The columns of a Parquet file; ConfigError where pyarrow is not installed."""
    parquet, arrow = pyarrow_parquet()
    try:
        table = parquet.read_table(arrow.BufferReader(data))
        root = {name: table.column(name).to_pylist() for name in table.column_names}
    except (arrow.ArrowException, *_DAMAGE) as error:
        raise RecordingError(
            f"{path} is not a Parquet file, or is damaged: {error}. Save it again."
        ) from error
    return _tree(path, root, layout)


def pyarrow_parquet() -> tuple[Any, Any]:
    """pyarrow.parquet and pyarrow; ConfigError that says how to install them."""
    try:
        return importlib.import_module("pyarrow.parquet"), importlib.import_module("pyarrow")
    except ImportError as error:
        raise ConfigError(MISSING_PYARROW) from error


def _tree(path: Path, root: Any, layout: FileLayout) -> TreeTable:
    table = lookup(root, layout.table) if layout.table else root
    if table is ABSENT:
        there = ", ".join(TreeTable(str(path), root, root).names[:20]) or "nothing with a name"
        raise ConfigError(
            f"{path} has no table {layout.table!r}: it has {there}. Give the path to the records "
            "or columns as `table` in the map's [file]."
        )
    return TreeTable(str(path), root, table)
