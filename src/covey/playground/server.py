"""The Playground's server: in a thread of the run's process, for as many visitors as come."""

from __future__ import annotations

import asyncio
import logging
import mimetypes
import socket
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import TypeAlias

import numpy as np
import uvicorn
from numpy.typing import NDArray
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from covey.errors import ArgumentError, CoveyError, NetworkError, OutputError
from covey.playground.broadcast import Broadcast
from covey.playground.client import Visitor
from covey.playground.controls import Controls
from covey.playground.guard import Guard
from covey.playground.messages import LONGEST, Asked, Greeting, HeatMap, Hello, Refused, decode, encode
from covey.runtime.watching.feed import Scene, Update
from covey.runtime.watching.steering import Steering

STATIC = Path(__file__).parent / "static"
"""The built page."""

FRAMES = 30.0
"""Frames a second."""

MOST_VISITORS = 50
"""Further ones are turned away."""

PATIENCE = 10.0
"""Seconds that a visitor has for its greeting."""

TURNED_AWAY = 1008
"""WebSocket's close code for those who break the rules."""

SeenBy: TypeAlias = Callable[[Scene, int, NDArray[np.float64]], NDArray[np.float64]]
"""Takes a scene, an agent of it and its committed pose (`runtime.watching.feed.POSE`); returns how well it sees each
landmark."""


