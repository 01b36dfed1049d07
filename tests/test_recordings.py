"""The reference recordings are the ones that their manifest describes."""

from pathlib import Path

import pytest

from servo_bench.errors import ConfigError, RecordingError
from servo_bench.recording.mcap_file import load, recover
from servo_bench.recording.reference import (
    MAX_TOTAL_BYTES,
    Manifest,
    Reference,
    described,
    manifest_text,
    read_manifest,
    refresh,
)
from tests.recording_files import rows, write

FOLDER = Path(__file__).parent.parent / "recordings"
FILES = {"nominal.mcap": False, "hidden-effect.mcap": False, "cut.mcap": True}


def entry(file: str) -> Reference:
    """What the manifest says of one file."""
    (found,) = (one for one in read_manifest(FOLDER).recording if one.file == file)
    return found


def test_the_manifest_lists_what_is_there() -> None:
    assert {one.file: one.cut for one in read_manifest(FOLDER).recording} == FILES
    assert {path.name for path in FOLDER.glob("*.mcap")} == FILES.keys()
    assert sum(path.stat().st_size for path in FOLDER.iterdir()) <= MAX_TOTAL_BYTES


@pytest.mark.parametrize("file", FILES)
def test_a_file_is_what_the_manifest_says(file: str) -> None:
    """Size, checksum, samples, provenance."""
    said = entry(file)
    assert said == described(FOLDER, file, said.description, said.command)
    assert said.samples > 0
    assert said.command
    assert {"servo_bench", "python", "utc", "clock_utc_ns"} <= said.provenance.keys()


@pytest.mark.parametrize("file", [file for file, cut in FILES.items() if not cut])
def test_a_whole_one_loads(file: str) -> None:
    recording = load(FOLDER / file)
    assert not recording.cut
    assert len(recording) == entry(file).samples
    assert recording.experiment is not None
    assert recording.rig is not None


def test_the_cut_one_is_refused_and_recovers(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="servo-bench recover"):
        load(FOLDER / "cut.mcap")
    found = recover(FOLDER / "cut.mcap", tmp_path / "out.mcap")
    recording = load(tmp_path / "out.mcap")
    whole = load(FOLDER / "nominal.mcap")
    assert found.samples == len(recording) == entry("cut.mcap").samples
    for name in recording.channels:
        assert recording[name].tobytes() == whole[name][: len(recording)].tobytes()


HAND_WRITTEN = """
[[recording]]
file = "a.mcap"
description = "the \\"first\\""
command = "servo-bench run"
"""


def test_the_manifest_is_filled_in_from_the_files(tmp_path: Path) -> None:
    write(tmp_path / "a.mcap", rows(20), facts={"host": 'a "b" \\ c\n'})
    (tmp_path / "manifest.toml").write_text(HAND_WRITTEN)
    with pytest.raises(ConfigError, match="sha256"):
        read_manifest(tmp_path)
    manifest = refresh(tmp_path)
    assert read_manifest(tmp_path) == manifest
    (one,) = manifest.recording
    assert (one.samples, one.cut, one.description) == (20, False, 'the "first"')
    assert manifest_text(Manifest()) == ""


def test_a_missing_manifest_is_said(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"manifest\.toml"):
        read_manifest(tmp_path)
