"""A stop from the command line: through the daemon, and without it where it does not answer.

Of the bench's file only what a stop needs is read, so that one with a mistake elsewhere can still
be stopped, and quickly. That there is nothing to stop is said only where it was seen: who may not
look into the daemon's folder asks the daemon at its configured address.
"""

import fcntl
import http.client
import json
import os
import socket
import ssl
import time
import urllib.request
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.error import HTTPError, URLError

from servo_bench.daemon.sockets import MAX_MESSAGE_BYTES, connected, run_folders
from servo_bench.errors import WireError
from servo_bench.files import find, read_toml
from servo_bench.run.lock import holder_of

PATIENCE_S = 2.0
HOST, PORT = "127.0.0.1", 8420
QUIET = ("idle", "analysing", "faulted")
"""States in which nobody stops a rig: whether it stands is known by then, or not at all."""
STATE = "state"
"""Where a bench's file does not say."""


@dataclass(frozen=True, slots=True)
class Reach:
    """Where a daemon's runs and its socket are, and what it wants to be shown.

    `url` is where its configuration puts it; "" where that names no port.
    """

    state: Path
    token: str | None = None
    certificate: Path | None = None
    url: str = ""


class _NotAskedError(Exception):
    """Why somebody who may play could not be asked, in words."""


def reach_of(name: str) -> Reach:
    """What a stop needs of a bench's file; ConfigError where there is none."""
    path = find(name)
    table = read_toml(path)
    network = table.get("network", {})
    network = network if isinstance(network, dict) else {}
    token_file, certificate = network.get("token_file"), network.get("certificate")
    token = None
    if token_file is not None:
        with suppress(OSError, UnicodeDecodeError):  # from this machine it goes without
            token = (path.parent / str(token_file)).read_text(encoding="ascii").strip()
    return Reach(
        path.parent / str(table.get("state", STATE)),
        token,
        path.parent / str(certificate) if certificate is not None else None,
        _configured_url(network),
    )


def _configured_url(network: dict[str, Any]) -> str:
    host, port = str(network.get("host", HOST)), network.get("port", PORT)
    if not isinstance(port, int) or port <= 0:
        return ""  # a free one, which only the daemon's lock names
    host = {"0.0.0.0": HOST, "::": "::1"}.get(host, host)  # noqa: S104 - asked, not bound
    scheme = "https" if network.get("certificate") is not None else "http"
    return f"{scheme}://[{host}]:{port}" if ":" in host else f"{scheme}://{host}:{port}"


def stop_rig(bench: Reach, operator: str) -> str:
    """Stop whatever the daemon of this configuration plays; what was done, in a sentence.

    The runner is asked itself, and the daemon as well, so that its queue is held. WireError where
    neither answers, or where one that may play could not be asked.
    """
    told, unasked = _ask_runners(bench, operator)
    answer = None
    try:
        answer = _ask_daemon(bench, operator)
    except _NotAskedError as error:
        if not told:
            unasked.append(str(error))
    why = "; ".join(unasked)
    if answer is not None:
        more = f" The run itself could not be asked ({why}): see that the shaft stands."
        return answer + (more if unasked else "")
    if unasked:
        raise WireError(
            f"the rig could not be asked to stop: {why}. Whether it moves is not known. If the "
            "shaft turns, use the emergency stop; where it may not be asked, use sudo, or the "
            "daemon's own user."
        )
    if told:
        return f"the daemon does not answer; {told} run(s) were told to stop the rig."
    raise WireError(
        "no daemon of this configuration answers, and no run of it is alive: nothing that it "
        "started moves the rig. If the shaft turns, use the emergency stop."
    )


def _ask_runners(bench: Reach, operator: str) -> tuple[int, list[str]]:
    """Tell every living runner to stop; how many were told, and why others could not be."""
    told = 0
    unasked = []
    try:
        folders = run_folders(bench.state)
    except OSError as error:
        return 0, [f"{bench.state}: {_reason(error)}"]
    for folder in folders:
        try:
            with connected(folder) as runner:
                _tell(runner, operator)
            told += 1
        except (FileNotFoundError, ConnectionRefusedError):
            continue  # a socket that nobody serves
        except OSError as error:
            unasked.append(f"the run {folder.name}: {_reason(error)}")
    return told, unasked


