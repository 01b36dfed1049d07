"""Writing results where the operator said, never over something that is there."""

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from servo_bench.errors import ConfigError, disk_is_full


def check_outputs(*paths: Path | None) -> None:
    """Raise ConfigError where an output is there already, named twice, or to be written nowhere.

    Asked before anything is computed: what took minutes is not to end without a place to go.
    """
    named = [path for path in paths if path is not None]
    for path in named:
        if named.count(path) > 1:
            raise ConfigError(f"{path} is named for two outputs: give each a file of its own.")
        try:
            is_there = path.exists()
        except OSError as error:  # a name that is too long
            raise _cannot_be_written(path, error.strerror) from error
        if is_there:
            raise ConfigError(f"{path} exists already: name another file, or move it away.")
        if not path.parent.is_dir():
            raise _cannot_be_written(path, "its folder is not there")
        if not os.access(path.parent, os.W_OK):
            raise _cannot_be_written(path, "nobody may write into its folder")


def _cannot_be_written(path: Path, why: str | None) -> ConfigError:
    return ConfigError(f"{path} cannot be written: {why}. Name a file in a folder that exists.")


def new_folder(path: Path) -> None:
    """Make a folder, if it is not there; ConfigError where it cannot be."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise ConfigError(
            f"{path} cannot be made a folder: {error.strerror}. Give another --out."
        ) from error


def write_text(path: Path, text: str) -> None:
    """Write a new file; ConfigError where the folder is missing or the file is there."""
    write_bytes(path, text.encode())


def write_bytes(path: Path, content: bytes) -> None:
    """Write a new file; ConfigError where the folder is missing or the file is there."""
    try:
        file = path.open("xb")
    except FileExistsError:
        check_outputs(path)
        return
    except OSError as error:
        raise _cannot_be_written(path, error.strerror) from error
    try:
        with file:
            file.write(content)
    except BaseException as error:  # half a file is none, and would stand in the next one's way
        path.unlink(missing_ok=True)
        if disk_is_full(error):
            raise ConfigError(f"{path} cannot be written: the disk is full. Make room.") from error
        if isinstance(error, OSError):
            raise _cannot_be_written(path, error.strerror) from error
        raise


def write_json(path: Path, numbers: Mapping[str, Any]) -> None:
    """Write figures as JSON to a new file."""
    write_text(path, json.dumps(numbers, indent=2) + "\n")
