"""The reference recordings of recordings/: their manifest, and what it must say of each file.

The hand writes `file`, `description` and `command`; everything else is taken from the files:

    python -m servo_bench.recording.reference recordings
"""

import hashlib
import json
import sys
import tomllib
from pathlib import Path
from typing import Any

from pydantic import Field

from servo_bench.errors import ConfigError
from servo_bench.files import Value, read_toml, validated
from servo_bench.recording.reader import contents_of, load, read_bytes

MANIFEST = "manifest.toml"
MAX_TOTAL_BYTES = 5_000_000
HAND_WRITTEN = ("file", "description", "command")


class Reference(Value):
    """One file: what it is for, the command that made it, and what it holds."""

    file: str = Field(pattern=r"^[a-z0-9-]+\.mcap$")
    description: str
    command: str
    cut: bool
    samples: int
    bytes: int
    sha256: str = Field(pattern=r"^[0-9a-f]{64}$")
    provenance: dict[str, str]


class Manifest(Value):
    """Everything in recordings/."""

    recording: tuple[Reference, ...] = ()


def read_manifest(folder: Path) -> Manifest:
    """The manifest in `folder`; ConfigError where it is missing or incomplete."""
    path = folder / MANIFEST
    if not path.is_file():
        raise ConfigError(f"there is no {path}. Write it as {folder / 'README.md'} says.")
    return validated(Manifest, read_toml(path), str(path))


def described(folder: Path, file: str, description: str, command: str) -> Reference:
    """What the manifest must say of one file. RecordingError where nothing of it can be read."""
    path = folder / file
    data = read_bytes(path)
    recording = load(path, allow_cut=True)
    return Reference(
        file=file,
        description=description,
        command=command,
        cut=contents_of(data, path).cut,
        samples=len(recording),
        bytes=len(data),
        sha256=hashlib.sha256(data).hexdigest(),
        provenance=dict(recording.provenance),
    )


def refresh(folder: Path) -> Manifest:
    """Write the manifest anew: the hand's three keys as they are, the rest from the files."""
    tables = tomllib.loads((folder / MANIFEST).read_text()).get("recording", [])
    manifest = Manifest(
        recording=tuple(
            described(folder, *(table[key] for key in HAND_WRITTEN)) for table in tables
        )
    )
    (folder / MANIFEST).write_text(manifest_text(manifest))
    return manifest


def manifest_text(manifest: Manifest) -> str:
    """The manifest as TOML."""
    return "\n".join(_entry(reference.model_dump()) for reference in manifest.recording)


def _entry(table: dict[str, Any]) -> str:
    provenance = table.pop("provenance")
    lines = ["[[recording]]", *_pairs(table), "", "[recording.provenance]", *_pairs(provenance)]
    return "\n".join(lines) + "\n"


def _pairs(table: dict[str, Any]) -> list[str]:
    # a JSON string, number or truth value is one of TOML too
    return [f"{key} = {json.dumps(value, ensure_ascii=False)}" for key, value in table.items()]


if __name__ == "__main__":
    refresh(Path(sys.argv[1]))
