"""The API without a socket: what it answers, what it refuses, and that it never tells a path.

The daemon's watch is not started here, so nothing that waits is ever played.
"""

import asyncio
import errno
import json
import re
import shutil
import sqlite3
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from starlette.datastructures import Headers

from servo_bench.catalogue import beside as beside_files
from servo_bench.catalogue import index
from servo_bench.catalogue.beside import replace_json
from servo_bench.clock import NS_PER_S
from servo_bench.daemon import api, requests
from servo_bench.daemon.api import build_app
from servo_bench.daemon.config import load_bench
from servo_bench.daemon.core import Daemon
from servo_bench.daemon.guard import MAX_PEERS, Rate, Sessions
from servo_bench.daemon.log import log
from servo_bench.daemon.models import Status
from servo_bench.recording.mcap_file import load
from tests.asgi_client import AsgiClient
from tests.daemon_process import write_bench

RECORDINGS = Path(__file__).parent.parent / "recordings"
TOKEN = "0123456789abcdef0123"  # noqa: S105 - a test's
CONNECT = sqlite3.connect
RUN = {"experiment": "short", "operator": "me", "confirm": True}


def recording() -> Path:
    """A reference recording."""
    return RECORDINGS / "nominal.mcap"


def client_of(folder: Path, network: str = "port = 0", peer: str = "127.0.0.1") -> AsgiClient:
    """A client of a daemon with one recording."""
    bench = load_bench(write_bench(folder, network=network))
    shutil.copy(recording(), bench.recordings / "reference.mcap")
    app = build_app(Daemon(bench, log()), bench)
    return AsgiClient(app, peer)


@pytest.fixture
def client(tmp_path: Path) -> AsgiClient:
    return client_of(tmp_path)


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> AsgiClient:
    """For requests that change nothing."""
    return client_of(tmp_path_factory.mktemp("shared"))


@pytest.fixture
def run_id(client: AsgiClient) -> str:
    (row,) = client.get("/api/runs").json()["runs"]
    return str(row["id"])


def problem(answer: Any, status: int) -> str:
    """The words of an answer that is a problem (RFC 9457)."""
    assert answer.status_code == status, answer.text
    assert answer.headers["content-type"] == "application/problem+json"
    table = answer.json()
    assert table["status"] == status
    assert set(table) >= {"type", "title", "status", "detail"}
    return str(table["detail"])


def test_a_run_waits_in_order_and_can_be_taken_out_again(client: AsgiClient) -> None:
    ids = []
    for position in range(2):
        answer = client.post("/api/runs", json={**RUN, "name": f"run {position}"})
        assert (answer.status_code, answer.json()["position"]) == (202, position)
        ids.append(answer.json()["id"])
    status = Status.model_validate(client.get("/api/status").json())
    assert [entry.id for entry in status.queue] == ids
    assert (status.state, status.held) == ("idle", True)
    assert client.delete(f"/api/queue/{ids[0]}").status_code == 204
    assert "was played, or removed" in problem(client.delete(f"/api/queue/{ids[0]}"), 404)
    assert [entry["id"] for entry in client.get("/api/status").json()["queue"]] == ids[1:]


def test_what_is_armed_is_what_was_looked_at(client: AsgiClient) -> None:
    def arming() -> str:
        return str(client.get("/api/status").json()["arming"])

    def arm(seen: str) -> Any:
        return client.post("/api/arm", json={"operator": "me", "seen": seen})

    nothing = arming()
    first, second = (client.post("/api/runs", json=RUN).json()["id"] for _ in range(2))
    looked_at = arming()
    assert arm(looked_at).status_code == 200
    client.post("/api/stop", json={"reason": "smoke"})
    stopped = arming()
    client.delete(f"/api/queue/{first}")
    left = arming()
    assert len({nothing, looked_at, stopped, left}) == 4
    for seen in (nothing, looked_at, stopped, ""):
        assert "has changed" in problem(arm(seen), 409)
    assert client.get("/api/status").json()["held_reason"] == "stopped by an operator (smoke)"
    client.post("/api/runs", json=RUN)
    assert arming() == left, "what waits behind is not armed by that"
    assert not arm(left).json()["held"]
    client.delete(f"/api/queue/{second}")
    assert client.post("/api/arm", json={"operator": "me"}).status_code == 200


