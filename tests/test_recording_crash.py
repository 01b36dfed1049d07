"""A recorder that is killed, and a disk that is full: what was kept stays readable."""

import errno
import os
import signal
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Self

import pytest

from servo_bench.errors import RecordingError, WireError
from servo_bench.recording import sink
from servo_bench.recording.mcap_file import RecordingWriter, load, recover
from servo_bench.recording.recording import Event
from servo_bench.run import session
from tests import small_runs
from tests.recording_files import EVENT, EXPERIMENT, FACTS, RIG, rows

ROWS_PER_S = 125
RECORDER = """
import sys
import time
from servo_bench.clock import monotonic_ns
from servo_bench.recording.provenance import provenance
from tests.recording_files import EXPERIMENT, RIG, rows
from servo_bench.recording.mcap_file import RecordingWriter

table = rows(2000)
began_ns = monotonic_ns()
with RecordingWriter(sys.argv[1], EXPERIMENT, RIG, provenance(), 125.0) as writer:
    for slot in range(len(table)):
        time.sleep(max(0, began_ns + slot * 8_000_000 - monotonic_ns()) * 1e-9)
        table["asked_ns"][slot] = monotonic_ns()
        writer.samples(table[slot : slot + 1])
        sys.stdout.write(f"{slot}\\n")
        sys.stdout.flush()
"""


def test_kill_9_costs_at_most_a_second(tmp_path: Path) -> None:
    path, out = tmp_path / "a.mcap", tmp_path / "b.mcap"
    root = Path(__file__).parent.parent
    with subprocess.Popen(
        [sys.executable, "-c", RECORDER, path], stdout=subprocess.PIPE, cwd=root, text=True
    ) as process:
        assert process.stdout is not None
        reported = -1
        while reported < 3 * ROWS_PER_S + 40:
            reported = int(process.stdout.readline())
        process.kill()
        rest = process.stdout.read().split("\n")
        assert process.wait() == -signal.SIGKILL
    reported = max([reported, *(int(line) for line in rest[:-1] if line)])
    with pytest.raises(RecordingError, match="was cut"):
        load(path)
    found = recover(path, out)
    recording = load(out)
    assert found.samples == len(recording) == len(load(path, allow_cut=True))
    assert recording["slot"].tolist() == list(range(len(recording)))
    assert reported - ROWS_PER_S <= len(recording) - 1
    assert recording.experiment == EXPERIMENT
    assert recording.rig == RIG


@pytest.mark.parametrize(("every", "slots"), [(1, 500), (3, 700), (40, 1500)])
def test_at_any_moment_less_than_a_second_is_not_in_the_file(
    tmp_path: Path, every: int, slots: int
) -> None:
    """Also where slots are skipped, so that fewer rows come in a second."""
    path = tmp_path / "a.mcap"
    table = rows(slots)[::every]
    with RecordingWriter(path, EXPERIMENT, RIG, FACTS, ROWS_PER_S) as writer:
        for row in range(table.size):
            writer.samples(table[row : row + 1])
            kept = len(load(path, allow_cut=True))
            held_ns = table["asked_ns"][row] - table["asked_ns"][min(kept, row)]
            assert held_ns < 10**9
    assert len(load(path)) == table.size


