"""Who comes late sees what went before."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.browsing import Serve, Shown

from covey.playground.sample import sample_feed
from covey.playground.server import PlaygroundServer
from covey.runtime.drawing.palette import rgb
from covey.runtime.watching.feed import ChangeKind, Motion, Scene, TeamChange, TeamState

Show = Callable[..., Shown]

ACROSS = 200
"""Moments in which the vehicles fly from one edge to the other."""


def lines(scene: Scene, agents: int) -> NDArray[np.float64]:
    """Where vehicles are that fly across, in all moments: (ACROSS, agents, 3)."""
    high = scene.positions_W[:, :2].max(axis=0)
    x = np.linspace(1.2, high[0], ACROSS)
    y = np.linspace(0.8, high[1], agents)
    return np.stack([*np.broadcast_arrays(x[:, None], y[None, :]), np.ones((ACROSS, agents))], axis=2)


def motions(places: NDArray[np.float64], start: float) -> Iterator[Motion]:
    nothing = np.zeros((places.shape[1], 3))
    for moment, positions in enumerate(places):
        poses = np.zeros((len(positions), 7))
        poses[:, :3], poses[:, 3] = positions, 1.0
        yield Motion(start + 0.1 * moment, poses, nothing, nothing, np.zeros((0, 3)), 10.0 + moment, np.nan)


def committed(time: float, agent: int) -> TeamChange:
    pose = np.array([[0.5, 0.5, 0.0, 1.0, 0.0, 0.0, 0.0]])
    none = np.zeros(0, dtype=np.int32)
    return TeamChange(time, ChangeKind.JOINED, (agent,), none, none, (agent,), pose, (), np.zeros(0), 1.0, "joined")


def begin(server: PlaygroundServer, agents: int, time: float) -> Scene:
    scene, state = (item for item, _ in zip(sample_feed(agents=agents, landmarks=150), range(2), strict=False))
    assert isinstance(scene, Scene)
    assert isinstance(state, TeamState)
    server.watch(replace(scene, obstacles=()))
    server.watch(replace(state, time=time))
    return scene


def drawn(shown: Shown, scene: Scene, path: NDArray[np.float64], agent: int) -> float:
    """Share of the places on a path where the map shows the colour of its agent."""
    colour = 255 * rgb(scene.agents[agent].colour)
    found = shown.settle().colours("scenery", path[:, :2].tolist())
    return float((np.abs(found[:, :3] - colour).max(axis=1) < 40).mean())


@pytest.mark.parametrize("joined", [False, True])
def test_a_late_visitor_sees_paths_and_flown_score_from_the_start(show: Show, serve: Serve, joined: bool) -> None:
    """Also those from before an agent joined, and so does who was there all the time."""
    server = serve()
    scene = begin(server, 4, 0.0)
    early = show(server.public_url)
    places = lines(scene, 4)
    for number, motion in enumerate(motions(places, 0.1)):
        server.watch(motion)
        if number == 0:
            early.wait(lambda state: state["pathPoints"] == 4)
        early.page.wait_for_timeout(4)
    end = 0.1 + 0.1 * ACROSS
    if joined:
        scene = begin(server, 5, end)
        server.watch(committed(end, 0))
        after = np.concatenate([places[-1:], [[[3.0, 3.0, 1.0]]]], axis=1)
        server.watch(next(motions(after, end)))
    late = show(server.public_url)
    for shown in (early, late):
        state = shown.wait(lambda state: len(state["pathStarts"]) == 4 + joined and state["time"] >= end - 0.2)
        np.testing.assert_allclose(state["pathStarts"][:4], [[0.1, *place] for place in places[0]], atol=1e-6)
        assert state["flownPoints"] >= (ACROSS if shown is late else 2)
        for agent in range(4):
            assert drawn(shown, scene, places[5:-20, agent], agent) > 0.9
            # The pose that was committed meanwhile is not where the vehicle was.
            assert drawn(shown, scene, np.linspace(places[-20, agent], (0.5, 0.5, 1.0), 60)[10:-10], agent) < 0.2
    if joined:
        state = late.state()
        np.testing.assert_allclose(state["pathStarts"][4], [end, 3.0, 3.0, 1.0], atol=1e-6)


def test_paths_go_on_where_a_late_visitor_found_them(show: Show, serve: Serve) -> None:
    server = serve()
    scene = begin(server, 4, 0.0)
    places = lines(scene, 4)
    moves = list(motions(places, 0.1))
    for motion in moves[: ACROSS // 2]:
        server.watch(motion)
    late = show(server.public_url)
    late.wait(lambda state: state["pathPoints"] > 4 * 0.4 * ACROSS)
    for motion in moves[ACROSS // 2 :]:
        server.watch(motion)
        late.page.wait_for_timeout(4)
    late.wait(lambda state: state["time"] > moves[-3].time)
    for agent in range(4):
        assert drawn(late, scene, places[5:-20, agent], agent) > 0.9
