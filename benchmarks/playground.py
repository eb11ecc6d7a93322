"""What the Playground costs: processor time of its server, a run beside visitors that do not read, memory over an hour.

The feed is made up, its vehicles fly and its agents trade; visitors are in a process of their own.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import resource
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from websockets.asyncio.client import connect

from covey.playground.broadcast import Broadcast
from covey.playground.client import Visitor
from covey.playground.messages import Steered
from covey.playground.sample import sample_feed
from covey.playground.server import PlaygroundServer
from covey.runtime.watching.feed import Scene, Update

Feed = list[Scene | Update]

SIZES = ((16, 1_000), (100, 10_000), (100, 100_000))
"""Agents and landmarks."""

RATE = 30.0
"""`Motion`s a second."""

HELLO = '{"type": "hello", "token": ""}'


def run(quick: bool) -> dict[str, Any]:
    """Share of a processor that the server takes, how a run fares beside visitors, and memory."""
    seconds = 3.0 if quick else 10.0
    return {
        **{f"{m}_agents_{n}_landmarks": serve_in_real_time(m, n, seconds) for m, n in SIZES},
        "run_beside_visitors": run_as_fast_as_possible(1_000 if quick else 10_000),
        "hour": in_a_process_of_its_own(360.0 if quick else 3600.0),
    }


def serve_in_real_time(agents: int, landmarks: int, seconds: float) -> dict[str, float]:
    """Tell a run in real time to three visitors; return what the server's thread and the run's own calls take."""
    feed = list(sample_feed(agents=agents, landmarks=landmarks, seconds=seconds, rate=RATE, trades=10.0))
    with PlaygroundServer() as server, visitors(server.port, 3) as outside:
        server.watch(feed[0])
        server.watch(feed[1])
        _wait_for(server, 3)
        time.sleep(1.0)  # until each has the whole state
        before, in_run, begun = _thread_time(server), 0.0, time.monotonic()
        for item in feed[2:]:
            due = begun + (0.0 if isinstance(item, Scene) else item.time)
            time.sleep(max(0.0, due - time.monotonic()))
            called = time.thread_time()
            server.watch(item)
            in_run += time.thread_time() - called
        elapsed = time.monotonic() - begun
        share = (_thread_time(server) - before) / elapsed
        outside.terminate()
        told = json.loads(outside.communicate()[0] or "{}")
    return {
        "server_share_of_a_core": share,
        "run_share_of_a_core": in_run / elapsed,
        "frames_a_second": told.get("frames", 0) / 3.0 / elapsed,
    }


def run_as_fast_as_possible(trades: int) -> dict[str, float]:
    """Return the processor time of a run's calls alone, beside visitors that read, and beside some that never do."""
    rate = 10.0
    feed = list(sample_feed(agents=16, landmarks=1_000, seconds=trades / rate, rate=RATE, trades=rate))
    times = {}
    for name, readers, stuck in (("alone", 0, 0), ("three_readers", 3, 0), ("three_that_never_read", 0, 3)):
        with contextlib.ExitStack() as stack:
            server = stack.enter_context(PlaygroundServer())
            stack.enter_context(visitors(server.port, readers))
            for _ in range(stuck):
                stack.enter_context(never_reads(server.port))
            _wait_for(server, readers + stuck)
            called = time.thread_time()
            for item in feed:
                server.watch(item)
            times[f"{name}_s"] = time.thread_time() - called
            if stuck:
                times["most_characters_waiting"] = float(max(visitor.backlog for visitor in server.visitors))
    return {"updates": float(len(feed)), **times}


