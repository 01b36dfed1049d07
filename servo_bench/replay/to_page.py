"""A recording shown on a daemon's page: one request to the daemon that has it in its catalogue."""

import http.client
import json
import ssl
import urllib.error
import urllib.request
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import quote, urlsplit

from servo_bench.errors import ConfigError, RecordingError, WireError

PATIENCE_S = 10.0
LONGEST_ANSWER = 64 << 20


@dataclass(frozen=True, slots=True)
class Daemon:
    """Where a daemon is: http(s)://host:port, its token if it wants one, and whom TLS believes."""

    url: str
    token: str | None = None
    trust: ssl.SSLContext | None = None

    def __post_init__(self) -> None:
        """ConfigError for what is no address of a daemon."""
        try:
            parts = urlsplit(self.url)
            there = parts.scheme in ("http", "https") and bool(parts.netloc) and parts.port != 0
        except ValueError:  # half an IPv6 address, or a port that is no number
            there = False
        if not there:
            raise ConfigError(
                f"{self.url!r} is no daemon's address: give http://127.0.0.1:8420, or the page of "
                "servo-bench daemon as the browser shows it."
            )

    def ask(self, method: str, path: str, body: dict[str, Any] | None = None) -> Any:
        """The answer's JSON. WireError where nobody answers, RecordingError where it refuses."""
        parts = urlsplit(self.url)
        headers = {"Content-Type": "application/json"}
        if self.token is not None:
            headers["Authorization"] = f"Bearer {self.token}"
        request = urllib.request.Request(  # noqa: S310 - http or https, see above
            f"{parts.scheme}://{parts.netloc}/api/{path}",
            None if body is None else json.dumps(body).encode(),
            headers,
            method=method,
        )
        try:
            with urllib.request.urlopen(  # noqa: S310
                request, timeout=PATIENCE_S, context=self.trust
            ) as answer:
                text = answer.read(LONGEST_ANSWER)
                return json.loads(text) if text else None
        except urllib.error.HTTPError as error:
            raise RecordingError(f"the daemon refuses ({error.code}): {_detail(error)}") from error
        except (OSError, ValueError, http.client.HTTPException) as error:
            raise WireError(
                f"no daemon answers at {self.url}: {error}. Start it (servo-bench daemon), or "
                "correct the address."
            ) from error


def show(daemon: Daemon, recording: Path, speed: float, start_s: float) -> str:
    """Play a recording to the page; the id of its run. RecordingError where the daemon lacks it."""
    number = _run_of(daemon, recording)
    daemon.ask("POST", "replay", {"run": number, "speed": speed, "start_s": start_s})
    return number


def _run_of(daemon: Daemon, recording: Path) -> str:
    """The run whose recording has the same name and size."""
    try:
        size = recording.stat().st_size
    except OSError as error:
        raise RecordingError(f"{recording} cannot be read: {error.strerror}.") from error
    found = daemon.ask("GET", f"runs?limit=500&q={quote(recording.name)}")
    runs = found.get("runs", []) if isinstance(found, dict) else []
    same = [str(run["id"]) for run in runs if run.get("bytes") == size]
    if not same:
        raise RecordingError(
            f"the daemon at {daemon.url} has no recording {recording.name} of {size} bytes: copy "
            "it into the daemon's folder of recordings."
        )
    return same[0]


def _detail(error: urllib.error.HTTPError) -> str:
    try:
        return str(json.loads(error.read(LONGEST_ANSWER))["detail"])
    except (OSError, ValueError, KeyError, TypeError):
        return str(error.reason)
