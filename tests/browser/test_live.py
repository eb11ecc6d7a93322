"""The page while a run goes on: what it may ask of it, and what it does when it loses it."""

from __future__ import annotations

import contextlib
import threading
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.browsing import WHITE, Feed, Serve, Shown, expected_cells

from covey.mission import Mission, load_mission
from covey.playground.sample import sample_feed
from covey.playground.server import PlaygroundServer
from covey.runtime.live_team import LiveTeam
from covey.runtime.plan import plan
from covey.runtime.watching.feed import (
    Activity,
    ChangeKind,
    Scene,
    TeamChange,
    TeamState,
    Trading,
    Update,
    Weights,
)
from covey.runtime.watching.steering import AddObstacle, Kill, Pause, Revive, SetLoss, SetWeight, Steering
from covey.runtime.watching.view import TeamView

Show = Callable[..., Shown]

RUNNING_OVER = 120.0
"""Seconds after which a run that a test left paused ends by itself."""


class Over(Exception):
    """The test does not need the run any more."""


class Running:
    """A run in a thread, which ends with its test."""

    def __init__(self, go: Callable[[Callable[[object], None]], object]) -> None:
        self._stop = threading.Event()
        self._go = go
        self.thread = threading.Thread(target=self._run)
        self.thread.start()

    def _run(self) -> None:
        def check(_: object) -> None:
            if self._stop.is_set():
                raise Over

        with contextlib.suppress(Over):
            self._go(check)

    def end(self) -> None:
        self._stop.set()
        self.thread.join(RUNNING_OVER)
        assert not self.thread.is_alive()


@pytest.fixture
def running() -> Iterator[Callable[..., Running]]:
    """Starts runs, and ends them."""
    runs: list[Running] = []

    def start(go: Callable[[Callable[[object], None]], object]) -> Running:
        runs.append(Running(go))
        return runs[-1]

    yield start
    for run in runs:
        run.end()


@pytest.fixture
def mission(root: Path) -> Mission:
    return load_mission(root / "examples" / "thesis-5.2.yaml")


def tell(server: PlaygroundServer, view: TeamView) -> Callable[[Scene | Update], None]:
    def watch(item: Scene | Update) -> None:
        view.apply(item)
        server.watch(item)

    return watch


def test_step_by_step_each_offer_turns_its_landmarks_white(
    show: Show, serve: Serve, running: Callable[..., Running], mission: Mission
) -> None:
    steering, view = Steering(), TeamView()
    steering.ask(Pause(), lambda why: None)
    server = serve(steering=steering)
    running(lambda check: plan(mission, watch=tell(server, view), steering=steering, on_progress=check))
    shown = show(server.url, width=900, height=700)
    shown.wait(lambda state: state["status"] == "open")
    scene = view.scene
    assert scene is not None
    assert "token" not in shown.page.url
    assert shown.text("#status") == "paused"
    offers = 0
    for _ in range(30):
        before = shown.state()["x"]
        shown.page.get_by_role("button", name="Step").click()
        state = shown.wait(lambda state, before=before: state["x"] > before)  # type: ignore[misc]
        expected = expected_cells(view)
        np.testing.assert_allclose(shown.cells(scene), expected, atol=1)
        white = np.flatnonzero((expected == WHITE).all(axis=1)).tolist()
        assert state["trading"] == white
        offers += bool(white)
        if offers >= 3:
            break
    assert offers >= 3
    shown.page.get_by_role("button", name="Go on").click()
    shown.page.locator("#status", has_text="certificate").wait_for()
    assert shown.page.locator("#steering").is_hidden()


def test_agents_are_killed_and_come_back(
    show: Show, serve: Serve, running: Callable[..., Running], mission: Mission
) -> None:
    steering = Steering(speed=0.0)
    server = serve(steering=steering)
    view = TeamView()
    running(
        lambda check: LiveTeam(mission, watch=tell(server, view), steering=steering).play(
            until=lambda: False, on_progress=check
        )
    )
    shown = show(server.url)
    page = shown.page
    page.keyboard.press("]")
    page.get_by_role("button", name="Kill").click()
    state = shown.wait(lambda state: state["activity"][0] == Activity.DEAD and 0 not in state["owner"], seconds=60.0)
    assert len(state["owner"]) == len(mission.landmarks)
    page.locator("tr[data-agent='0']", has_text="dead").wait_for()
    page.locator("#log li[data-kind=adoption]").first.wait_for()
    page.get_by_role("button", name="Revive").click()
    shown.wait(lambda state: state["activity"][0] != Activity.DEAD and 0 in state["owner"], seconds=60.0)
    page.locator("#log li[data-kind=return]").first.wait_for()


