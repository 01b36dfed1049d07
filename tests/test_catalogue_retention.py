"""Retention lists; it deletes only what was listed, when it was told and confirmed."""

import json
import shutil
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from typer.testing import CliRunner

from servo_bench.catalogue import Catalogue
from servo_bench.catalogue.beside import FIGURE, beside, make_way_for_figures
from servo_bench.catalogue.retention import age, delete, let_go
from servo_bench.cli import catalogue as command
from servo_bench.errors import ConfigError, RecordingError
from tests.recording_files import FACTS, rows, write

NOW = datetime(2026, 6, 1, tzinfo=UTC)


@pytest.fixture
def catalogue(tmp_path: Path) -> Catalogue:
    """One old run, one old and tagged, one new, one from the future, one that is no recording."""
    for name, days in {"old": 100, "tagged": 100, "new": 10, "future": -400}.items():
        utc = (NOW - timedelta(days=days)).isoformat(timespec="seconds")
        write(tmp_path / f"{name}.mcap", rows(20), facts={**FACTS, "utc": utc})
    (tmp_path / "broken.mcap").write_text("?")
    made = Catalogue(tmp_path)
    made.refresh()
    made.annotate(made.id_of(tmp_path / "tagged.mcap"), tags=["keep"])
    return made


def _rule(catalogue: Catalogue, *keep: str) -> list[str]:
    return [run.name for run in let_go(catalogue.all(), timedelta(days=90), keep, NOW)]


def test_a_rule_lets_go_what_is_old_and_bears_no_tag_that_keeps(catalogue: Catalogue) -> None:
    assert _rule(catalogue, "keep") == ["old"]
    assert sorted(_rule(catalogue)) == ["old", "tagged"]


@pytest.mark.parametrize(("text", "hours"), [("36h", 36), ("90d", 2160), ("2w", 336)])
def test_ages(text: str, hours: int) -> None:
    assert age(text) == timedelta(hours=hours)


@pytest.mark.parametrize("text", ["", "90", "d", "-1d", "0d", "nan d", "1e400d", "3m", "1 0d"])
def test_what_is_no_age(text: str) -> None:
    with pytest.raises(ConfigError, match="no age"):
        age(text)


def test_deleting_takes_the_files_beside_too_and_nothing_else(catalogue: Catalogue) -> None:
    old = catalogue.folder / "old.mcap"
    for place in beside(old):
        place.write_text(json.dumps({FIGURE: 98.0}))
    catalogue.refresh()
    before = set(catalogue.folder.glob("*.mcap"))
    gone = [run for run in catalogue.all() if run.name == "old"]
    done = delete(catalogue, gone)
    assert (done.deleted, done.bytes, done.kept) == (1, gone[0].bytes, ())
    assert set(catalogue.folder.glob("*.mcap")) == before - {old}
    assert not any(place.exists() for place in beside(old))
    assert catalogue.search("old").total == 0


def test_what_a_measurement_was_imported_from_stays(catalogue: Catalogue) -> None:
    old = catalogue.folder / "old.mcap"
    theirs = {old.with_suffix(".json"): "[[0.0, 1.5], [0.008, 1.6]]", old.with_suffix(".html"): "x"}
    for place, text in theirs.items():
        place.write_text(text)
    catalogue.refresh()
    done = delete(catalogue, [run for run in catalogue.all() if run.name == "old"])
    assert done.deleted == 1
    assert {place: place.read_text() for place in theirs} == theirs
    tagged = catalogue.folder / "tagged.mcap"
    tagged.with_suffix(".json").write_text("[[0.0, 1.5]]")
    with pytest.raises(RecordingError, match=r"tagged\.json is there and holds no figures"):
        make_way_for_figures(tagged)
    make_way_for_figures(catalogue.folder / "new.mcap")


def test_what_has_changed_since_it_was_listed_is_kept(catalogue: Catalogue) -> None:
    gone = [run for run in catalogue.all() if run.name == "old"]
    catalogue.annotate(gone[0].id, notes="wait, this one matters")
    done = delete(catalogue, gone)
    assert (done.deleted, len(done.kept)) == (0, 1)
    assert (catalogue.folder / "old.mcap").exists()


def _prune(folder: Path, *words: str, answer: str = "") -> tuple[int, str]:
    done = CliRunner().invoke(
        command.app, ["prune", "--folder", str(folder), "--older-than", "1h", *words], input=answer
    )
    return done.exit_code, done.output + str(done.exception or "")


@pytest.mark.parametrize(
    ("words", "answer", "left"),
    [
        ((), "", 5),
        (("--delete",), "", 5),
        (("--delete",), "yes\nno\n", 5),
        (("--delete",), "99\n", 5),
        (("--delete", "--confirmed", "99"), "", 5),
        (("--confirmed", "3"), "", 5),
        (("--delete",), "3\n", 2),
        (("--delete", "--confirmed", "2", "--keep-tag", "keep"), "", 3),
    ],
)
def test_nothing_goes_without_the_right_number(
    catalogue: Catalogue, words: tuple[str, ...], answer: str, left: int
) -> None:
    _prune(catalogue.folder, *words, answer=answer)
    assert len(list(catalogue.folder.glob("*.mcap"))) == left


def test_search_and_note_from_the_command_line(catalogue: Catalogue, tmp_path: Path) -> None:
    runner, folder = CliRunner(), ["--folder", str(catalogue.folder)]
    path = str(catalogue.folder / "old.mcap")
    words = ["note", path, "--notes", "belt changed", "--tag", "belt", "--tag", "odd"]
    assert runner.invoke(command.app, words).exit_code == 0
    assert runner.invoke(command.app, ["note", path, "--untag", "odd"]).exit_code == 0
    found = runner.invoke(command.app, ["search", "belt", "changed", *folder])
    assert "old" in found.output
    assert catalogue.get(catalogue.id_of(Path(path))).tags == ("belt",)
    shown = runner.invoke(command.app, ["show", path])
    assert '"notes": "belt changed"' in shown.output
    shutil.copy(path, catalogue.folder / "copy.mcap")
    assert "6 recordings" in runner.invoke(command.app, ["rebuild", *folder]).output


@pytest.mark.parametrize(
    ("said", "folder"), [("", "recordings"), ('recordings = "kept"\n', "kept")]
)
def test_beside_a_bench_file_its_recordings_are_meant_with_the_daemons_ids(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, said: str, folder: str
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / folder).mkdir()
    write(tmp_path / folder / "run.mcap", rows(20))
    (tmp_path / "bench.toml").write_text(f'rig = "rigs/paper.toml"\n{said}')
    daemons = Catalogue(tmp_path / folder)
    number = daemons.id_of(tmp_path / folder / "run.mcap")
    done = CliRunner().invoke(command.app, ["search", "--json", "found.json"])
    assert done.exit_code == 0, done.output
    (run,) = json.loads((tmp_path / "found.json").read_text())["runs"]
    assert run["id"] == number
    assert CliRunner().invoke(command.app, ["show", number]).exit_code == 0
