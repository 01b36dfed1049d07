"""A recording in another program's file, read there by that program's own means."""

import csv
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.io
from typer.testing import CliRunner

from servo_bench.cli.app import app
from servo_bench.errors import ConfigError, RecordingError
from servo_bench.foreign import exporting
from servo_bench.foreign.exporting import export
from servo_bench.foreign.importing import read_foreign
from servo_bench.foreign.maps import load_map
from servo_bench.recording.mcap_file import load
from servo_bench.recording.recording import MISSING, Recording
from tests.recording_files import NAMES, rows, write


@pytest.fixture
def run(tmp_path: Path) -> Recording:
    table = rows(50)
    table["load_angle_rad"][7], table["load_angle_counts"][7] = np.nan, MISSING
    table["motor_velocity_rad_s"] = np.random.default_rng(1).normal(size=50) * 1e-7
    return load(write(tmp_path / "run.mcap", table))


def _wanted(run: Recording) -> dict[str, np.ndarray]:
    asked = run["asked_ns"]
    return {"t_s": (asked - asked[0]) * 1e-9, **run.channels}


def test_csv_reads_back_to_the_last_bit(run: Recording, tmp_path: Path) -> None:
    export(run, tmp_path / "a.csv", "csv")
    with (tmp_path / "a.csv").open(newline="") as file:
        lines = list(csv.DictReader(file))
    assert list(lines[0]) == ["t_s", *NAMES]
    for name, values in _wanted(run).items():
        gone = np.isnan(values) if values.dtype.kind == "f" else values == MISSING
        cells = [line[name] for line in lines]
        assert [cell == "" for cell in cells] == gone.tolist()
        read = [type(v)(c) for c, v in zip(cells, values.tolist(), strict=True) if c]
        assert read == values[~gone].tolist()


def test_npz_and_mat_hold_the_arrays_themselves(run: Recording, tmp_path: Path) -> None:
    export(run, tmp_path / "a.npz", "npz")
    export(run, tmp_path / "a.mat", "mat")
    mat = scipy.io.loadmat(str(tmp_path / "a.mat"))
    with np.load(tmp_path / "a.npz", allow_pickle=False) as npz:
        assert npz.files == ["t_s", *NAMES]
        for name, values in _wanted(run).items():
            assert npz[name].dtype == values.dtype
            assert npz[name].tobytes() == values.tobytes()
            assert mat[name].shape == (len(run), 1)
            assert mat[name].tobytes() == values.tobytes()


@pytest.mark.parametrize("kind", ["csv", "npz", "mat"])
def test_what_was_exported_can_be_imported(run: Recording, tmp_path: Path, kind: str) -> None:
    out = tmp_path / f"a.{kind}"
    done = CliRunner().invoke(
        app, ["export", str(tmp_path / "run.mcap"), "--to", kind, "-o", str(out)]
    )
    assert done.exit_code == 0, done.output
    (tmp_path / "map.toml").write_text("""
        name = "our own"
        [[channel]]
        role = "time"
        column = "t_s"
        unit = "s"
        [[channel]]
        role = "motor_velocity"
        column = "motor_velocity_rad_s"
        unit = "rad/s"
        [[channel]]
        role = "chip"
        column = "chip"
    """)
    back = read_foreign(out, load_map(tmp_path / "map.toml"))
    assert back["motor_velocity_rad_s"].tobytes() == run["motor_velocity_rad_s"].tobytes()
    assert back["chip"].tolist() == run["chip"].tolist()
    np.testing.assert_array_equal(back["t_s"], _wanted(run)["t_s"])


def test_a_channel_may_be_called_as_numpys_own_parameters_are(
    run: Recording, tmp_path: Path
) -> None:
    taken = {name: np.arange(3.0) for name in ("file", "allow_pickle", "t_s")}
    export(replace(run, channels=taken), tmp_path / "a.npz", "npz")
    with np.load(tmp_path / "a.npz", allow_pickle=False) as archive:
        assert sorted(archive.files) == sorted(taken)
        assert (archive["file"] == taken["file"]).all()


def test_a_run_without_asks_gets_its_times_from_the_slots(run: Recording, tmp_path: Path) -> None:
    channels = {name: values for name, values in run.channels.items() if name != "asked_ns"}
    export(replace(run, channels=channels), tmp_path / "a.npz", "npz")
    with np.load(tmp_path / "a.npz") as npz:
        slots = run["slot"] - run["slot"][0]
        np.testing.assert_allclose(npz["t_s"], slots * run.period_s, rtol=1e-15)


def test_parquet_holds_nulls_where_nothing_came(run: Recording, tmp_path: Path) -> None:
    pytest.importorskip("pyarrow", reason="pyarrow is not installed")
    parquet = pytest.importorskip("pyarrow.parquet")
    export(run, tmp_path / "a.parquet", "parquet")
    table = parquet.read_table(tmp_path / "a.parquet")
    assert table.column_names == ["t_s", *NAMES]
    counts = table.column("load_angle_counts").to_pylist()
    assert counts[7] is None
    assert counts[8] == run["load_angle_counts"][8]
    assert table.column("chip").to_pylist() == run["chip"].tolist()


def test_parquet_without_its_package_says_how_to_install_it(
    run: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("pyarrow", "pyarrow.parquet"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(ConfigError, match=r"pip install 'servo-bench\[parquet\]'"):
        export(run, tmp_path / "a.parquet", "parquet")
    assert not (tmp_path / "a.parquet").exists()


def test_a_file_is_never_overwritten_and_none_is_left_half_done(
    run: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "a.csv").write_text("precious")
    with pytest.raises(ConfigError, match=r"a.csv exists already: name another file"):
        export(run, tmp_path / "a.csv", "csv")
    assert (tmp_path / "a.csv").read_text() == "precious"
    with pytest.raises(ConfigError, match="cannot be written: No such file"):
        export(run, tmp_path / "no" / "a.csv", "csv")
    named = replace(run, channels={"t_s": run["chip"], "x" * 32: run["chip"]})
    with pytest.raises(RecordingError, match="cannot be a name in a MAT file: at most 31"):
        export(named, tmp_path / "b.mat", "mat")
    assert not (tmp_path / "b.mat").exists()

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(exporting, "_cells", full)
    with pytest.raises(ConfigError, match="No space left"):
        export(run, tmp_path / "c.csv", "csv")
    assert not (tmp_path / "c.csv").exists()
