"""What was imported is an MCAP file that reads back equal, by us and by a stranger's reader."""

import warnings
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import Writer
from numpy.typing import NDArray
from typer.testing import CliRunner

from servo_bench.cli.app import app
from servo_bench.errors import ConfigError, RecordingError
from servo_bench.foreign.importing import read_foreign
from servo_bench.foreign.maps import load_map
from servo_bench.kernels.analysis import analyse
from servo_bench.recording.blocks import blocks_of
from servo_bench.recording.mcap_file import load, recover
from servo_bench.recording.measured_writer import save_measured
from servo_bench.recording.plant import ForeignPlant
from servo_bench.recording.recording import Event, Recording
from tests.foreign_files import PLAIN, ROWS, imported
from tests.recording_files import json_messages, rows, strangers_file
from tests.reported_run import short_run

with warnings.catch_warnings():
    warnings.simplefilter("ignore", DeprecationWarning)  # the module warns about its own import
    from mcap_ros2.reader import read_ros2_messages

PLANT = ForeignPlant(name="p", inertia_kg_m2=2e-4, output_locked=True)


def recording(**channels: NDArray[np.generic] | list[float]) -> Recording:
    arrays = {name: np.array(values) for name, values in channels.items()}
    facts = {"source_file": "a.csv", "map": 'name = "½"\n'}
    events = (Event(0, "import", "2 rows were dropped", {"rows": 2}),)
    return Recording(arrays, 0.25, None, None, facts, events, plant=PLANT)


def assert_equal(one: Recording, other: Recording) -> None:
    assert list(one.channels) == list(other.channels)
    for name in one.channels:
        assert one[name].dtype == other[name].dtype
        assert one[name].tobytes() == other[name].tobytes()
    for field in ("period_s", "experiment", "rig", "provenance", "events", "cut", "plant"):
        assert getattr(one, field) == getattr(other, field)


@settings(max_examples=40, deadline=None)
@given(data=st.data(), count=st.integers(2, 60))
def test_every_bit_comes_back(data: st.DataObject, count: int) -> None:
    seed = data.draw(st.integers(0, 2**32 - 1))
    rng = np.random.default_rng(seed)
    made = recording(
        t_s=np.cumsum(rng.exponential(1e-3, count)) - data.draw(st.floats(-1e9, 1e9)),
        current_a=rng.integers(0, 256, count * 8, np.uint8).view(np.float64),
        run=rng.integers(-(2**63), 2**63 - 1, count),
    )
    with TemporaryDirectory() as folder:
        save_measured(made, Path(folder) / "a.mcap")
        assert_equal(load(Path(folder) / "a.mcap"), made)


def test_an_import_on_the_command_line_reads_back_as_imported(tmp_path: Path) -> None:
    made = imported(tmp_path, ROWS, PLAIN)
    out = tmp_path / "a.mcap"
    done = CliRunner().invoke(
        app,
        ["import", str(tmp_path / "a.csv"), "--map", str(tmp_path / "map.toml"), "-o", str(out)],
    )
    assert done.exit_code == 0, done.output
    assert "3 rows, 1.5 s, t_s, current_a" in done.output
    loaded = load(out)
    own = ("command", "clock_monotonic_ns", "clock_utc_ns", "clock_uncertainty_ns", "utc")
    alike = {key: value for key, value in made.provenance.items() if key not in own}
    assert alike.items() <= loaded.provenance.items()
    assert_equal(replace(loaded, provenance=made.provenance), made)
    again = CliRunner().invoke(app, ["import", "a", "--map", "b", "-o", str(out)])
    assert isinstance(again.exception, ConfigError)


def test_a_strangers_reader_finds_typed_messages_at_their_times(tmp_path: Path) -> None:
    made = recording(t_s=[-1.0, 0.5, 0.75], current_a=[1.0, np.nan, 3.0], run=[1, 1, 1])
    save_measured(made, tmp_path / "a.mcap")
    seen = list(read_ros2_messages(tmp_path / "a.mcap", topics="/measured"))
    for name in made.channels:
        values = np.array([getattr(one.ros_msg, name) for one in seen])
        np.testing.assert_array_equal(values, made[name])
    assert [one.log_time_ns for one in seen] == [0, 1_500_000_000, 1_750_000_000]
    with (tmp_path / "a.mcap").open("rb") as file:
        summary = make_reader(file, validate_crcs=True).get_summary()
    assert summary is not None
    assert {channel.topic for channel in summary.channels.values()} == {
        "/measured", "/events", "/config",
    }  # fmt: skip
    (schema,) = (s for s in summary.schemas.values() if s.encoding == "ros2msg")
    assert schema.data.decode().split("\n")[:2] == ["float64 t_s", "float64 current_a"]