def test_every_control_asks_for_what_it_says(show: Show, serve: Serve) -> None:
    steering = Steering()
    steering.offer(Kill, Revive, SetWeight, AddObstacle, SetLoss)
    server = serve(steering=steering)
    feed = sample_feed(agents=3, landmarks=100, seconds=1.0)
    scene = next(feed)
    assert isinstance(scene, Scene)
    for item in (scene, next(feed)):
        server.watch(item)
    shown = show(server.url)
    page = shown.page

    def asked() -> object:
        for _ in range(100):
            requests = steering.take()
            if requests:
                (request,) = requests
                return request.command
            page.wait_for_timeout(20)
        raise AssertionError("nothing was asked for")

    page.locator("tr[data-agent='2']").click()
    page.get_by_role("button", name="Kill").click()
    assert asked() == Kill(2)
    page.keyboard.press("k")
    assert asked() == Kill(2)
    page.keyboard.press("Escape")
    page.get_by_label("lost").fill("0.25")
    assert asked() == SetLoss(0.25)
    page.get_by_role("button", name="Obstacle").click()
    page.mouse.click(*shown.place(2.0, 3.0))
    obstacle = asked()
    assert isinstance(obstacle, AddObstacle)
    assert (obstacle.x, obstacle.y) == pytest.approx((2.0, 3.0), abs=0.05)
    page.keyboard.press("w")
    x, y = shown.place(*map(float, scene.positions_W[37, :2]))
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x, y - 60, steps=3)
    assert "weight 2.00" in shown.text("#tip")
    page.mouse.up()
    weight = asked()
    assert isinstance(weight, SetWeight)
    assert weight.landmark == 37
    assert weight.weight == pytest.approx(2.0, rel=0.02)
    page.keyboard.press("Escape")
    page.get_by_label("Speed").select_option("2")
    page.keyboard.press("Space")
    page.locator("#status", has_text="paused").wait_for()
    assert steering.pace.speed == 2.0
    assert steering.pace.paused


def test_a_landmark_that_becomes_worth_more_looks_stronger_than_the_others(show: Show, serve: Serve) -> None:
    server = serve()
    feed = sample_feed(agents=3, landmarks=100, seconds=1.0)
    scene = next(feed)
    assert isinstance(scene, Scene)
    for item in (scene, next(feed)):
        server.watch(item)
    shown = show(server.public_url)
    before = shown.cells(scene)
    server.watch(Weights(0.0, np.array([37], dtype=np.int32), np.array([4.0])))
    shown.wait(lambda state: state["weights"][37] == 4.0)
    after = shown.cells(scene)
    np.testing.assert_array_equal(after[37], before[37])
    paler = after.sum(axis=1) > before.sum(axis=1)
    assert paler[np.arange(100) != 37].all()


def test_who_comes_late_sees_with_whom_an_agent_has_traded(show: Show, serve: Serve) -> None:
    server = serve()
    view = TeamView()
    trades: Counter[int] = Counter()
    for item in sample_feed(agents=3, landmarks=100, seconds=20.0):
        tell(server, view)(item)
        if isinstance(item, TeamChange) and item.kind is ChangeKind.TRADE and 0 in item.agents:
            trades.update(set(item.agents) - {0})
    assert len(trades) == 2
    shown = show(server.public_url)
    shown.page.keyboard.press("]")
    card = shown.page.locator("#card .partners")
    assert view.scene is not None
    for partner, times in trades.items():
        card.get_by_text(f"{view.scene.agents[partner].name} ×{times}").wait_for()


def test_who_comes_late_counts_events_as_those_do_who_were_there(show: Show, serve: Serve, planned: Feed) -> None:
    server = serve()
    early = show(server.public_url, wait=False)
    for item in planned[:-1]:
        server.watch(item)
    late = show(server.public_url)
    events = sum(isinstance(item, TeamChange | Trading) for item in planned)
    numbers = [
        shown.page.locator("#log li:not([data-kind=ended]) .when").all_inner_texts()
        for shown in (early.ready(), late)
        if shown.wait(lambda state: state["x"] == events)
    ]
    assert numbers[0] == numbers[1]
    assert int(numbers[0][-1]) == 1


