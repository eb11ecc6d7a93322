"""The server, with real sockets."""

import asyncio
import http.client
import json
import socket as sockets
import threading
import urllib.request
from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.visitors import HELLO, close_code, listen, visit
from websockets.asyncio.client import connect
from websockets.exceptions import InvalidStatus

from covey.errors import InputError, NetworkError, OutputError
from covey.playground.client import BACKLOG
from covey.playground.sample import sample_feed
from covey.playground.server import PlaygroundServer, bind
from covey.runtime.watching.feed import Motion, ObstacleAppeared, Scene, TeamChange, TeamState
from covey.runtime.watching.steering import Kill, SetLoss, Steering
from covey.runtime.watching.view import TeamView

Serve = Callable[..., PlaygroundServer]


def get(server: PlaygroundServer, path: str, **headers: str) -> http.client.HTTPResponse:
    connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=10)
    connection.request("GET", path, headers={name.replace("_", "-"): value for name, value in headers.items()})
    response = connection.getresponse()
    response.read()
    connection.close()
    return response


def types(messages: list[dict[str, Any]]) -> list[str]:
    return [message["type"] for message in messages]


def test_the_page_is_served_and_can_call_nobody(serve: Serve) -> None:
    server = serve()
    response = get(server, "/")
    assert response.status == 200
    assert response.headers["Content-Type"].startswith("text/html")
    policy = response.headers["Content-Security-Policy"]
    assert "default-src 'none'" in policy
    assert "http" not in policy
    assert response.headers["X-Content-Type-Options"] == "nosniff"
    assert get(server, "/app.js").headers["Content-Type"].startswith("text/javascript")
    for path in ("/none.js", "/../pyproject.toml", "/..%2f..%2fpyproject.toml", "/api/record", "/api/heatmap?agent=0"):
        assert get(server, path).status == 404


def test_the_token_is_in_the_fragment_and_new_each_time(serve: Serve) -> None:
    first, second = serve(), serve()
    assert first.url == f"http://127.0.0.1:{first.port}/#token={first.controls.token}"
    assert first.controls.token != second.controls.token
    assert len(first.controls.token) >= 32


@pytest.mark.parametrize(
    "headers",
    [
        {"Host": "evil.example"},
        {"Host": "evil.example:80"},
        {"Host": ""},
        {"Origin": "http://evil.example"},
        {"Origin": "null"},
        {"Sec_Fetch_Site": "cross-site", "Sec_Fetch_Mode": "no-cors", "Sec_Fetch_Dest": "script"},
        {"Sec_Fetch_Site": "cross-site", "Sec_Fetch_Mode": "navigate", "Sec_Fetch_Dest": "iframe"},
    ],
)
def test_pages_of_other_origins_get_nothing(serve: Serve, headers: dict[str, str]) -> None:
    server = serve()
    assert get(server, "/", **headers).status == 403
    assert get(server, "/api/heatmap?agent=0", **headers).status == 403


def test_a_link_may_lead_to_the_page(serve: Serve) -> None:
    headers = {"Sec_Fetch_Site": "cross-site", "Sec_Fetch_Mode": "navigate", "Sec_Fetch_Dest": "document"}
    assert get(serve(), "/", **headers).status == 200


@pytest.mark.parametrize("own", [False, True])
def test_the_socket_checks_origin_and_host(serve: Serve, own: bool) -> None:
    server = serve()

    async def knock() -> None:
        origin = f"http://127.0.0.1:{server.port}" if own else "http://evil.example"
        async with visit(server, origin=origin) as socket:
            assert types(await listen(socket, "Hello")) == ["Hello"]

    async def knock_by_another_name() -> None:
        address = f"ws://evil.example:{server.port}/api/feed"
        async with connect(address, host="127.0.0.1", port=server.port, proxy=None):
            pass

    if own:
        asyncio.run(knock())
    for refused in (knock_by_another_name,) if own else (knock, knock_by_another_name):
        with pytest.raises(InvalidStatus) as caught:
            asyncio.run(refused())
        assert caught.value.response.status_code == 403