def test_runs_that_overlap_are_plotted_one_after_the_other(tmp_path: Path) -> None:
    made = recording(t_s=[5.0, 6.0, 5.0, 7.0], run=[0, 0, 1, 1])
    save_measured(made, tmp_path / "a.mcap")
    seen = list(read_ros2_messages(tmp_path / "a.mcap", topics="/measured"))
    assert [one.log_time_ns / 1e9 for one in seen] == [5.0, 6.0, 6.25, 8.25]
    assert load(tmp_path / "a.mcap")["t_s"].tolist() == [5.0, 6.0, 5.0, 7.0]


def test_a_cut_one_is_refused_and_recovered(tmp_path: Path) -> None:
    count = 40_000
    made = recording(
        t_s=np.arange(count) * 0.25, current_a=np.random.default_rng(1).normal(size=count)
    )
    save_measured(made, tmp_path / "a.mcap")
    whole = (tmp_path / "a.mcap").read_bytes()
    (tmp_path / "b.mcap").write_bytes(whole[: len(whole) * 3 // 4])
    with pytest.raises(RecordingError, match=r"was cut: .*samples .*servo-bench recover"):
        load(tmp_path / "b.mcap")
    found = recover(tmp_path / "b.mcap", tmp_path / "c.mcap")
    saved = load(tmp_path / "c.mcap")
    assert saved.cut
    assert 0 < len(saved) == found.samples < count
    assert found.seconds == pytest.approx(0.25 * found.samples)
    np.testing.assert_array_equal(saved["current_a"], made["current_a"][: len(saved)])
    assert saved.plant == PLANT


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"encoding": "json"}, "'json' with a schema in 'ros2msg'; cdr with ros2msg can"),
        ({"schema": "float64 x\nfloat64 y"}, "have x, y: t_s and at least one other"),
        ({"schema": "float64 t_s"}, "have t_s: t_s and at least"),
        ({"schema": "float64 t_s\nfloat64[2] x"}, "shorter than its schema"),
        ({"schema": "float64 t_s\nuint64 x"}, "x does not fit into int64"),
        ({"schema": "float64 x\nfloat64 t_s"}, "t_s is nan in message 1"),
        ({"schema": "string t_s"}, "begins with no number"),
        ({"schema": "float64[1] t_s\nint8[2] x"}, "have t_s: t_s and at least"),
        ({"messages": [], "chunked": False, "schema": "float64 t_s"}, "there is no message on"),
    ],
)
def test_what_is_wrong_with_a_strangers_file_is_said(
    tmp_path: Path, options: dict[str, Any], says: str
) -> None:
    body = bytes((0, 1, 0, 0)) + np.array([0.0, np.nan]).tobytes()[:8] + b"\xff" * 8
    given_ = {"messages": [body] * 3, "encoding": "cdr", "schema": "float64 t_s\nint8 x"} | options
    path = strangers_file(tmp_path / "a.mcap", topic="/measured", **given_)
    with pytest.raises(RecordingError, match=f"(?s)a.mcap cannot be used: .*{says}"):
        load(path)


def test_a_strangers_types_are_read(tmp_path: Path) -> None:
    schema = "bool[4] ignored\nfloat32 t_s\nint8 state\n"
    bodies = [
        bytes((0, 1, 0, 0)) + bytes(4) + np.float32(0.5 * k).tobytes() + np.int8(-k).tobytes()
        for k in range(3)
    ]
    path = strangers_file(
        tmp_path / "a.mcap", bodies, encoding="cdr", schema=schema, topic="/measured"
    )
    loaded = load(path)
    assert loaded["t_s"].tolist() == [0.0, 0.5, 1.0]
    assert loaded["state"].tolist() == [0, -1, -2]
    assert (loaded.plant, loaded.period_s) == (None, 0.008)


