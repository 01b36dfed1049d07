"""Writing results where the operator said, never over something that is there."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from servo_bench.errors import ConfigError


def refuse_existing(*paths: Path | None) -> None:
    """Raise ConfigError where one of the outputs is already there."""
    for path in paths:
        if path is not None and path.exists():
            raise ConfigError(f"{path} exists already: name another file, or move it away.")


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
        with path.open("xb") as file:
            file.write(content)
    except FileExistsError:
        refuse_existing(path)
    except OSError as error:
        raise ConfigError(
            f"{path} cannot be written: {error.strerror}. Name a file in a folder that exists."
        ) from error


def write_json(path: Path, numbers: Mapping[str, Any]) -> None:
    """Write figures as JSON to a new file."""
    write_text(path, json.dumps(numbers, indent=2) + "\n")
