"""Foreign files in every format become the channels that the map says, and nothing else happens."""

import csv
import io
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io
from hypothesis import given
from hypothesis import strategies as st

from servo_bench.errors import ConfigError, RecordingError
from servo_bench.foreign.importing import read_foreign
from servo_bench.foreign.maps import load_map
from servo_bench.foreign.quantities import ROLES, UNITS
from servo_bench.foreign.rows import Source, timed
from tests.foreign_files import CURRENT, PLAIN, ROOT, ROWS, TIME, imported

DOCUMENT = (ROOT / "docs" / "import.md").read_text()


def _json(value: Any) -> bytes:
    return json.dumps(value).encode()


def _npz(**arrays: Any) -> bytes:
    file = io.BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()


def _mat(folder: Path, **values: Any) -> bytes:
    path = folder / "made.mat"
    scipy.io.savemat(path, values)
    return path.read_bytes()


def test_every_format_gives_the_same_channels(tmp_path: Path) -> None:
    t, i = [0.0, 0.5, 1.0], [1.0, 2.0, 4.0]
    records = [{"t": a, "i": b} for a, b in zip(t, i, strict=True)]
    deep = '[file]\ntable = "log.rows"\n'
    matrix = TIME.replace('"t"', '"data.1"') + CURRENT.replace('"i"', '"data.0"')
    numbered = TIME.replace('"t"', "0") + CURRENT.replace('"i"', "1")
    table = np.column_stack([i, t])
    cases: list[tuple[str, str | bytes, str]] = [
        ("a.csv", ROWS, PLAIN),
        ("b.csv", "﻿" + ROWS.replace("\n", "\r\n"), PLAIN),
        ("c.csv", "# a\n\nt, i \n0,1,\n# b\n0.5,2,\n1,4,\n", PLAIN),
        ("d.csv", 'x\ny\n"t";i\ns;A\n0;1,0\n0,5;2e0\n1;4\n',
         '[file]\nskip_lines = 2\nskip_rows = 1\ndelimiter = ";"\ndecimal = ","\n' + PLAIN),
        ("e.dat", "0 1\n.5   2\n1\t4\n", '[file]\nheader = false\ndelimiter = "whitespace"\n'
         + numbered),
        ("f.tsv", ROWS.replace(",", "\t"), PLAIN),
        ("g.log", ROWS.encode("utf-16"), '[file]\nformat = "csv"\nencoding = "utf-16"\n' + PLAIN),
        ("h.json", _json(records), PLAIN),
        ("i.json", _json({"t": t, "i": i}), PLAIN),
        ("j.json", _json({"log": {"rows": records}}), deep + PLAIN),
        ("k.json", _json([[a, b] for a, b in zip(t, i, strict=True)]), numbered),
        ("l.json", _json([{"t": a, "m": {"i": b}} for a, b in zip(t, i, strict=True)]),
         TIME + CURRENT.replace('"i"', '"m.i"')),
        ("m.npz", _npz(t=t, i=np.array(i, np.float32)), PLAIN),
        ("n.npz", _npz(data=table), matrix),
        ("o.mat", _mat(tmp_path, t=t, i=i), PLAIN),
        ("p.mat", _mat(tmp_path, log={"rows": {"t": t, "i": np.array(i, np.int16)}}), deep + PLAIN),
        ("q.mat", _mat(tmp_path, data=table), matrix),
    ]  # fmt: skip
    for name, content, plan in cases:
        recording = imported(tmp_path, content, plan, name)
        assert list(recording.channels) == ["t_s", "current_a"], name
        assert recording["t_s"].tolist() == t, name
        assert recording["current_a"].tolist() == i, name
        assert recording["current_a"].dtype == np.float64, name


def test_parquet_gives_them_too(tmp_path: Path) -> None:
    arrow = pytest.importorskip("pyarrow", reason="pyarrow is not installed")
    parquet = pytest.importorskip("pyarrow.parquet")
    parquet.write_table(arrow.table({"t": [0.0, 0.5], "i": [1, 2]}), tmp_path / "b.parquet")
    recording = imported(tmp_path, (tmp_path / "b.parquet").read_bytes(), PLAIN, "a.parquet")
    assert recording["current_a"].tolist() == [1.0, 2.0]