class PlaygroundServer:
    """Serves the page, and what a run tells or a record holds, until it is closed.

    Parameters
    ----------
    host : str
        Address or name to bind to.
    port : int
        0 for a free one.
    steering : Steering, optional
        Of the run.
    seen_by : callable, optional
        For heat maps.
    record : bytes, optional
        Instead of a live run: the lines of a record, see `covey.playground.offline.feed_bytes`.
    speed : float
        How fast a record is played at first.
    static : Path, optional
        Directory of the built page; by default the one that comes with covey.

    Attributes
    ----------
    thread : threading.Thread
        Where all of it happens but `watch`.

    Raises
    ------
    NetworkError
        If the port cannot be had.
    OutputError
        If the page is missing.

    Examples
    --------
    >>> with PlaygroundServer() as server:  # give `server.watch` to a run
    ...     server.url.startswith("http://127.0.0.1:")
    True
    """

    def __init__(
        self,
        *,
        host: str = "127.0.0.1",
        port: int = 0,
        steering: Steering | None = None,
        seen_by: SeenBy | None = None,
        record: bytes | None = None,
        speed: float = 1.0,
        static: Path | None = None,
    ) -> None:
        self.controls = Controls(steering)
        self._broadcast = Broadcast()
        self._seen_by = seen_by
        self._seen: dict[int, tuple[Scene, bytes, str]] = {}
        self._record = record
        self._speed = speed
        self._page = load_page(static or STATIC)
        self._socket = bind(host, port)
        self.host, self.port = host, int(self._socket.getsockname()[1])
        app = Starlette(
            routes=[
                WebSocketRoute("/api/feed", self._feed),
                Route("/api/record", self._send_record),
                Route("/api/heatmap", self._send_heatmap),
                Route("/{name}", self._send_file),
                Route("/", self._send_file),
            ]
        )
        self._uvicorn = uvicorn.Server(
            uvicorn.Config(
                Guard(app, host=host),
                http="h11",
                ws="websockets-sansio",
                ws_max_size=4 * LONGEST,
                ws_per_message_deflate=False,  # nothing is gained on one machine
                lifespan="off",
                log_config=None,
                log_level=logging.CRITICAL,  # whoever knocks could fill the terminal
                access_log=False,
                server_header=False,
                proxy_headers=False,
                limit_concurrency=2 * MOST_VISITORS,
                timeout_graceful_shutdown=1,
            )
        )
        self._loop = asyncio.new_event_loop()
        self.thread = threading.Thread(target=self._run, name="playground", daemon=True)
        self.thread.start()

    @property
    def url(self) -> str:
        """Where the page is, with the token: whoever has it may steer."""
        return f"{self.public_url}#token={self.controls.token}"

    @property
    def public_url(self) -> str:
        """Where the page is for those who only watch."""
        name = {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(self.host, self.host)
        return f"http://{f'[{name}]' if ':' in name else name}:{self.port}/"

    @property
    def visitors(self) -> tuple[Visitor, ...]:
        """Who is here."""
        return tuple(self._broadcast.visitors)

    def watch(self, item: Scene | Update) -> None:
        """Take in what a run tells: the watcher of the run."""
        self._broadcast(item)

    def close(self) -> None:
        """Say good-bye to all visitors and free the port."""
        self._uvicorn.should_exit = True
        self.thread.join()

    def __enter__(self) -> PlaygroundServer:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    # In the thread.

    def _run(self) -> None:
        with asyncio.Runner(loop_factory=lambda: self._loop) as runner:
            runner.run(self._serve())

    async def _serve(self) -> None:
        ticking = asyncio.create_task(self._tick())
        await self._uvicorn.serve(sockets=[self._socket])
        ticking.cancel()
        for connection in list(self._uvicorn.server_state.connections):
            if connection.transport is not None:
                connection.transport.abort()  # of visitors that do not read
        await asyncio.sleep(0)

    async def _tick(self) -> None:
        commands = self.controls.commands
        while True:
            await asyncio.sleep(1.0 / FRAMES)
            if commands != self.controls.commands:  # the run has come so far as to say
                commands = self.controls.commands
                for visitor in self.visitors:
                    visitor.answer(self._hello(visitor))
            self._broadcast.pass_on(self.controls.steered)

    async def _feed(self, socket: WebSocket) -> None:
        """Talk to one visitor."""
        visitors = self._broadcast.visitors
        if len(visitors) >= MOST_VISITORS:
            await socket.close(1013)
            return
        await socket.accept()
        with suppress(WebSocketDisconnect):
            try:
                async with asyncio.timeout(PATIENCE):
                    greeting = await _receive(socket)
                if not isinstance(greeting, Greeting):
                    raise ArgumentError("greeting: expected it first")
                if greeting.token and not self.controls.knows(greeting.token):
                    raise ArgumentError("token: expected another")
            except (ArgumentError, TimeoutError):
                await socket.close(TURNED_AWAY)
                return
            await self._converse(socket, Visitor(may_steer=bool(greeting.token)))

    async def _converse(self, socket: WebSocket, visitor: Visitor) -> None:
        visitor.answer(self._hello(visitor))
        self._broadcast.visitors.add(visitor)
        sending = asyncio.create_task(_send(socket, visitor))
        broke_the_rules = False
        try:
            while True:
                asked = await _receive(socket)
                if not isinstance(asked, Asked) or not self.controls.knows(asked.token):
                    raise ArgumentError("token: expected the right one")
                self.controls.ask(asked, lambda refused: self._answer(visitor, refused))
        except ArgumentError:
            broke_the_rules = True
        finally:
            self._broadcast.visitors.discard(visitor)
            sending.cancel()
            with suppress(asyncio.CancelledError, WebSocketDisconnect):
                await sending
        if broke_the_rules:
            await socket.close(TURNED_AWAY)

    def _hello(self, visitor: Visitor) -> str:
        source = "live" if self._record is None else "record"
        return encode(Hello(source, visitor.may_steer, self.controls.commands, self._speed))

    def _answer(self, visitor: Visitor, refused: Refused) -> None:
        with suppress(RuntimeError):  # the run refuses after the server was closed
            self._loop.call_soon_threadsafe(visitor.answer, encode(refused))

    async def _send_file(self, request: Request) -> Response:
        found = self._page.get(request.path_params.get("name", "index.html"))
        if found is None:
            return PlainTextResponse("There is no such page.\n", 404)
        content, kind = found
        return Response(content, media_type=kind)

    async def _send_record(self, request: Request) -> Response:
        if self._record is None:
            return PlainTextResponse("This is a live run.\n", 404)
        return Response(self._record, media_type="application/jsonl", headers={"Content-Encoding": "gzip"})

    async def _send_heatmap(self, request: Request) -> Response:
        asked = request.query_params.get("agent", "")
        agent = int(asked) if asked.isascii() and asked.isdigit() and len(asked) < 7 else -1
        try:
            text = await self._heatmap(agent)
        except CoveyError:  # a sensor of the user's own
            text = None
        if text is None:
            return PlainTextResponse("Nothing is known of what this agent sees.\n", 404)
        return Response(text, media_type="application/json")

    async def _heatmap(self, agent: int) -> str | None:
        """Return what an agent sees as a message, computed once for a scene and a pose."""
        scene, pose = self._broadcast.whereabouts(agent)
        if scene is None or pose is None or self._seen_by is None:
            return None
        known = self._seen.get(agent)
        if known is not None and known[0] is scene and known[1] == pose.tobytes():
            return known[2]
        seen = await asyncio.to_thread(self._seen_by, scene, agent, pose)
        text = encode(HeatMap(agent, seen.astype(np.float32)))
        self._seen[agent] = scene, pose.tobytes(), text
        return text


async def _send(socket: WebSocket, visitor: Visitor) -> None:
    while True:
        await socket.send_text(await visitor.next())


async def _receive(socket: WebSocket) -> Greeting | Asked:
    message = await socket.receive()
    if message["type"] == "websocket.disconnect":
        raise WebSocketDisconnect(message.get("code", 1005))
    text = message.get("text")
    if text is None:
        raise ArgumentError("frame: expected text")
    return decode(text)


def load_page(static: Path) -> dict[str, tuple[bytes, str]]:
    """Return the content and the type of each file of the built page.

    Raises
    ------
    OutputError
        If it was not built.
    """
    if not (static / "index.html").is_file():
        raise OutputError("the Playground's page is not built: run make web")
    files = sorted(path for path in static.iterdir() if path.is_file())
    return {path.name: (path.read_bytes(), mimetypes.guess_type(path.name)[0] or "text/plain") for path in files}


def bind(host: str, port: int) -> socket.socket:
    """Return a socket that listens.

    Raises
    ------
    NetworkError
        If the host is unknown or the port is taken.
    """
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(
            host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
        listening = socket.socket(family, kind, protocol)
        try:
            listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listening.bind(address)
            listening.listen()
        except OSError:
            listening.close()
            raise
    except OSError as error:
        raise NetworkError(
            f"the Playground cannot listen on {host}, port {port or 'any'}: {error.strerror or error}; "
            "choose another --host or --port"
        ) from error
    return listening
