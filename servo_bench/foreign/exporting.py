"""A recording as a file of another program: every channel, its unit in its name.

A count that did not come is an empty cell in CSV, null in Parquet, and -2^63 in NPZ and MAT, whose
integers have no other word for it. A run, which has slots instead, gets `t_s` as its first column.
"""

import csv
import io
import zipfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any, Literal, cast

import numpy as np
import scipy.io
from numpy.typing import NDArray

from servo_bench.errors import ConfigError, RecordingError
from servo_bench.foreign.containers import pyarrow_parquet
from servo_bench.recording.recording import MISSING, Recording

Columns = Mapping[str, NDArray[Any]]
Kind = Literal["csv", "parquet", "mat", "npz"]
LONGEST_MAT_NAME = 31


def export(recording: Recording, path: str | Path, kind: Kind, *, fast: bool = False) -> None:
    """Write every channel to the new file `path`; with `fast` the several samples of each command.

    Raises ConfigError where the file exists, cannot be written, or needs a package that is not
    installed; RecordingError where the format has no room for a channel's name, or where there are
    no fast samples.
    """
    columns = fast_columns_of(recording) if fast else columns_of(recording)
    writer = WRITERS[kind]
    if kind == "parquet":
        pyarrow_parquet()  # before there is a file
    with _new_file(Path(path)) as file:
        writer(columns, file)


def columns_of(recording: Recording) -> dict[str, NDArray[Any]]:
    """The channels by name, shape (rows,), `t_s` among them."""
    if "t_s" in recording:
        return dict(recording.channels)
    return {"t_s": _times(recording), **recording.channels}


def fast_columns_of(recording: Recording) -> dict[str, NDArray[Any]]:
    """The fast samples by name, shape (samples,), `t_s` from the first one's ask among them."""
    if not recording.fast:
        raise RecordingError(
            "this recording has one sample per command and no fast ones. Export it without --fast, "
            "or record with drive.samples_per_command above 1."
        )
    asked_ns = recording.fast["asked_ns"]
    return {"t_s": (asked_ns - asked_ns[:1]) * 1e-9, **recording.fast}


def _times(recording: Recording) -> NDArray[np.float64]:
    """Seconds from the first row's ask, or from its slot where no ask was recorded."""
    asked = recording.channels.get("asked_ns")
    if asked is not None and not (asked == MISSING).any():
        since: NDArray[np.float64] = (asked - asked[:1]) * 1e-9
        return since
    slot = recording["slot"] if "slot" in recording else np.arange(len(recording))
    times: NDArray[np.float64] = (slot - slot[:1]).astype(np.float64) * recording.period_s
    return times


@contextmanager
def _new_file(path: Path) -> Iterator[IO[bytes]]:
    """A new file that is gone again where it could not be finished."""
    try:
        with path.open("xb") as file:
            try:
                yield file
            except BaseException:
                path.unlink()
                raise
    except FileExistsError as error:
        raise ConfigError(f"{path} exists already: name another file, or move it away.") from error
    except OSError as error:
        raise ConfigError(
            f"{path} cannot be written: {error.strerror}. Give a folder that exists and has room."
        ) from error


def _write_csv(columns: Columns, file: IO[bytes]) -> None:
    text = io.TextIOWrapper(file, encoding="utf-8", newline="", write_through=True)
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(zip(*(_cells(values) for values in columns.values()), strict=True))
    text.detach()  # the file is another's to close


def _cells(values: NDArray[Any]) -> list[Any]:
    """Numbers that read back to the last bit; nothing where nothing came."""
    gone = np.isnan(values) if values.dtype.kind == "f" else values == MISSING
    return [None if empty else value for empty, value in zip(gone, values.tolist(), strict=True)]


def _write_npz(columns: Columns, file: IO[bytes]) -> None:
    # not by numpy's `savez_compressed`: a channel may be called as one of its own parameters
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, values in columns.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                np.lib.format.write_array(member, values, allow_pickle=False)


def _write_mat(columns: Columns, file: IO[bytes]) -> None:
    for name in columns:
        if len(name) > LONGEST_MAT_NAME or not name[:1].isalpha():
            raise RecordingError(
                f"{name} cannot be a name in a MAT file: at most {LONGEST_MAT_NAME} characters, a "
                "letter first. Export to csv, parquet or npz."
            )
    # it takes an open file too, which its stubs do not say
    scipy.io.savemat(cast("Any", file), dict(columns), oned_as="column", do_compression=True)


def _write_parquet(columns: Columns, file: IO[bytes]) -> None:
    parquet, arrow = pyarrow_parquet()
    arrays = {
        name: arrow.array(values, mask=values == MISSING if values.dtype == np.int64 else None)
        for name, values in columns.items()
    }
    parquet.write_table(arrow.table(arrays), file)


WRITERS: Mapping[Kind, Callable[[Columns, IO[bytes]], None]] = {
    "csv": _write_csv,
    "parquet": _write_parquet,
    "mat": _write_mat,
    "npz": _write_npz,
}