REVOLUTION = {
    "rad": 2 * math.pi, "mrad": 2000 * math.pi, "deg": 360, "arcmin": 21600, "rev": 1,
    "counts": 4096,
}  # fmt: skip
ALIKE = {
    "time": {"s": 2, "ms": 2e3, "us": 2e6, "ns": 2e9},
    "angle": REVOLUTION,
    "angular velocity": {
        "rad/s": 2 * math.pi, "deg/s": 360, "rev/s": 1, "rpm": 60, "counts/s": 4096,
    },
    "current": {"A": 3, "mA": 3e3},
    "torque": {"Nm": 0.5, "mNm": 500, "Ncm": 50},
    "voltage": {"V": 24, "mV": 24e3},
    "temperature": {"degC": 25, "K": 298.15, "degF": 77},
    "whole number": {"1": 7},
}  # fmt: skip


@pytest.mark.parametrize("role", [role for role in ROLES if role != "time"])
def test_one_quantity_in_every_unit_is_one_value(tmp_path: Path, role: str) -> None:
    alike = ALIKE[ROLES[role].quantity]
    assert set(alike) == set(UNITS[ROLES[role].quantity])
    plan, first = TIME, next(iter(alike.values()))
    for index, unit in enumerate(alike):
        counts = "counts_per_rev = 4096\n" if unit.startswith("counts") else ""
        plan += f'[[channel]]\nrole = "{role}"\nname = "x{index}"\ncolumn = "{unit}"\n'
        plan += f'unit = "{unit}"\n{counts}'
    row = ",".join(str(value) for value in alike.values())
    recording = imported(tmp_path, f"t,{','.join(alike)}\n0,{row}\n1,{row}\n", plan)
    for index in range(len(alike)):
        channel = recording[f"x{index}{ROLES[role].suffix}"]
        np.testing.assert_allclose(channel, first, rtol=1e-12)
        assert channel.dtype == (np.int64 if ROLES[role].suffix == "" else np.float64)


def test_a_mat_file_may_call_a_variable_what_it_likes(tmp_path: Path) -> None:
    made = _mat(tmp_path, t=[0.0, 1.0, 2.0], i=[1.0, 2.0, 3.0], file=[4.0], args={"i": 5.0})
    assert imported(tmp_path, made, PLAIN, "o.mat")["current_a"].tolist() == [1.0, 2.0, 3.0]


def test_times_in_every_unit_are_the_same_times(tmp_path: Path) -> None:
    for unit, two_seconds in ALIKE["time"].items():
        plan = TIME.replace('"s"', f'"{unit}"') + CURRENT
        recording = imported(tmp_path, f"t,i\n0,1\n{two_seconds},2\n", plan)
        np.testing.assert_allclose(recording["t_s"], [0.0, 2.0], rtol=1e-12)
        assert recording.period_s == pytest.approx(2.0)


def test_scale_offset_sign_product_bits_constant_and_unwrap(tmp_path: Path) -> None:
    plan = (
        TIME
        + """
        [[channel]]
        role = "current"
        column = "i"
        unit = "mA"
        scale = 2
        offset = 100
        sign = -1
        [[channel]]
        role = "voltage"
        column = "duty"
        integer_bits = 8
        scale = 0.01
        times = "supply"
        unit = "V"
        [[channel]]
        role = "phase"
        value = 2
        [[channel]]
        role = "motor_velocity"
        value = 3
        scale = 2
        sign = -1
        times = "supply"
        unit = "rad/s"
        [[channel]]
        role = "motor_position"
        column = "angle"
        unit = "deg"
        unwrap = true
    """
    )
    text = "t,i,duty,supply,angle\n0,50,100,10,350\n1,0,156,20,5\n2,-50,255,10,20\n"
    recording = imported(tmp_path, text, plan)
    np.testing.assert_allclose(recording["current_a"], [-0.2, -0.1, 0.0], atol=1e-15)
    np.testing.assert_allclose(recording["voltage_v"], [10.0, -20.0, -0.1])
    np.testing.assert_allclose(np.rad2deg(recording["motor_position_rad"]), [350, 365, 380])
    assert recording["phase"].tolist() == [2, 2, 2]
    assert recording["motor_velocity_rad_s"].tolist() == [-60.0, -120.0, -60.0]


