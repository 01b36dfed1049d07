"""What stands before every request: who may ask what, how often, and how much.

| check  | what it refuses                                                       | answer   |
|--------|-----------------------------------------------------------------------|----------|
| Host   | a name that is not ours: another site's page, its name rebound to us  | 421      |
| Origin | a change, or a WebSocket, that another site's page asks for           | 403      |
| rate   | more requests than `requests_per_second`; a stop is never refused     | 429      |
| body   | one without a length, or longer than `max_body_bytes`; never a stop's | 411, 413 |
| token  | all below /api but health and login, where a token is configured      | 401      |

A stop from this machine itself needs no token. Tokens are compared in constant time; a login gives
a session's cookie, which scripts cannot read and other sites' pages do not send.
"""

import hmac
import json
import secrets
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field
from http.cookies import CookieError, SimpleCookie
from urllib.parse import urlsplit

from starlette.datastructures import Address, Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from servo_bench.clock import NS_PER_S, monotonic_ns
from servo_bench.daemon.config import Bench, accepted_hosts, is_loopback
from servo_bench.daemon.problems import MEDIA_TYPE, ApiError, problem

COOKIE = "servo_bench_session"
SESSION_S = 12 * 3600
MAX_SESSIONS = 64
MAX_PEERS = 1024
LOGINS_PER_SECOND, LOGIN_BURST = 0.5, 10.0
SAFE = frozenset({"GET", "HEAD", "OPTIONS"})
OPEN = frozenset({"/api/health", "/api/login"})
STOP, LOGIN = "/api/stop", "/api/login"
HEADERS = {
    "Content-Security-Policy": "default-src 'self'; object-src 'none'; base-uri 'none'; "
    "form-action 'self'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Permissions-Policy": "camera=(), microphone=(), geolocation=()",
}
Now = Callable[[], int]


@dataclass
class Rate:
    """A token bucket for each peer; the longest unseen are forgotten."""

    per_second: float
    burst: float
    now_ns: Now = monotonic_ns
    _buckets: OrderedDict[str, tuple[float, int]] = field(default_factory=OrderedDict)

    def allows(self, peer: str) -> bool:
        """Whether this peer may ask once more, and take note that it has."""
        now_ns = self.now_ns()
        level, then_ns = self._buckets.pop(peer, (self.burst, now_ns))
        level = min(self.burst, level + (now_ns - then_ns) / NS_PER_S * self.per_second)
        self._buckets[peer] = (max(level - 1.0, 0.0) if level >= 1.0 else level, now_ns)
        while len(self._buckets) > MAX_PEERS:
            self._buckets.popitem(last=False)
        return level >= 1.0


class Sessions:
    """Who has shown the token lately; forgotten when the daemon ends."""

    def __init__(self, token: str | None, now_ns: Now = monotonic_ns) -> None:
        self._token = token
        self._now_ns = now_ns
        self._until_ns: OrderedDict[str, int] = OrderedDict()

    @property
    def needed(self) -> bool:
        """Whether a token is configured."""
        return self._token is not None

    def is_token(self, given: str) -> bool:
        """Whether that is the token, in a time that tells nothing about it."""
        expected = self._token or ""
        same = hmac.compare_digest(given.encode(), expected.encode())
        return same and self.needed

    def open(self) -> str:
        """A new session's secret."""
        secret = secrets.token_urlsafe(32)
        self._until_ns[secret] = self._now_ns() + SESSION_S * NS_PER_S
        while len(self._until_ns) > MAX_SESSIONS:
            self._until_ns.popitem(last=False)
        return secret

    def knows(self, headers: Headers) -> bool:
        """Whether a request carries the token or a session's cookie."""
        scheme, _, given = headers.get("authorization", "").partition(" ")
        if scheme.lower() == "bearer" and self.is_token(given.strip()):
            return True
        try:
            cookie = SimpleCookie(headers.get("cookie", "")).get(COOKIE)
        except CookieError:
            return False
        return cookie is not None and self._until_ns.get(cookie.value, 0) > self._now_ns()


