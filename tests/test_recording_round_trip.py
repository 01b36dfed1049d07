"""What is written is read back, by us and by strangers' readers."""

import json
import warnings
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from numpy.typing import NDArray

from servo_bench.errors import RecordingError
from servo_bench.recording.mcap_file import RecordingWriter, load
from servo_bench.recording.recording import MISSING, SAMPLE_DTYPE, SAMPLE_FIELDS, Event
from tests.recording_files import EVENT, EXPERIMENT, FACTS, NAMES, RIG, rows, write

with warnings.catch_warnings():
    warnings.simplefilter("ignore", DeprecationWarning)  # the module warns about its own import
    from mcap_ros2.reader import read_ros2_messages


SPECIAL = {
    "int64": [MISSING, -1, 0, 2**63 - 1],
    "float64": [np.nan, -np.nan, np.inf, -np.inf, -0.0, 5e-324],
    "uint32": [0, 2**32 - 1],
}


@st.composite
def any_rows(draw: st.DrawFn) -> NDArray[np.void]:
    """Rows with every bit pattern that a value may have, slots rising, phases real."""
    size = 8 * SAMPLE_DTYPE.itemsize
    some = np.frombuffer(draw(st.binary(min_size=size, max_size=size)), SAMPLE_DTYPE)
    table = np.resize(some, draw(st.integers(0, 150)))
    for name, kind in draw(st.lists(st.sampled_from(SAMPLE_FIELDS), max_size=4)):
        table[name][:: draw(st.integers(1, 9))] = draw(st.sampled_from(SPECIAL[kind]))
    step, first = draw(st.integers(1, 10**9)), draw(st.integers(0, 10**9))
    table["slot"] = first + step * np.arange(table.size)
    table["phase"] %= 4
    return table


@settings(max_examples=80, deadline=None)
@given(table=any_rows(), batch=st.integers(1, 200))
def test_every_bit_of_every_value_comes_back(table: NDArray[np.void], batch: int) -> None:
    with TemporaryDirectory() as folder:
        path = Path(folder) / "a.mcap"
        with RecordingWriter(path, EXPERIMENT, RIG, FACTS, 125.0) as writer:
            for first in range(0, table.size, batch):
                writer.samples(table[first : first + batch])
        recording = load(path)
    assert list(recording.channels) == NAMES
    for name in NAMES:
        assert recording[name].dtype == SAMPLE_DTYPE[name]
        assert recording[name].tobytes() == table[name].tobytes()


def test_everything_beside_the_samples_comes_back(tmp_path: Path) -> None:
    recording = load(write(tmp_path / "a.mcap", rows(70), (EVENT, EVENT)))
    assert recording.experiment == EXPERIMENT
    assert recording.rig == RIG
    assert recording.period_s == EXPERIMENT.period_s
    assert recording.provenance == FACTS
    assert recording.events == (EVENT, EVENT)
    assert not recording.cut


def test_a_run_without_rig_and_experiment_keeps_its_period(tmp_path: Path) -> None:
    with RecordingWriter(tmp_path / "a.mcap", None, None, {}, 125.0) as writer:
        writer.samples(rows(3))
    recording = load(tmp_path / "a.mcap")
    assert (recording.experiment, recording.rig, recording.period_s) == (None, None, 0.008)


def test_what_json_lacks_becomes_what_it_has(tmp_path: Path) -> None:
    data = {"nan": np.nan, "count": np.int64(3), "all": np.arange(2), "path": Path("x"), "t": (1,)}
    recording = load(write(tmp_path / "a.mcap", rows(1), (Event(-5, "k", "t", data),)))
    assert recording.events[0].data == {
        "nan": None,
        "count": 3,
        "all": [0, 1],
        "path": "x",
        "t": [1],
    }


def test_the_mcap_library_reads_the_samples_as_ros_2_messages(tmp_path: Path) -> None:
    table = rows(130)
    table["load_angle_rad"][7], table["load_angle_counts"][7] = np.nan, MISSING
    path = write(tmp_path / "a.mcap", table, (EVENT,))
    seen = list(read_ros2_messages(path, topics="/samples"))
    assert len(seen) == table.size
    for name in NAMES:
        values = np.array([getattr(one.ros_msg, name) for one in seen], SAMPLE_DTYPE[name])
        assert values.tobytes() == table[name].tobytes()
    assert [one.log_time_ns - 1_700_000_000 * 10**9 for one in seen] == table["asked_ns"].tolist()


def test_the_mcap_library_finds_all_through_the_index(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", rows(200), (EVENT,))
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        counts = summary.statistics.channel_message_counts
        topics = {channel.topic: counts[key] for key, channel in summary.channels.items()}
        metadata = {record.name: record.metadata for record in reader.iter_metadata()}
        events = [json.loads(m.data) for _, _, m in reader.iter_messages(topics=["/events"])]
    assert topics == {"/samples": 200, "/events": 1, "/config": 1}
    assert json.loads(metadata["servo_bench.rig"]["json"]) == RIG.model_dump(mode="json")
    assert events == [
        {"time_ns": EVENT.time_ns, "kind": EVENT.kind, "text": EVENT.text, "data": dict(EVENT.data)}
    ]


def test_a_file_that_exists_is_refused_and_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(b"precious")
    with pytest.raises(RecordingError, match=r"never overwritten.*another name"):
        RecordingWriter(path, EXPERIMENT, RIG, FACTS, 125.0)
    assert path.read_bytes() == b"precious"


def test_a_folder_that_is_not_there_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="cannot be created: No such file"):
        RecordingWriter(tmp_path / "no" / "a.mcap", EXPERIMENT, RIG, FACTS, 125.0)


def test_rows_of_another_kind_are_refused(tmp_path: Path) -> None:
    with (
        RecordingWriter(tmp_path / "a.mcap", EXPERIMENT, RIG, FACTS, 125.0) as writer,
        pytest.raises(ValueError, match="SAMPLE_DTYPE"),
    ):
        writer.samples(np.zeros(3, [("slot", "<i8")]))


def test_an_error_in_the_run_still_leaves_a_whole_file(tmp_path: Path) -> None:
    def run() -> None:
        with RecordingWriter(tmp_path / "a.mcap", EXPERIMENT, RIG, FACTS, 125.0) as writer:
            writer.samples(rows(10))
            raise KeyError("the run's own")

    with pytest.raises(KeyError):
        run()
    assert len(load(tmp_path / "a.mcap")) == 10