def test_a_visitor_gets_the_state_and_all_that_follows(serve: Serve) -> None:
    server = serve()
    feed = list(sample_feed(agents=4, landmarks=60, seconds=20.0))
    half = len(feed) // 2

    async def watch() -> list[dict[str, Any]]:
        async with visit(server) as socket:
            begin = await listen(socket, "Steered")
            for item in feed[half:]:
                server.watch(item)
                await asyncio.sleep(0.0005)
            return begin + await listen(socket, "Ended")

    for item in feed[:half]:
        server.watch(item)
    messages = asyncio.run(watch())
    assert types(messages)[:4] == ["Hello", "Scene", "TeamState", "History"]
    view = TeamView()
    for item in feed[:half]:
        view.apply(item)
    assert messages[2]["trades"] == view.trades > 0
    changes = [item for item in feed[:half] if isinstance(item, TeamChange)]
    assert [change["text"] for change in messages[3]["changes"]] == [change.text for change in changes]
    later = [item.text for item in feed[half:] if isinstance(item, TeamChange)]
    assert [message["text"] for message in messages if message["type"] == "TeamChange"] == later
    times = [message["time"] for message in messages if message["type"] == "Motion"]
    assert all(first < second for first, second in pairwise(times))


def test_a_visitor_after_the_end_learns_of_it(serve: Serve) -> None:
    server = serve()
    for item in sample_feed(agents=4, landmarks=60, seconds=2.0):
        server.watch(item)

    async def watch() -> list[dict[str, Any]]:
        async with visit(server) as socket:
            return await listen(socket, "Steered")

    messages = asyncio.run(watch())
    assert {"Scene", "TeamState", "History", "Motion", "Health", "Ended"} <= set(types(messages))


def test_when_changes_pile_up_the_state_comes_instead(serve: Serve) -> None:
    server = serve()
    feed = list(sample_feed(agents=4, landmarks=60, seconds=2000.0, rate=2.0, trades=1.0))
    scene, state, *rest = feed

    async def watch() -> list[dict[str, Any]]:
        async with visit(server) as socket:
            server.watch(scene)
            server.watch(state)
            begin = await listen(socket, "Steered")
            for item in rest:  # within one frame
                server.watch(item)
            return begin + await listen(socket, "Ended")

    messages = asyncio.run(watch())
    assert types(messages).count("Scene") == 1
    assert types(messages).count("TeamChange") < 300 < sum(isinstance(item, TeamChange) for item in rest)
    states = [message for message in messages if message["type"] == "TeamState"]
    assert states[-1]["trades"] == sum(isinstance(item, TeamChange) and item.kind.value == "trade" for item in rest)


def test_a_new_scene_is_told_with_its_obstacles(serve: Serve) -> None:
    server = serve()
    feed = list(sample_feed(agents=4, landmarks=60, seconds=1.0))
    larger = list(sample_feed(agents=5, landmarks=70, seconds=1.0))
    assert isinstance(feed[0], Scene)
    appeared = ObstacleAppeared(0.5, feed[0].obstacles[0])

    async def watch() -> list[dict[str, Any]]:
        async with visit(server) as socket:
            for item in (*feed[:2], appeared):
                server.watch(item)
            messages = await listen(socket, "ObstacleAppeared")
            for item in larger[:2]:
                server.watch(item)
            return messages + await listen(socket, "TeamState")

    messages = asyncio.run(watch())
    scenes = [message for message in messages if message["type"] == "Scene"]
    assert [len(scene["agents"]) for scene in scenes] == [4, 5]
    assert types(messages).count("ObstacleAppeared") == 1