class Guard:
    """The middleware: answers what is refused itself, and puts its headers on every answer."""

    def __init__(
        self, app: ASGIApp, bench: Bench, sessions: Sessions, now_ns: Now = monotonic_ns
    ) -> None:
        self._app = app
        self._hosts = accepted_hosts(bench)
        self._sessions = sessions
        self._max_body = bench.network.max_body_bytes
        network = bench.network
        self._rate = Rate(network.requests_per_second, network.request_burst, now_ns)
        self._logins = Rate(LOGINS_PER_SECOND, LOGIN_BURST, now_ns)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Check, then hand on."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        try:
            self._check(scope, Headers(scope=scope))
        except ApiError as error:
            await _refuse(scope, receive, send, error)
            return

        async def with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in HEADERS.items():
                    headers.setdefault(name, value)
                if scope["path"].startswith("/api"):
                    headers.setdefault("Cache-Control", "no-store")
            await send(message)

        await self._app(scope, receive, with_headers)

    def _check(self, scope: Scope, headers: Headers) -> None:
        self._check_host(headers)
        changes = scope["type"] == "websocket" or scope["method"] not in SAFE
        if changes:
            _check_origin(headers)
        path = scope["path"]
        peer = (scope.get("client") or ("", 0))[0]
        if path != STOP:
            self._check_rate(path, peer)
            if scope["type"] == "http":
                self._check_body(headers)
        if self._sessions.needed and path.startswith("/api") and path not in OPEN:
            here = path == STOP and is_loopback(peer)
            if not here and not self._sessions.knows(headers):
                raise ApiError(
                    401,
                    "token-needed",
                    "this daemon asks for its token. Send it as Authorization: Bearer ..., or log "
                    "in by POST /api/login.",
                )

    def _check_host(self, headers: Headers) -> None:
        host = headers.get("host", "")
        try:
            name = urlsplit(f"//{host}").hostname or ""
        except ValueError:
            name = ""
        if name not in self._hosts:
            raise ApiError(
                421,
                "wrong-host",
                f"this daemon is not called {host[:80]!r}. Reach it by a name that it knows, or "
                "add that one to network.hosts.",
            )

    def _check_rate(self, path: str, peer: str) -> None:
        allowed = self._logins.allows(peer) if path == LOGIN else self._rate.allows(peer)
        if not allowed:
            raise ApiError(
                429, "too-many-requests", "too many requests from this address. Wait a second."
            )

    def _check_body(self, headers: Headers) -> None:
        if "transfer-encoding" in headers:
            raise ApiError(411, "length-needed", "a body must say its length. Send Content-Length.")
        length = headers.get("content-length", "0")
        if not length.isdecimal() or int(length) > self._max_body:
            raise ApiError(
                413,
                "too-large",
                f"a body of {length[:20]} bytes is more than the {self._max_body} that are read.",
            )


def _check_origin(headers: Headers) -> None:
    """Refuse what a browser sends for another site's page; other programs send no Origin."""
    origin = headers.get("origin")
    if origin is not None:
        try:
            same = urlsplit(origin).netloc.lower() == headers.get("host", "").lower()
        except ValueError:
            same = False
    else:
        same = headers.get("sec-fetch-site", "none") in ("same-origin", "none")
    if not same:
        raise ApiError(
            403,
            "other-origin",
            "a page of another site asked for this. Use this daemon's own page, or a program.",
        )


async def _refuse(scope: Scope, receive: Receive, send: Send, error: ApiError) -> None:
    body = json.dumps(problem(error.status, error.slug, str(error))).encode()
    prefix = "http"
    if scope["type"] == "websocket":
        await receive()  # the request to connect
        if error.status == 401:  # a browser sees the code of what was accepted, and nothing else
            await send({"type": "websocket.accept"})
            await send({"type": "websocket.close", "code": 1008, "reason": error.slug})
            return
        if "websocket.http.response" not in scope.get("extensions", {}):
            await send({"type": "websocket.close", "code": 1008, "reason": error.slug})
            return
        prefix = "websocket.http"
    headers = {**HEADERS, "Content-Type": MEDIA_TYPE, "Content-Length": str(len(body))}
    if error.status == 401:
        headers["WWW-Authenticate"] = "Bearer"
    if error.status == 429:
        headers["Retry-After"] = "1"
    if prefix == "http":
        headers["Connection"] = "close"  # its body is not read
    await send(
        {
            "type": f"{prefix}.response.start",
            "status": error.status,
            "headers": [(k.lower().encode(), v.encode()) for k, v in headers.items()],
        }
    )
    await send({"type": f"{prefix}.response.body", "body": body})


def elsewhere(client: Address | None) -> str:
    """The address that a request came from, "" where that is this machine."""
    return "" if client is None or is_loopback(client.host) else client.host