def test_in_a_runs_file_another_programs_measured_is_left_alone(tmp_path: Path) -> None:
    table = rows(4)
    names = ["slot", "phase", "chip", "velocity_command_rad_s", "load_angle_rad"]
    with (tmp_path / "a.mcap").open("xb") as file:
        writer = Writer(file)
        writer.start()
        writer.add_metadata("servo_bench.recording", {"period_s": "0.008"})
        samples = writer.register_channel("/samples", "json", 0)
        other = writer.register_channel("/measured", "jpeg", 0)
        for message in json_messages(table, names):
            writer.add_message(samples, 0, message, 0)
            writer.add_message(other, 0, b"picture", 0)
        writer.finish()
    assert load(tmp_path / "a.mcap")["slot"].tolist() == table["slot"].tolist()


def test_a_run_is_not_written_whole_and_a_file_never_overwritten(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="no channel t_s: it has slot"):
        save_measured(replace(recording(slot=[0]), plant=None), tmp_path / "a.mcap")
    made = recording(t_s=[0.0, 1.0], current_a=[0.0, 1.0])
    save_measured(made, tmp_path / "a.mcap")
    with pytest.raises(RecordingError, match="never overwritten"):
        save_measured(made, tmp_path / "a.mcap")


def test_the_blocks_are_those_whose_input_and_output_came() -> None:
    t, nothing = [0.0, 1.0], [np.nan, np.nan]
    free = replace(recording(t_s=t, current_a=t, motor_velocity_rad_s=t), plant=None)
    assert [block.name for block in blocks_of(free)] == ["mechanics"]
    locked = recording(t_s=t, current_a=t, motor_position_rad=t)
    assert [block.name for block in blocks_of(locked)] == ["transmission"]
    paper = recording(t_s=t, velocity_command_rad_s=t, load_angle_rad=t, current_a=nothing)
    assert [block.name for block in blocks_of(paper)] == ["loop"]
    assert blocks_of(recording(t_s=t, current_a=t)) == ()
    assert [block.name for block in blocks_of(short_run())] == [
        "controller", "mechanics", "transmission", "loop",
    ]  # fmt: skip


def test_a_run_that_went_through_another_programs_file_has_the_same_kernels(tmp_path: Path) -> None:
    """Export to CSV, import with a map, analyse: the numbers of the run itself."""
    run = short_run()
    channels = {name: run[name] for name in ("slot", "phase", "velocity_command_rad_s",
                                             "load_angle_rad")}  # fmt: skip
    bare = replace(run, channels=channels, experiment=None, rig=None)
    text = "slot,phase,v,angle\n" + "\n".join(
        f"{s},{p},{v!r},{a!r}"
        for s, p, v, a in zip(*(c.tolist() for c in channels.values()), strict=True)
    )
    plan = f"""
        period_s = {run.period_s!r}
        [[channel]]
        role = "slot"
        column = "slot"
        [[channel]]
        role = "phase"
        column = "phase"
        [[channel]]
        role = "velocity_command"
        column = "v"
        unit = "rad/s"
        [[channel]]
        role = "load_position"
        column = "angle"
        unit = "rad"
    """
    save_measured(imported(tmp_path, text, plan), tmp_path / "a.mcap")
    loaded = load(tmp_path / "a.mcap")
    ours, theirs = (analyse(one, polynomial="15341", memory=18) for one in (bare, loaded))
    skipped = {"run"}
    assert {k: v for k, v in ours.numbers().items() if k not in skipped} == {
        k: v for k, v in theirs.numbers().items() if k not in skipped
    }


def test_analyse_says_what_a_recording_without_command_lacks(tmp_path: Path) -> None:
    made = imported(tmp_path, ROWS, PLAIN)
    with pytest.raises(RecordingError, match="no channel velocity_command_rad_s: it has current_a"):
        analyse(made, polynomial="15341")


def test_the_name_of_a_shipped_map_is_enough(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("t,u,y\n0,0,0\n1,1,360\n")
    made = read_foreign(tmp_path / "a.csv", load_map("maps/undcmotor.toml"))
    np.testing.assert_allclose(made["motor_velocity_rad_s"], [0, 2 * np.pi])