def test_an_event_is_in_the_file_at_once_with_all_before_it(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with RecordingWriter(path, EXPERIMENT, RIG, FACTS, ROWS_PER_S) as writer:
        writer.samples(rows(5))
        assert len(load(path, allow_cut=True)) == 0
        writer.event(EVENT)
        recording = load(path, allow_cut=True)
    assert recording.events == (EVENT,)
    assert len(recording) == 5


FULL_DISK = """
import resource, signal, sys
from tests.recording_files import EXPERIMENT, FACTS, RIG, rows
from servo_bench.errors import RecordingError
from servo_bench.recording.mcap_file import RecordingWriter

signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))
try:
    with RecordingWriter(sys.argv[1], EXPERIMENT, RIG, FACTS, 125.0) as writer:
        for part in rows(3000).reshape(50, 60):
            writer.samples(part)
except RecordingError as error:
    sys.stdout.write(str(error))
"""


def test_a_file_that_may_not_grow_keeps_what_it_has(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    said = subprocess.run(
        [sys.executable, "-c", FULL_DISK, path],
        cwd=Path(__file__).parent.parent,
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    assert path.stat().st_size == 20_000
    kept = len(load(path, allow_cut=True))
    assert kept > 0
    assert f"a.mcap cannot be written any further: File too large. {kept} samples are kept" in said
    assert said.endswith(f"servo-bench recover {path}")


class SmallDisk:
    """`os.write` on a disk with room for so many bytes."""

    def __init__(self, room: int) -> None:
        self.room = room

    def __call__(self, descriptor: int, data: memoryview) -> int:
        if self.room == 0:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        written = os.pwritev(descriptor, [data[: self.room]], os.fstat(descriptor).st_size)
        self.room -= written
        return written


def on_a_disk_of(room: int, path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Write 200 rows with ENOSPC after `room` bytes, and try again after it."""
    with monkeypatch.context() as patch:
        patch.setattr(sink.os, "write", SmallDisk(room))
        with RecordingWriter(path, EXPERIMENT, RIG, FACTS, ROWS_PER_S) as writer:
            table = rows(200)
            for first in range(0, 200, 12):
                try:
                    writer.samples(table[first : first + 12])
                except RecordingError:
                    with pytest.raises(RecordingError, match="No space left"):
                        writer.event(EVENT)
                    raise


@pytest.mark.parametrize("room", [4_500, 9_000, 17_000, 22_000])
def test_a_full_disk_is_said_and_what_is_there_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, room: int
) -> None:
    path = tmp_path / "a.mcap"
    with pytest.raises(RecordingError, match="No space left on device") as caught:
        on_a_disk_of(room, path, monkeypatch)
    kept = load(path, allow_cut=True)
    assert f"{len(kept)} samples are kept" in str(caught.value)
    assert kept["slot"].tolist() == list(range(len(kept)))


def test_a_disk_without_room_for_the_head_is_left_without_a_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(RecordingError, match="No space left on device"):
        on_a_disk_of(500, tmp_path / "a.mcap", monkeypatch)
    assert list(tmp_path.iterdir()) == []


def test_recovery_onto_a_full_disk_leaves_no_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "a.mcap"
    with RecordingWriter(path, EXPERIMENT, RIG, FACTS, ROWS_PER_S) as writer:
        writer.samples(rows(200))
    monkeypatch.setattr(sink.os, "write", SmallDisk(5_000))
    with pytest.raises(RecordingError, match="No space left on device"):
        recover(path, tmp_path / "b.mcap")
    assert list(tmp_path.iterdir()) == [path]


def test_a_full_disk_does_not_hide_what_ended_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def run() -> None:
        with RecordingWriter(tmp_path / "a.mcap", EXPERIMENT, RIG, FACTS, ROWS_PER_S) as writer:
            writer.samples(rows(5))
            monkeypatch.setattr(sink.os, "write", SmallDisk(0))
            raise KeyError("the run's own")

    with pytest.raises(KeyError) as caught:
        run()
    assert "No space left" in caught.value.__notes__[0]


class ToldLoop:
    """A bus loop that says one thing after another, and has ended when all is said."""

    stop_takes_s = 60.0

    def __init__(self, *told: tuple[str, str]) -> None:
        self.told = list(told)
        self.process = SimpleNamespace(returncode=1)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None: ...

    @property
    def ended(self) -> bool:
        return not self.told

    over = ended

    def events(self, timeout_s: float) -> list[session.Told]:
        now, self.told = self.told[:1], self.told[1:]
        return [(Event(1, kind, text, {}), kind == "error") for kind, text in now]


def run_onto_a_disk_that_fills(
    loop: ToldLoop, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Run with a disk that is full once the first word has been written."""
    with monkeypatch.context() as patch:
        patch.setattr(session, "_Loop", lambda job: loop)
        session.run(
            small_runs.experiment(),
            small_runs.paper_rig(),
            folder / "a.mcap",
            progress=lambda _: patch.setattr(sink.os, "write", SmallDisk(0)),
        )


def test_a_full_disk_does_not_hide_that_the_rig_did_not_confirm_its_stop(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    loop = ToldLoop(
        ("playing", "the drive is enabled"),
        ("answer lost", "the first that the disk refuses"),
        ("error", "drive 1 did not confirm its stop."),
        ("supervisor's stop", "nobody answers."),
    )
    with pytest.raises(RecordingError, match="No space left") as raised:
        run_onto_a_disk_that_fills(loop, tmp_path, monkeypatch)
    assert loop.over, "it was heard to its end"
    assert str(raised.value).endswith("Of the rig: drive 1 did not confirm its stop.")


def test_a_disk_that_is_full_at_the_end_does_not_hide_what_ended_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    loop = ToldLoop(("playing", "the drive is enabled"))
    with pytest.raises(WireError, match=r"ended without a word.*No space left"):
        run_onto_a_disk_that_fills(loop, tmp_path, monkeypatch)