REFUSED: list[tuple[dict[str, Any], int, str]] = [
    ({**RUN, "experiment": "../../etc/passwd"}, 404, "no experiment.*short"),
    ({**RUN, "experiment": "/etc/passwd\x00"}, 404, "no experiment"),
    ({**RUN, "confirm": False}, 422, "confirm"),
    ({"experiment": "short", "operator": "me"}, 422, "confirm"),
    ({**RUN, "operator": ""}, 422, "operator"),
    ({**RUN, "operator": "me\x1b[2J"}, 422, "operator"),
    ({**RUN, "limits": {"velocity_rad_s": 1e9}}, 422, "limits"),
    ({**RUN, "overrides": {"rig": "other"}}, 422, "rig"),
    ({**RUN, "overrides": {"amplitude_deg_s": 1e5}}, 422, "rig's limit is 400 deg/s"),
    ({**RUN, "overrides": {"amplitude_deg_s": -1}}, 422, "amplitude"),
    ({**RUN, "overrides": {"periods": 101}}, 422, "periods"),
    ({**RUN, "notes": "x" * 10_001}, 422, "notes"),
]


@pytest.mark.parametrize(("body", "status", "words"), REFUSED, ids=[str(n) for n in range(12)])
def test_what_must_not_be_played_is_refused_before_it_waits(
    shared: AsgiClient, body: dict[str, Any], status: int, words: str
) -> None:
    answer = shared.post("/api/runs", json=body)
    detail = problem(answer, status)
    assert re.search(words, detail), detail
    assert shared.get("/api/status").json()["queue"] == []


def test_a_preview_tells_what_would_move_and_lets_nothing_wait(shared: AsgiClient) -> None:
    (plain,) = [e for e in shared.get("/api/experiments").json() if e["file"] == "short"]
    halved = {"amplitude_deg_s": np.degrees(plain["peak_velocity_rad_s"]) / 2, "standstill_s": 5}
    body = {"experiment": "short", "overrides": halved}
    shown = shared.post("/api/preview", json=body).json()
    assert shown["peak_velocity_rad_s"] == pytest.approx(plain["peak_velocity_rad_s"] / 2)
    assert shown["seconds"] > plain["seconds"]
    too_fast = {"experiment": "short", "overrides": {"amplitude_deg_s": 500}}
    assert "limit" in problem(shared.post("/api/preview", json=too_fast), 422)
    assert shared.get("/api/status").json()["queue"] == []


def test_a_change_within_the_limits_is_taken(client: AsgiClient) -> None:
    answer = client.post("/api/runs", json={**RUN, "overrides": {"amplitude_deg_s": 100}})
    assert answer.status_code == 202


