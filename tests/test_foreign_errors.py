"""What is wrong with a file or a map is said: what, got, allowed, next. Nothing else comes out."""

import io
import json
import math
import os
import zipfile
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
import scipy.io
from hypothesis import example, given, settings
from hypothesis import strategies as st

from servo_bench.errors import BenchError, ConfigError, RecordingError
from servo_bench.foreign import containers, tables
from servo_bench.foreign.importing import read_foreign
from servo_bench.foreign.maps import load_map
from tests.foreign_files import CURRENT, PLAIN, ROWS, TIME, imported

VOLTAGE = '[[channel]]\nrole = "voltage"\ncolumn = "u"\nunit = "V"\n'
COUNTS = '[[channel]]\nrole = "load_position"\ncolumn = "i"\nunit = "counts"\n'
RUNS = '[runs]\ncolumn = "n"\n'


@pytest.mark.parametrize(
    ("plan", "says"),
    [
        ("", r"map.toml: mend these keys:\s+channel: Field required"),
        ("channel = []", "channel: .*at least 1"),
        (PLAIN + "[file]\ncolour = 1", "file.colour: Extra inputs are not permitted"),
        ("= 3", "is not TOML"),
        (TIME + CURRENT.replace("current", "curent"), r"channel 2 \(curent\): there is no role "
         r"'curent'. Give one of time, .*current, .*chip\."),
        (TIME + CURRENT.replace('"A"', '"rpm"'), r"the role current is a current, and its unit is "
         r"'rpm'. Give one of A, mA, or another role\."),
        (TIME.replace('"s"', '"min"') + CURRENT, "its unit is 'min'. Give one of s, ms, us, ns"),
        (TIME + COUNTS, "counts_per_rev is None with the unit 'counts'. Give the counts of one"),
        (PLAIN + "counts_per_rev = 4", "counts_per_rev is 4.0 with the unit 'A'"),
        (PLAIN + "value = 1", "column is 'i' and value is 1.0. Give one of them"),
        (PLAIN + "unwrap = true", "unwrap undoes the wrap of an angle .* this is a current"),
        (TIME + '[[channel]]\nrole = "flag"\ncolumn = "i"', "a flag has no name of its own"),
        (PLAIN + 'name = "Motor 1"', "its name is 'Motor 1'. Give up to 23 small letters"),
        (TIME + '[[channel]]\nrole="flag"\ncolumn="i"\nname="current_a"', "is another role's"),
        (PLAIN + CURRENT, "two channels would be current_a. Leave one out, or give"),
        (CURRENT, "neither is there. Give one of them"),
        ("period_s = 1\n" + PLAIN, "both is there. Give one of them"),
        (TIME, "there is no channel but time. Add what was measured"),
        ('period_s = -1\n' + CURRENT, "period_s: .*greater than 0, got -1"),
        (TIME + CURRENT + VOLTAGE, r"channel 3 \(voltage\): .*a.csv has no column 'u'.* It has "
         r"'t', 'i'. Mend the column in the map .*optional = true"),
        (PLAIN + VOLTAGE.replace('"u"', "2"), "has no column 2"),
        (PLAIN + VOLTAGE.replace('"u"', "-1"), "has no column -1"),
        (RUNS + PLAIN, r"\[runs\]: .*a.csv has no column 'n'.* It has 't', 'i'"),
        (PLAIN + 'times = "u"', "has no column 'u'"),
        (PLAIN + '[file]\ncolumns = ["t", "i", "r"]', r"a.csv has the columns t, i, and .* is for "
         r"files with t, i, r\. Give the map of this file"),
        (PLAIN + '[file]\ndelimiter = "ab"', "cannot be split at 'ab' .*Give one character"),
        (PLAIN + '[file]\nencoding = "klingon"', "there is no encoding 'klingon'. Give utf-8"),
        (PLAIN + "[plant]\ninertia_kg_m2 = -1", r"mend these keys:\s+inertia_kg_m2: .*got -1"),
        (PLAIN + "[plant]\ncolour = 1", "colour: Extra inputs"),
        (PLAIN + '[plant]\ninertia_kg_m2 = { from = "J" }', "kg_m2 comes from 'J' .* no such"),
    ],
)  # fmt: skip
def test_a_map_that_does_not_fit_is_named(tmp_path: Path, plan: str, says: str) -> None:
    with pytest.raises(ConfigError, match=f"(?s){says}"):
        imported(tmp_path, ROWS, plan)


