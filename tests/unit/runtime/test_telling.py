"""What runs tell: all of it adds up to what came out, and nothing else changes."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from covey.errors import ArgumentError
from covey.mission import Mission, load_mission, parse_mission
from covey.playground.messages import encode
from covey.runtime.agent import build_models
from covey.runtime.fly import fly
from covey.runtime.plan import plan
from covey.runtime.result import Deployment, PlanStatus, Progress
from covey.runtime.watching.feed import (
    Activity,
    BoundFound,
    ChangeKind,
    Ended,
    Health,
    Motion,
    Note,
    ObstacleAppeared,
    Run,
    Scene,
    TeamChange,
    TeamState,
    Trading,
    Update,
)
from covey.runtime.watching.telling import KEYFRAME_SECONDS, MOTION_EVERY, describe
from covey.runtime.watching.view import TeamView

SCENE: dict[str, Any] = {
    "schema_version": 1,
    "name": "field",
    "seed": 3,
    "environment": {
        "landmarks": {"grid": {"x_m": [-4, 4], "y_m": [-4, 4], "spacing_m": 1}},
        "region": {"box": {"x_m": [-4, 4], "y_m": [-4, 4]}},
    },
    "agents": [
        {"name": "blue", "pose": {"x_m": -3, "y_m": -3}},
        {"name": "red", "pose": {"x_m": 3, "y_m": -3}},
        {"name": "green", "pose": {"x_m": 0, "y_m": 3}},
    ],
}


def scene(**changes: Any) -> Mission:
    """Return a small mission."""
    return parse_mission(json.dumps({**SCENE, **changes}), format="json")


def same(first: Deployment, second: Deployment) -> bool:
    """Whether two runs came to the same bit for bit."""
    return (
        first.history == second.history
        and first.poses == second.poses
        and np.array_equal(first.owner, second.owner)
        and first.pose_optimizations == second.pose_optimizations
    )


def added_up(items: list[Scene | Update]) -> TeamView:
    """Return the view after all items, each checked against what tells the same."""
    view = TeamView()
    last = -1.0
    for item in items:
        if isinstance(item, TeamState) and view.scene is not None and last >= 0.0:
            state = view.state()
            for name in ("owner", "poses", "scores", "weights", "trading"):
                assert np.array_equal(getattr(item, name), getattr(state, name)), name
            assert item.trades == state.trades
        view.apply(item)
        if not isinstance(item, Scene):
            assert item.time >= last
            last = item.time
        if isinstance(item, TeamChange):
            assert view.score == item.score
    return view


@pytest.fixture(scope="module")
def planned() -> tuple[Deployment, list[Scene | Update]]:
    items: list[Scene | Update] = []
    return plan(scene(), bound=True, watch=items.append), items


def test_the_folder_of_a_sensor_of_the_users_own_is_not_told(root: Path) -> None:
    mission = load_mission(root / "examples" / "own-model.yaml")
    told = describe(mission, build_models(mission), run=Run.PLAN, software={})
    assert {agent.sensor for agent in told.agents} == {"own_model.py:Spotlight"}
    assert str(root) not in encode(told)


def test_a_plan_that_is_watched_comes_out_the_same(planned: tuple[Deployment, list[Scene | Update]]) -> None:
    assert same(plan(scene()), planned[0])


def test_what_a_plan_tells_adds_up(planned: tuple[Deployment, list[Scene | Update]]) -> None:
    deployment, items = planned
    assert isinstance(items[0], Scene)
    assert isinstance(items[1], TeamState)
    assert isinstance(items[-2], TeamState)
    assert isinstance(items[-1], Ended)
    view = added_up(items)
    assert np.array_equal(view.owner, deployment.owner)
    assert view.score == deployment.score.final
    assert view.trades == deployment.trades > 0
    assert not view.trading.any()
    assert set(view.activity.tolist()) == {Activity.QUIESCENT}
    assert deployment.bound is not None
    assert view.bound == deployment.bound.team_upper_bound
    assert view.ended is not None
    assert (view.ended.status, view.ended.holds) == ("settled", True)
    changes = [item for item in items if isinstance(item, TeamChange)]
    assert [change.score for change in changes] == [entry.score for entry in deployment.history[1:]]
    assert [change.kind.value for change in changes] == [entry.event for entry in deployment.history[1:]]


def test_landmarks_are_offered_from_the_offer_to_the_end_of_the_trade(
    planned: tuple[Deployment, list[Scene | Update]],
) -> None:
    view = TeamView()
    offered = traded = 0
    for item in planned[1]:
        if isinstance(item, TeamChange) and item.kind is ChangeKind.TRADE:
            assert view.trading[item.landmarks].all()  # all that changes hands was white
            assert len(item.landmarks)
            traded += 1
        if isinstance(item, Trading):
            both = np.concatenate([item.give, item.want])
            assert len(both)
            assert view.trading[both].all() != item.open
            offered += item.open
            if item.open:
                assert (view.owner[item.give] == item.server).all()
        view.apply(item)
    assert offered >= traded > 0


def test_a_plan_that_is_interrupted_tells_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("covey.runtime.plan.REPORT_EVERY", 0.0)  # else it may settle before the first report
    items: list[Scene | Update] = []

    def stop(news: Progress) -> None:
        if news.trades:
            raise KeyboardInterrupt

    deployment = plan(scene(), on_progress=stop, watch=items.append)
    assert deployment.status is PlanStatus.INTERRUPTED
    view = added_up(items[:-2])
    view.apply(items[-2])
    view.apply(items[-1])
    assert view.ended is not None
    assert (view.ended.status, view.ended.holds) == ("interrupted", None)
    assert np.array_equal(view.owner, deployment.owner)
    assert view.score == deployment.score.final


def test_what_a_watcher_raises_ends_the_run() -> None:
    def refuse(item: Scene | Update) -> None:
        raise OSError("no")

    with pytest.raises(OSError, match="no"):
        plan(scene(), watch=refuse)


@pytest.fixture(scope="module")
def flown() -> tuple[Deployment, list[Scene | Update], Any]:
    faults = [
        {"at_s": 6.0, "motor": {"agent": "red", "rotor": 1}},
        {"at_s": 9.0, "obstacle": {"box": {"x_m": [1, 1.5], "y_m": [1, 1.5], "z_m": [0, 3]}}},
    ]
    mission = scene(flight={"faults": faults})
    items: list[Scene | Update] = []
    flight = fly(mission, vehicles="reference", watch=items.append)
    again = fly(mission, vehicles="reference")
    assert np.array_equal(flight.log.state, again.log.state)
    assert same(flight.deployment, again.deployment)
    return flight.deployment, items, flight


def test_what_a_flight_tells_adds_up(flown: tuple[Deployment, list[Scene | Update], Any]) -> None:
    deployment, items, flight = flown
    view = added_up(items)
    assert view.scene is not None
    assert view.scene.run is Run.FLIGHT
    assert view.scene.body_radius > 0.0
    assert np.array_equal(view.owner, deployment.owner)
    assert view.score == deployment.score.final
    assert len(view.obstacles) == 1
    assert view.activity[1] == Activity.DEAD
    assert any(isinstance(item, TeamChange) and item.kind is ChangeKind.DEATH for item in items)
    assert any(isinstance(item, ObstacleAppeared) for item in items)
    kinds = {item.kind for item in items if isinstance(item, Note)}
    assert {"takeoff", "reached", "fault", "lost", "landing"} <= kinds
    assert any((item.activity == Activity.FLYING).any() for item in items if isinstance(item, Health))
    batteries = np.array([item.battery for item in items if isinstance(item, Health)])
    batteries = batteries[np.isfinite(batteries).all(axis=1)]
    assert (np.diff(batteries, axis=0) <= 0.0).all()
    assert 1.0 - batteries[-1, 0] == pytest.approx(flight.deployment.flight.duration / 960.0, rel=0.2)
    assert batteries[-1, 1] > batteries[-1, 0]  # it does not fly any more
    assert batteries[-1, 1] == pytest.approx(batteries[-5, 1], abs=1e-4)  # its rotors idle
    times = np.array([item.time for item in items if isinstance(item, Motion)])
    assert np.diff(times)[:-1] == pytest.approx(MOTION_EVERY, abs=1e-6)
    states = [item.time for item in items if isinstance(item, TeamState)]
    assert max(np.diff(states)) <= KEYFRAME_SECONDS + 1.0
    motion = view.motion
    assert motion is not None
    assert motion.poses[:, :3] == pytest.approx(flight.log.state[-1, :, :3], abs=0.2)
    assert np.linalg.norm(motion.poses[:, 3:], axis=1) == pytest.approx(1.0)


def test_bounds_are_told_only_if_asked_for() -> None:
    items: list[Scene | Update] = []
    plan(scene(), watch=items.append)
    assert not any(isinstance(item, BoundFound) for item in items)


def test_a_view_refuses_what_does_not_fit(planned: tuple[Deployment, list[Scene | Update]]) -> None:
    first, state = planned[1][0], planned[1][1]
    assert isinstance(state, TeamState)
    with pytest.raises(ArgumentError, match="expected a Scene first, got TeamState"):
        TeamView().apply(state)
    view = TeamView()
    view.apply(first)
    with pytest.raises(ArgumentError, match="TeamState that fits its Scene"):
        view.apply(dataclasses.replace(state, owner=state.owner[:-1]))
