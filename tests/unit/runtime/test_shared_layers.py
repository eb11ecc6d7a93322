"""Agents that share an altitude: never too close, at no moment, and proved with it; and what the result says of it."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.unit.runtime.small import check_deployment

from covey import certify
from covey.errors import InputError, ResultError
from covey.geometry import Pose2
from covey.mission import Mission, parse_mission
from covey.runtime.agent import build_models
from covey.runtime.airspace import room_of
from covey.runtime.fly import fly
from covey.runtime.network.remote_agent import join_mission
from covey.runtime.plan import PlanRun, plan
from covey.runtime.records.record import read_result, result_text
from covey.runtime.result import Deployment
from covey.transports import Loopback

CROWDED: dict[str, Any] = {
    "schema_version": 1,
    "name": "crowded",
    "seed": 3,
    "environment": {
        "landmarks": {"grid": {"x_m": [-0.5, 0.5], "y_m": [-0.5, 0.5], "spacing_m": 0.125}},
        "region": {"box": {"x_m": [-2, 2], "y_m": [-2, 2]}},
    },
    "sensor": {"model": "anisotropic", "optimal_distance_m": 0.4},
    "agents": {"count": 4},
}


def crowded(*, agents: int = 4, seed: int = 3, trade: str = "pairwise", **flight: Any) -> Mission:
    """Return a mission whose agents would all like to be in the same place: they share one layer of 4 m by 4 m."""
    document = {
        **CROWDED,
        "seed": seed,
        "agents": {"count": agents},
        "coverage": {"trade": trade},
        "flight": {"ceiling_m": 2.0, **flight},
    }
    return parse_mission(json.dumps(document), format="json")


def least_distance(mission: Mission, poses: tuple[Pose2, ...] | list[Pose2]) -> float:
    """Return the least distance between two agents that share a layer."""
    assert mission.separation is not None
    pairs = [(i, j) for i in range(len(poses)) for j in mission.separation.sharing(i) if j > i]
    return min((math.hypot(poses[i].x - poses[j].x, poses[i].y - poses[j].y) for i, j in pairs), default=math.inf)


@pytest.mark.parametrize("trade", ["pairwise", "thesis"])
@pytest.mark.parametrize("layers", [1, 2])
def test_committed_positions_keep_apart_at_every_moment(
    trade: str, layers: int, seeds: Callable[[int, int], range]
) -> None:
    touching = 0
    for seed in seeds(2, 60):
        mission = crowded(agents=4 * layers, seed=seed, trade=trade, layers=layers, ceiling_m=9.0)
        assert mission.separation is not None
        assert len(set(mission.separation.layers)) == layers
        run = PlanRun(mission, None)
        team, spacing = run.team, mission.separation.spacing
        log, moments = team._log, [list(team.poses)]

        def note(event: str, agents: tuple[int, ...], log: Any = log, moments: Any = moments, team: Any = team) -> None:
            log(event, agents)
            moments.append(list(team.poses))
            own = [node.pose for node in team.nodes]
            assert all(own[agent] == team.poses[agent] for agent in range(len(own)) if team.nodes[agent].quiescent)

        team._log = note  # type: ignore[method-assign]
        deployment = run.deployment()
        assert len(moments) == len(deployment.history)
        assert min(least_distance(mission, poses) for poses in moments) >= spacing
        check_deployment(deployment)
        assert certify(deployment).holds
        touching += least_distance(mission, deployment.poses) < 1.05 * spacing
    assert touching, "the constraint never mattered"


def test_the_certificate_speaks_of_all_free_poses(seeds: Callable[[int, int], range]) -> None:
    """Against dense sampling of what the others leave: no free pose is better by more than the proved gap."""
    for seed in seeds(1, 30):
        mission = crowded(seed=seed)
        deployment = plan(mission)
        assert deployment.certificate is not None
        assert mission.separation is not None
        models, landmarks = build_models(mission), mission.landmarks
        grid = np.array(list(itertools.product(*[np.linspace(-2, 2, 41)] * 2, np.linspace(-math.pi, math.pi, 36))))
        for i, agent in enumerate(deployment.agents):
            others = np.array([deployment.poses[j].position_W for j in mission.separation.sharing(i)])
            away = np.hypot(*(grid[:, None, :2] - others[None]).transpose(2, 0, 1)).min(axis=1)
            clear = grid[away >= mission.separation.clear]
            own = landmarks.subset(agent.landmarks)
            best = (models[i].visibility(clear, own) @ own.weights).max(initial=0.0)
            assert best <= agent.score + deployment.certificate.worst_pose_gap + 1e-9
            room = room_of(mission, deployment.poses, i)
            assert room.contains(deployment.poses[i].x, deployment.poses[i].y)
            x, y = room.sample(300, rng=np.random.default_rng(0)).T
            near = np.hypot(x[:, None] - others[:, 0], y[:, None] - others[:, 1])
            assert near.min() >= mission.separation.spacing


def test_an_offer_is_reserved_until_it_is_committed_or_dropped() -> None:
    run = PlanRun(crowded(agents=5), None)
    team = run.team
    airspace = team.airspace
    assert airspace is not None
    for _ in team.start():
        pass
    offers = 0
    while team.advance():
        for node in team.nodes:
            offer = node.offer
            if offer is None:
                continue
            offers += 1
            for third in set(range(5)) - {offer.sender.agent, offer.trade.client}:
                assert not airspace.is_free(third, offer.server_pose)
                assert not airspace.is_free(third, offer.client_pose)
    assert offers
    assert all(node.offer is None for node in team.nodes)


def test_a_proof_is_adopted_only_where_it_is_still_free() -> None:
    run = PlanRun(crowded(), None)
    run.deployment()
    team = run.team
    taken = team.poses[1]
    before = list(team.poses)
    assert not team.adopt(0, Pose2(taken.x + 0.3, taken.y, 0.0))
    assert team.poses == before
    freed = team.free(0, Pose2(taken.x + 0.3, taken.y, 0.5))
    assert freed.yaw == 0.5
    assert team.airspace is not None
    assert team.airspace.is_free(0, freed)
    assert team.free(0, team.poses[0]) == team.poses[0]


def test_flying_gives_what_planning_gives_and_says_what_it_cost() -> None:
    mission = crowded()
    flown, planned = fly(mission, vehicles="kinematic").deployment, plan(mission)
    assert (flown.score, flown.poses) == (planned.score, planned.poses)
    assert [(e.event, e.agents) for e in flown.history] == [(e.event, e.agents) for e in planned.history]
    report = flown.flight
    assert report is not None
    assert len(set(report.altitudes)) == 1
    assert report.min_separation >= report.required_separation
    assert (report.waypoints_missed, report.collisions) == (0, 0)
    free = plan(replace(mission, separation=None)).score.final
    assert report.separation_cost == pytest.approx(free - planned.score.final, abs=1e-12)
    assert report.separation_cost > 0.0


def test_who_cannot_get_to_a_waypoint_holds_where_nobody_else_may_be() -> None:
    """Obstacles appear on goals: poses are given up, and committed positions keep apart all the same."""
    ball = {"sphere": {"center_m": [0.6, 0.6, 1.5], "radius_m": 0.5}}
    mission = crowded(faults=[{"at_s": 8.0, "obstacle": ball}])
    flight = fly(mission, vehicles="kinematic")
    deployment = flight.deployment
    assert deployment.certificate is not None
    assert deployment.certificate.holds
    assert mission.separation is not None
    assert certify(deployment).holds
    for moment in flight.moments:
        assert least_distance(mission, moment.poses) >= mission.separation.spacing


def test_a_vehicle_that_is_lost_needs_no_room() -> None:
    mission = crowded(agents=3, faults=[{"at_s": 10.0, "motor": {"agent": "agent-1", "rotor": 1}}])
    deployment = fly(mission, vehicles="reference").deployment
    assert deployment.flight is not None
    assert deployment.flight.lost == ("agent-1",)
    assert deployment.mission.separation is not None
    assert deployment.mission.separation.layers == (None, 0, 0)
    assert deployment.certificate is not None
    assert deployment.certificate.holds


def test_the_result_alone_tells_who_keeps_apart(tmp_path: Path) -> None:
    deployment = plan(crowded())
    deployment.save(tmp_path / "out")
    again = read_result(tmp_path / "out")
    assert again.mission.separation == deployment.mission.separation
    assert certify(tmp_path / "out").holds
    document = json.loads(result_text(deployment, tmp_path))
    assert document["mission"]["separation"]["layers"] == [0, 0, 0, 0]


def moved(deployment: Deployment) -> Deployment:
    """Put the first agent beside the second."""
    first, second = deployment.agents[:2]
    pose = Pose2(*first_towards(first.pose, second.pose, 0.9), first.pose.yaw)
    return replace(deployment, agents=(replace(first, pose=pose), *deployment.agents[1:]))


def first_towards(first: Pose2, second: Pose2, distance: float) -> tuple[float, float]:
    away = math.hypot(first.x - second.x, first.y - second.y)
    share = distance / away
    return second.x + share * (first.x - second.x), second.y + share * (first.y - second.y)


def test_a_certificate_names_those_that_are_too_close() -> None:
    deployment = plan(crowded())
    certificate = certify(moved(deployment))
    found = [violation for violation in certificate.violations if violation.kind == "separation"]
    assert not certificate.holds
    assert ("agent-1", "agent-2") in [violation.agents for violation in found]
    assert deployment.mission.separation is not None
    amount = next(violation.amount for violation in found if violation.agents == ("agent-1", "agent-2"))
    assert amount == pytest.approx(deployment.mission.separation.spacing - 0.9)


def test_without_the_others_a_better_pose_is_free() -> None:
    """If nobody had to keep apart, the same deployment would be no Voronoi configuration: the proof knew."""
    deployments = [plan(crowded(seed=seed)) for seed in range(4)]
    free = [replace(it, mission=replace(it.mission, separation=None)) for it in deployments]
    assert max(certify(it).worst_pose_gap for it in free) > 5 * deployments[0].sigma


@pytest.mark.parametrize(
    ("change", "place"),
    [
        (lambda block: block.update(layers=[0]), "mission.separation.layers"),
        (lambda block: block.update(spacing_m=-1.0), "mission.separation.spacing_m"),
        (lambda block: block.update(layers=[0, 0, 0, "x"]), r"mission.separation.layers\[3\]"),
        (lambda block: block.pop("spacing_m"), "mission.separation.spacing_m"),
    ],
)
def test_a_result_with_a_broken_separation_is_refused(
    change: Callable[[dict[str, Any]], object], place: str, tmp_path: Path
) -> None:
    plan(crowded()).save(tmp_path / "out")
    file = tmp_path / "out" / "result.json"
    document = json.loads(file.read_text(encoding="utf-8"))
    change(document["mission"]["separation"])
    file.write_text(json.dumps(document), encoding="utf-8")
    with pytest.raises(ResultError, match=place):
        read_result(tmp_path / "out")


def test_agents_in_processes_of_their_own_need_layers_of_their_own() -> None:
    transport: Any = Loopback(rng=np.random.default_rng(0)).endpoint(0)
    with pytest.raises(InputError, match="expected a layer for each agent"):
        join_mission(crowded(), transport)


def test_another_seed_that_leaves_no_room_is_refused() -> None:
    poses: Iterator[tuple[float, float]] = itertools.cycle([(-1.0, -1.0), (1.0, 1.0)])
    mission = crowded(agents=2)
    agents = tuple(
        replace(agent, pose=Pose2(0.4 * x, 0.4 * y, 0.0)) for agent, (x, y) in zip(mission.agents, poses, strict=False)
    )
    plan(replace(mission, agents=agents))
    near = tuple(replace(agent, pose=Pose2(0.3 * agent.pose.x, 0.3 * agent.pose.y, 0.0)) for agent in agents)
    with pytest.raises(InputError, match=r"agent-1 and agent-2 start 0\.\d+ m apart"):
        plan(replace(mission, agents=near))


def test_a_cost_that_was_interrupted_is_not_stated(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Ctrl-C while the other plan is made: the flight is whole, and its cost is unknown instead of wrong."""

    def interrupted(mission: Mission) -> Deployment:
        return PlanRun(mission, None).interrupted()

    monkeypatch.setattr("covey.runtime.plan.plan", interrupted)
    deployment = fly(crowded(), vehicles="kinematic").deployment
    assert deployment.flight is not None
    assert math.isnan(deployment.flight.separation_cost)
    assert json.loads(result_text(deployment, tmp_path))["flight"]["separation_cost"] is None
    deployment.save(tmp_path / "out")
    again = read_result(tmp_path / "out").flight
    assert again is not None
    assert math.isnan(again.separation_cost)