@pytest.mark.parametrize(
    "frames",
    [
        [HELLO % "wrong"],
        [HELLO % "\\ud800"],
        ["{"],
        ["a" * 5000],
        [b"\x00\x01"],
        ['{"type": "command", "token": "TOKEN", "command": "pause"}'],
        [HELLO % "TOKEN", "[]"],
        [HELLO % "TOKEN", '{"type": "command", "token": "wrong", "command": "pause"}'],
        [HELLO % "TOKEN", '{"type": "command", "token": "TOKEN", "command": "fly"}'],
        [HELLO % "TOKEN", b"\x00"],
        [HELLO % "TOKEN", HELLO % "TOKEN"],
        [HELLO % "TOKEN", "a" * 100_000],
        [HELLO % "", '{"type": "command", "token": "", "command": "pause"}'],
    ],
)
def test_whoever_breaks_the_rules_is_turned_away(serve: Serve, frames: list[str | bytes]) -> None:
    steering = Steering()
    server = serve(steering=steering)

    async def knock() -> int | None:
        async with connect(f"ws://127.0.0.1:{server.port}/api/feed", proxy=None) as socket:
            for frame in frames:
                await socket.send(frame.replace("TOKEN", server.controls.token) if isinstance(frame, str) else frame)
            return await close_code(socket)

    async def others() -> list[str]:
        async with visit(server) as socket:
            server.watch(next(sample_feed()))
            return types(await listen(socket, "Scene"))

    assert asyncio.run(knock()) in (1008, 1009)
    assert not steering.pace.paused
    assert "Scene" in asyncio.run(others())


def test_who_has_the_token_may_steer_and_refusals_are_private(serve: Serve) -> None:
    steering = Steering()
    steering.offer(Kill)
    server = serve(steering=steering)
    token = server.controls.token
    for item in sample_feed(agents=3, landmarks=12, seconds=0.5):
        server.watch(item)

    async def steer() -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
        async with visit(server, token) as captain, visit(server) as guest:
            told = await listen(captain, "Steered")
            seen = await listen(guest, "Steered")
            for command in ({"command": "pause"}, {"command": "kill", "agent": 1}, {"command": "loss", "loss": 0.1}):
                await captain.send(json.dumps({"type": "command", "token": token, **command}))
            told += await listen(captain, "Refused")
            seen += await listen(guest, "Steered")
            (request,) = steering.take()
            assert request.command == Kill(1)
            request.refuse("agent: it is dead already")
            told += await listen(captain, "Refused")
            return told, seen

    told, seen = asyncio.run(steer())
    hello = told[0]
    assert (hello["may_steer"], seen[0]["may_steer"]) == (True, False)
    assert set(hello["commands"]) == {"pause", "resume", "step", "speed", "kill"}
    assert [message["command"] for message in told if message["type"] == "Refused"] == ["loss", "kill"]
    assert "Refused" not in types(seen)
    assert [message["paused"] for message in seen if message["type"] == "Steered"] == [False, True]
    assert steering.pace.paused
    assert SetLoss not in {type(request.command) for request in steering.take()}


def test_a_run_may_say_later_what_it_carries_out(serve: Serve) -> None:
    steering = Steering()
    server = serve(steering=steering)

    async def watch() -> list[list[str]]:
        async with visit(server) as socket:
            first = await listen(socket, "Hello")
            steering.offer(Kill)
            return [first[0]["commands"], (await listen(socket, "Hello"))[0]["commands"]]

    first, second = asyncio.run(watch())
    assert set(second) - set(first) == {"kill"}


def test_heat_maps_are_computed_once_for_a_pose(serve: Serve) -> None:
    calls = []

    def seen_by(scene: Scene, agent: int, pose: NDArray[np.float64]) -> NDArray[np.float64]:
        calls.append((agent, pose.copy()))
        return np.arange(float(len(scene.positions_W)))

    server = serve(seen_by=seen_by)
    feed = list(sample_feed(agents=3, landmarks=12, seconds=3.0))
    for item in feed[:2]:
        server.watch(item)
    assert get(server, "/api/heatmap?agent=1").status == 200
    assert get(server, "/api/heatmap?agent=1").status == 200
    assert len(calls) == 1
    state = feed[1]
    assert isinstance(state, TeamState)
    np.testing.assert_array_equal(calls[0][1], state.poses[1])
    for query in ("", "?agent=3", "?agent=-1", "?agent=x", "?agent=99999999999999999999"):
        assert get(server, f"/api/heatmap{query}").status == 404
    for item in list(sample_feed(agents=4, landmarks=15, seconds=1.0))[:2]:  # somebody joins, landmarks are added
        server.watch(item)
    for agent in (1, 3):
        with urllib.request.urlopen(f"{server.public_url}api/heatmap?agent={agent}") as response:
            assert json.load(response)["visibility"]["shape"] == [15]


