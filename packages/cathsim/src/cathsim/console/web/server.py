"""The web server: one page, its files, and a websocket for one operator at a time."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import threading
import time
from collections import OrderedDict
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

from fastapi import FastAPI, Request, WebSocket, WebSocketDisconnect
from fastapi.responses import FileResponse, PlainTextResponse, Response
from fastapi.staticfiles import StaticFiles

from cathsim.console.web.messages import Access
from cathsim.console.worker import RealTimeLoop

PAGE = Path(__file__).parents[1] / "page"
# codes of the websocket's end that the page understands
REFUSED, OCCUPIED, FLOODED, FAILED = 4401, 4409, 4429, 1011
# A page sends a reading a picture of its screen at most, from a gamepad: up to 240 a second.
MOST_A_SECOND, MOST_AT_ONCE = 300, 600
_MOST_NOTICES = 8  # that wait for a page that does not read
_HEADERS = {
    "Content-Security-Policy": "default-src 'self'; connect-src 'self' ws: wss:; img-src 'self' blob: data:; "
    "frame-ancestors 'none'",
    "Referrer-Policy": "no-referrer",  # the address holds the token
    "Cache-Control": "no-store",
    "X-Content-Type-Options": "nosniff",
}

_LOGGER = logging.getLogger(__name__)


class Desk:
    """Between the loop's thread and the operator's websocket: the latest picture, and the latest message of each kind.

    For a page that does not read nothing piles up: a newer state replaces an older one, and the last few notices are
    kept.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._frame: bytes | None = None
        self._messages: OrderedDict[str, dict[str, Any] | bytes] = OrderedDict()
        self._ready: tuple[asyncio.AbstractEventLoop, asyncio.Event] | None = None

    def take(self) -> bool:
        """Seats an operator; false while another one sits here. Called in the server's event loop."""
        with self._lock:
            if self._ready is not None:
                return False
            self._ready = asyncio.get_running_loop(), asyncio.Event()
            self._frame = None
            self._messages.clear()
            return True

    def leave(self) -> None:
        """The operator is gone."""
        with self._lock:
            self._ready = None

    def show(self, frame: bytes) -> None:
        """Takes a picture from the loop; one that has not been sent yet is dropped."""
        with self._lock:
            self._frame = frame
            self._wake()

    def say(self, message: dict[str, Any] | bytes) -> None:
        """Takes a message from the loop."""
        with self._lock:
            if self._ready is not None:
                key = _kind(message)
                self._messages.pop(key, None)
                self._messages[key] = message
                notices = [kind for kind in self._messages if kind.startswith(_NOTICE)]
                for kind in notices[:-_MOST_NOTICES]:
                    del self._messages[kind]
                self._wake()

    def _wake(self) -> None:
        if self._ready is not None:
            loop, event = self._ready
            with contextlib.suppress(RuntimeError):  # the event loop has closed: the program is ending
                loop.call_soon_threadsafe(event.set)

    async def next(self) -> list[dict[str, Any] | bytes]:
        """Waits for something to send: messages in their order, then the latest picture."""
        ready = self._ready
        if ready is None:
            raise RuntimeError("nobody sits at the desk: call take() first")
        await ready[1].wait()
        with self._lock:
            ready[1].clear()
            batch: list[dict[str, Any] | bytes] = [*self._messages.values()]
            self._messages.clear()
            if self._frame is not None:
                batch.append(self._frame)
                self._frame = None
            return batch


_NOTICE = "notice"


def _kind(message: dict[str, Any] | bytes) -> str:
    """What a newer message of the same kind replaces."""
    if isinstance(message, bytes):
        return "surface"
    return f"{_NOTICE} {message['text']}" if message["type"] == _NOTICE else str(message["type"])


class Pace:
    """Counts what a page sends: a bucket of `MOST_AT_ONCE` that fills up by `MOST_A_SECOND`.

    Args:
        clock: gives the time, s.
    """

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._clock, self._left, self._at = clock, float(MOST_AT_ONCE), clock()

    def allows(self) -> bool:
        """Whether one more message may come."""
        now = self._clock()
        self._left = min(self._left + MOST_A_SECOND * (now - self._at), MOST_AT_ONCE)
        self._at = now
        if self._left < 1:
            return False
        self._left -= 1
        return True


def create_app(loop: RealTimeLoop, desk: Desk, access: Access) -> FastAPI:
    """The web application of a console: `/` is the page, `/ws` the websocket. It starts and stops the loop."""

    @contextlib.asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        loop.start()
        yield
        await asyncio.to_thread(loop.stop)

    app = FastAPI(title="CathSim console", lifespan=lifespan, docs_url=None, redoc_url=None, openapi_url=None)

    @app.middleware("http")
    async def guard(request: Request, proceed: Any) -> Response:
        # the page's own files hold no secret, and they are asked for without a token
        token = request.query_params.get("token", "")
        refusal = access.refusal(request.headers, token) if request.url.path == "/" else ""
        response = PlainTextResponse(refusal + "\n", status_code=403) if refusal else await proceed(request)
        response.headers.update(_HEADERS)
        return response

    @app.get("/")
    def page() -> FileResponse:
        return FileResponse(PAGE / "index.html")

    app.mount("/page", StaticFiles(directory=PAGE), name="page")

    @app.websocket("/ws")
    async def operate(socket: WebSocket) -> None:
        refusal = access.refusal(socket.headers, socket.query_params.get("token", ""))
        await socket.accept()
        if refusal or not desk.take():
            reason = refusal or "another window is at the controls: close it first"
            await socket.close(REFUSED if refusal else OCCUPIED, reason)
            return
        loop.operator_came()
        sender = asyncio.create_task(_send(socket, desk))
        try:
            await _receive(socket, loop, desk)
        finally:
            sender.cancel()
            loop.operator_left()
            desk.leave()

    return app


async def _send(socket: WebSocket, desk: Desk) -> None:
    try:
        while True:
            for message in await desk.next():
                if isinstance(message, bytes):
                    await socket.send_bytes(message)
                else:
                    await socket.send_json(message)
    except (WebSocketDisconnect, RuntimeError):
        return  # the page is gone
    except Exception:  # a page without pictures would stand still for ever: it connects again
        _LOGGER.exception("a message could not be sent")
        await socket.close(FAILED, "a message could not be sent: connecting again")


async def _receive(socket: WebSocket, loop: RealTimeLoop, desk: Desk) -> None:
    pace = Pace()
    with contextlib.suppress(WebSocketDisconnect, RuntimeError):  # the second: it was closed from this side
        while True:
            message = await socket.receive()
            if message["type"] == "websocket.disconnect":
                return
            if not pace.allows():
                loop.panel.release()
                await socket.close(FLOODED, f"more than {MOST_A_SECOND} messages a second: close what sends them")
                return
            try:
                loop.request(message.get("text") or "")
            except ValueError as error:
                desk.say({"type": "notice", "kind": "error", "text": str(error)})
            except Exception as error:  # a message must not end the connection
                _LOGGER.exception("a request failed")
                text = f"the request failed ({type(error).__name__}: {error})"
                desk.say({"type": "notice", "kind": "error", "text": text})
