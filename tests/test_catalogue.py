"""The catalogue is what the files say, whoever changes them, and however often it is made anew."""

import json
import multiprocessing
import os
import shutil
import sqlite3
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from servo_bench.catalogue import Catalogue, Run, reading, run_id
from servo_bench.catalogue import catalogue as catalogue_module
from servo_bench.catalogue.beside import Notes, beside, read_notes, write_notes
from servo_bench.catalogue.index import NAME
from servo_bench.errors import ConfigError, RecordingError
from servo_bench.recording.recording import Event
from tests.recording_files import EXPERIMENT, RIG, json_messages, rows, strangers_file, write

HOSTILE_NAMES = (
    "semi;colon'quote\".mcap",
    "new\nline.mcap",
    "\x1b[31mred.mcap",
    "<img src=x onerror=alert(1)>.mcap",
    "%s%n{0}.mcap",
    "..mcap.mcap",
    "-rf.mcap",
    "ünïcødé \u202e reversed.mcap",
    "%2e%2e%2f.mcap",
    "UPPER.MCAP",
)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A whole recording, to be copied."""
    return write(tmp_path_factory.mktemp("whole") / "whole.mcap", rows(200))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder of recordings that is empty yet."""
    made = tmp_path / "recordings"
    made.mkdir()
    return made


def _refreshed(folder: Path) -> Catalogue:
    catalogue = Catalogue(folder)
    catalogue.refresh()
    return catalogue


def _only(catalogue: Catalogue) -> Run:
    (run,) = catalogue.search().runs
    return run


def test_a_run_says_what_its_recording_says(folder: Path) -> None:
    path = folder / "first.mcap"
    write(path, rows(200))
    run = _only(_refreshed(folder))
    assert (run.name, run.file, run.state) == ("first", "first.mcap", "complete")
    assert (run.experiment, run.rig) == (EXPERIMENT.name, RIG.name)
    assert run.excitation.startswith("m-sequence 15341 at ")
    assert run.seconds == pytest.approx(200 * EXPERIMENT.period_s)
    assert run.bytes == path.stat().st_size
    assert run.missed == 0
    assert run.id == run_id(Path("first.mcap"))


@pytest.mark.parametrize(
    ("events", "state", "words"),
    [
        ((Event(1, "error", "drive 1 is in fault", {"error": "DriveError"}),), "faulted", "fault"),
        ((Event(1, "stop asked", "the operator asked"),), "stopped", "by the operator after 50"),
        ((Event(1, "stop asked", "", {"by": "Ada (smoke)"}),), "stopped", "by Ada (smoke) after"),
        (
            (Event(1, "stop asked", "", {"by": "Ada\x1b[2J"}),),
            "stopped",
            "by Ada\N{REPLACEMENT CHARACTER}[2J",
        ),
        ((Event(1, "stop asked", "", {"by": ["Ada"]}),), "stopped", "by the operator after"),
        ((Event(1, "slot skipped", "", {"slot": 5, "to": 9}),), "complete", "4 slots missed"),
    ],
)
def test_how_a_run_ended(folder: Path, events: tuple[Event, ...], state: str, words: str) -> None:
    write(folder / "run.mcap", rows(50), events)
    run = _only(_refreshed(folder))
    assert run.state == state
    assert words in run.sentence


