"""A foreign file's bytes and its columns: which reader is for which file."""

from collections.abc import Callable, Mapping
from pathlib import Path

from servo_bench.errors import ConfigError, RecordingError
from servo_bench.foreign import containers
from servo_bench.foreign.maps import FileLayout, Format, LoadedMap
from servo_bench.foreign.tables import MAX_BYTES, Table
from servo_bench.foreign.text import read_text

READERS: Mapping[Format, Callable[[Path, bytes, FileLayout], Table]] = {
    "csv": read_text,
    "json": containers.read_json,
    "mat": containers.read_mat,
    "npz": containers.read_npz,
    "parquet": containers.read_parquet,
}
ENDINGS: Mapping[str, Format] = {
    **dict.fromkeys((".csv", ".tsv", ".txt", ".dat", ".asc"), "csv"),
    ".json": "json",
    ".mat": "mat",
    ".npz": "npz",
    **dict.fromkeys((".parquet", ".pq"), "parquet"),
}


def read_table(path: Path, data: bytes, loaded: LoadedMap) -> Table:
    """The file's columns, by the map's format or the file's ending.

    Raises ConfigError where neither says a format or the file is not one that the map is for,
    RecordingError where the file cannot be read.
    """
    table = _reader(path, loaded)(path, data, loaded.map.file)
    meant = loaded.map.file.columns
    if meant is not None and table.names != meant:
        raise ConfigError(
            f"{path} has the columns {', '.join(table.names[:40])}, and {loaded.path} is for files "
            f"with {', '.join(meant)}. Give the map of this file."
        )
    return table


def read_bytes(path: Path) -> bytes:
    """All of a file that is neither missing, empty nor too large; else RecordingError."""
    try:
        with path.open("rb") as file:
            data = file.read(MAX_BYTES + 1)
    except OSError as error:
        raise RecordingError(
            f"{path} cannot be read: {error.strerror}. Give the path of a file with measured data."
        ) from error
    if not data:
        raise RecordingError(f"{path} is empty: it has 0 bytes. Give a file with measured data.")
    if len(data) > MAX_BYTES:
        raise RecordingError(
            f"{path} is larger than the {MAX_BYTES // 2**20} MiB that are read at once. Cut it."
        )
    return data


def _reader(path: Path, loaded: LoadedMap) -> Callable[[Path, bytes, FileLayout], Table]:
    kind = loaded.map.file.format or ENDINGS.get(path.suffix.lower())
    if kind is None:
        raise ConfigError(
            f"{path} ends in {path.suffix!r}, which says no format: {', '.join(ENDINGS)} do. Give "
            f"format = ... in the [file] of {loaded.path}: one of {', '.join(READERS)}."
        )
    return READERS[kind]
