"""How long a question and its answer take between two processes, by `ZenohTransport` and by a plain Zenoh query.

Question and answer are a request and an offer of some landmarks each; the plain query carries as many bytes and does
nothing with them.  The two take turns.
"""

from __future__ import annotations

import json
import socket
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from typing import Any

import numpy as np
import zenoh

from covey.geometry import Pose2
from covey.protocol import Offer, PoseRecord, RecordSlice, Request, Sender, TradeId
from covey.transports.codec import Codec
from covey.transports.network import NetworkOptions
from covey.transports.zenoh import ZenohTransport

SIZES = (40, 400, 4000)
"""Landmarks of each side."""

CODEC = Codec(bytes(16), agents=2, landmarks=2 * max(SIZES))
PLAIN = "covey-benchmark/plain"
WARM_UP = 50


def question(landmarks: int, number: int) -> Request:
    """Return a request of agent 0."""
    return Request(Sender(0, 1), TradeId(0, 1, number), _pose(), _records(landmarks, 0))


def answer(landmarks: int, number: int) -> Offer:
    """Return an offer of agent 1: a tenth of its landmarks for a tenth of the other's."""
    own = _records(landmarks, 1)
    give, want = own.indices[::10], own.indices[::10] - 1
    pose = _pose()
    return Offer(Sender(1, 1), TradeId(0, 1, number), pose, own, give, want, pose.pose, pose.pose)


def _pose() -> PoseRecord:
    return PoseRecord(1, 20, Pose2(1.0, 2.0, 0.5))


def _records(landmarks: int, agent: int) -> RecordSlice:
    indices = 2 * np.arange(landmarks, dtype=np.int64) + agent
    return RecordSlice(indices, np.tile(np.array([1, 20, agent, 1], dtype=np.int64), (landmarks, 1)))


def serve(endpoint: str) -> None:
    """Answer, in a process of its own, until it is killed."""
    offers = {landmarks: answer(landmarks, 0) for landmarks in SIZES}
    sizes = {_bytes(question(n, 0)): bytes(_bytes(offer)) for n, offer in offers.items()}
    session = zenoh.open(_plain_config(connect=endpoint))

    def reply(query: zenoh.Query) -> None:
        with query:
            query.reply(query.key_expr, sizes[len(query.payload or b"")])

    session.declare_queryable(PLAIN, reply)
    transport = ZenohTransport(Sender(1, 1), CODEC, NetworkOptions(connect=(endpoint,)))
    while True:
        transport.wait(60.0)
        for message in transport.receive():
            if isinstance(message, Request):
                transport.send(0, offers[len(message.records.indices)])


def run(quick: bool) -> dict[str, Any]:
    """Median and 95th percentile of the seconds of a round trip, and how many times longer ours takes."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    transport = ZenohTransport(Sender(0, 1), CODEC, NetworkOptions(listen=(endpoint,)))
    session = zenoh.open(_plain_config(connect=endpoint))
    program = f"import sys; sys.path[:0] = {sys.path!r}; import network; network.serve({endpoint!r})"
    server = subprocess.Popen([sys.executable, "-c", program])
    try:
        _until(lambda: bool(transport.peers))
        _until(lambda: _ask_plainly(session, _bytes(question(SIZES[0], 0))))
        return {f"{n}_landmarks": _compare(transport, session, n, 100 if quick else 1000) for n in SIZES}
    finally:
        server.kill()
        server.wait()
        session.close()
        transport.close()


def _compare(transport: ZenohTransport, session: zenoh.Session, landmarks: int, repetitions: int) -> dict[str, Any]:
    size = _bytes(question(landmarks, 0))
    ours: list[float] = []
    plain: list[float] = []
    for number in range(WARM_UP + repetitions):
        started = time.perf_counter()
        transport.send(1, question(landmarks, number))
        while not transport.receive():
            transport.wait(10.0)
        middle = time.perf_counter()
        _ask_plainly(session, size)
        ours.append(middle - started)
        plain.append(time.perf_counter() - middle)
    ours, plain = ours[WARM_UP:], plain[WARM_UP:]
    return {
        "question_bytes": size,
        "answer_bytes": _bytes(answer(landmarks, 0)),
        "transport_s": round(statistics.median(ours), 6),
        "transport_p95_s": round(float(np.percentile(ours, 95)), 6),
        "plain_query_s": round(statistics.median(plain), 6),
        "plain_query_p95_s": round(float(np.percentile(plain, 95)), 6),
        "ratio": round(statistics.median(ours) / statistics.median(plain), 2),
    }


def _ask_plainly(session: zenoh.Session, size: int) -> bool:
    return any(reply.ok is not None for reply in session.get(PLAIN, payload=bytes(size), timeout=10.0))


def _bytes(message: Request | Offer) -> int:
    return len(CODEC.encode(message, sender=message.sender, to=0, number=1))


def _plain_config(*, connect: str) -> zenoh.Config:
    config = zenoh.Config()
    for key, value in {
        "connect/endpoints": [connect],
        "listen/endpoints": ["tcp/127.0.0.1:0"],
        "scouting/multicast/enabled": False,
    }.items():
        config.insert_json5(key, json.dumps(value))
    return config


def _until(holds: Callable[[], bool]) -> None:
    end = time.monotonic() + 30.0
    while not holds():
        if time.monotonic() > end:
            raise TimeoutError("the other process did not answer")
        time.sleep(0.01)
