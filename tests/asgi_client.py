"""An application asked without a socket: httpx's own transport, and a WebSocket by hand."""

import asyncio
import contextlib
from collections.abc import AsyncIterator
from typing import Any

import httpx

HOST = "127.0.0.1:8420"


class AsgiClient:
    """Requests to an ASGI application, each in an event loop of its own.

    The application's own faults are answers, not exceptions. Cookies are kept.
    """

    def __init__(self, app: Any, peer: str = "127.0.0.1") -> None:
        self._app = app
        self._peer = peer
        self._cookies = httpx.Cookies()

    def request(self, method: str, path: str, **options: Any) -> httpx.Response:
        """Any request; options are httpx's."""
        return asyncio.run(self._request(method, path, options))

    async def _request(self, method: str, path: str, options: dict[str, Any]) -> httpx.Response:
        transport = httpx.ASGITransport(self._app, False, client=(self._peer, 5000))
        async with httpx.AsyncClient(
            transport=transport, base_url=f"http://{HOST}", cookies=self._cookies
        ) as client:
            answer = await client.request(method, path, **options)
            self._cookies = client.cookies
            return answer

    def get(self, path: str, **options: Any) -> httpx.Response:
        """GET."""
        return self.request("GET", path, **options)

    def post(self, path: str, **options: Any) -> httpx.Response:
        """POST."""
        return self.request("POST", path, **options)

    def patch(self, path: str, **options: Any) -> httpx.Response:
        """PATCH."""
        return self.request("PATCH", path, **options)

    def delete(self, path: str) -> httpx.Response:
        """DELETE."""
        return self.request("DELETE", path)

    @contextlib.asynccontextmanager
    async def socket(self, path: str, **headers: str) -> AsyncIterator["AsgiSocket"]:
        """A WebSocket, inside an event loop; its first message is the answer to the connection."""
        cookies = "; ".join(f"{name}={value}" for name, value in self._cookies.items())
        given = {"host": HOST, "cookie": cookies, **headers}
        scope = {
            "type": "websocket",
            "asgi": {"version": "3.0"},
            "http_version": "1.1",
            "scheme": "ws",
            "path": path,
            "raw_path": path.encode(),
            "query_string": b"",
            "root_path": "",
            "headers": [(name.encode(), value.encode()) for name, value in given.items()],
            "client": (self._peer, 5000),
            "server": ("127.0.0.1", 8420),
            "subprotocols": [],
        }
        socket = AsgiSocket()
        socket.sent.put_nowait({"type": "websocket.connect"})
        serving = asyncio.create_task(self._app(scope, socket.sent.get, socket.got.put))
        try:
            yield socket
        finally:
            socket.sent.put_nowait({"type": "websocket.disconnect", "code": 1000})
            await asyncio.wait_for(serving, 10.0)


class AsgiSocket:
    """Both directions of a WebSocket, as queues of ASGI messages."""

    def __init__(self) -> None:
        self.sent: asyncio.Queue[dict[str, Any]] = asyncio.Queue()
        self.got: asyncio.Queue[dict[str, Any]] = asyncio.Queue()

    def send(self, **content: Any) -> None:
        """A message to the application: `text` or `bytes`."""
        self.sent.put_nowait({"type": "websocket.receive", **content})

    async def next(self) -> dict[str, Any]:
        """The application's next message."""
        return await asyncio.wait_for(self.got.get(), 10.0)
