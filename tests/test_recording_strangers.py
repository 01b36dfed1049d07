"""Files that other programs wrote: the same result, or an error that says what is missing."""

import json
import re
import struct
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import CompressionType

from servo_bench.errors import RecordingError
from servo_bench.recording import cdr
from servo_bench.recording import format as names
from servo_bench.recording.mcap_file import load
from servo_bench.recording.recording import MISSING, SAMPLE_FIELDS
from tests.recording_files import (
    EXPERIMENT,
    NAMES,
    json_messages,
    rows,
    strangers_file,
    write,
)

DOCUMENT = (Path(__file__).parent.parent / names.DOCUMENT).read_text()
FEW = ["load_angle_rad", "chip", "velocity_command_rad_s", "phase", "slot"]


def test_the_documents_example_loads(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (example,) = re.findall(r"```python\n(.*?)```", DOCUMENT, re.DOTALL)
    exec(compile(example, names.DOCUMENT, "exec"), {})  # noqa: S102
    recording = load("mine.mcap")
    assert len(recording) == 1000
    assert recording.period_s == 0.008
    angle = np.cumsum(recording["velocity_command_rad_s"]) * 0.008
    np.testing.assert_allclose(recording["load_angle_rad"][1:], angle[:-1], atol=1e-9)


def test_the_document_names_everything_in_a_file() -> None:
    for name, kind in SAMPLE_FIELDS:
        required = "**required**" if name in names.REQUIRED_FIELDS else ""
        (line,) = (line for line in DOCUMENT.splitlines() if line.startswith(f"| `{name}` |"))
        assert f"| {kind} |" in line
        assert required in line
    for name, value in vars(names).items():
        if name.endswith(("_TOPIC", "_METADATA")):
            assert f"`{value}`" in DOCUMENT
        if name.startswith("MAX_"):
            assert f"{value // names.MIB} MiB" in " ".join(DOCUMENT.split())
    assert " ".join(NAMES) in " ".join(DOCUMENT.split())


@pytest.mark.parametrize(
    ("chunked", "indexed", "compression"),
    list(product((True, False), (True, False), CompressionType)),
)
def test_json_without_chunks_or_indexes_reads_alike(
    tmp_path: Path, chunked: bool, indexed: bool, compression: CompressionType
) -> None:
    table = rows(60)
    path = strangers_file(
        tmp_path / "a.mcap",
        json_messages(table, FEW),
        chunked=chunked,
        indexed=indexed,
        compression=compression,
    )
    recording = load(path)
    assert set(recording.channels) == set(FEW)
    for name in FEW:
        assert recording[name].dtype == table[name].dtype
        assert (recording[name] == table[name]).all()


@pytest.mark.parametrize("chunked", [True, False])
@pytest.mark.parametrize("order", "<>")
def test_other_schemas_with_the_same_names_read_alike(
    tmp_path: Path, chunked: bool, order: str
) -> None:
    """Fields in another order and other types, padding, an array, constants, a string behind."""
    table = rows(60)
    schema = """
        # a stranger's
        uint8 MODE_RUN=1
        bool valid true
        builtin_interfaces/Time stamp
        float32 slot  # as a float
        float64[2] strange_array
        uint8 phase
        int16 chip
        float32 velocity_command_rad_s
        float64 load_angle_rad
        string note "a # b"
        float64 motor_position_rad
        ===
        MSG: builtin_interfaces/Time
        int32 sec
        uint32 nanosec
    """.replace("        ", "")
    # bool, 3 pad, Time, float32, float64[2], uint8, 1 pad, int16, float32, float64, the string
    body = struct.Struct(order + "B3x iI f 2d B x h f d")
    head = bytes((0, 1 if order == "<" else 0, 0, 0))
    messages = [
        head
        + body.pack(
            *(1, 5, 6, row["slot"], 1.0, 2.0, row["phase"], row["chip"]),
            *(row["velocity_command_rad_s"], row["load_angle_rad"]),
        )
        + struct.pack(order + "I", slot % 7 + 1)
        + b"x" * (slot % 7 + 1)
        for slot, row in enumerate(table)
    ]
    path = strangers_file(
        tmp_path / "a.mcap", messages, encoding="cdr", schema=schema, chunked=chunked
    )
    recording = load(path)
    assert set(recording.channels) == set(FEW)
    for name in set(FEW) - {"velocity_command_rad_s"}:
        assert (recording[name] == table[name]).all()
    near = recording["velocity_command_rad_s"], table["velocity_command_rad_s"]
    np.testing.assert_allclose(*near, rtol=1e-7)


def test_the_layout_of_our_own_schema_is_our_row() -> None:
    fields = cdr.layout(cdr.schema_text())
    assert fields.names == tuple(NAMES)
    wide = 8 * (len(NAMES) - 2)
    assert [fields.fields[name][1] for name in NAMES] == [*range(0, wide, 8), wide, wide + 4]


def _with(**changes: Any) -> list[bytes]:
    """Ten good JSON messages, the fourth with changes."""
    messages = [json.loads(message) for message in json_messages(rows(10), FEW)]
    messages[3] |= changes
    return [json.dumps(message).encode() for message in messages]


def test_null_and_absent_are_what_did_not_come(tmp_path: Path) -> None:
    path = strangers_file(
        tmp_path / "a.mcap", _with(load_angle_rad=None, asked_ns=7, device_time_us=None, chip=3.0)
    )
    recording = load(path)
    assert np.flatnonzero(np.isnan(recording["load_angle_rad"])).tolist() == [3]
    assert recording["asked_ns"].tolist() == [MISSING] * 3 + [7] + [MISSING] * 6
    assert (recording["device_time_us"] == MISSING).all()
    assert recording["chip"][3] == 3
    assert "statusword" not in recording
    told = strangers_file(tmp_path / "b.mcap", _with(statusword=None))
    assert load(told)["statusword"].tolist() == [0] * 10


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"slot": 3.5}, "slot is 3.5"),
        ({"slot": None}, "slot is missing"),
        ({"slot": -1}, "slot is missing or negative"),
        ({"slot": 2**63}, "slot"),
        ({"slot": 2**70}, "slot"),
        ({"slot": 1e300}, "slot is 1e"),
        ({"slot": float("inf")}, "slot is inf"),
        ({"slot": 9.3e18}, "slot is 9.3e"),
        ({"slot": True}, "slot is 'True'"),
        ({"phase": 4}, "phase is 4"),
        ({"phase": None}, "phase is nan"),
        ({"phase": -1}, "phase is -1"),
        ({"phase": 2**32}, "phase is 4294967296"),
        ({"load_angle_rad": "1.0"}, "load_angle_rad is '1.0'"),
        ({"load_angle_rad": [1.0]}, "load_angle_rad is"),
        ({"load_angle_rad": 10**400}, "load_angle_rad does not fit"),
        ({"note": "x" * (names.MAX_JSON_BYTES + 1)}, "a JSON message of"),
    ],
)
def test_a_value_that_does_not_fit_is_named(
    tmp_path: Path, changes: dict[str, Any], says: str
) -> None:
    path = strangers_file(tmp_path / "a.mcap", _with(**changes))
    with pytest.raises(RecordingError, match=f"(?s)a.mcap.*{re.escape(says)}.*{names.DOCUMENT}"):
        load(path)


