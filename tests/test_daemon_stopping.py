"""`servo-bench stop`: what it asks, and that it never says more than it has seen."""

import errno
import getpass
import json
import os
import select
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from threading import Thread
from typing import Any

import pytest

from servo_bench.cli.stop import stop
from servo_bench.daemon import stopping
from servo_bench.daemon.control import Control
from servo_bench.daemon.sockets import connected, listening
from servo_bench.daemon.stopping import Reach, reach_of, stop_rig
from servo_bench.errors import WireError
from servo_bench.run.lock import Holder, take
from servo_bench.run.table import SlotTable

STANDS = (200, b'{"stopped": true, "standing": true, "state": "idle"}')
NOWHERE = "http://127.0.0.1:1"


@contextmanager
def answering(status: int, body: bytes) -> Iterator[tuple[str, list[dict[str, Any]]]]:
    """The address of something that answers every POST so, and what it was asked."""
    asked: list[dict[str, Any]] = []

    class Answer(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            length = int(self.headers["Content-Length"])
            asked.append({"path": self.path, **json.loads(self.rfile.read(length))})
            self.send_response(status)
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *_: object) -> None: ...

    with HTTPServer(("127.0.0.1", 0), Answer) as server:
        thread = Thread(target=server.serve_forever)
        thread.start()
        try:
            yield f"http://127.0.0.1:{server.server_port}", asked
        finally:
            server.shutdown()
            thread.join()


