"""Landmarks that are no cells of the grid which the others are."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.browsing import WHITE, Serve, Shown, expected_cells

from covey.environment import Landmarks
from covey.environment.lattice import find_lattice
from covey.playground.sample import sample_feed
from covey.playground.server import PlaygroundServer
from covey.runtime.drawing.palette import rgb
from covey.runtime.watching.feed import ChangeKind, Scene, TeamChange, TeamState, Trading, Update
from covey.runtime.watching.steering import SetWeight, Steering
from covey.runtime.watching.view import TeamView

Show = Callable[..., Shown]

BESIDE = np.array([[7.0, 3.0, 0.0], [4.5, 5.5, 0.0], [2.8, 4.2, 0.0]])
"""On a corner of four cells, in the middle of one, and elsewhere."""


def with_points(agents: int, landmarks: int, points: NDArray[np.float64]) -> tuple[Scene, TeamState]:
    """A made-up scene of cells, to which points are added that the first agent owns."""
    scene, state = (item for item, _ in zip(sample_feed(agents=agents, landmarks=landmarks), range(2), strict=False))
    assert isinstance(scene, Scene)
    assert isinstance(state, TeamState)
    more = len(points)
    ones = np.ones(landmarks + more)
    owner = np.concatenate([state.owner, np.zeros(more, dtype=np.int32)])
    positions = np.concatenate([scene.positions_W, points])
    return (
        replace(scene, positions_W=positions, weights=ones, obstacles=()),
        replace(state, owner=owner, weights=ones),
    )


class Told:
    """A server that is told a run, and the state after it."""

    def __init__(self, server: PlaygroundServer) -> None:
        self.server, self.view = server, TeamView()

    def __call__(self, *items: Scene | Update) -> None:
        for item in items:
            self.view.apply(item)
            self.server.watch(item)


def in_the_middle(shown: Shown, scene: Scene, landmarks: list[int]) -> NDArray[np.int64]:
    return shown.settle().colours("cells", scene.positions_W[landmarks, :2].tolist())[:, :3]


@pytest.mark.parametrize("cells", [150, 12_000])
def test_points_lie_on_the_cells_and_change_hands_like_these(show: Show, serve: Serve, cells: int) -> None:
    """As single shapes, of which one is drawn anew, and as one image with a pixel a cell."""
    scene, state = with_points(4, cells, BESIDE)
    told = Told(serve())
    told(scene, state)
    shown = show(told.server.public_url)
    added = [cells, cells + 1, cells + 2]
    assert shown.state()["loose"] == added
    if cells == 12_000:
        shown.page.locator("#map").focus()
        assert shown.state()["cellPixels"] < 7
        # Closer, so that there is more than a point to be seen of a cell, but not so close that it is drawn by itself.
        shown.page.mouse.move(*shown.place(4.5, 4.5))
        while shown.state()["cellPixels"] < 5.5:
            shown.page.mouse.wheel(0, -40)
            shown.settle()
    palette = np.array([np.rint(255 * rgb(agent.colour)) for agent in scene.agents])

    def check() -> None:
        seen = in_the_middle(shown, scene, added)
        np.testing.assert_allclose(seen, expected_cells(told.view)[added], atol=1)
        if cells == 150:
            np.testing.assert_allclose(shown.cells(scene)[:cells], expected_cells(told.view)[:cells], atol=1)

    check()
    beneath = next(k for k in range(cells) if (scene.positions_W[k] == BESIDE[1]).all())
    offered = np.array([added[0], beneath], dtype=np.int32)
    none = np.zeros(0, dtype=np.int32)
    told(Trading(1.0, 1, 0, offered, none, open=True))
    shown.wait(lambda state: state["trading"] == sorted(offered.tolist()))
    check()
    assert (in_the_middle(shown, scene, added[:1]) == WHITE).all()
    new = np.array([2, 3], dtype=np.int32)
    told(
        TeamChange(2.0, ChangeKind.TRADE, (1, 0), offered, new, (), np.zeros((0, 7)), (), np.zeros(0), 1.0, "a trade"),
        Trading(2.0, 1, 0, offered, none, open=False),
    )
    shown.wait(lambda state: state["trades"] == 1)
    check()
    np.testing.assert_allclose(in_the_middle(shown, scene, added[:1])[0], palette[2], atol=1)


def test_a_point_is_found_before_the_cell_beneath_it(show: Show, serve: Serve) -> None:
    steering = Steering()
    steering.offer(SetWeight)
    server = serve(steering=steering)
    for item in with_points(4, 150, BESIDE):
        server.watch(item)
    shown = show(server.url)
    page = shown.page

    def tip(x: float, y: float) -> str:
        page.mouse.move(*shown.place(x, y))
        return shown.text("#tip")

    assert "landmark 151\n" in tip(4.5, 5.5)
    assert re.search(r"watched by 1 agent-1, visibility \d", shown.text("#tip"))
    assert "landmark 79\n" in tip(4.9, 5.9)
    assert "landmark 150\n" in tip(7.05, 2.95)
    page.get_by_role("button", name="Weight").click()
    x, y = shown.place(4.5, 5.5)
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x, y - 60, steps=3)
    page.mouse.up()
    requests = list(steering.take())
    for _ in range(100):
        page.wait_for_timeout(20)
        requests += steering.take()
        if requests:
            break
    assert [request.command for request in requests] == [SetWeight(151, 2.0)]


def test_a_point_that_is_worth_less_is_paler_but_not_of_its_cell_s_colour(show: Show, serve: Serve) -> None:
    scene, state = with_points(4, 150, BESIDE)
    weights = state.weights.copy()
    weights[150:] = (1.0, 0.25, 0.0)
    server = serve()
    server.watch(scene)
    server.watch(replace(state, weights=weights, owner=np.where(np.arange(153) < 150, 1, 0).astype(np.int32)))
    shown = show(server.public_url)
    colour, other = (255 * rgb(scene.agents[agent].colour) for agent in (0, 1))
    whole, pale, gone = in_the_middle(shown, scene, [150, 151, 152])
    np.testing.assert_allclose(whole, colour, atol=1)
    paper = shown.colours("cells", [[0.5, -0.5]])[0, :3]
    np.testing.assert_allclose(pale, 0.475 * colour + 0.525 * paper, atol=2)
    np.testing.assert_allclose(gone, other, atol=1)


def test_the_page_and_the_figures_agree_on_what_is_a_cell(show: Show, serve: Serve) -> None:
    rng = np.random.default_rng(5)
    server = serve()
    shown = show(server.public_url, wait=False)
    found = []
    for number in range(24):
        points = np.round(rng.uniform(-3.0, 14.0, (int(rng.integers(1, 30)), 2)) * 4.0) / 4.0
        points[0] = (0.5, 0.5) if number % 4 else (-50.5, 90.5)
        scene, state = with_points(3, 24, np.column_stack([points, np.zeros(len(points))]))
        if number % 8 == 7:
            scene = replace(scene, positions_W=scene.positions_W[::-1].copy())
        scene = replace(scene, mission=f"number {number}")
        server.watch(scene)
        server.watch(state)
        shown.wait(lambda state, name=scene.mission: state["mission"] == name)  # type: ignore[misc]
        loose = shown.state()["loose"]
        lattice = find_lattice(Landmarks(scene.positions_W[:, :2], cell_size=scene.cell_size))
        assert loose == (None if lattice is None else lattice.loose.tolist())
        found.append(loose is not None)
    assert 5 < sum(found) < 19
