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


def write_text(path: Path, text: str) -> None:
    """Write a new file; ConfigError where the folder is missing or the file is there."""
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError:
        refuse_existing(path)
    except OSError as error:
        raise ConfigError(f"{path} cannot be written: {error.strerror}.") from error


def write_json(path: Path, numbers: Mapping[str, Any]) -> None:
    """Write figures as JSON to a new file."""
    write_text(path, json.dumps(numbers, indent=2) + "\n")
