"""Columns of numbers, wherever they came from: the one seam between a file's format and a map.

`TextTable` holds cells of text, `TreeTable` what JSON, MAT and NPZ files hold: nested tables, lists
and arrays. A path is a name, or names with dots between; a number picks a column of a matrix.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from servo_bench.errors import RecordingError

Array = NDArray[np.float64]
Column = int | str
MAX_BYTES = 256 * 2**20
"""Of a file that is read, and of the arrays in an NPZ file."""
ABSENT = object()


class Table(Protocol):
    """A foreign file as columns."""

    @property
    def names(self) -> tuple[str, ...]:
        """What can be asked for, for people."""
        ...

    def has(self, column: Column) -> bool:
        """Whether there is such a column."""
        ...

    def column(self, column: Column) -> Array:
        """Its numbers, shape (rows,), NaN for none; RecordingError where one is no number."""
        ...

    def scalar(self, path: str) -> float | None:
        """A single number that the file holds beside the columns; None where it is not there."""
        ...

    def place(self, row: int) -> str:
        """Where the reader finds row `row` (counted from 0) in the file."""
        ...


@dataclass(frozen=True, slots=True)
class TextTable:
    """Rows of cells under a header; `lines[row]` is the row's line in the file."""

    file: str
    names: tuple[str, ...]
    cells: Sequence[Sequence[str]]
    lines: Sequence[int]
    decimal: str

    def has(self, column: Column) -> bool:
        """Whether there is such a column; a name that two columns have is none."""
        if isinstance(column, int):
            return 0 <= column < len(self.names)
        return self.names.count(column) == 1

    def column(self, column: Column) -> Array:
        """See `Table`; an empty cell is NaN."""
        index = column if isinstance(column, int) else self.names.index(column)
        return np.array(
            [self._number(cells[index], row, column) for row, cells in enumerate(self.cells)],
            np.float64,
        )

    def _number(self, cell: str, row: int, column: Column) -> float:
        text = cell.strip()
        if self.decimal != ".":  # there a point parts thousands, or is nothing at all
            text = text.replace(".", "?").replace(self.decimal, ".")
        if not text:
            return np.nan
        try:
            return float(text.replace("_", "?"))  # only Python parts digits so
        except ValueError as error:
            raise RecordingError(
                f"{self.file}, {self.place(row)}: column {column!r} is {cell[:40]!r}, and must "
                "be a number. Mend the line, or tell the map about lines before the data "
                "(skip_lines, skip_rows, comment), the delimiter or the decimal sign."
            ) from error

    def scalar(self, path: str) -> float | None:  # noqa: ARG002 a text file holds columns only
        """None: a text file holds columns only."""
        return None

    def place(self, row: int) -> str:
        """The line in the file."""
        return f"line {self.lines[row]}"


@dataclass(frozen=True, slots=True)
class TreeTable:
    """A nested value; the columns are `table` in it: records, columns by name, or a matrix."""

    file: str
    root: Any
    table: Any

    @property
    def names(self) -> tuple[str, ...]:
        """The names one level below the table."""
        node = self.table
        if _is_list(node) and node and isinstance(node[0], Mapping):
            node = node[0]
        if isinstance(node, Mapping):
            return tuple(str(name) for name in node)
        width = len(node[0]) if _is_list(node) and node and _is_list(node[0]) else 0
        if isinstance(node, np.ndarray) and node.ndim == 2:
            width = node.shape[1]
        return tuple(str(index) for index in range(width))

    def has(self, column: Column) -> bool:
        """Whether any record has it."""
        if self._by_record():
            return any(lookup(record, str(column)) is not ABSENT for record in self.table)
        return lookup(self.table, str(column)) is not ABSENT

    def column(self, column: Column) -> Array:
        """See `Table`; null, and a record without it, are NaN."""
        found: Any
        if self._by_record():
            found = [lookup(record, str(column)) for record in self.table]
        else:
            found = lookup(self.table, str(column))
        if isinstance(found, np.ndarray):
            return self._from_array(found, column)
        if not _is_list(found):
            raise RecordingError(self._not_numbers(column, f"{found!r:.40}", "the column"))
        return np.array([self._number(v, row, column) for row, v in enumerate(found)], np.float64)

    def _by_record(self) -> bool:
        return _is_list(self.table)

    def _from_array(self, found: NDArray[Any], column: Column) -> Array:
        flat = np.squeeze(found)
        flat = flat.reshape(1) if flat.ndim == 0 else flat
        if flat.dtype.kind not in "biuf" or flat.ndim != 1:
            got = f"an array of {found.dtype} of shape {found.shape}"
            raise RecordingError(self._not_numbers(column, got, "the column"))
        return flat.astype(np.float64)

    def _number(self, value: Any, row: int, column: Column) -> float:
        if value is None or value is ABSENT:
            return np.nan
        if isinstance(value, bool | int | float | np.number):
            try:
                return float(value)
            except OverflowError:
                return np.inf
        raise RecordingError(self._not_numbers(column, f"{value!r:.40}", self.place(row)))

    def _not_numbers(self, column: Column, got: str, place: str) -> str:
        return (
            f"{self.file}, {place}: column {column!r} is {got}, and must be one number per row. "
            "Name a path to numbers; a column of a matrix is `path.2`, counted from 0."
        )

    def scalar(self, path: str) -> float | None:
        """The number at `path` from the file's root."""
        value = lookup(self.root, path)
        if isinstance(value, np.ndarray) and value.size == 1 and value.dtype.kind in "biuf":
            return float(value.reshape(-1)[0])
        if isinstance(value, bool) or not isinstance(value, int | float):
            return None
        try:
            return float(value)
        except OverflowError:
            return None

    def place(self, row: int) -> str:
        """The row, counted from 1."""
        return f"row {row + 1}"


def lookup(node: Any, path: str) -> Any:
    """What is at `path` below `node`, or ABSENT. A name with dots in it comes before a path."""
    if isinstance(node, Mapping):
        if path in node:
            return node[path]
        first, dot, rest = path.partition(".")
        return lookup(node[first], rest) if dot and first in node else ABSENT
    if isinstance(node, np.ndarray) and node.dtype.names:
        return node[path] if path in node.dtype.names else ABSENT
    # ASCII digits only: str.isdigit knows more of them than int() does
    index = int(path) if path.isascii() and path.isdigit() and len(path) < 10 else -1
    if isinstance(node, np.ndarray) and node.ndim == 2 and 0 <= index < node.shape[1]:
        return node[:, index]
    if _is_list(node) and 0 <= index < len(node):
        return node[index]
    return ABSENT


def _is_list(node: Any) -> bool:
    return isinstance(node, list)