def in_a_process_of_its_own(seconds: float) -> dict[str, float]:
    """Return what `memory_over_time` does, in a process whose memory nothing else has used."""
    program = f"import sys; sys.path[:0] = {sys.path!r}; import playground; playground.print_memory({seconds})"
    done = subprocess.run([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True, check=True)
    return dict(json.loads(done.stdout))


def print_memory(seconds: float) -> None:
    """Print what `memory_over_time` returns."""
    print(json.dumps(memory_over_time(seconds)))


def memory_over_time(seconds: float) -> dict[str, float]:
    """Return how much the process grows from a tenth of the time on: a visitor that reads, and one that does not."""

    async def hour() -> tuple[float, float]:
        broadcast = Broadcast()
        reader, stuck = Visitor(may_steer=False), Visitor(may_steer=False)
        broadcast.visitors |= {reader, stuck}
        steered = Steered(paused=False, speed=0.0, loss=0.0)

        async def read() -> None:
            while True:
                await reader.next()

        reading = asyncio.create_task(read())
        stuck.idle = True  # it has been told the state, and then nothing more is sent
        early = 0.0
        for item in sample_feed(agents=16, landmarks=1_000, seconds=seconds, rate=10.0, trades=1.0):
            broadcast(item)
            broadcast.pass_on(steered)
            stuck.idle = False
            await asyncio.sleep(0)
            if not isinstance(item, Scene) and item.time < 0.1 * seconds:
                early = _megabytes()
        reading.cancel()
        return early, _megabytes()

    early, late = asyncio.run(hour())
    return {"mission_s": seconds, "early_megabytes": early, "grown_megabytes": late - early}


@contextlib.contextmanager
def visitors(port: int, count: int) -> Iterator[subprocess.Popen[str]]:
    """Let so many visitors read, in a process of their own that prints how many frames they got."""
    program = f"import sys; sys.path[:0] = {sys.path!r}; import playground; playground.read({port}, {count})"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
    with subprocess.Popen(
        [sys.executable, "-c", program], stdout=subprocess.PIPE, text=True, env=environment
    ) as process:
        try:
            yield process
        finally:
            process.kill()


def read(port: int, count: int) -> None:
    """Visit and read until the end of the server or SIGTERM."""
    frames = 0

    async def one() -> None:
        nonlocal frames
        async with connect(f"ws://127.0.0.1:{port}/api/feed", proxy=None, max_size=None) as visitor:
            await visitor.send(HELLO)
            async for _ in visitor:
                frames += 1

    async def all_of_them() -> None:
        visits = asyncio.gather(*(one() for _ in range(count)), return_exceptions=True)
        asyncio.get_running_loop().add_signal_handler(signal.SIGTERM, visits.cancel)
        with contextlib.suppress(asyncio.CancelledError):
            await visits

    asyncio.run(all_of_them())
    print(json.dumps({"frames": frames}))


@contextlib.contextmanager
def never_reads(port: int) -> Iterator[socket.socket]:
    """Greet, and never read."""
    with socket.create_connection(("127.0.0.1", port)) as visitor:
        visitor.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        lines = (
            "GET /api/feed HTTP/1.1",
            f"Host: 127.0.0.1:{port}",
            "Upgrade: websocket",
            "Connection: Upgrade",
            "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==",
            "Sec-WebSocket-Version: 13",
        )
        visitor.sendall("".join(f"{line}\r\n" for line in (*lines, "")).encode())
        visitor.recv(1024)
        visitor.sendall(bytes([0x81, 0x80 | len(HELLO), 0, 0, 0, 0]) + HELLO.encode())
        yield visitor


def _wait_for(server: PlaygroundServer, count: int) -> None:
    end = time.monotonic() + 30.0
    while len(server.visitors) < count and time.monotonic() < end:
        time.sleep(0.02)


def _thread_time(server: PlaygroundServer) -> float:
    assert server.thread.ident is not None
    return time.clock_gettime(time.pthread_getcpuclockid(server.thread.ident))


def _megabytes() -> float:
    """Return the memory that the process has now; NaN where the system does not tell."""
    status = Path("/proc/self/statm")
    if not status.exists():
        return float("nan")
    return int(status.read_text().split()[1]) * resource.getpagesize() / 1e6