def test_runs_are_kept_apart_and_may_overlap_in_time(tmp_path: Path) -> None:
    text = "t,i,n,a\n" + "".join(
        f"{t},{n}{t},{n},{a}\n" for n in (3, 7, 5) for t, a in ((0, 350), (1, 10), (2, 30))
    )
    angle = '[[channel]]\nrole = "load_position"\ncolumn = "a"\nunit = "deg"\nunwrap = true\n'
    recording = imported(tmp_path, text, '[runs]\ncolumn = "n"\nkeep = [5, 3]\n' + PLAIN + angle)
    assert recording["run"].tolist() == [3, 3, 3, 5, 5, 5]
    assert recording["t_s"].tolist() == [0, 1, 2, 0, 1, 2]
    assert recording["current_a"].tolist() == [30, 31, 32, 50, 51, 52]
    np.testing.assert_allclose(np.rad2deg(recording["load_angle_rad"]), [350, 370, 390] * 2)
    (event,) = recording.events
    assert (event.kind, event.data) == ("import", {"rows": 3})
    assert recording.period_s == 1.0


def test_a_window_keeps_both_its_ends(tmp_path: Path) -> None:
    plan = PLAIN + "[window]\nfrom_ms = 500\nto_s = 1\n"
    recording = imported(tmp_path, ROWS + "1.5,9\n", plan)
    assert recording["t_s"].tolist() == [0.5, 1.0]
    assert "2 rows lie outside the window" in recording.events[0].text


def test_a_period_stands_in_for_times_run_by_run(tmp_path: Path) -> None:
    plan = 'period_ms = 20\n[runs]\ncolumn = "n"\n' + CURRENT
    recording = imported(tmp_path, "i,n\n1,0\n2,0\n3,1\n4,1\n", plan)
    np.testing.assert_allclose(recording["t_s"], [0.0, 0.02, 0.0, 0.02])
    assert recording.period_s == pytest.approx(0.02)


def test_rows_without_a_number_go_only_by_leave_and_are_counted(tmp_path: Path) -> None:
    text = "t,i\n0,1\n1,\n2,nan\n3,inf\n,4\n5,6\n"
    recording = imported(tmp_path, text, 'nan = "drop"\n' + PLAIN)
    assert recording["t_s"].tolist() == [0.0, 5.0]
    assert recording.events[0].data == {"rows": 4}


def test_irregular_times_stay_as_they_are(tmp_path: Path) -> None:
    t = np.cumsum(np.random.default_rng(1).exponential(1e-3, 200))
    text = "t,i\n" + "".join(f"{x!r},1\n" for x in t.tolist())
    recording = imported(tmp_path, text, PLAIN)
    assert recording["t_s"].tolist() == t.tolist()
    assert recording.period_s == np.median(np.diff(t))


def test_repeated_times_are_spread_or_dropped_as_the_map_says(tmp_path: Path) -> None:
    text = "t,i\n0,1\n0,2\n10,3\n10,4\n10,5\n10,6\n20,7\n20,8\n"
    spread = imported(tmp_path, text, 'repeated = "spread"\n' + PLAIN)
    assert spread["t_s"].tolist() == [0, 5, 10, 12.5, 15, 17.5, 20, 25]
    assert spread.events[0].data == {"rows": 5}
    first = imported(tmp_path, text, 'repeated = "first"\n' + PLAIN)
    assert first["t_s"].tolist() == [0, 10, 20]
    assert first["current_a"].tolist() == [1, 3, 7]


@given(
    counts=st.lists(st.integers(1, 6), min_size=2, max_size=20),
    steps=st.lists(st.floats(1e-4, 10.0), min_size=20, max_size=20),
    second=st.lists(st.integers(1, 6), min_size=2, max_size=5),
)
def test_spread_times_rise_and_stay_in_their_ticks(
    counts: list[int], steps: list[float], second: list[int]
) -> None:
    ticks = np.cumsum(steps)
    one = np.repeat(ticks[: len(counts)], counts)
    t_s = np.concatenate([one, np.repeat(ticks[: len(second)], second)])
    run = np.repeat([4, 2], [one.size, sum(second)])
    source = Source("a", str)
    found, _ = timed(t_s, np.arange(t_s.size), run, "spread", source)
    assert (np.diff(found.t_s)[np.diff(run) == 0] > 0).all()
    followed = found.t_s[: one.size - counts[-1]]
    np.testing.assert_array_equal(np.searchsorted(ticks, followed * (1 + 1e-12), "right") - 1,
                                  np.repeat(np.arange(len(counts) - 1), counts[:-1]))  # fmt: skip
    kept, _ = timed(t_s, np.arange(t_s.size), run, "first", source)
    assert set(kept.t_s) == set(t_s)
    assert kept.rows.size == len(counts) + len(second)