def test_a_sensor_that_fails_costs_only_its_heat_map(serve: Serve) -> None:
    def seen_by(scene: Scene, agent: int, pose: NDArray[np.float64]) -> NDArray[np.float64]:
        raise InputError("sensor model 'own.py:Own': fails")

    server = serve(seen_by=seen_by)
    for item in list(sample_feed(agents=3, landmarks=12, seconds=1.0))[:2]:
        server.watch(item)
    assert get(server, "/api/heatmap?agent=1").status == 404
    assert get(server, "/").status == 200


def test_a_record_is_sent_instead_of_a_run(serve: Serve) -> None:
    server = serve(record=b"packed", speed=2.0)

    async def greet() -> list[dict[str, Any]]:
        async with visit(server) as socket:
            return await listen(socket, "Hello")

    (hello,) = asyncio.run(greet())
    assert (hello["source"], hello["speed"], hello["commands"]) == ("record", 2.0, [])
    response = get(server, "/api/record")
    assert (response.status, response.headers["Content-Encoding"]) == (200, "gzip")


def test_a_visitor_that_never_reads_holds_nobody_up(serve: Serve) -> None:
    server = serve()
    feed = list(sample_feed(agents=40, landmarks=2000, seconds=60.0, trades=10.0))
    with sockets.create_connection(("127.0.0.1", server.port)) as stuck:
        stuck.setsockopt(sockets.SOL_SOCKET, sockets.SO_RCVBUF, 4096)
        stuck.sendall(
            f"GET /api/feed HTTP/1.1\r\nHost: 127.0.0.1:{server.port}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
            "Sec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\nSec-WebSocket-Version: 13\r\n\r\n".encode()
        )
        stuck.recv(1024)
        text = (HELLO % "").encode()
        stuck.sendall(bytes([0x81, 0x80 | len(text), 0, 0, 0, 0]) + text)

        async def watch() -> list[dict[str, Any]]:
            async with visit(server) as socket:
                server.watch(feed[0])
                server.watch(feed[1])
                messages = await listen(socket, "Steered")
                for index, item in enumerate(feed[2:]):
                    server.watch(item)
                    if index % 10 == 0:
                        await asyncio.sleep(0.002)
                return messages + await listen(socket, "Ended")

        messages = asyncio.run(watch())
        backlogs = [visitor.backlog for visitor in server.visitors]
    assert types(messages).count("TeamChange") > 100
    assert max(backlogs, default=0) <= BACKLOG
    total = sum(isinstance(item, Motion) for item in feed)
    assert 0 < types(messages).count("Motion") <= total


def test_closing_leaves_neither_thread_nor_port(static: Any) -> None:
    before = threading.active_count()
    server = PlaygroundServer(static=static)
    port = server.port

    async def stay() -> int | None:
        async with visit(server) as socket:
            await listen(socket, "Hello")
            await asyncio.to_thread(server.close)
            return await close_code(socket)

    assert asyncio.run(stay()) == 1012
    assert threading.active_count() == before
    bind("127.0.0.1", port).close()


def test_what_is_wrong_is_said_at_once(static: Any, tmp_path: Any) -> None:
    with bind("127.0.0.1", 0) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(NetworkError, match=f"127.0.0.1, port {port}: .*; choose another --host or --port"):
            PlaygroundServer(port=port, static=static)
    with pytest.raises(NetworkError, match=r"no-such-host\.invalid"):
        PlaygroundServer(host="no-such-host.invalid", static=static)
    with pytest.raises(OutputError, match="make web"):
        PlaygroundServer(static=tmp_path / "none")


def test_an_address_of_the_sixth_version() -> None:
    with bind("::1", 0) as listening:
        assert listening.family == sockets.AF_INET6
