"""Visitors of the Playground's server."""

import asyncio
import contextlib
import json
from collections.abc import AsyncIterator
from typing import Any

from websockets.asyncio.client import ClientConnection, connect
from websockets.exceptions import ConnectionClosed

from covey.playground.server import PlaygroundServer

HELLO = '{"type": "hello", "token": "%s"}'


@contextlib.asynccontextmanager
async def visit(server: PlaygroundServer, token: str = "", **options: Any) -> AsyncIterator[ClientConnection]:
    """Connect and greet."""
    address = f"ws://127.0.0.1:{server.port}/api/feed"
    async with connect(address, proxy=None, max_size=None, **options) as socket:
        await socket.send(HELLO % token)
        yield socket


async def listen(socket: ClientConnection, until: str) -> list[dict[str, Any]]:
    """Return the messages up to the first of a type."""
    messages: list[dict[str, Any]] = []
    async with asyncio.timeout(20.0):
        while not any(message["type"] == until for message in messages):
            messages += json.loads(await socket.recv())
    return messages


async def close_code(socket: ClientConnection) -> int | None:
    """Read on until the server closes the connection; return its code."""
    async with asyncio.timeout(20.0):
        with contextlib.suppress(ConnectionClosed):
            while True:
                await socket.recv()
    return socket.close_code
