"""The daemon's parts, each against what it promises: lock, queue, frames, systemd, config."""

import errno
import json
import os
import shutil
import socket
import struct
import subprocess
import sys
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import BaseModel

from servo_bench.cli.daemon import UNIT
from servo_bench.daemon import store
from servo_bench.daemon.config import BenchConfig, NetworkConfig, RunConfig, load_bench
from servo_bench.daemon.job import RunJob, RunResult
from servo_bench.daemon.live import (
    LINGER_S,
    MAX_ROWS,
    ReplaySource,
    TableSource,
    Viewer,
    frame,
    thinned,
)
from servo_bench.daemon.notify import notify, watchdog_s
from servo_bench.daemon.processes import bus_processes
from servo_bench.daemon.queue import Queue, Waiting
from servo_bench.daemon.requests import new_file, recording_bytes
from servo_bench.errors import BenchError, BusyError, ConfigError, RecordingError
from servo_bench.excitation.counting import counted_slots
from servo_bench.excitation.experiment import experiment_from_table
from servo_bench.excitation.fields import first_primitive
from servo_bench.recording.mcap_file import RecordingWriter
from servo_bench.recording.recording import FAST_DTYPE, SAMPLE_DTYPE
from servo_bench.rig import load_rig
from servo_bench.run.command_line import bus_loop_command
from servo_bench.run.lock import Holder, holder_of, rig_lock_path, take
from servo_bench.run.table import SlotTable
from tests.daemon_process import rows_of, write_bench
from tests.played_rig import Rig, experiment
from tests.recording_files import FACTS


def test_a_lock_names_its_holder_and_ends_with_it(tmp_path: Path) -> None:
    path = tmp_path / "rig.lock"
    lock = take(path, Holder("the night shift", url="http://127.0.0.1:1"))
    with pytest.raises(BusyError, match=r"held by the night shift \(process \d+.*127.0.0.1:1\)"):
        take(path, Holder("another"))
    lock.release()
    assert not path.exists()
    take(path, Holder("another")).release()


def test_a_lock_lives_as_long_as_anybody_has_its_descriptor(tmp_path: Path) -> None:
    path = tmp_path / "rig.lock"
    lock = take(path, Holder("first"))
    childs = os.dup(lock.descriptor)
    lock.let_go()
    with pytest.raises(BusyError, match="first"):
        take(path, Holder("second"))
    os.close(childs)
    again = take(path, Holder("second"))
    held = holder_of(path)
    assert held is not None
    assert held.what == "second"
    again.release()


def test_a_lock_that_only_another_user_may_write_names_him_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "rig.lock"
    real = os.open

    def of_another(name: Path, flags: int, mode: int = 0o777) -> int:
        if flags & os.O_RDWR and name == path:
            raise PermissionError(errno.EACCES, "Permission denied")
        return real(name, flags, mode)

    lock = take(path, Holder("the night shift"))
    with monkeypatch.context() as patched:
        patched.setattr(os, "open", of_another)
        with pytest.raises(BusyError, match=r"another cannot have.* held by the night shift"):
            take(path, Holder("another"))
        lock.let_go()
        with pytest.raises(ConfigError, match="must remove it"):
            take(path, Holder("another"))
    take(path, Holder("the night shift")).release()


@pytest.mark.parametrize("text", ["", "{", "[]", '{"what": 1, "more": 2}', "\0" * 4096])
def test_a_lock_with_strange_words_in_it_is_a_lock_all_the_same(tmp_path: Path, text: str) -> None:
    path = tmp_path / "rig.lock"
    path.write_text(text)
    assert holder_of(path) is None
    take(path, Holder("me")).release()


def test_two_buses_have_two_locks_and_one_bus_has_one() -> None:
    rig = load_rig("rigs/paper.toml")
    assert rig_lock_path(rig.bus) == rig_lock_path({**rig.bus, "tcp_tune": False})
    assert rig_lock_path(rig.bus) != rig_lock_path({**rig.bus, "port": 1})
    assert rig_lock_path({"channel": "../../etc/x"}).parent == rig_lock_path(rig.bus).parent


def waiting(number: int) -> Waiting:
    return Waiting(f"{number:016x}", f"{number}.mcap", "a run", "short", "me", "a note", {})


