"""CSV and its kin: any delimiter, comments, lines before the header, no header, decimal commas."""

import csv
from pathlib import Path

from servo_bench.errors import ConfigError, RecordingError
from servo_bench.foreign.maps import FileLayout
from servo_bench.foreign.tables import TextTable

WHITESPACE = "whitespace"


def read_text(path: Path, data: bytes, layout: FileLayout) -> TextTable:
    """The table in a text file.

    `delimiter` is one character, or "whitespace" for runs of blanks; by default a comma, in a .tsv
    file a tab. Raises RecordingError for what is no table, ConfigError for an impossible layout.
    """
    numbered = _lines(path, data, layout)
    if layout.delimiter == WHITESPACE:
        rows = [(number, line.split()) for number, line in numbered]
    else:
        rows = _split(path, numbered, layout)
    if not rows:
        raise RecordingError(
            f"{path} is empty: it has no line that is neither blank nor a comment. Give another "
            "file, or tell the map less to skip."
        )
    first = [cell.strip() for cell in rows[0][1]]
    names = tuple(first if layout.header else map(str, range(len(first))))
    body = rows[(1 if layout.header else 0) + layout.skip_rows :]
    return TextTable(
        file=str(path),
        names=names,
        cells=[_cells(path, number, cells, len(names)) for number, cells in body],
        lines=[number for number, _ in body],
        decimal=layout.decimal,
    )


def _lines(path: Path, data: bytes, layout: FileLayout) -> list[tuple[int, str]]:
    """The lines that say something, each with its number in the file."""
    encoding = "utf-8-sig" if layout.encoding.lower() in ("utf-8", "utf8") else layout.encoding
    try:
        text = data.decode(encoding)
    except UnicodeError as error:
        raise RecordingError(
            f"{path} is no text in {layout.encoding}: {error}. Give its encoding in the map's "
            "[file], or its format where it is csv, json, mat, npz or parquet by another name."
        ) from error
    except (LookupError, ValueError) as error:
        raise ConfigError(
            f"there is no encoding {layout.encoding!r}. Give utf-8, latin-1, utf-16 or another "
            "that Python knows."
        ) from error
    if "\0" in text:
        raise RecordingError(
            f"{path} is no text: it has a zero byte at {text.index(chr(0))}. Give its format in "
            "the map's [file] (csv, json, mat, npz, parquet), or its encoding (utf-16)."
        )
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    return [
        (number, line)
        for number, line in enumerate(lines, start=1)
        if number > layout.skip_lines
        and line.strip()
        and not line.lstrip().startswith(layout.comment)
    ]


def _split(
    path: Path, numbered: list[tuple[int, str]], layout: FileLayout
) -> list[tuple[int, list[str]]]:
    delimiter = layout.delimiter or ("\t" if path.suffix.lower() == ".tsv" else ",")
    try:
        reader = csv.reader((line for _, line in numbered), delimiter=delimiter)
        return [(numbered[reader.line_num - 1][0], cells) for cells in reader]
    except csv.Error as error:
        raise RecordingError(
            f"{path} is no table of text: {error}. Give a file with one row per line."
        ) from error
    except (TypeError, ValueError) as error:
        raise ConfigError(
            f"a line cannot be split at {layout.delimiter!r} ({error}). Give one character as "
            f'delimiter, or "{WHITESPACE}".'
        ) from error


def _cells(path: Path, number: int, cells: list[str], width: int) -> list[str]:
    """The row's cells, less empty ones beyond the header: many programs end lines with a comma."""
    while len(cells) > width and not cells[-1].strip():
        cells = cells[:-1]
    if len(cells) != width:
        raise RecordingError(
            f"{path}, line {number} has {len(cells)} cells, and the first line has {width}. Mend "
            "that line, or tell the map the right delimiter, comment or skip_lines."
        )
    return cells