@pytest.fixture
def forbidden(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A state folder that this user may not look into, whoever that is."""
    state = tmp_path / "state"

    def refused(path: object, *_: object, **__: object) -> None:
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))

    monkeypatch.setattr(stopping, "run_folders", refused)
    monkeypatch.setattr(stopping.os, "open", refused)
    return state


def test_who_may_not_look_asks_the_daemon_at_its_configured_address(forbidden: Path) -> None:
    with answering(*STANDS) as (url, asked):
        sentence = stop_rig(Reach(forbidden, url=url), "me")
    assert asked == [{"path": "/api/stop", "operator": "me"}]
    assert "the rig stands" in sentence
    assert "permission denied" in sentence


@pytest.mark.parametrize(
    ("standing", "state", "words"),
    [
        (True, "faulted", "the rig stands, and"),
        (False, "stopping", "the rig is being stopped, and"),
        (False, "faulted", "whether the rig stands is not known: look at it"),
    ],
)
def test_what_the_daemon_does_not_know_is_not_said(
    tmp_path: Path, standing: bool, state: str, words: str
) -> None:
    body = json.dumps({"stopped": True, "standing": standing, "state": state}).encode()
    with answering(200, body) as (url, _):
        lock = take(tmp_path / "daemon.lock", Holder("the daemon", url=url))
        assert words in stop_rig(Reach(tmp_path), "me")
        lock.release()


@pytest.mark.parametrize("url", ["", NOWHERE])
def test_who_may_not_look_is_never_told_that_nothing_moves(forbidden: Path, url: str) -> None:
    with pytest.raises(WireError, match=r"permission denied.*not known.*use sudo") as told:
        stop_rig(Reach(forbidden, url=url), "me")
    assert "nothing" not in str(told.value)


def test_a_folder_that_cannot_be_read_is_not_one_without_runs(tmp_path: Path) -> None:
    (tmp_path / "runs").write_text("")
    with pytest.raises(WireError, match="not a directory"):
        stop_rig(Reach(tmp_path), "me")


@pytest.mark.parametrize(
    ("status", "body", "words"),
    [
        (401, b"", "answers with status 401"),
        (200, b"[]", "does not answer as a daemon does"),
        (200, b"{", "does not answer as a daemon does"),
    ],
)
def test_a_living_daemon_that_takes_no_stop_is_said(
    tmp_path: Path, status: int, body: bytes, words: str
) -> None:
    with answering(status, body) as (url, _):
        lock = take(tmp_path / "daemon.lock", Holder("the daemon", url=url))
        with pytest.raises(WireError, match=words):
            stop_rig(Reach(tmp_path), "me")
        lock.release()


def test_no_proxy_has_a_say_in_a_stop(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("http_proxy", NOWHERE)
    monkeypatch.delenv("no_proxy", raising=False)
    with answering(*STANDS) as (url, _):
        lock = take(tmp_path / "daemon.lock", Holder("the daemon", url=url))
        assert "the rig stands" in stop_rig(Reach(tmp_path), "me")
        lock.release()


def test_the_lock_of_a_daemon_that_was_killed_leads_to_no_other_bench(tmp_path: Path) -> None:
    """Its file is left; another bench has the port by now."""
    with answering(*STANDS) as (url, asked):
        take(tmp_path / "daemon.lock", Holder("the daemon", url=url)).let_go()
        with pytest.raises(WireError, match="nothing that it started moves the rig"):
            stop_rig(Reach(tmp_path, url=url), "me")
    assert asked == []


@pytest.fixture
def runner(tmp_path: Path) -> Iterator[Control]:
    """A runner's end of its socket, beside one that nobody serves."""
    folders = [tmp_path / "runs" / name for name in ("dead", "living")]
    for folder in folders:
        folder.mkdir(parents=True)
    listening(folders[0]).close()
    lock = os.open(tmp_path, os.O_RDONLY)
    with listening(folders[1]) as listener, SlotTable.create(4) as table:
        listener.setblocking(True)
        control = Control(listener, lock, "living")
        control.show(table, 0.008)
        yield control
        for peer in control._peers:
            peer.close()
        control._selector.close()
        if control._table is not None:
            control._table.__exit__(None, None, None)
    os.close(lock)


def serve_one(control: Control) -> None:
    """What the runner's thread does, until who has connected is gone again."""
    control._accept()
    while control._peers:
        select.select(control._peers, [], [])
        control._take(control._peers[0])


def test_a_runner_has_taken_the_stop_when_it_is_said_to_be_told(
    tmp_path: Path, runner: Control
) -> None:
    serving = Thread(target=serve_one, args=[runner])
    serving.start()
    assert "1 run(s) were told" in stop_rig(Reach(tmp_path), "me")
    serving.join()
    assert (runner.stop_asked, runner.asked_by) == (True, "me")


def test_the_stop_of_who_left_without_listening_is_heeded(tmp_path: Path, runner: Control) -> None:
    """The slot table's message lies unread in its socket when it closes that."""
    peer = connected(tmp_path / "runs" / "living")
    runner._accept()
    peer.send(b'{"kind": "stop", "by": "me"}')
    peer.close()
    (ours,) = runner._peers
    runner._take(ours)
    assert runner.asked_by == "me"
    runner._take(ours)
    assert runner._peers == []


def test_a_runner_that_does_not_take_the_stop_is_not_said_to_be_told(
    tmp_path: Path, runner: Control, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stopping, "PATIENCE_S", 0.01)
    with pytest.raises(WireError, match=r"the run living: timed out.*not known"):
        stop_rig(Reach(tmp_path), "me")


@pytest.mark.parametrize(
    ("network", "url"),
    [
        ("", "http://127.0.0.1:8420"),
        ('host = "0.0.0.0"\nport = 9000', "http://127.0.0.1:9000"),
        ('host = "::"', "http://[::1]:8420"),
        ('host = "bench.lab"\ncertificate = "bench.crt"', "https://bench.lab:8420"),
        ("port = 0", ""),
        ('port = "x"', ""),
    ],
)
def test_the_configured_address_is_read_even_of_a_file_with_mistakes(
    tmp_path: Path, network: str, url: str
) -> None:
    (tmp_path / "bench.toml").write_text(f"rig = 3\n[network]\n{network}\n")
    assert reach_of(str(tmp_path / "bench.toml")).url == url


def test_a_user_without_a_name_can_stop(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def nameless() -> str:
        raise KeyError("getpwuid(): uid not found: 4242")

    monkeypatch.setattr(getpass, "getuser", nameless)
    (tmp_path / "bench.toml").write_text("")
    with answering(*STANDS) as (url, asked):
        (tmp_path / "state").mkdir()
        lock = take(tmp_path / "state" / "daemon.lock", Holder("the daemon", url=url))
        stop(str(tmp_path / "bench.toml"))
        lock.release()
    assert [one["operator"] for one in asked] == ["the operator at a terminal"]