def _tell(runner: socket.socket, operator: str) -> None:
    """Tell a runner to stop, and wait until it has taken that: it lets go of who has no more to
    say. TimeoutError where it does not."""
    runner.settimeout(PATIENCE_S)
    until_s = time.monotonic() + PATIENCE_S
    runner.send(json.dumps({"kind": "stop", "by": operator}).encode())
    runner.shutdown(socket.SHUT_WR)
    while runner.recv(MAX_MESSAGE_BYTES):  # what it shows to everybody
        if time.monotonic() > until_s:
            raise TimeoutError(f"it has not taken the stop for {PATIENCE_S:g} s")


def _ask_daemon(bench: Reach, operator: str) -> str | None:
    """The daemon's answer; None where there is none. _NotAskedError where that is not certain."""
    url = _living_url(bench)
    if url is None:
        return None
    if not url:
        raise _NotAskedError("the daemon's address is not known")
    try:
        table = _posted(bench, f"{url}/api/stop", operator)
        return _told(table["standing"], table["state"])
    except HTTPError as error:
        raise _NotAskedError(f"{url} answers with status {error.code}") from error
    except URLError as error:
        if isinstance(error.reason, ConnectionRefusedError):
            return None
        raise _NotAskedError(f"{url}: {error.reason}") from error
    except (OSError, http.client.HTTPException) as error:
        raise _NotAskedError(f"{url}: {_reason(error)}") from error
    except (ValueError, LookupError, TypeError) as error:
        raise _NotAskedError(f"{url} does not answer as a daemon does") from error


def _told(standing: object, state: object) -> str:
    """What the daemon answered, in words."""
    if standing is not True and state in QUIET:
        stands = "whether the rig stands is not known: look at it; the queue"
    else:
        stands = f"the rig {'stands' if standing is True else 'is being stopped'}, and the queue"
    return f"stopped: {stands} is held (state {state})."


def _living_url(bench: Reach) -> str | None:
    """Where the daemon that lives can be asked, "" where nothing says; None where none lives.

    The lock's file outlives a daemon that was killed, and another may have its port by now: only
    a lock that is held says who is there.
    """
    path = bench.state / "daemon.lock"
    try:
        if not _is_held(path):
            return None
    except FileNotFoundError:
        return None
    except OSError:
        return bench.url
    holder = holder_of(path)
    return holder.url if holder is not None and holder.url else bench.url


def _is_held(path: Path) -> bool:
    """Whether somebody has the lock. OSError where that cannot be seen."""
    handle = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    try:
        fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    finally:
        os.close(handle)
    return False


def _posted(bench: Reach, url: str, operator: str) -> Any:
    """What is answered to a stop; no proxy has a say in it."""
    headers = {"Content-Type": "application/json"}
    if bench.token is not None:
        headers["Authorization"] = f"Bearer {bench.token}"
    request = urllib.request.Request(  # noqa: S310 - our own daemon's address, http or https
        url, json.dumps({"operator": operator}).encode(), headers, method="POST"
    )
    opener = urllib.request.build_opener(
        urllib.request.ProxyHandler({}), urllib.request.HTTPSHandler(context=_trusting(bench))
    )
    with opener.open(request, timeout=PATIENCE_S) as answer:
        return json.load(answer)


def _reason(error: Exception) -> str:
    words = error.strerror if isinstance(error, OSError) else None
    return (words or str(error) or type(error).__name__).lower()


def _trusting(bench: Reach) -> ssl.SSLContext | None:
    """The daemon's own certificate is the one that is believed; its name is not asked for."""
    if bench.certificate is None:
        return None
    context = ssl.create_default_context(cafile=str(bench.certificate))
    context.check_hostname = False
    return context
