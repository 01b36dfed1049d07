"""A stop from the command line: through the daemon, and without it where it does not answer.

Of the bench's file only what a stop needs is read, so that one with a mistake elsewhere can still
be stopped, and quickly.
"""

import json
import ssl
import urllib.request
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from servo_bench.daemon.sockets import connected, run_folders
from servo_bench.errors import WireError
from servo_bench.files import find, read_toml
from servo_bench.run.lock import holder_of

PATIENCE_S = 2.0
STATE = "state"
"""Where a bench's file does not say."""


@dataclass(frozen=True, slots=True)
class Reach:
    """Where a daemon's runs and its socket are, and what it wants to be shown."""

    state: Path
    token: str | None = None
    certificate: Path | None = None


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
    )


def stop_rig(bench: Reach, operator: str) -> str:
    """Stop whatever the daemon of this configuration plays; what was done, in a sentence.

    The runner is asked itself, and the daemon as well, so that its queue is held. WireError where
    neither answers.
    """
    runners = _ask_runners(bench, operator)
    answer = _ask_daemon(bench, operator)
    if answer is not None:
        return answer
    if runners:
        return f"the daemon does not answer; {runners} run(s) were told to stop the rig."
    raise WireError(
        "no daemon of this configuration answers, and no run of it is alive: nothing that it "
        "started moves the rig. If the shaft turns, use the emergency stop."
    )


def _ask_runners(bench: Reach, operator: str) -> int:
    """Tell every living runner to stop; how many were told."""
    told = 0
    for folder in run_folders(bench.state):
        with suppress(OSError), connected(folder) as runner:  # a socket that nobody serves
            runner.send(json.dumps({"kind": "stop", "by": operator}).encode())
            told += 1
    return told


def _ask_daemon(bench: Reach, operator: str) -> str | None:
    """The daemon's answer; None where there is none."""
    holder = holder_of(bench.state / "daemon.lock")
    if holder is None or not holder.url:
        return None
    headers = {"Content-Type": "application/json"}
    if bench.token is not None:
        headers["Authorization"] = f"Bearer {bench.token}"
    request = urllib.request.Request(  # noqa: S310 - our own daemon's address, http or https
        f"{holder.url}/api/stop",
        json.dumps({"operator": operator}).encode(),
        headers,
        method="POST",
    )
    try:
        with urllib.request.urlopen(  # noqa: S310
            request, timeout=PATIENCE_S, context=_trusting(bench)
        ) as answer:
            table = json.load(answer)
    except (OSError, ValueError):
        return None
    stands = "the rig stands" if table["standing"] else "the rig is being stopped"
    return f"stopped: {stands}, and the queue is held (state {table['state']})."


def _trusting(bench: Reach) -> ssl.SSLContext | None:
    """The daemon's own certificate is the one that is believed; its name is not asked for."""
    if bench.certificate is None:
        return None
    context = ssl.create_default_context(cafile=str(bench.certificate))
    context.check_hostname = False
    return context