def test_an_optional_column_that_is_absent_is_left_out_and_said(tmp_path: Path) -> None:
    plan = PLAIN + '[[channel]]\nrole = "voltage"\ncolumn = "u"\nunit = "V"\noptional = true\n'
    recording = imported(tmp_path, ROWS, plan)
    assert "voltage_v" not in recording
    assert recording.events[0].text == "there is no column for voltage_v"


def test_the_plant_takes_readers_units_and_values_of_the_file(tmp_path: Path) -> None:
    plan = (
        PLAIN
        + """
        [file]
        table = "rows"
        [plant]
        inertia_kg_m2 = 2e-4
        backlash_gap_deg = 180
        pendulum.mass_kg = { from = "setup.mass_g", scale = 1e-3 }
        pendulum.length_m = 0.1
    """
    )
    content = _json({"setup": {"mass_g": 490}, "rows": {"t": [0, 1], "i": [1, 2]}})
    plant = imported(tmp_path, content, plan, "a.json").plant
    assert plant is not None
    assert plant.pendulum is not None
    assert (plant.name, plant.inertia_kg_m2) == ("test", 2e-4)
    assert plant.backlash_gap_rad == pytest.approx(math.pi)
    assert plant.pendulum.mass_kg == pytest.approx(0.49)


def test_the_provenance_says_where_it_came_from(tmp_path: Path) -> None:
    recording = imported(tmp_path, ROWS, PLAIN)
    facts = recording.provenance
    assert facts["source_file"] == "a.csv"
    assert facts["source_sha256"] == (  # by sha256sum
        "41457c128a62714ecb6ecfc92b0b1b259d99be92d53308dac86332a76049401a"
    )
    assert facts["map"] == (tmp_path / "map.toml").read_text()


def test_quoted_cells_are_one_cell(tmp_path: Path) -> None:
    text = io.StringIO()
    csv.writer(text).writerows([["t", "i", "note, and more"], [0, 1, "a,b"], [1, 2, 'say "x"']])
    assert imported(tmp_path, text.getvalue(), PLAIN)["current_a"].tolist() == [1.0, 2.0]


@pytest.mark.parametrize(
    "name", sorted(p.name for p in (ROOT / "servo_bench/library/maps").iterdir())
)
def test_a_shipped_map_loads_and_is_in_the_document(name: str) -> None:
    loaded = load_map(f"maps/{name}")
    assert loaded.map.source
    assert f"`maps/{name}`" in DOCUMENT


def test_the_document_names_every_role_with_its_units() -> None:
    for name, role in ROLES.items():
        (line,) = (line for line in DOCUMENT.splitlines() if line.startswith(f"| `{name}` | "))
        channel = role.base + role.suffix
        assert f"| `{channel}` |" in line or not channel
        assert line.split("|")[3].strip() == ", ".join(UNITS[role.quantity])


def test_the_documents_map_reads_a_file(tmp_path: Path) -> None:
    text = DOCUMENT.split("```toml\n")[1].split("```")[0]
    (tmp_path / "map.toml").write_text(text)
    (tmp_path / "a.csv").write_text("a\nb\nc\nt;enc;iq\nms;1;mA\n0;4095;1,5\n8;0;2\n")
    recording = read_foreign(tmp_path / "a.csv", load_map(tmp_path / "map.toml"))
    np.testing.assert_allclose(recording["current_a"], [-1.5e-3, -2e-3])
    np.testing.assert_allclose(np.diff(recording["motor_position_rad"]), 2 * np.pi / 4096)


@pytest.mark.parametrize(
    ("map_text", "rows", "said"),
    [
        (TIME + "optional = true\n" + CURRENT, ROWS, "a time cannot be optional"),
        ('[file]\nencoding = "u\\u0000"\n' + PLAIN, ROWS, "there is no encoding"),
        (PLAIN, ROWS.replace("0.5", "1_000"), "'1_000', and must be a number"),
    ],
)
def test_what_no_table_can_be_is_said(tmp_path: Path, map_text: str, rows: str, said: str) -> None:
    with pytest.raises((ConfigError, RecordingError), match=said):
        imported(tmp_path, rows, map_text)


def test_a_constant_that_hangs_on_an_absent_column_is_left_out_with_it(tmp_path: Path) -> None:
    volts = '[[channel]]\nrole = "voltage"\nvalue = 12.0\ntimes = "duty"\nunit = "V"\n'
    recording = imported(tmp_path, ROWS, PLAIN + volts + "optional = true\n")
    assert "voltage_v" not in recording