@pytest.mark.parametrize("missing", names.REQUIRED_FIELDS)
def test_a_required_field_that_is_missing_is_named(tmp_path: Path, missing: str) -> None:
    few = [name for name in FEW if name != missing]
    path = strangers_file(tmp_path / "a.mcap", json_messages(rows(10), few))
    with pytest.raises(RecordingError, match=f"{missing} is missing.*{names.DOCUMENT}"):
        load(path)


def test_a_file_with_nothing_measured_is_refused(tmp_path: Path) -> None:
    path = strangers_file(tmp_path / "a.mcap", json_messages(rows(10), FEW[1:]))
    with pytest.raises(RecordingError, match=r"nothing measured.*load_angle_rad"):
        load(path)


GOOD = json_messages(rows(3), FEW)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"messages": [], "chunked": False}, "there is no message on /samples"),
        ({"messages": [b"["]}, "not JSON"),
        ({"messages": [b"[" * 100_000]}, "not JSON"),
        ({"messages": [b"3"]}, "a JSON int"),
        ({"messages": [b"\xff\xfe"]}, "not JSON"),
        ({"topic": "/other"}, "no channel /samples .*: /camera, /other"),
        ({"encoding": "protobuf"}, "'protobuf'"),
        ({"encoding": "cdr"}, "'cdr' with a schema in ''"),
        ({"encoding": "cdr", "schema": "string slot"}, "slot is missing"),
        ({"encoding": "cdr", "schema": "!!"}, "there is no message|slot is missing"),
        ({"encoding": "cdr", "schema": "int64 slot"}, "encapsulation is"),
        ({"encoding": "cdr", "schema": "int64[3000] slot"}, "shorter than its schema"),
        ({"facts": {"version": "1"}}, "period_s is missing"),
        ({"facts": {"period_s": "fast"}}, "period_s is 'fast'"),
        ({"facts": {"period_s": "nan"}}, "period_s is nan"),
        ({"facts": {"version": "2"}}, "version '2'"),
        ({"experiment": {}}, "servo_bench.experiment cannot be understood"),
        ({"experiment": {"identification": {"amplitude_deg_s": 10**400}}}, "experiment cannot"),
    ],
)
def test_what_is_wrong_with_a_file_is_said(
    tmp_path: Path, options: dict[str, Any], says: str
) -> None:
    path = strangers_file(tmp_path / "a.mcap", **({"messages": GOOD} | options))
    with pytest.raises(RecordingError, match=f"(?s)a.mcap cannot be used: .*{says}"):
        load(path)


def test_an_experiment_in_the_file_gives_the_period(tmp_path: Path) -> None:
    table = EXPERIMENT.model_dump(mode="json") | {"period_s": 0.004}
    recording = load(strangers_file(tmp_path / "a.mcap", GOOD, experiment=table))
    assert recording.period_s == 0.004
    assert recording.experiment == EXPERIMENT.model_copy(update={"period_s": 0.004})


def test_rows_come_by_slot_and_each_slot_once(tmp_path: Path) -> None:
    table = rows(50)
    shuffled = np.random.default_rng(3).permutation(table)
    again = table[[4, 9]].copy()
    again["load_angle_rad"] = 99.0
    recording = load(write(tmp_path / "a.mcap", np.concatenate([shuffled, again])))
    for name in NAMES:
        assert (recording[name] == table[name]).all()
    (event,) = recording.events
    assert event.kind == "duplicate slots"
    assert event.data == {"dropped": 2, "first_slot": 4}


@pytest.mark.parametrize(
    "event", [{}, {"time_ns": 1.5, "kind": "a", "text": "b"}, {"time_ns": 1, "kind": "a"}]
)
def test_an_event_that_is_none_is_refused(tmp_path: Path, event: dict[str, Any]) -> None:
    path = strangers_file(tmp_path / "a.mcap", [json.dumps(event).encode()], topic="/events")
    with pytest.raises(RecordingError, match="an event is"):
        load(path)