def test_cut_and_foreign_files_are_listed_as_such(folder: Path, whole: Path) -> None:
    data = whole.read_bytes()
    (folder / "cut.mcap").write_bytes(data[: len(data) * 2 // 3])
    (folder / "text.mcap").write_text("not MCAP")
    (folder / "empty.mcap").write_bytes(b"")
    (folder / "ignored.txt").write_text("no recording")
    names = ["slot", "phase", "chip", "velocity_command_rad_s", "load_angle_rad"]
    messages = json_messages(rows(20), names)
    strangers_file(folder / "stranger.mcap", messages)
    strangers_file(folder / "camera.mcap", messages[:1], topic="/other", facts={"period_s": "x"})
    states = {run.name: run.state for run in _refreshed(folder).search().runs}
    assert states == {
        "cut": "cut",
        "text": "unreadable",
        "empty": "unreadable",
        "stranger": "complete",
        "camera": "complete",
    }


def test_the_summary_and_the_walk_agree(folder: Path, whole: Path) -> None:
    """Without its summary the same file is walked, and says the same but that it is whole."""
    shutil.copy(whole, folder / "whole.mcap")
    (folder / "cut.mcap").write_bytes(whole.read_bytes()[:-8])
    runs = {run.name: run for run in _refreshed(folder).search().runs}
    for fact in ("experiment", "rig", "excitation", "seconds", "missed", "started_utc"):
        assert getattr(runs["whole"], fact) == getattr(runs["cut"], fact)
    assert runs["cut"].state == "cut"


def test_nothing_changed_means_nothing_read(folder: Path, whole: Path) -> None:
    for number in range(3):
        shutil.copy(whole, folder / f"{number}.mcap")
    catalogue = Catalogue(folder)
    first, second = catalogue.refresh(), catalogue.refresh()
    assert (first.added, first.changed, first.removed, first.unchanged) == (3, 0, 0, 0)
    assert (second.added, second.changed, second.removed, second.unchanged) == (0, 0, 0, 3)


def test_a_clock_that_was_set_back_hides_no_change(folder: Path, whole: Path) -> None:
    path = folder / "run.mcap"
    shutil.copy(whole, path)
    catalogue = _refreshed(folder)
    path.unlink()
    write(path, rows(30))
    os.utime(path, (1_000_000, 1_000_000))
    assert catalogue.refresh().changed == 1
    assert _only(catalogue).seconds == pytest.approx(30 * EXPERIMENT.period_s)


def test_a_deleted_recording_vanishes(folder: Path, whole: Path) -> None:
    path = folder / "run.mcap"
    shutil.copy(whole, path)
    catalogue = _refreshed(folder)
    number = _only(catalogue).id
    path.unlink()
    with pytest.raises(RecordingError, match="was deleted"):
        catalogue.path(number)
    with pytest.raises(RecordingError, match="there is no run"):
        catalogue.get(number)
    assert catalogue.search().total == 0


def test_notes_and_tags_outlive_the_index(folder: Path, whole: Path) -> None:
    shutil.copy(whole, folder / "run.mcap")
    catalogue = _refreshed(folder)
    number = _only(catalogue).id
    catalogue.annotate(number, notes="knocks at 3 Hz\nsee photo", tags=["knock", " knock", "x"])
    catalogue.annotate(number, operator="Ada")
    before = catalogue.get(number)
    catalogue.rebuild()
    assert catalogue.get(number) == before
    assert (before.notes, before.tags) == ("knocks at 3 Hz\nsee photo", ("knock", "x"))
    assert catalogue.search("KNOCKS 3", tag="x").runs == (before,)
    assert catalogue.search(tag="kno").total == 0


def test_notes_can_be_written_before_the_recording(folder: Path, whole: Path) -> None:
    path = folder / "run.mcap"
    write_notes(path, Notes(notes="planned", tags=("night",), operator="Ada"))
    shutil.copy(whole, path)
    run = _only(_refreshed(folder))
    assert (run.notes, run.tags, run.operator) == ("planned", ("night",), "Ada")
    assert run.id == Catalogue(folder).id_of(path)


def test_damaged_notes_are_told_and_never_replaced(folder: Path, whole: Path) -> None:
    shutil.copy(whole, folder / "run.mcap")
    path = beside(folder / "run.mcap").notes
    path.write_text('{"notes": "precious", "tags": [')
    catalogue = _refreshed(folder)
    run = _only(catalogue)
    assert "not a JSON object" in run.notes
    with pytest.raises(RecordingError, match="Mend it"):
        catalogue.annotate(run.id, notes="new")
    assert "precious" in path.read_text()


@pytest.mark.parametrize("tags", [["x" * 65], ["a\nb"], ["\ud800"], [str(n) for n in range(65)]])
def test_tags_that_cannot_be_are_refused(folder: Path, whole: Path, tags: list[str]) -> None:
    shutil.copy(whole, folder / "run.mcap")
    catalogue = _refreshed(folder)
    with pytest.raises(RecordingError, match="tags"):
        catalogue.annotate(_only(catalogue).id, tags=tags)
    assert _only(catalogue).tags == ()


def test_figures_and_verdict_come_from_the_files_beside(folder: Path, whole: Path) -> None:
    shutil.copy(whole, folder / "run.mcap")
    catalogue = _refreshed(folder)
    number = _only(catalogue).id
    figures = {"vaf_same_order3_percent": 95.5, "flags": ["a"], "run": {"slots": 1}, "memory": 9}
    catalogue.store_figures(number, figures)
    verdict = {"verdict": "named", "causes": [{"effect": "coulomb"}, {"effect": "cogging"}]}
    run = catalogue.store_diagnosis(number, verdict)
    assert dict(run.figures) == {"vaf_same_order3_percent": 95.5, "memory": 9}
    assert (run.verdict, run.causes) == ("named", ("coulomb", "cogging"))
    assert catalogue.search("cogging").runs == (run,)
    beside(folder / "run.mcap").diagnosis.unlink()
    assert catalogue.get(number).verdict is None


@pytest.mark.parametrize(
    "text", ["", "[]", "nonsense", '{"verdict": 3, "causes": 7}', "[" * 100_000, '{"a": NaN}']
)
def test_what_lies_beside_may_be_anything(folder: Path, whole: Path, text: str) -> None:
    shutil.copy(whole, folder / "run.mcap")
    for place in beside(folder / "run.mcap"):
        place.write_text(text)
    run = _only(_refreshed(folder))
    assert (run.state, run.verdict, dict(run.figures)) == ("complete", None, {})


def test_hostile_names_are_listed_searched_and_opened(folder: Path, whole: Path) -> None:
    raw = os.fsencode(folder) + b"/bytes-\xff\xfe.mcap"
    for name in HOSTILE_NAMES:
        shutil.copy(whole, folder / name)
    Path(os.fsdecode(raw)).write_bytes(whole.read_bytes())
    catalogue = _refreshed(folder)
    page = catalogue.search(limit=100)
    assert page.total == len(HOSTILE_NAMES) + 1
    for run in page.runs:
        assert run.name.isprintable()
        assert json.loads(run.json())["id"] == run.id
        path = catalogue.path(run.id)
        assert path.read_bytes() == whole.read_bytes()
        assert catalogue.annotate(run.id, notes="x").notes == "x"
        assert read_notes(path).notes == "x"
    assert catalogue.search("%").total == 2
    assert catalogue.search("'quote").total == 1
    assert catalogue.rebuild().changed == len(HOSTILE_NAMES) + 1


def test_no_id_and_no_link_leads_out_of_the_folder(
    folder: Path, whole: Path, tmp_path: Path
) -> None:
    outside = tmp_path / "outside.mcap"
    shutil.copy(whole, outside)
    (folder / "link.mcap").symlink_to(outside)
    (folder / "sub").symlink_to(tmp_path)
    os.mkfifo(folder / "pipe.mcap")
    catalogue = _refreshed(folder)
    assert catalogue.search().total == 0
    for number in ("../outside", "", "x" * 10_000, "'; DROP TABLE runs; --"):
        with pytest.raises(RecordingError):
            catalogue.path(number)
    with pytest.raises(RecordingError, match="not in the catalogue's folder"):
        catalogue.id_of(outside)
    assert run_id(Path("outside.mcap")) != run_id(Path("../outside.mcap"))


def test_a_recording_that_becomes_a_link_is_gone(folder: Path, whole: Path, tmp_path: Path) -> None:
    shutil.copy(whole, folder / "run.mcap")
    catalogue = _refreshed(folder)
    number = _only(catalogue).id
    shutil.copy(whole, tmp_path / "secret.mcap")
    (folder / "run.mcap").unlink()
    (folder / "run.mcap").symlink_to(tmp_path / "secret.mcap")
    with pytest.raises(RecordingError, match="was deleted"):
        catalogue.path(number)


def test_damaged_bytes_give_a_line_and_never_an_error(folder: Path, whole: Path) -> None:
    data = bytearray(whole.read_bytes())
    rng = np.random.default_rng(1)
    for number in range(120):
        spoilt = bytearray(data)
        for place in rng.integers(8, len(data), 1 + number % 4):
            spoilt[place] = int(rng.integers(0, 256))
        near_end = len(data) - 1 - int(rng.integers(0, 400))
        spoilt[near_end] ^= int(rng.integers(1, 256))
        (folder / f"{number}.mcap").write_bytes(spoilt)
    runs = _refreshed(folder).search(limit=200).runs
    assert len(runs) == 120
    assert all(run.sentence for run in runs)


def test_one_odd_file_keeps_nobody_from_the_others(folder: Path, whole: Path) -> None:
    shutil.copy(whole, folder / "whole.mcap")
    skipped = Event(1, "slot skipped", "", {"slot": 0, "to": 10**400})
    write(folder / "skipped.mcap", rows(20), (skipped,))
    names = ["slot", "phase", "chip", "velocity_command_rad_s", "load_angle_rad"]
    messages = json_messages(rows(20), names)
    strangers_file(folder / "slow.mcap", messages, facts={"period_s": "1e308"})
    runs = {run.name: run for run in _refreshed(folder).search().runs}
    assert {name: run.state for name, run in runs.items()} == {
        "whole": "complete",
        "skipped": "unreadable",
        "slow": "complete",
    }
    assert "cannot be listed" in runs["skipped"].sentence
    assert runs["slow"].seconds is None


@pytest.mark.parametrize("changed_s", [2.6e11, 1e300, -1e300])
def test_a_files_time_may_be_anything(folder: Path, changed_s: float) -> None:
    (folder / "text.mcap").write_text("not MCAP")
    run = reading.run_of(folder, Path("text.mcap"), 8, changed_s)
    assert run.started_utc.startswith("9999-12-31")


def test_a_folder_that_goes_during_the_walk_is_gone(
    folder: Path, whole: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("stays", "goes"):
        (folder / name).mkdir()
        shutil.copy(whole, folder / name / "run.mcap")
    walk = os.walk

    def walked(top: Path) -> Iterator[Any]:
        for found in walk(top):
            if Path(found[0]).name == "goes":
                shutil.rmtree(found[0])
            yield found

    monkeypatch.setattr(catalogue_module.os, "walk", walked)
    assert _only(_refreshed(folder)).file == "stays/run.mcap"


def test_a_name_too_long_for_notes_is_listed_and_told(folder: Path, whole: Path) -> None:
    shutil.copy(whole, folder / ("x" * 250 + ".mcap"))
    catalogue = _refreshed(folder)
    run = _only(catalogue)
    assert run.state == "complete"
    with pytest.raises(RecordingError, match="name too long"):
        catalogue.annotate(run.id, notes="note")


def test_pages_of_a_search_are_disjoint_and_complete(folder: Path, whole: Path) -> None:
    for number in range(7):
        shutil.copy(whole, folder / f"{number}.mcap")
    catalogue = _refreshed(folder)
    pages = [catalogue.search(limit=3, offset=offset) for offset in (0, 3, 6)]
    assert {page.total for page in pages} == {7}
    assert sorted(run.name for page in pages for run in page.runs) == [str(n) for n in range(7)]


def _spoil(path: Path) -> None:
    path.write_bytes(b"SQLite format 3\0" + b"\xff" * 4096)


def _other_version(path: Path) -> None:
    path.unlink()
    with sqlite3.connect(path) as connection:
        connection.execute("CREATE TABLE runs (something TEXT)")
        connection.execute("PRAGMA user_version = 99")
    connection.close()


@pytest.mark.parametrize("spoil", [_spoil, _other_version, Path.unlink, lambda p: p.write_text("")])
def test_an_index_that_was_damaged_is_made_anew(
    folder: Path, whole: Path, spoil: Callable[[Path], object]
) -> None:
    shutil.copy(whole, folder / "run.mcap")
    before = _only(_refreshed(folder))
    for ending in ("-wal", "-shm"):
        (folder / (NAME + ending)).unlink(missing_ok=True)
    spoil(folder / NAME)
    assert _only(_refreshed(folder)) == before


def test_damage_within_the_index_is_told_and_mended_by_a_rebuild(folder: Path, whole: Path) -> None:
    for number in range(40):
        shutil.copy(whole, folder / f"{number}.mcap")
    catalogue = _refreshed(folder)
    with sqlite3.connect(folder / NAME) as connection:
        connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    connection.close()
    data = bytearray((folder / NAME).read_bytes())
    data[8192:] = b"\xa5" * (len(data) - 8192)
    (folder / NAME).write_bytes(data)
    with pytest.raises(RecordingError, match="catalogue rebuild"):
        catalogue.search(limit=100)
    catalogue.rebuild()
    assert catalogue.search(limit=100).total == 40


def test_a_folder_that_is_not_there_and_an_index_that_cannot_be(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="there is no folder"):
        Catalogue(tmp_path / "no")
    with pytest.raises(ConfigError, match="cannot be used"):
        Catalogue(tmp_path, tmp_path / "no" / "index.sqlite").refresh()


def _busy(folder: str, number: int) -> None:
    catalogue = Catalogue(Path(folder))
    for turn in range(4):
        catalogue.refresh()
        own = run_id(Path(f"{number}.mcap"))
        catalogue.annotate(own, tags=[*catalogue.get(own).tags, f"turn {turn}"])
        catalogue.annotate(run_id(Path("shared.mcap")), notes=f"by {number} in turn {turn}")


def test_processes_share_a_catalogue(folder: Path, whole: Path) -> None:
    for name in ("0", "1", "2", "shared"):
        shutil.copy(whole, folder / f"{name}.mcap")
    context = multiprocessing.get_context("fork")
    workers = [context.Process(target=_busy, args=(str(folder), n)) for n in range(3)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join(60)
    assert [worker.exitcode for worker in workers] == [0, 0, 0]
    catalogue = _refreshed(folder)
    assert catalogue.search().total == 4
    runs = {run.name: run for run in catalogue.all()}
    for number in range(3):
        assert runs[str(number)].tags == tuple(f"turn {turn}" for turn in range(4))
    assert runs["shared"].notes.endswith("in turn 3")
    assert all(run == catalogue.get(run.id) for run in runs.values())
