"""EDS, TOML, and MCAP files for `tests.fuzz_targets`: what people and machines make of them."""

import copy
import json
import math
import tomllib
from collections.abc import Callable
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from hypothesis import strategies as st
from mcap.writer import CompressionType

import drivers.profile_file
from drivers.canopen.eds import load_eds
from drivers.canopen.profile import load_profile as canopen_profile
from drivers.counter.profile import load_profile as counter_profile
from drivers.modbus.library import load_profile as modbus_profile
from servo_bench.excitation.experiment import load_experiment
from servo_bench.files import SHIPPED
from servo_bench.recording.mcap_file import load, recover
from servo_bench.recording.scan import MAGIC
from servo_bench.rig import load_rig
from servo_bench.run.axes import axis_settings
from tests.recording_files import EVENT, json_messages, rows, strangers_file, write
from tests.test_drivers_eds import GOOD, MESS

MEMORY = Path("/dev/shm")  # noqa: S108 - thousands of small files


def _in_a_file(name: str, data: bytes, play: Callable[[Path], object]) -> None:
    with TemporaryDirectory(dir=MEMORY if MEMORY.is_dir() else None) as folder:
        path = Path(folder) / name
        path.write_bytes(data)
        play(path)


# EDS

_EDS_LINES = st.sampled_from([
    *("[6041]", "[1400sub1]", "[1400sub0]", "[zzzz]", "[6041Name]", "[1010Value]", "[FileInfo]"),
    *("ObjectType=0x7", "ObjectType=0x8", "ObjectType=9", "ObjectType=", "ObjectType=x"),
    *("DataType=0x0007", "DataType=0xFFFF", "DataType=", "DataType=9", "DataType=0x0001"),
    *("SubNumber=3", "SubNumber=0xFFFFFFFF", "CompactSubObj=2", "CompactSubObj=255"),
    *("NrOfEntries=1", "1=one", "AccessType=rw", "AccessType=", "AccessType=none"),
    *("DefaultValue=$NODEID+0x200", "DefaultValue=$NODEID", "DefaultValue=1.5", "DefaultValue=-1"),
    *("LowLimit=0x80000000", "HighLimit=99999999999999999999", "LowLimit=a", "PDOMapping=1"),
    *("ParameterName=", "ParameterName=a.b", "Factor=0", "=", "==", "[", "]", "[]", "[[", "%(x)s"),
    *("[DeviceInfo]", "[DEFAULT]", "[DeviceComissioning]", "NodeID=0x1", "BaudRate_10=z"),
])  # fmt: skip
_EDS_EDITS = st.lists(
    st.tuples(st.integers(0, 60), st.integers(0, 2), _EDS_LINES | st.text(max_size=12)),
    max_size=6,
)
EDS = st.tuples(st.sampled_from([GOOD, MESS]), _EDS_EDITS, st.integers(0, 127), st.booleans())
"""Text, edits (line; replace, insert, delete; by what), node id, and whether in Latin-1."""


def eds(case: tuple[str, list[tuple[int, int, str]], int, bool]) -> None:
    """The device's dictionary is read, and every object's entry is used."""
    text, edits, node_id, latin = case
    lines = text.splitlines()
    for place, kind, line in edits:
        at = place % (len(lines) + 1)
        lines[at : at + (kind != 1)] = [] if kind == 2 else [line]
    encoding = "latin-1" if latin else "utf-8"
    data = "\n".join(lines).encode(encoding, errors="replace")
    _in_a_file("device.eds", data, lambda path: _use_eds(path, node_id))


def _use_eds(path: Path, node_id: int) -> None:
    dictionary = load_eds(path, node_id, (0x6041,))
    for index in dictionary:
        for sub in (0, 1, 255):
            variable = dictionary.get_variable(index, sub)
            if variable is not None:
                assert len(variable) >= 0
                assert isinstance(variable.writable, bool)


# TOML


def toml_of(table: dict[str, Any]) -> str:
    """A table as TOML, each of its keys on one line."""
    return "".join(f"{json.dumps(key)} = {_inline(value)}\n" for key, value in table.items())


def _inline(value: Any) -> str:
    if isinstance(value, dict):
        pairs = ", ".join(f"{json.dumps(key)} = {_inline(it)}" for key, it in value.items())
        return f"{{{pairs}}}"
    if isinstance(value, list):
        return f"[{', '.join(map(_inline, value))}]"
    if isinstance(value, float) and not math.isfinite(value):
        return "nan" if math.isnan(value) else "inf" if value > 0 else "-inf"
    return json.dumps(value)


_SCALARS = (
    st.booleans()
    | st.integers(-(1 << 63), (1 << 63) - 1)
    | st.sampled_from([0, 1, -1, 2, 127, 128, 65536, 1e300, -0.0, 1e-300, 0.5, math.inf, math.nan])
    | st.text(st.characters(codec="utf-8", exclude_characters="\x7f"), max_size=8)
    | st.sampled_from(["", "generic", "0x6041", "int32", "modbus-rtu", "../..", "count", "x" * 300])
)
_VALUES = st.recursive(
    _SCALARS,
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(st.text("abc_", max_size=4), inner, max_size=3)
    ),
    max_leaves=5,
)
_EDITS = st.lists(
    st.tuples(st.integers(0, 200), st.sampled_from(["set", "drop", "add", "swap"]), _VALUES),
    min_size=1,
    max_size=3,
)
_TEXT_EDITS = st.lists(st.tuples(st.integers(0, 3000), st.binary(max_size=4)), max_size=3)