def test_what_an_agent_sees_by_a_sensor_of_its_own_is_asked_again_when_it_has_moved(show: Show, serve: Serve) -> None:
    """It sees one landmark: the nearest."""

    def seen_by(scene: Scene, agent: int, pose: NDArray[np.float64]) -> NDArray[np.float64]:
        away = np.linalg.norm(scene.positions_W[:, :2] - pose[:2], axis=1)
        return np.where(away == away.min(), 1.0, 0.0)

    server = serve(seen_by=seen_by)
    feed = sample_feed(agents=3, landmarks=100, seconds=1.0)
    scene, state = next(feed), next(feed)
    assert isinstance(scene, Scene)
    assert isinstance(state, TeamState)
    scene = replace(scene, agents=tuple(replace(agent, sensor="own.py:Own") for agent in scene.agents))
    server.watch(scene)
    shown = show(server.public_url, wait=False)
    for landmark in (12, 47):
        poses = state.poses.copy()
        poses[0, :2] = scene.positions_W[landmark, :2]
        server.watch(replace(state, poses=poses))
        if landmark == 12:
            shown.ready().page.keyboard.press("]")
        for _ in range(100):
            if shown.settle().cells(scene).sum(axis=1).argmax() == landmark:
                break
            shown.page.wait_for_timeout(50)
        light = shown.cells(scene).sum(axis=1)
        assert light.argmax() == landmark
        assert (light == light.max()).sum() == 1


def test_what_is_refused_is_said(show: Show, serve: Serve) -> None:
    steering = Steering()
    steering.offer(Kill)
    server = serve(steering=steering)
    feed = sample_feed(agents=3, landmarks=100, seconds=1.0)
    for item in (next(feed), next(feed)):
        server.watch(item)
    shown = show(server.url)
    shown.page.keyboard.press("]")
    shown.page.keyboard.press("k")
    for _ in range(100):
        for request in steering.take():
            request.refuse("agent-1 cannot be killed twice")
        shown.page.wait_for_timeout(10)
    shown.page.get_by_text("agent-1 cannot be killed twice").wait_for()


def test_without_the_token_one_only_watches(show: Show, serve: Serve) -> None:
    steering = Steering()
    server = serve(steering=steering)
    feed = sample_feed(agents=3, landmarks=100, seconds=1.0)
    for item in (next(feed), next(feed)):
        server.watch(item)
    shown = show(server.public_url)
    shown.page.keyboard.press("]")
    shown.page.locator("#card").wait_for()
    assert shown.page.locator("#steering").is_hidden()
    assert shown.page.get_by_role("button", name="Kill").count() == 0
    shown.page.keyboard.press("Space")
    shown.page.wait_for_timeout(200)
    assert not steering.pace.paused


def test_with_a_wrong_token_one_sees_nothing_but_why(show: Show, serve: Serve) -> None:
    shown = show(f"{serve(steering=Steering()).public_url}#token=wrong", wait=False)
    shown.page.get_by_text("turned this page away").wait_for()
    assert shown.state() is None


def test_the_token_of_an_earlier_run_is_dropped(show: Show, serve: Serve) -> None:
    with PlaygroundServer(steering=Steering()) as first:
        port = first.port
        shown = show(first.url, wait=False)
        shown.page.get_by_text("Waiting for the mission").wait_for()
    second = serve(steering=Steering(), port=port)
    feed = sample_feed(agents=3, landmarks=100, seconds=1.0)
    for item in (next(feed), next(feed)):
        second.watch(item)
    shown.wait(lambda state: state["status"] == "open")
    assert shown.page.locator("#steering").is_hidden()
    shown.troubles[:] = [trouble for trouble in shown.troubles if "ERR_CONNECTION_REFUSED" not in trouble]


def test_it_waits_for_the_mission_and_comes_back_after_a_lost_connection(show: Show, serve: Serve) -> None:
    with PlaygroundServer() as first:
        shown = show(first.public_url, wait=False)
        shown.page.get_by_text("Waiting for the mission").wait_for()
        feed = tuple(sample_feed(agents=3, landmarks=100, seconds=2.0))
        for item in feed[:-1]:
            first.watch(item)
        trades = shown.wait(lambda state: state["trades"] > 0)["trades"]
        port = first.port
    shown.page.locator("#status", has_text="connection lost").wait_for()
    assert shown.page.locator("#map").is_visible()
    second = serve(port=port)
    for item in feed[:-1]:
        second.watch(item)
    shown.page.locator("#status", has_text="live").wait_for()
    assert shown.wait(lambda state: state["status"] == "open")["trades"] == trades
    # The browser itself complains of the connections that were refused meanwhile.
    shown.troubles[:] = [trouble for trouble in shown.troubles if "ERR_CONNECTION_REFUSED" not in trouble]


def test_histories_of_a_long_run_stay_short(show: Show, serve: Serve) -> None:
    server = serve()
    shown = show(server.public_url, wait=False)
    feed = sample_feed(agents=4, landmarks=60, seconds=3000.0, rate=4.0, trades=2.0)
    for count, item in enumerate(feed):
        server.watch(item)
        if count % 100 == 0:
            shown.page.wait_for_timeout(1)
        if not isinstance(item, Scene) and item.time > 2900.0:
            break
    state = shown.wait(lambda state: state["time"] > 2899.0, seconds=60.0)
    assert state["entries"] <= 4000
    assert state["scorePoints"] <= 4000
    assert state["pathPoints"] <= 4 * 1500