def test_a_full_disk_is_said_before_anything_waits(
    client: AsgiClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    usage = shutil.disk_usage("/")._replace(free=1 << 20)
    monkeypatch.setattr(requests.shutil, "disk_usage", lambda _: usage)
    assert "Make room" in problem(client.post("/api/runs", json=RUN), 507)
    assert client.get("/api/status").json()["queue"] == []


def test_a_disk_that_fills_up_under_the_catalogue_is_said_as_such(
    client: AsgiClient, run_id: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """SQLite's own error, from a database that may not grow; and the system's, from a file."""

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr(index.sqlite3, "connect", _connected_to_a_full_disk)
        assert "the disk is full" in problem(client.get("/api/runs"), 507)
    with monkeypatch.context() as patched:
        patched.setattr(beside_files.os, "fsync", full)
        answer = client.patch(f"/api/runs/{run_id}", json={"notes": "x"})
        assert "make room" in problem(answer, 507)
        patched.setattr(api.library, "detail", full)
        assert "Make room" in problem(client.get(f"/api/runs/{run_id}"), 507)
    assert client.get("/api/runs").json()["total"] == 1


def _connected_to_a_full_disk(*_: object, **__: object) -> sqlite3.Connection:
    connection = CONNECT(":memory:", isolation_level=None)
    connection.execute("PRAGMA max_page_count = 1")
    return connection


def test_stop_may_be_asked_any_number_of_times_with_or_without_words(client: AsgiClient) -> None:
    for body in (None, {}, {"operator": "me", "reason": "smoke"}):
        answer = client.post("/api/stop", json=body)
        assert answer.json() == {"stopped": True, "standing": True, "state": "idle"}
    assert client.get("/api/status").json()["held_reason"] == "stopped by an operator"
    assert not client.post("/api/arm", json={"operator": "me"}).json()["held"]
    assert client.post("/api/stop", content=b"").status_code == 200
    assert client.get("/api/status").json()["held"]


def test_the_first_who_stops_stays_named_until_somebody_arms(tmp_path: Path) -> None:
    """Neither another stop, nor the run's end, nor what goes wrong at it takes the name away."""
    bench = load_bench(write_bench(tmp_path))
    daemon = Daemon(bench, log())

    def why() -> str:
        return str(daemon.status()["held_reason"])

    assert "the daemon was started" in why()
    daemon.stop("Ada (smoke)")
    for later in (
        lambda: daemon.stop("an operator at the page"),
        lambda: daemon.condition.fail("the drive is in fault", confirmed=True),
        lambda: daemon.condition.hold("stopped by SIGTERM: 3 of 9 slots played."),
    ):
        later()
        assert why() == "stopped by Ada (smoke)"
    assert "in fault" in daemon.status()["fault"]["sentence"]
    daemon.condition.arm("Ada")
    assert (why(), daemon.status()["held"]) == ("", False)
    daemon.condition.fail("the wire is cut", confirmed=False)
    daemon.stop("Bob")
    assert why() == "a fault"


def test_a_recording_is_listed_searched_shown_annotated_and_fetched(
    client: AsgiClient, run_id: str
) -> None:
    assert client.get("/api/runs", params={"q": "nothing like it"}).json()["total"] == 0
    row = client.patch(f"/api/runs/{run_id}", json={"notes": "a look", "tags": ["x"]}).json()
    assert (row["notes"], row["tags"]) == ("a look", ["x"])
    assert client.get("/api/runs", params={"q": "look", "tag": "x"}).json()["total"] == 1
    shown = client.get(f"/api/runs/{run_id}").json()
    assert shown["notes"] == "a look"
    assert not shown["has_report"]
    fetched = client.get(f"/api/runs/{run_id}/recording")
    assert fetched.content == recording().read_bytes()
    assert "attachment" in fetched.headers["content-disposition"]
    for kind in ("report", "analysis"):
        assert "analyse the run first" in problem(client.get(f"/api/runs/{run_id}/{kind}"), 404)


def test_a_report_is_shown_where_no_script_can_run(
    client: AsgiClient, run_id: str, tmp_path: Path
) -> None:
    (tmp_path / "recordings" / "reference.html").write_text("<h1>report</h1>")
    replace_json(tmp_path / "recordings" / "reference.json", {"vaf_same_order3_percent": 1.0})
    answer = client.get(f"/api/runs/{run_id}/report")
    assert answer.text == "<h1>report</h1>"
    assert "sandbox" in answer.headers["content-security-policy"]
    assert client.get(f"/api/runs/{run_id}/analysis").json()["vaf_same_order3_percent"] == 1.0


@pytest.mark.parametrize("points", [1, 7, 20_000])
def test_thinned_samples_hold_every_extreme(client: AsgiClient, run_id: str, points: int) -> None:
    names = "load_angle_rad,velocity_command_rad_s"
    table = client.get(
        f"/api/runs/{run_id}/samples", params={"channels": names, "points": points}
    ).json()
    angle_rad = load(recording())["load_angle_rad"]
    angle_rad = angle_rad[np.isfinite(angle_rad)]
    column = table["columns"]["load_angle_rad"]
    assert len(column["min"]) == len(column["max"]) == len(table["t_s"]) <= points
    assert min(v for v in column["min"] if v is not None) == angle_rad.min()
    assert max(v for v in column["max"] if v is not None) == angle_rad.max()


def test_a_channel_that_is_not_there_is_said_with_those_that_are(
    client: AsgiClient, run_id: str
) -> None:
    answer = client.get(f"/api/runs/{run_id}/samples", params={"channels": "colour"})
    assert "load_angle_rad" in problem(answer, 422)


def test_a_recording_deleted_under_the_catalogue_is_gone_in_words(
    client: AsgiClient, run_id: str, tmp_path: Path
) -> None:
    (tmp_path / "recordings" / "reference.mcap").unlink()
    for path in ("", "/recording", "/samples", "/report"):
        words = problem(client.get(f"/api/runs/{run_id}{path}"), 404)
        assert str(tmp_path) not in words
    problem(client.post("/api/replay", json={"run": run_id}), 404)
    problem(client.post(f"/api/runs/{run_id}/analyse"), 404)
    problem(client.patch(f"/api/runs/{run_id}", json={"notes": "x"}), 404)


def test_a_recording_that_is_replaced_by_a_link_leads_nowhere(
    client: AsgiClient, run_id: str, tmp_path: Path
) -> None:
    path = tmp_path / "recordings" / "reference.mcap"
    path.unlink()
    path.symlink_to("/etc/passwd")
    answer = client.get(f"/api/runs/{run_id}/recording")
    problem(answer, 404)
    assert b"root:" not in answer.content


@pytest.mark.parametrize(
    "path",
    [
        "/api/runs/..%2f..%2fetc%2fpasswd/recording",
        "/api/runs/%2e%2e/recording",
        "/..%2fapi.py",
        "/../../pyproject.toml",
        "/%00",
        "/js/../../api.py",
        "/api/jobs/..%2f..",
    ],
)
def test_no_path_of_a_request_leads_anywhere(shared: AsgiClient, path: str) -> None:
    answer = shared.get(path)
    assert answer.status_code in (404, 422), answer.text
    assert answer.headers["content-type"] == "application/problem+json"


def test_the_page_and_the_reference_need_nobody_else(shared: AsgiClient) -> None:
    page = shared.get("/")
    assert page.status_code == 200
    assert "default-src 'self'" in page.headers["content-security-policy"]
    assert "http" not in page.headers["content-security-policy"]
    reference = shared.get("/docs").text
    assert "<script" not in reference
    for path in shared.get("/openapi.json").json()["paths"]:
        assert path in reference


FOREIGN: list[tuple[str, str, dict[str, str], int]] = [
    ("GET", "/api/status", {"Host": "evil.example"}, 421),
    ("GET", "/api/status", {"Host": "127.0.0.1.evil.example:8420"}, 421),
    ("GET", "/", {"Host": ""}, 421),
    ("POST", "/api/stop", {"Origin": "http://evil.example"}, 403),
    ("POST", "/api/stop", {"Origin": "http://[bad"}, 403),
    ("POST", "/api/arm", {"Origin": "null"}, 403),
    ("POST", "/api/runs", {"Origin": "http://127.0.0.1:1"}, 403),
    ("POST", "/api/stop", {"Sec-Fetch-Site": "cross-site"}, 403),
    ("DELETE", "/api/replay", {"Origin": "http://evil.example"}, 403),
]


@pytest.mark.parametrize(("method", "path", "headers", "status"), FOREIGN)
def test_other_sites_are_refused(
    shared: AsgiClient, method: str, path: str, headers: dict[str, str], status: int
) -> None:
    problem(shared.request(method, path, headers=headers), status)


def test_the_same_site_is_not_refused(client: AsgiClient) -> None:
    for host in ("127.0.0.1:8420", "localhost:8420", "[::1]:8420"):
        headers = {"Host": host, "Origin": f"http://{host}"}
        assert client.post("/api/stop", headers=headers).status_code == 200


STRANGE_WORDS: list[tuple[bytes, dict[str, str], str]] = [
    (b"operator=Ada", {"Content-Type": "application/x-www-form-urlencoded"}, "an operator"),
    (b'{"operator": "Ada"}', {"Content-Type": "application/x-www-form-urlencoded"}, "Ada"),
    (b'{"operator": "Ada", "reason": "smoke\\nand fire"}', {}, "Ada (smoke and fire)"),
    (b'{"operator": "Ada\\u001b[2J", "more": 1}', {}, "Ada\N{REPLACEMENT CHARACTER}[2J"),
    (b'{"operator": ["Ada"], "reason": "\\ud800"}', {}, "an operator (\N{REPLACEMENT CHARACTER})"),
    (b'{"operator": "%s"}' % (b"x" * 300), {}, "x" * 199 + "\N{HORIZONTAL ELLIPSIS}"),
    (b"[]", {}, "an operator"),
    (b"{", {}, "an operator"),
    (b"\xff", {}, "an operator"),
    (b"[" * 60_000, {}, "an operator"),
    (b"x" * 70_000, {}, "an operator"),
    (b'{"operator": "Ada"}', {"Transfer-Encoding": "chunked"}, "Ada"),
]


@pytest.mark.parametrize(("body", "headers", "told"), STRANGE_WORDS, ids=range(12))
def test_a_stop_is_heeded_whatever_its_words_are(
    client: AsgiClient, body: bytes, headers: dict[str, str], told: str
) -> None:
    said = {"Content-Type": "application/json", **headers}
    assert client.post("/api/stop", content=body, headers=said).status_code == 200
    assert client.get("/api/status").json()["held_reason"] == f"stopped by {told}"


def test_a_stop_does_not_wait_for_words_that_do_not_come(
    client: AsgiClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(api, "WORDS_PATIENCE_S", 0.0)

    async def words() -> AsyncIterator[bytes]:
        yield b'{"operator": '
        await asyncio.Event().wait()

    assert client.post("/api/stop", content=words()).status_code == 200
    assert client.get("/api/status").json()["held_reason"] == "stopped by an operator"


def test_bodies_have_a_length_and_a_limit(shared: AsgiClient) -> None:
    problem(shared.post("/api/arm", content=b"x" * 70_000), 413)
    problem(shared.post("/api/arm", headers={"Transfer-Encoding": "chunked"}), 411)
    problem(shared.post("/api/arm", headers={"Content-Length": b"\xb2"}), 413)
    problem(shared.post("/api/arm", content=b'{"operator": "me"}'), 422)  # not said to be JSON


def test_a_token_is_asked_for_everywhere_but_for_a_stop_from_here(tmp_path: Path) -> None:
    (tmp_path / "token").write_text(TOKEN)
    client = client_of(tmp_path, 'token_file = "token"')
    assert client.get("/api/health").status_code == 200
    assert client.post("/api/stop").status_code == 200
    for method, path in (("GET", "status"), ("POST", "arm"), ("GET", "runs"), ("POST", "runs")):
        answer = client.request(method, f"/api/{path}")
        problem(answer, 401)
        assert answer.headers["www-authenticate"] == "Bearer"
    for given in (TOKEN[:-1], TOKEN + "x", "", "ü"):
        header = {"Authorization": f"Bearer {given}".encode()}
        problem(client.get("/api/status", headers=header), 401)
        problem(client.post("/api/login", json={"token": given}), 401)
    bearer = {"Authorization": f"Bearer {TOKEN}"}
    assert client.get("/api/status", headers=bearer).status_code == 200
    login = client.post("/api/login", json={"token": TOKEN})
    assert login.status_code == 204
    cookie = login.headers["set-cookie"].lower()
    assert "httponly" in cookie
    assert "samesite=strict" in cookie
    assert TOKEN not in cookie
    assert client.get("/api/status").status_code == 200

    async def look() -> None:
        async with client.socket("/api/live") as live:
            assert (await live.next())["type"] == "websocket.accept"
            assert json.loads((await live.next())["text"])["kind"] == "status"
        async with client.socket("/api/live", cookie="") as live:
            assert (await live.next())["type"] == "websocket.accept"
            assert (await live.next())["code"] == 1008  # policy violation: the page asks to log in

    asyncio.run(look())


def test_a_stop_from_elsewhere_needs_the_token(tmp_path: Path) -> None:
    (tmp_path / "token").write_text(TOKEN)
    network = 'host = "0.0.0.0"\ntoken_file = "token"\nallow_plain_http = true'
    client = client_of(tmp_path, network, peer="192.0.2.1")
    problem(client.post("/api/stop"), 401)
    header = {"Authorization": f"Bearer {TOKEN}"}
    assert client.post("/api/stop", headers=header, json={"operator": "Ada"}).status_code == 200
    told = client.get("/api/status", headers=header).json()["held_reason"]
    assert told == "stopped by Ada from 192.0.2.1"


@pytest.mark.parametrize(
    ("peer", "status"), [("::ffff:127.0.0.1", 200), ("::1", 200), ("::ffff:192.0.2.1", 401)]
)
def test_who_listens_on_ipv6_knows_this_machine_by_either_address(
    tmp_path: Path, peer: str, status: int
) -> None:
    (tmp_path / "token").write_text(TOKEN)
    network = 'host = "::"\ntoken_file = "token"\nallow_plain_http = true'
    client = client_of(tmp_path, network, peer=peer)
    assert client.post("/api/stop", json={"operator": "Ada"}).status_code == status
    header = {"Authorization": f"Bearer {TOKEN}"}
    told = client.get("/api/status", headers=header).json()["held_reason"]
    assert (told == "stopped by Ada") == (status == 200)


def test_the_live_view_tells_its_status_and_heeds_a_stop(client: AsgiClient) -> None:
    client.post("/api/arm", json={"operator": "me"})

    async def look() -> dict[str, Any]:
        async with client.socket("/api/live") as live:
            assert (await live.next())["type"] == "websocket.accept"
            assert not json.loads((await live.next())["text"])["held"]
            for noise in ("", "{", "[]", '{"kind": "start"}', '{"kind": ' + "[" * 5000):
                live.send(text=noise)
            live.send(bytes=b"\0" * 100)
            live.send(text='{"kind": "stop"}')
            while not (told := json.loads((await live.next())["text"]))["held"]:
                pass
            return dict(told)

    assert asyncio.run(look())["held_reason"] == "stopped by an operator at the page"


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ({"operator": "Ada", "reason": "the space bar"}, "Ada (the space bar)"),
        ({"operator": "Ada\x1b[2J"}, "Ada\N{REPLACEMENT CHARACTER}[2J"),
        ({"operator": ["Ada"], "more": 1}, "an operator at the page"),
    ],
)
def test_a_stop_over_the_live_view_has_a_name_and_is_heeded_whatever_its_words(
    client: AsgiClient, words: dict[str, Any], told: str
) -> None:
    async def look() -> str:
        async with client.socket("/api/live") as live:
            assert (await live.next())["type"] == "websocket.accept"
            live.send(text=json.dumps({"kind": "stop", **words}))
            reason = ""
            while not reason.startswith("stopped"):
                reason = json.loads((await live.next())["text"])["held_reason"]
            return reason

    assert asyncio.run(look()) == f"stopped by {told}"


def test_another_sites_page_gets_no_live_view(shared: AsgiClient) -> None:
    async def look() -> None:
        async with shared.socket("/api/live", origin="http://evil.example") as live:
            assert (await live.next())["type"] == "websocket.close"

    asyncio.run(look())


def test_a_recording_is_replayed_to_the_live_view(client: AsgiClient, run_id: str) -> None:
    asked = client.post("/api/replay", json={"run": run_id, "speed": 1000.0})
    assert asked.json()["replay"] == {"run": run_id, "speed": 1000.0}

    async def look() -> bytes:
        async with client.socket("/api/live") as live:
            while "bytes" not in (message := await live.next()):
                pass
            return bytes(message["bytes"])

    assert asyncio.run(look())[:4] == b"VLBS"
    assert client.delete("/api/replay").status_code == 204
    assert client.get("/api/status").json()["replay"] is None


def test_requests_have_a_rate_but_a_stop_has_none(tmp_path: Path) -> None:
    network = "requests_per_second = 0.001\nrequest_burst = 3"
    client = client_of(tmp_path, network)
    answers = [client.get("/api/health").status_code for _ in range(5)]
    assert answers == [200, 200, 200, 429, 429]
    assert [client.post("/api/stop").status_code for _ in range(5)] == [200] * 5


def test_a_rate_refills_with_time_and_forgets_whom_it_has_not_seen() -> None:
    now_ns = [0]
    rate = Rate(2.0, 4.0, lambda: now_ns[0])
    assert [rate.allows("a") for _ in range(6)] == [True] * 4 + [False] * 2
    now_ns[0] = NS_PER_S
    assert [rate.allows("a") for _ in range(4)] == [True, True, False, False]
    for number in range(3 * MAX_PEERS):
        rate.allows(str(number))
    assert len(rate._buckets) == MAX_PEERS


def test_a_session_ends_by_the_clock_that_nobody_sets() -> None:
    now_ns = [0]
    sessions = Sessions(TOKEN, lambda: now_ns[0])
    headers = Headers({"cookie": f"servo_bench_session={sessions.open()}"})
    assert sessions.knows(headers)
    now_ns[0] = 13 * 3600 * NS_PER_S
    assert not sessions.knows(headers)
    assert not Sessions(None).is_token("")