def _shipped(*folders: Path) -> st.SearchStrategy[Any]:
    paths = sorted(path for folder in folders for path in folder.glob("*.toml"))
    return st.tuples(st.sampled_from(paths), _EDITS | st.none(), _TEXT_EDITS)


RIGS = st.tuples(
    _shipped(*(folder / "rigs" for folder in SHIPPED)), st.sampled_from([0.008, 0.001, 1e-9, 10.0])
)
EXPERIMENTS = _shipped(*(folder / "experiments" for folder in SHIPPED))
PROFILES = _shipped(
    *(drivers.profile_file.PROFILES / it for it in ("canopen", "modbus", "counter"))
)


@cache
def _table(path: Path) -> dict[str, Any]:
    return tomllib.loads(path.read_text("utf-8"))


def _places(table: Any) -> list[tuple[Any, Any]]:
    """Every (container, key) in a table."""
    keys = table.keys() if isinstance(table, dict) else range(len(table))
    found = []
    for key in keys:
        found.append((table, key))
        if isinstance(table[key], dict | list):
            found += _places(table[key])
    return found


def changed(case: tuple[Path, list[tuple[int, str, Any]] | None, list[tuple[int, bytes]]]) -> bytes:
    """A shipped file with some of its values, or else some of its bytes, changed."""
    path, edits, cuts = case
    if edits is None:
        data = bytearray(path.read_bytes())
        for place, piece in cuts:
            at = place % len(data)
            data[at : at + 2] = piece
        return bytes(data)
    table = copy.deepcopy(_table(path))
    for number, what, value in edits:
        places = _places(table)
        if not places:
            break
        holder, key = places[number % len(places)]
        other, where = places[(number * 7 + 1) % len(places)]
        if what == "set":
            holder[key] = value
        elif what == "swap":
            holder[key] = copy.deepcopy(other[where])
        elif what == "drop":
            del holder[key]
        elif isinstance(holder, dict):
            holder["another"] = value
    return toml_of(table).encode()


def rigs(case: tuple[Any, float]) -> None:
    """The rig is read, and what master and software rig need is made of it."""
    edited, period_s = case

    def use(path: Path) -> None:
        rig = load_rig(path)
        rig.simulation_settings()
        axis_settings(rig, period_s)

    _in_a_file("rig.toml", changed(edited), use)


def experiments(case: Any) -> None:
    """The experiment is read, and its schedule is made."""
    _in_a_file("experiment.toml", changed(case), lambda path: load_experiment(path).schedule())


_READERS = {"canopen": canopen_profile, "modbus": modbus_profile, "counter": counter_profile}


def profiles(case: Any) -> None:
    """The profile is read, as what it was and as the others."""

    def use(path: Path) -> None:
        _READERS[case[0].parent.name](str(path))

    _in_a_file("profile.toml", changed(case), use)


# MCAP


@cache
def whole(kind: str = "ours", samples: int = 200) -> bytes:
    """A whole file of so many samples, by us or as a stranger's without chunks or compression."""
    table = rows(samples)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "a.mcap"
        messages = json_messages(table, MCAP_CHANNELS)
        if kind == "ours":
            write(path, table, (EVENT,))
        elif kind == "no chunks":
            strangers_file(path, messages, chunked=False)
        else:
            strangers_file(path, messages, compression=CompressionType[kind])
        return path.read_bytes()


MCAP_CHANNELS = ["slot", "phase", "chip", "velocity_command_rad_s", "load_angle_rad"]
_FLIPS = st.lists(st.tuples(st.floats(0, 1, exclude_max=True), st.integers(1, 255)), max_size=4)
_RUNS = st.lists(
    st.tuples(st.integers(8, 3200), st.sampled_from([0, 0x7F, 0x80, 0xFF]), st.integers(1, 9)),
    max_size=1,
)
_CHANGED = st.tuples(
    st.sampled_from(["ours", "no chunks", "NONE", "LZ4"]),
    *(_FLIPS, _RUNS, st.floats(0.3, 1) | st.just(1.0), st.binary(max_size=12)),
)
"""A file, bytes that are flipped, lengths that lie, where it is cut, what is put behind."""
MCAP = st.tuples(
    _CHANGED | st.binary(max_size=200) | st.binary(max_size=200).map(MAGIC.__add__),
    st.sampled_from(["load", "load cut", "recover"]),
)


def mcap(case: tuple[Any, str]) -> None:
    """It is loaded, or saved what can be saved."""
    told, how = case
    data = told if isinstance(told, bytes) else _damaged(*told)

    def use(path: Path) -> None:
        if how == "recover":
            recover(path, path.with_name("b.mcap"))
            assert load(path.with_name("b.mcap"), allow_cut=True) is not None
        else:
            load(path, allow_cut=how == "load cut")

    _in_a_file("a.mcap", data, use)


def _damaged(
    kind: str,
    flips: list[tuple[float, int]],
    runs: list[tuple[int, int, int]],
    cut: float,
    behind: bytes,
) -> bytes:
    data = bytearray(whole(kind, 24))
    for place, mask in flips:
        data[int(place * len(data))] ^= mask
    for offset, value, length in runs:
        data[offset : offset + length] = bytes([value]) * length
    return bytes(data[: int(cut * len(data))]) + behind
