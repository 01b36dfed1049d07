"""Recordings that lie beside a test."""

from dataclasses import dataclass
from pathlib import Path

from servo_bench.errors import RecordingError
from servo_bench.recording.mcap_file import load
from servo_bench.recording.recording import Recording


@dataclass(frozen=True, slots=True)
class Recordings:
    """What the fixture `recording` is: called with a name, it reads that file."""

    folders: tuple[Path, ...]

    def __call__(self, name: str, *, allow_cut: bool = False) -> Recording:
        """The recording of that name. RecordingError where it is nowhere, or cannot be read."""
        for folder in self.folders:
            if (folder / name).is_file():
                return load(folder / name, allow_cut=allow_cut)
        looked = ", ".join(str(folder / name) for folder in self.folders)
        raise RecordingError(
            f"there is no recording {name}: looked for {looked}. Put it beside the test, or name "
            "its folder in servo_bench_recordings."
        )
