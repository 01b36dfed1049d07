"""Files that end too early, or are not what they were: our errors only, and all that is whole."""

import re
import tracemalloc
from pathlib import Path
from tempfile import TemporaryDirectory

import lz4.frame
import pytest
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Chunk

from servo_bench.errors import RecordingError
from servo_bench.recording.format import MAX_CHUNK_BYTES, MIB
from servo_bench.recording.mcap_file import Recovered, load, recover
from servo_bench.recording.recording import Recording
from servo_bench.recording.scan import MAGIC, End, scan
from tests.fuzz_files import whole
from tests.recording_files import NAMES, rows

TABLE = rows(200)


def loaded(data: bytes, *, allow_cut: bool) -> Recording | RecordingError:
    """What loading those bytes gives; any other exception is the test's failure."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "a.mcap"
        path.write_bytes(data)
        try:
            return load(path, allow_cut=allow_cut)
        except RecordingError as error:
            return error


def data_end(data: bytes) -> int:
    """Where the data section ends."""
    (end,) = (item for item in scan(data) if isinstance(item, End))
    return end.offset


OTHER_KINDS = ("no chunks", "NONE", "ZSTD")


@pytest.mark.parametrize(
    "kind", ["ours", "LZ4", *(pytest.param(it, marks=pytest.mark.long) for it in OTHER_KINDS)]
)
def test_cut_anywhere_it_keeps_what_was_before_the_cut(kind: str) -> None:
    data = whole(kind)
    step = len(data) // 20
    near_the_end = range(len(data) - 60, len(data), 5)
    kept = 0
    for length in (*range(0, 60, 4), *range(60, len(data) - 60, step), *near_the_end):
        error = loaded(data[:length], allow_cut=False)
        assert isinstance(error, RecordingError)
        recording = loaded(data[:length], allow_cut=True)
        if isinstance(recording, RecordingError):
            assert kept == 0
            continue
        assert recording.cut
        assert len(recording) >= kept
        kept = len(recording)
        for name in recording.channels:
            assert recording[name].tobytes() == TABLE[name][:kept].tobytes()
        assert f"{kept} samples" in str(error)
        assert re.search(r"servo-bench recover \S+a\.mcap$", str(error))
    assert kept == len(TABLE)


def test_without_the_summary_nothing_is_lost(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(whole()[: data_end(whole())])
    found = recover(path, tmp_path / "b.mcap")
    assert found == Recovered(200, 1.6, 1, lost_bytes=0, was_cut=True)


@pytest.mark.parametrize("kind", ["ours", "no chunks", "NONE", "LZ4"])
@pytest.mark.parametrize("share", [0.4, 0.77, 0.95])
def test_recovery_makes_a_whole_file_of_all_that_can_be_read(
    tmp_path: Path, kind: str, share: float
) -> None:
    cut, out = tmp_path / "cut.mcap", tmp_path / "out.mcap"
    cut.write_bytes(whole(kind)[: int(share * data_end(whole(kind)))])
    readable = load(cut, allow_cut=True)
    found = recover(cut, out)
    recording = load(out)
    assert recording.cut
    assert 0 < len(recording) < len(TABLE)
    assert found.samples == len(recording) == len(readable)
    assert found.events == len(recording.events)
    assert found.seconds == pytest.approx(len(recording) * 0.008)
    assert found.was_cut
    for name in recording.channels:
        assert recording[name].tobytes() == readable[name].tobytes()
    assert (recording.experiment, recording.rig) == (readable.experiment, readable.rig)
    assert recording.provenance == readable.provenance
    assert recover(out, tmp_path / "again.mcap").was_cut is False
    assert load(tmp_path / "again.mcap").cut


def test_a_whole_file_is_copied_and_said_to_be_whole(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(whole())
    found = recover(path, tmp_path / "b.mcap")
    assert found == Recovered(200, 1.6, 1, lost_bytes=0, was_cut=False)
    assert not load(tmp_path / "b.mcap").cut


def test_recovery_overwrites_nothing(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(whole())
    with pytest.raises(RecordingError, match="never overwritten"):
        recover(path, path)
    assert path.read_bytes() == whole()


def test_recovery_that_is_interrupted_leaves_no_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, out = tmp_path / "a.mcap", tmp_path / "b.mcap"
    path.write_bytes(whole())

    def interrupted(*_: object) -> None:
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr("servo_bench.recording.recover._copy_messages", interrupted)
        with pytest.raises(KeyboardInterrupt):
            recover(path, out)
    assert recover(path, out).samples > 0


def test_recovery_of_a_file_without_samples_leaves_no_file(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    for length in (0, 8, 60, 3000):
        path.write_bytes(whole()[:length])
        with pytest.raises(RecordingError):
            recover(path, tmp_path / "b.mcap")
    assert list(tmp_path.iterdir()) == [path]


def chunks(data: bytes) -> list[tuple[int, int]]:
    """Offset and length of every chunk record in one of our files."""
    found, offset = [], len(MAGIC)
    while data[offset] != Opcode.DATA_END:
        length = 9 + int.from_bytes(data[offset + 1 : offset + 9], "little")
        if data[offset] == Opcode.CHUNK:
            found.append((offset, length))
        offset += length
    return found


def test_a_damaged_chunk_is_left_out_and_the_rest_kept(tmp_path: Path) -> None:
    data = bytearray(whole())
    offset, length = chunks(whole())[2]
    data[offset + length // 2] ^= 0x10
    path = tmp_path / "a.mcap"
    path.write_bytes(data)
    with pytest.raises(RecordingError, match=rf"damaged: chunk at byte {offset}: .*138 samples"):
        load(path)
    recording = load(path, allow_cut=True)
    gone = set(range(200)) - set(recording["slot"].tolist())
    assert gone == set(range(62, 124))
    found = recover(path, tmp_path / "b.mcap")
    assert (found.samples, found.lost_bytes) == (138, length)


def test_the_first_chunk_which_says_the_channels_may_be_damaged_too(tmp_path: Path) -> None:
    data = bytearray(whole())
    offset, length = chunks(whole())[0]
    data[offset + length // 2] ^= 0x10
    path = tmp_path / "a.mcap"
    path.write_bytes(data)
    assert recover(path, tmp_path / "b.mcap").samples == len(TABLE)
    assert (
        load(tmp_path / "b.mcap")["load_angle_rad"].tobytes() == TABLE["load_angle_rad"].tobytes()
    )


@settings(max_examples=200, deadline=None)
@given(
    flips=st.lists(
        st.tuples(st.floats(0, 1, exclude_max=True), st.integers(1, 255)), min_size=1, max_size=3
    )
)
def test_a_changed_byte_is_noticed_or_changes_nothing(flips: list[tuple[float, int]]) -> None:
    """All that a recording is made of is under a checksum; the summary is not, and not read."""
    data = bytearray(whole())
    for place, mask in flips:
        data[int(place * len(data))] ^= mask
    result = loaded(bytes(data), allow_cut=False)
    if isinstance(result, Recording):
        original = loaded(whole(), allow_cut=False)
        assert isinstance(original, Recording)
        for name in NAMES:
            assert result[name].tobytes() == original[name].tobytes()
        assert result.events == original.events
        assert (result.rig, result.experiment) == (original.rig, original.experiment)
        assert result.provenance == original.provenance


@given(st.binary(max_size=200))
@settings(max_examples=100, deadline=None)
def test_garbage_is_not_a_recording(data: bytes) -> None:
    assert isinstance(loaded(data, allow_cut=True), RecordingError)
    assert isinstance(loaded(MAGIC + data, allow_cut=True), RecordingError)
    assert isinstance(loaded(MAGIC + data + MAGIC, allow_cut=True), RecordingError)


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (b"", "not an MCAP file: it is empty"),
        (bytes(4096), "not an MCAP file: it begins with 00 00"),
        (b"PK\x03\x04 a zip", "not an MCAP file: it begins with 50 4b"),
        (MAGIC, "nothing can be saved"),
        (MAGIC + bytes(4096), "nothing can be saved"),
    ],
)
def test_what_is_no_recording_is_said(data: bytes, says: str) -> None:
    error = loaded(data, allow_cut=True)
    assert isinstance(error, RecordingError)
    assert says in str(error)


def test_a_path_that_is_no_file_is_said(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="cannot be read: No such file"):
        load(tmp_path / "no.mcap")
    with pytest.raises(RecordingError, match="cannot be read: Is a directory"):
        load(tmp_path)


def bomb(compression: str, data: bytes, declared: int) -> bytes:
    """A chunk record that lies about its size, before a whole file's records."""
    builder = RecordBuilder()
    Chunk(compression, data, 0, 0, 0, declared).write(builder)
    return MAGIC + builder.end() + whole()[len(MAGIC) :]


ZEROS = bytes(100 * MIB)


@pytest.mark.parametrize(
    ("compression", "pack"), [("zstd", zstandard.compress), ("lz4", lz4.frame.compress)]
)
@pytest.mark.parametrize("declared", [1000, MAX_CHUNK_BYTES + 1, 2**64 - 1])
def test_a_chunk_that_lies_about_its_size_costs_no_memory(
    compression: str, pack: type[bytes], declared: int
) -> None:
    data = bomb(compression, pack(ZEROS), declared)
    tracemalloc.start()
    try:
        refused = loaded(data, allow_cut=False)
        saved = loaded(data, allow_cut=True)
        _, peak_bytes = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert isinstance(refused, RecordingError)
    assert "chunk at byte 8" in str(refused)
    assert isinstance(saved, Recording)
    assert saved.channels.keys() == set(NAMES)
    assert len(saved) == len(TABLE)
    assert peak_bytes < 8 * MIB
