"""Small files that are whole or the old ones, whatever happens while they are written."""

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from servo_bench.errors import ConfigError, RecordingError, disk_is_full


def write_json(path: Path, table: Mapping[str, Any]) -> None:
    """Replace `path` by `table` as JSON. RecordingError where the disk is full or refuses."""
    new = path.with_name(f".{path.name}.new")
    try:
        with new.open("w") as file:
            json.dump(table, file)
            file.flush()
            os.fsync(file.fileno())
        new.replace(path)
        _sync_folder(path.parent)
    except OSError as error:
        new.unlink(missing_ok=True)
        full = "Make room" if disk_is_full(error) else "Mend the folder"
        raise RecordingError(
            f"{path.name} cannot be kept in {path.parent}: {error.strerror}. {full}, then try "
            "again; nothing was changed."
        ) from error


def read_json(path: Path) -> dict[str, Any] | None:
    """The table in `path`; None where there is no such file. ConfigError where it is no table."""
    try:
        table = json.loads(path.read_bytes())
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        raise ConfigError(f"{path} cannot be used: {error}. Move it away.") from error
    if not isinstance(table, dict):
        raise ConfigError(f"{path} holds a {type(table).__name__}, not a table. Move it away.")
    return table


def _sync_folder(folder: Path) -> None:
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