@pytest.mark.parametrize(
    ("content", "plan", "says"),
    [
        ("t;i\n0;998,5\n1;1.000\n", PLAIN + '[file]\ndecimal = ","\ndelimiter = ";"',
         "column 'i' is '1.000', and must be a number"),
        ("", PLAIN, "is empty: it has 0 bytes"),
        ("\n# a\n\n", PLAIN, "is empty: it has no line that is neither blank nor a comment"),
        ("t,i\n", PLAIN, "is empty: it has 0 rows under t, i. Give a file with at least 2"),
        ("t,i\n0,1\n", PLAIN, "it has 1 rows"),
        (bytes(range(256)) * 4, PLAIN, r"is no text in utf-8: .*Give its encoding"),
        (b"t,i\n0,\0\n", PLAIN, "has a zero byte at 6. Give its format"),
        ("t,i\n0,1,2\n", PLAIN, "line 2 has 3 cells, and the first line has 2"),
        ("t,i\n# c\n0,1\n1\n", PLAIN, "line 4 has 1 cells"),
        ("t,i\n0,1\n1,x\n", PLAIN, "line 3: column 'i' is 'x', and must be a number. Mend"),
        ("t,i\n0,1\n1,2,5\n", PLAIN, "line 3 has 3 cells"),
        ('t,i\n0,"' + "x" * 200_000, PLAIN, "is no table of text: field larger"),
        ("t,i\n0,1\n1,nan\n2,\n", PLAIN, r"line 3: current_a is nan \(2 such rows in all\), and "
         r"must be a finite number. .*nan = \"drop\""),
        ("t,i\n0,1\n,2\n", PLAIN, "line 3: time is nan"),
        ("t,i\n0,1\n1,1e999\n", PLAIN, "current_a is inf"),
        ("t,i\n0,1\n1,1e300\n", PLAIN, r"current_a is 1e\+300 \(1 such rows\), more than 1e\+12. "
         r"Are unit, scale and offset of .*right\?"),
        ("t,i\n0,1\n1,1e300\n", PLAIN + "scale = 1e300", "current_a is inf"),
        ("t,i\n0,1\n1700000000000,1\n", PLAIN, r"line 3: the time is 1.7e\+12 s, more than 4e\+09 "
         r"s. Is the time's unit right"),
        ("t,i\n0,1\n2,1\n1,1\n", PLAIN, r"line 4: the time falls from 2 s to 1 s \(1 times in "
         r"all\). Sort the file, or split it into runs"),
        ("t,i\n0,1\n1,1\n1,1\n", PLAIN, r"line 4: the time 1 s is repeated \(1 rows in all\). Say "
         r"in the map .*\"spread\".*\"first\""),
        ("t,i\n1,1\n1,1\n", 'repeated = "spread"\n' + PLAIN, "cannot be spread: the tick at 1 s .* "
         "or the only one of its run"),
        ("t,i\n0,1\n1,nan\n", 'nan = "drop"\n' + PLAIN, "1 of 2 rows are left, .*least 2 in one"),
        (ROWS, PLAIN + "[window]\nfrom_s = 9\n", "0 of 3 rows are left"),
        ("t,i,n\n0,1,0\n0,1,1\n", RUNS + PLAIN, "2 of 2 rows are left, 1 in the longest run"),
        ("t,i,n\n0,1,0\n0,1,1.5\n", RUNS + PLAIN, "line 3: the run is 1.5 in column 'n'"),
        ("t,i,n\n0,1,0\n0,1,nan\n", RUNS + PLAIN, "line 3: the run is nan"),
        ("t,i,n\n0,1,0\n1,1,1\n2,1,0\n", RUNS + PLAIN, "line 4: run 0 begins a second time. Rows "
         "of one run must stand together"),
        ("t,i,n\n0,1,0\n1,1,1\n", RUNS + "keep = [0, 8]\n" + PLAIN, "has no run 8 in column 'n': "
         "it has 0, 1. Mend keep"),
        ("t,i\n0,1\n1,1.5\n", TIME + '[[channel]]\nrole = "flag"\nname = "x"\ncolumn = "i"',
         "x is 1.5, and a flag is a whole number"),
    ],
)  # fmt: skip
def test_text_that_cannot_be_used_is_named(
    tmp_path: Path, content: str | bytes, plan: str, says: str
) -> None:
    with pytest.raises(RecordingError, match=f"(?s)a.csv.*{says}"):
        imported(tmp_path, content, plan)


def test_a_name_that_two_columns_have_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="no column 'i', or two of that name"):
        imported(tmp_path, "t,i,i\n0,1,2\n", PLAIN)


def test_a_file_that_is_not_there_and_one_without_a_format(tmp_path: Path) -> None:
    plan = tmp_path / "map.toml"
    plan.write_text('name = "a"\n' + PLAIN)
    with pytest.raises(RecordingError, match=r"b.csv cannot be read: No such file"):
        read_foreign(tmp_path / "b.csv", load_map(plan))
    with pytest.raises(
        ConfigError, match=r"ends in '.xls', which says no format: .csv, .*format ="
    ):
        imported(tmp_path, ROWS, PLAIN, "a.xls")
    with pytest.raises(ConfigError, match=r"there is no file maps/none\.toml"):
        load_map("maps/none.toml")