def test_a_queue_is_on_disk_before_it_is_true(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    queue = Queue(tmp_path, 3)
    assert [queue.add(waiting(number)) for number in (1, 2)] == [0, 1]
    assert list(Queue(tmp_path, 3)) == [waiting(1), waiting(2)]

    def full(descriptor: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr(store.os, "fsync", full)
        with pytest.raises(RecordingError, match=r"No space left.*nothing was changed"):
            queue.add(waiting(3))
        with pytest.raises(RecordingError):
            queue.remove(waiting(1).id)
    assert list(queue) == list(Queue(tmp_path, 3)) == [waiting(1), waiting(2)]
    assert [path.name for path in tmp_path.iterdir()] == ["queue.json"]
    queue.add(waiting(3))
    with pytest.raises(BenchError, match="3 runs wait already"):
        queue.add(waiting(4))
    assert queue.remove(waiting(2).id) == waiting(2)
    assert queue.remove(waiting(2).id) is None
    assert queue.first() == waiting(1)


@pytest.mark.parametrize("text", ["{", "[]", '{"waiting": 3}', '{"waiting": [{"id": 1}]}', "{}"])
def test_a_damaged_queue_is_said_and_never_replaced(tmp_path: Path, text: str) -> None:
    (tmp_path / "queue.json").write_text(text)
    with pytest.raises(ConfigError, match=r"queue.json.*Move it away"):
        Queue(tmp_path, 3)
    assert (tmp_path / "queue.json").read_text() == text


def test_what_the_daemon_hands_a_runner_comes_out_as_it_went_in(tmp_path: Path) -> None:
    plan = experiment()
    job = RunJob("a", plan, load_rig("rigs/paper.toml"), tmp_path, True, 0, 1, None, {"x": "y"})
    assert RunJob.from_table(json.loads(json.dumps(job.table()))) == job
    result = RunResult("stopped", "stopped.", notes=("a", "b"))
    with pytest.raises(ConfigError, match="no job of this version"):
        RunJob.from_table({**job.table(), "new": 1})
    assert RunResult.from_table(json.loads(json.dumps(asdict(result)))) == result


def test_viewers_get_every_row_once_and_a_slow_one_gets_fewer_not_more_memory() -> None:
    slots = 4 * MAX_ROWS
    with SlotTable.create(slots) as table:
        source = TableSource(table, 0.5)
        quick, slow = Viewer(), Viewer()
        assert quick.frame(source) is None
        got = []
        for done in range(0, slots + 1, 100):
            rows = table.rows[max(0, done - 100) : done]
            rows["slot"] = np.arange(max(0, done - 100), done)
            rows["asked_ns"] = 7 + 8_000_000 * rows["slot"]
            rows["motor_torque_nm"] = rows["slot"]
            table.done = done
            block = quick.frame(source)
            got += [rows_of(block)] if block else []
        late = slow.frame(source, history=slots)
        assert late is not None
        assert len(late) == 16 + MAX_ROWS * 48
        everything = np.concatenate(got)
        np.testing.assert_allclose(everything[:, 0], np.arange(slots) * 0.008)
        np.testing.assert_allclose(everything[:, 4], np.arange(slots) / 0.5)
        assert rows_of(late)[-1, 0] == everything[-1, 0]
        assert quick.frame(source) is None
        del rows


def test_a_skipped_slot_is_in_no_frame() -> None:
    with SlotTable.create(4) as table:
        table.rows["slot"][[1, 3]] = [1, 3]
        table.rows["asked_ns"][[1, 3]] = [10, 20]
        table.done = 4
        assert len(TableSource(table, 1.0).rows(0, 4)) == 2


def test_thinning_keeps_first_and_last_and_order() -> None:
    rows = np.arange(6.0 * 1234).reshape(-1, 6)
    kept = thinned(rows)
    assert len(kept) == MAX_ROWS
    assert (np.diff(kept[:, 0]) > 0).all()
    np.testing.assert_array_equal(kept[[0, -1]], rows[[0, -1]])
    assert struct.unpack_from("<4I", frame(rows))[:3] == (0x53424C56, 1234, 6)


@pytest.mark.parametrize("speed", [0.1, 1.0, 50.0])
def test_a_replay_takes_the_recordings_time_over_its_speed(speed: float) -> None:
    recording = Rig().record(experiment("2327", memory=8, fresh=16))
    now_ns = [0]
    source = ReplaySource(recording, speed, now_ns=lambda: now_ns[0])
    duration_s = len(recording) * recording.period_s
    now_ns[0] = round(duration_s / speed / 2 * 1e9)
    assert abs(source.ready() - len(recording) / 2) <= 1
    assert not source.over
    now_ns[0] = round(duration_s / speed * 1e9)
    assert source.ready() == len(recording)
    assert not source.over, "pages have yet to fetch its end"
    now_ns[0] += round(LINGER_S * 1e9)
    assert source.over
    np.testing.assert_array_equal(source.rows(0, len(recording))[:, 3], recording["load_angle_rad"])
    assert ReplaySource(recording, 1.0, 1.0, lambda: 0).ready() == 125


def test_systemd_is_told_by_its_own_protocol(tmp_path: Path) -> None:
    place = f"/tmp/{os.getpid()}.notify"  # noqa: S108 - a socket's path may have 107 bytes
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind("\0" + place)
        assert notify("READY=1", "STATUS=up", environment={"NOTIFY_SOCKET": "@" + place})
        assert systemd.recv(100) == b"READY=1\nSTATUS=up"
        # one who does not read fills what the kernel keeps, and does not hold the daemon up
        beat = partial(notify, "WATCHDOG=1", environment={"NOTIFY_SOCKET": "@" + place})
        assert not all(beat() for _ in range(10_000))
    assert not notify("READY=1", environment={})
    assert not notify("READY=1", environment={"NOTIFY_SOCKET": str(tmp_path / "gone")})
    assert watchdog_s({"WATCHDOG_USEC": "10000000"}) == 10.0
    assert watchdog_s({"WATCHDOG_USEC": "1", "WATCHDOG_PID": "1"}) is None
    assert watchdog_s({}) is None


def test_the_unit_lets_a_run_outlive_the_web_side_and_watches_it() -> None:
    lines = UNIT.read_text().splitlines()
    for wanted in (
        *("Type=notify", "KillMode=process", "Restart=on-failure"),
        *("LimitRTPRIO=95", "LimitMEMLOCK=infinity", "NoNewPrivileges=yes"),
    ):
        assert wanted in lines
    assert not [line for line in lines if line.startswith("RestrictRealtime")]


def test_systemd_understands_every_line_of_the_unit(tmp_path: Path) -> None:
    verifier = shutil.which("systemd-analyze")
    if verifier is None:
        pytest.skip("no systemd-analyze here: it reads a unit as systemd does")
    program = shutil.which("true")
    unit = tmp_path / UNIT.name
    text = UNIT.read_text()
    unit.write_text(text.replace("ExecStart=/usr/local/bin/servo-bench", f"ExecStart={program}"))
    assert program is not None
    assert program in unit.read_text()
    done = subprocess.run([verifier, "verify", unit], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_no_bus_process_is_found_where_none_is() -> None:
    assert bus_processes(os.getpid()) == []


def test_a_bus_process_is_known_by_the_command_that_a_session_starts_it_with() -> None:
    """It waits for its job: nothing comes on its standard input."""
    command = bus_loop_command(os.getpid())
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL) as process:
        assert bus_processes(os.getpid()) == [process.pid]
        assert bus_processes(os.getpid() + 1) == []
        process.kill()


def test_files_have_plain_names_that_nothing_else_has(tmp_path: Path) -> None:
    names = {new_file(tmp_path, "../../etc/passwd\0 <b>ü</b>" * 9)[0] for _ in range(50)}
    assert len(names) > 45
    assert all(
        name.isascii()
        and name.replace("-", "").replace("_", "").replace(".", "").isalnum()
        and len(name) < 80
        for name in names
    )


BAD_BENCHES = [
    ('host = "0.0.0.0"', r"nothing asks who they are.*token_file"),
    ('host = "0.0.0.0"\ntoken_file = "token"', r"without TLS.*allow_plain_http"),
    ('token_file = "none"', r"there is no file"),
    ('token_file = "short"', r"token of 3 characters.*openssl"),
    ('certificate = "token"', r"go together"),
    ('host = "0.0.0.0"\ntoken_file = "token"\ncertificate = "no.crt"\nkey = "k"', "no file"),
    ("port = 70000", r"network.port"),
    ('hosts = "x"', r"network.hosts"),
    ("requests_per_second = 0", r"requests_per_second"),
    ("colour = 1", r"network.colour"),
]


@pytest.mark.parametrize(("network", "words"), BAD_BENCHES, ids=[row[1] for row in BAD_BENCHES])
def test_a_bench_that_must_not_be_served_is_refused_in_words(
    tmp_path: Path, network: str, words: str
) -> None:
    (tmp_path / "token").write_text("0123456789abcdef\n")
    (tmp_path / "short").write_text("abc")
    with pytest.raises(ConfigError, match=words):
        load_bench(write_bench(tmp_path, network=network))


def test_beyond_loopback_with_a_token_and_the_words(tmp_path: Path) -> None:
    (tmp_path / "token").write_text("0123456789abcdef\n")
    network = 'host = "0.0.0.0"\ntoken_file = "token"\nallow_plain_http = true'
    bench = load_bench(write_bench(tmp_path, network=network))
    assert bench.beyond_loopback
    assert bench.token == "0123456789abcdef"  # noqa: S105 - a test's
    assert "0123456789abcdef" not in repr(bench)


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ('recordings = "bench.toml"', "cannot be made a folder"),
        ('state = "\\u0000"', "state"),
        ('rigs = "x"', "rigs"),
    ],
)
def test_folders_that_cannot_be_are_said(tmp_path: Path, more: str, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        load_bench(write_bench(tmp_path, more=more))


@pytest.mark.parametrize("model", [BenchConfig, NetworkConfig, RunConfig])
def test_every_key_of_a_bench_file_is_documented(model: type[BaseModel]) -> None:
    text = (Path(__file__).parent.parent / "docs" / "daemon.md").read_text()
    assert [
        key
        for key in model.model_fields
        if f"{key} = " not in text and key not in {"network", "run"}
    ] == []


def test_the_bench_file_of_the_documentation_is_one(tmp_path: Path) -> None:
    text = (Path(__file__).parent.parent / "docs" / "daemon.md").read_text()
    written = text.split("```toml\n")[1].split("```")[0]
    (tmp_path / "bench.toml").write_text(written)
    for name in ("token", "bench.crt", "bench.key"):
        (tmp_path / name).write_text("0123456789abcdef0123456789abcdef")
    bench = load_bench(tmp_path / "bench.toml")
    assert {"paper", "demo"} <= set(bench.experiments)
    assert bench.network == NetworkConfig(
        token_file="token",  # noqa: S106 - a file's name
        certificate="bench.crt",
        key="bench.key",
    )
    assert bench.run == RunConfig(cpu=1)


SEQUENCES: list[dict[str, Any]] = [
    {"polynomial": "2327", "periods": 3},
    {"polynomial": "2327", "length": 77},
    {"kind": "inverse-repeat", "polynomial": "2327", "periods": 2},
    {"kind": "field", "field": 3, "degree": 5, "periods": 2},
    {"kind": "field", "field": 5, "polynomial": first_primitive(5, 3)},
    {
        "kind": "multi-amplitude",
        "polynomial": "2327",
        "amplitudes_rad_s": [1.0, 2.0, 3.0],
        "settling": 20,
        "periods": 2,
    },
    {"kind": "from-recording", "commands_rad_s": [0.0, 1.0, 0.5]},
]


@pytest.mark.parametrize("sequence", SEQUENCES, ids=range(7))
def test_slots_are_counted_as_the_schedule_has_them(sequence: dict[str, Any]) -> None:
    table = experiment().model_dump(mode="json")
    if sequence.get("kind") not in ("multi-amplitude", "from-recording"):
        sequence = {"amplitude_rad_s": 1.0, **sequence}
    for key in ("identification", "validation"):
        plan = experiment_from_table({**table, key: sequence, "standstill_s": 0.1}, "a test")
        assert counted_slots(plan) == plan.schedule().slots


@pytest.mark.parametrize("polynomial", ["", "9", "-7", "x", "0", "7" * 1000])
def test_a_sequence_that_is_none_is_counted_all_the_same(polynomial: str) -> None:
    table = experiment().model_dump(mode="json")
    for kind in ("m-sequence", "inverse-repeat"):
        sequence = {"kind": kind, "polynomial": polynomial, "amplitude_rad_s": 1.0}
        assert counted_slots(experiment_from_table({**table, "identification": sequence}, "x")) > 0


@pytest.mark.parametrize("each", [1, 8])
def test_a_recording_never_needs_more_room_than_was_asked_for(tmp_path: Path, each: int) -> None:
    """Samples of noise, which no compression makes smaller."""
    slots, rng = 2000, np.random.default_rng(1)
    rig = load_rig("rigs/paper.toml")
    rig = rig.model_copy(
        update={"drive": rig.drive.model_copy(update={"samples_per_command": each})}
    )
    noise = {
        kind: np.frombuffer(rng.bytes(count * kind.itemsize), kind).copy()
        for kind, count in ((SAMPLE_DTYPE, slots), (FAST_DTYPE, slots * each))
    }
    for rows in noise.values():
        rows["asked_ns"] = np.arange(len(rows)) * 1_000_000
    with RecordingWriter(tmp_path / "a.mcap", experiment(), rig, FACTS, 125.0) as writer:
        if each > 1:
            writer.fast(noise[FAST_DTYPE])
        writer.samples(noise[SAMPLE_DTYPE])
    size = (tmp_path / "a.mcap").stat().st_size
    assert 0.6 * recording_bytes(slots, each) < size <= recording_bytes(slots, each)


def test_a_row_has_what_the_frames_need() -> None:
    assert {"slot", "asked_ns", "motor_torque_nm"} <= set(SAMPLE_DTYPE.names or ())


def test_the_first_answer_waits_for_no_numerics_and_no_master() -> None:
    """What a run or an analysis needs is imported in its own process, or when it is asked for."""
    heavy = ("numba", "scipy", "matplotlib", "servo_bench.run.session", "drivers.canopen.master")
    program = (
        "import sys, servo_bench.daemon.__main__\n"
        f"print([name for name in {heavy!r} if name in sys.modules])"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert done.stdout == "[]\n"
