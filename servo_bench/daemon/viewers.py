"""The WebSocket: status on every change and at least every 0.25 s, samples 30 times a second."""

import asyncio
import json
from contextlib import suppress

from fastapi import WebSocket, WebSocketDisconnect

from servo_bench.daemon.core import Daemon
from servo_bench.daemon.guard import elsewhere
from servo_bench.daemon.live import Viewer
from servo_bench.daemon.models import Status, StopRequest

FRAME_EVERY_S = 1.0 / 30.0
STATUS_EVERY_S = 0.25
MOST_VIEWERS = 32
HISTORY_ROWS = 500
"""What a page that is opened, or loaded again, in the middle of a run sees at once."""
TRY_AGAIN_LATER = 1013
MAX_MESSAGE = 4096


class Viewers:
    """All open pages. Each has a place in the rows, and costs nothing more when it is slow."""

    def __init__(self, daemon: Daemon) -> None:
        self._daemon = daemon
        self._count = 0

    async def serve(self, socket: WebSocket) -> None:
        """One viewer, until it goes."""
        await socket.accept()
        if self._count >= MOST_VIEWERS:  # a browser shows the reason of what was accepted only
            await socket.close(TRY_AGAIN_LATER, f"{MOST_VIEWERS} pages are open already")
            return
        self._count += 1
        listening = asyncio.create_task(self._listen(socket))
        try:
            await self._show(socket, listening)
        except WebSocketDisconnect:
            pass  # it went while something was sent to it
        finally:
            self._count -= 1
            listening.cancel()
            with suppress(asyncio.CancelledError, WebSocketDisconnect):
                await listening

    async def _show(self, socket: WebSocket, listening: "asyncio.Task[None]") -> None:
        viewer, loop = Viewer(), asyncio.get_running_loop()
        version, told_s = -1, 0.0
        while not listening.done():
            now_s = loop.time()
            if version != self._daemon.condition.version or now_s - told_s >= STATUS_EVERY_S:
                version, told_s = self._daemon.condition.version, now_s
                await socket.send_text(self._status())
            block = viewer.frame(self._daemon.source(), HISTORY_ROWS)
            if block is not None:
                await socket.send_bytes(block)
            await asyncio.wait([listening], timeout=FRAME_EVERY_S)

    def _status(self) -> str:
        table = Status.model_validate(self._daemon.status()).model_dump(mode="json")
        return json.dumps({"kind": "status", **table})

    async def _listen(self, socket: WebSocket) -> None:
        """Heed a stop; anything else is passed over. Ends when the viewer has gone."""
        while True:
            message = await socket.receive()
            if message["type"] == "websocket.disconnect":
                return
            if (asked := _stop_in(message.get("text"))) is not None:
                self._daemon.stop(asked.words("an operator at the page", elsewhere(socket.client)))


def _stop_in(text: str | None) -> StopRequest | None:
    """The stop that a message asks for, with what fits of its words."""
    if text is None or len(text) > MAX_MESSAGE:
        return None
    try:
        message = json.loads(text)
    except (ValueError, RecursionError):
        return None
    if not isinstance(message, dict) or message.pop("kind", None) != "stop":
        return None
    return StopRequest.in_table(message)