def test_a_file_above_the_bound_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.touch()
    os.truncate(path, tables.MAX_BYTES + 1)  # sparse: takes no room
    (tmp_path / "map.toml").write_text('name = "a"\n' + PLAIN)
    with pytest.raises(RecordingError, match="larger than the 256 MiB"):
        read_foreign(path, load_map(tmp_path / "map.toml"))


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ("[", "is not JSON: Expecting value.*format"),
        ("[" * 100_000, "is not JSON"),
        ("[]", "has none of the|has no column 't'"),
        ("3", "has no column 't'"),
        ('"text"', "has no column 't'"),
        ('{"t": 3, "i": 4}', "column 't' is 3, and must be one number per row"),
        ('{"t": [0, 1], "i": [1, 2, 3]}', "current_a has 3 rows, and another column 2"),
        ('{"t": [0, 1], "i": [1, "2"]}', "row 2: column 'i' is '2', and must be one number"),
        ('[{"t": 0, "i": 1}, {"t": 1}]', "row 2: current_a is nan"),
        ('[{"t": 0, "i": 1}, {"t": 1, "i": null}]', "row 2: current_a is nan"),
        ('[{"t": 0, "i": 1}, 7]', "row 2: current_a is nan"),
        ('[{"t": 0, "i": 1}, {"t": 1, "i": 1' + "0" * 400 + "}]", "row 2: current_a is inf"),
        ('[{"t": 0, "i": [1]}, {"t": 1, "i": [2]}]', r"row 1: column 'i' is \[1\]"),
    ],
)
def test_json_that_cannot_be_used_is_named(tmp_path: Path, content: str, says: str) -> None:
    with pytest.raises(BenchError, match=f"(?s)a.json.*{says}"):
        imported(tmp_path, content, PLAIN, "a.json")


def test_a_table_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="has no table 'rows': it has entries, kp"):
        imported(tmp_path, '{"entries": [], "kp": 1}', '[file]\ntable = "rows"\n' + PLAIN, "a.json")


def _zip(**members: bytes) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        for name, data in members.items():
            archive.writestr(name, data)
    return file.getvalue()


def _npy(array: np.ndarray) -> bytes:
    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()


def test_containers_that_cannot_be_used_are_named(tmp_path: Path) -> None:
    objects = np.array([None, {}], object)
    pickled = io.BytesIO()
    np.lib.format.write_array(pickled, objects)
    lying = _npy(np.zeros(4)).replace(b"(4,)", b"(9,)")
    scipy.io.savemat(tmp_path / "x.mat", {"t": [0.0, 1.0], "i": ["a", "b"], "c": [1j, 2j]})
    letters = (tmp_path / "x.mat").read_bytes()
    hdf5 = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(512) + b"\x89HDF\r\n\x1a\n"
    cases = [
        ("a.npz", b"PK not really", "is not an NPZ file of plain arrays"),
        ("a.npz", _zip(**{"t.npy": b"x", "i.npy": b"y"}), "is not an NPZ"),
        ("a.npz", _zip(**{"t.npy": pickled.getvalue()}), "t.npy holds Python objects.*savez"),
        ("a.npz", _zip(**{"t.npy": lying}), "declares .9,. of float64 and holds other bytes"),
        ("a.npz", _zip(**{"t.npy": _npy(np.zeros(2)), "i.npy": _npy(np.zeros((2, 2)))}),
         r"column 'i' is an array of float64 of shape \(2, 2\)"),
        ("a.mat", b"garbage" * 100, "is not a MAT file, or is damaged"),
        ("a.mat", hdf5, r"of version 7.3 \(HDF5\), .*save\('NAME.mat', '-v7'\)"),
        ("a.mat", letters, "column 'i' is an array of <U1"),
    ]  # fmt: skip
    for name, content, says in cases:
        with pytest.raises(RecordingError, match=f"(?s){name}.*{says}"):
            imported(tmp_path, content, PLAIN, name)


def test_an_npz_that_unpacks_to_too_much_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(containers, "MAX_BYTES", 1000)
    with pytest.raises(RecordingError, match="unpacks to 0 MiB"):
        imported(tmp_path, _zip(**{"t.npy": _npy(np.zeros(1000))}), PLAIN, "a.npz")


NUMBER = st.one_of(
    st.floats(width=32).map(str),
    st.integers().map(str),
    st.sampled_from(["", "nan", "1e999", "-0", "0x1", "1_0", "٣", "1,5", "#", '"', "'", "1e9"]),
)
MAPS = st.sampled_from([
    PLAIN,
    'repeated = "spread"\nnan = "drop"\n' + PLAIN,
    'repeated = "first"\n' + PLAIN + "unwrap = false\n[window]\nfrom_s = 0\n",
    '[file]\ndelimiter = "whitespace"\nheader = false\n'
    + PLAIN.replace('"t"', "0").replace('"i"', "1"),
    '[file]\ndelimiter = "\\""\n' + PLAIN,
    '[file]\nskip_rows = 2\n[runs]\ncolumn = "i"\n' + PLAIN,
])  # fmt: skip


def _ours_or_a_recording(content: str | bytes, plan: str, file: str) -> None:
    """Either one of our errors, or channels that keep what a recording promises."""
    with TemporaryDirectory() as folder:
        try:
            recording = imported(Path(folder), content, plan, file)
        except BenchError:
            return
    assert {len(values) for values in recording.channels.values()} == {len(recording)}
    assert math.isfinite(recording.period_s)
    assert all(np.isfinite(values).all() for values in recording.channels.values())
    if "run" not in recording:
        assert (np.diff(recording["t_s"]) > 0).all()


@settings(max_examples=150, deadline=None)
@given(
    rows=st.lists(st.lists(NUMBER, min_size=1, max_size=3), max_size=6),
    plan=MAPS,
    end=st.sampled_from(["\n", "\r\n", "\r", ",\n"]),
)
@example(rows=[["0", "1"], ["5e-324", "1"], ["5e-324", "2"]], plan=MAPS.elements[1], end="\n")
def test_whatever_a_table_says_only_our_errors_come_out(
    rows: list[list[str]], plan: str, end: str
) -> None:
    text = "t,i" + end + "".join(",".join(row) + end for row in rows)
    _ours_or_a_recording(text, plan, "a.csv")


@settings(max_examples=100, deadline=None)
@given(content=st.binary(max_size=200) | st.text(max_size=200), plan=MAPS)
def test_whatever_the_bytes_are_only_our_errors_come_out(content: str | bytes, plan: str) -> None:
    text = content if isinstance(content, bytes) else content.encode(errors="replace")
    _ours_or_a_recording(text, plan, "a.csv")


JSON_VALUE = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=3),
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(st.sampled_from(["t", "i", "t.i", "0", "x"]), inner, max_size=4)
    ),
    max_leaves=12,
)
JSON_MAPS = st.sampled_from([
    PLAIN,
    'nan = "drop"\nrepeated = "spread"\n' + PLAIN,
    '[file]\ntable = "t"\n' + PLAIN,
    PLAIN.replace('"i"', '"t.i"'),
    PLAIN.replace('"t"', "0").replace('"i"', '"١"'),
    PLAIN + '[plant]\ninertia_kg_m2 = { from = "x" }\n',
])  # fmt: skip


@settings(max_examples=150, deadline=None)
@given(value=JSON_VALUE, plan=JSON_MAPS)
def test_whatever_json_says_only_our_errors_come_out(value: object, plan: str) -> None:
    _ours_or_a_recording(json.dumps(value), plan, "a.json")


@settings(max_examples=150, deadline=None)
@given(data=st.data())
def test_a_damaged_npz_gives_only_our_errors(data: st.DataObject) -> None:
    damaged = bytearray(WHOLE["a.npz"])
    for place in data.draw(st.lists(st.integers(0, len(damaged) - 1), max_size=4)):
        damaged[place] = data.draw(st.integers(0, 255))
    cut = data.draw(st.integers(1, len(damaged)))
    _ours_or_a_recording(bytes(damaged[:cut]), PLAIN, "a.npz")


BESIDE_THEM = ((176, 255), (264, 0))


@pytest.mark.parametrize(
    ("place", "byte"),
    [(145, 255), (130, 7), *(pytest.param(*it, marks=pytest.mark.long) for it in BESIDE_THEM)],
)
def test_a_damaged_mat_gives_only_our_errors(place: int, byte: int) -> None:
    """All but the second bring scipy's own reader down with a segmentation fault."""
    damaged = bytearray(WHOLE["a.mat"])
    damaged[place] = byte
    _ours_or_a_recording(bytes(damaged), PLAIN, "a.mat")
    _ours_or_a_recording(bytes(damaged[: place + 1]), PLAIN, "a.mat")


def _whole() -> dict[str, bytes]:
    npz, mat = io.BytesIO(), io.BytesIO()
    columns = {"t": np.arange(4.0), "i": np.arange(4)}
    np.savez_compressed(npz, **columns)
    scipy.io.savemat(mat, columns | {"s": {"a": ["x"]}})
    return {"a.npz": npz.getvalue(), "a.mat": mat.getvalue()}


WHOLE = _whole()
