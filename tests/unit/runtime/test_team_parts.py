"""What a team is made of: streams of random numbers, sensors, first owners, the planner, and the baseline."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tests.unit.runtime.small import AGENTS, POLYGON, small

from covey.coverage import team_visibility
from covey.geometry import Pose2
from covey.mission import Mission, OptimizerName, SensorSpec, Trade
from covey.optimize import DifferentialEvolution, Exact, PoseProblem, Search
from covey.protocol import AgentState
from covey.runtime.agent import LEAST_GAIN, TeamPlanner, build_models, build_optimizer
from covey.runtime.baseline import greedy_lloyd
from covey.runtime.streams import Stream, generator
from covey.runtime.team import Team, initial_owners


def planner(mission: Mission, trade: Trade = Trade.PAIRWISE, name: OptimizerName = OptimizerName.SEARCH) -> TeamPlanner:
    return TeamPlanner(mission, build_models(mission), trade=trade, optimizer=name, seed=1)


def state(agent: int, pose: Pose2, landmarks: list[int]) -> AgentState:
    return AgentState(agent, pose, np.array(landmarks, dtype=np.int64))


def test_streams_are_independent_and_repeat() -> None:
    drawn = {
        (stream, index, seed): generator(seed, stream, index).random()
        for stream in Stream
        for index in range(3)
        for seed in range(3)
    }
    assert len(set(drawn.values())) == len(drawn)
    assert all(generator(seed, stream, index).random() == value for (stream, index, seed), value in drawn.items())


def test_the_numbers_of_streams_are_part_of_what_a_seed_means() -> None:
    assert {stream.name: int(stream) for stream in Stream} == {
        "ASSIGNMENT": 2, "PLANNER": 3, "BUS": 4, "NODE": 5, "PROOF": 6, "BASELINE": 7, "BOUND": 8, "WEATHER": 9,
    }  # fmt: skip


def test_equal_sensors_are_one_model() -> None:
    mission = small(agents=[AGENTS[0], {**AGENTS[1], "sensor": {"model": "isotropic"}}, AGENTS[2]])
    models = build_models(mission)
    assert models[0] is models[2]
    assert [model.name for model in models] == ["anisotropic", "isotropic", "anisotropic"]


def test_each_name_has_its_optimiser() -> None:
    kinds = {name: type(build_optimizer(name)) for name in OptimizerName}
    assert kinds == {
        OptimizerName.SEARCH: Search,
        OptimizerName.EXACT: Exact,
        OptimizerName.DIFFERENTIAL_EVOLUTION: DifferentialEvolution,
    }
    assert all(build_optimizer(name).name == name.value for name in OptimizerName)


def test_improve_gives_a_pose_that_is_better_or_none() -> None:
    mission = small(region=POLYGON)
    for name in (OptimizerName.SEARCH, OptimizerName.EXACT):
        thinks = planner(mission, name=name)
        own = np.arange(0, 64, 3)
        pose = mission.agents[0].pose
        better = thinks.improve(0, pose, own)
        assert better is not None
        problem = PoseProblem(thinks.models[0], mission.landmarks.subset(own), mission.agents[0].region)
        assert problem.score(better) > problem.score(pose) + LEAST_GAIN * mission.coverage.sigma
        assert thinks.improve(0, better, own) is None
        # V11: nothing to see, nothing to gain
        assert thinks.improve(0, pose, np.empty(0, dtype=np.int64)) is None


def test_visibility_is_that_of_the_agents_own_sensor_and_is_kept() -> None:
    mission = small(agents=[AGENTS[0], {**AGENTS[1], "sensor": {"model": "isotropic"}}])
    thinks = planner(mission)
    for number in range(7):
        pose = Pose2(0.1 * number, 0.0, 0.3)
        rows = team_visibility(thinks.models, [pose, pose], mission.landmarks)
        for agent in (0, 1):
            np.testing.assert_array_equal(thinks.visibility(agent, pose), rows[agent])
            assert thinks.visibility(agent, pose) is thinks.visibility(agent, pose)


@pytest.mark.parametrize("trade", list(Trade))
def test_a_proposal_shares_the_union_and_gains(trade: Trade) -> None:
    mission = small()
    thinks = planner(mission, trade)
    rng = np.random.default_rng(0)
    proposals = 0
    for _ in range(20):
        pair = rng.permutation(64)[: rng.integers(0, 64)]
        cut = rng.integers(0, len(pair) + 1)
        poses = [Pose2.from_array([*rng.uniform(-2, 2, 2), rng.uniform(-3, 3)]) for _ in range(2)]
        server = state(0, poses[0], sorted(pair[:cut].tolist()))
        client = state(1, poses[1], sorted(pair[cut:].tolist()))
        proposal = thinks.propose(server, client)
        if proposal is None:
            continue
        proposals += 1
        union = np.concatenate([proposal.server_landmarks, proposal.client_landmarks])
        np.testing.assert_array_equal(np.sort(union), np.sort(pair))

        def total(sides: list[tuple[int, Pose2, np.ndarray[tuple[int], np.dtype[np.int64]]]]) -> float:
            return sum(float(thinks.visibility(agent, pose)[own].sum()) for agent, pose, own in sides)

        before = total([(0, server.pose, server.landmarks), (1, client.pose, client.landmarks)])
        after = total(
            [
                (0, proposal.server_pose, proposal.server_landmarks),
                (1, proposal.client_pose, proposal.client_landmarks),
            ]
        )
        assert after > before
        if trade is Trade.THESIS:
            assert (proposal.server_pose, proposal.client_pose) == (server.pose, client.pose)
    assert proposals > 10


def test_the_first_owners_of_a_seed() -> None:
    mission = small()
    owners = [initial_owners(mission, seed) for seed in (1, 1, 2)]
    np.testing.assert_array_equal(owners[0], owners[1])
    assert (owners[0] != owners[2]).any()
    assert set(owners[0].tolist()) == {0, 1, 2}


def test_a_team_logs_what_happens() -> None:
    mission = small()
    team = Team(mission, planner(mission), seed=1)
    assert [entry.event for entry in team.history] == ["initial"]
    for _ in team.start():
        pass
    assert [entry.event for entry in team.history[1:]] == ["optimization"] * 3
    while team.advance():
        pass
    trades = [entry for entry in team.history if entry.event == "trade"]
    assert len(trades) == team.trades > 0
    assert all(len(entry.agents) == 2 for entry in trades)
    seen = team_visibility(team.planner.models, team.poses, mission.landmarks)
    assert team.score == pytest.approx(seen[team.owner, np.arange(64)].sum(), rel=1e-12)
    # the observer's books agree with each node's own
    for agent, node in enumerate(team.nodes):
        assert node.pose == team.poses[agent]
        np.testing.assert_array_equal(node.landmarks, team.sets()[agent])


def test_a_worse_pose_is_not_adopted() -> None:
    mission = small()
    team = Team(mission, planner(mission), seed=1)
    for _ in team.start():
        pass
    while team.advance():
        pass
    before = (team.score, list(team.poses))
    assert not team.adopt(0, Pose2(2.0, 2.0, 0.0))
    assert (team.score, team.poses) == before


def test_the_baseline_is_a_deployment() -> None:
    """Greedy is at least as good as any one grid pose for all, Lloyd never worse than greedy, weights scale both."""
    for mission in (small(), small(region=POLYGON), small(agents={"count": 1})):
        models = build_models(mission)
        rng = np.random.default_rng(0)
        baseline = greedy_lloyd(mission, models, rng=rng)
        assert 0.0 < baseline.greedy <= baseline.greedy_lloyd
        problem = PoseProblem(models[0], mission.landmarks, mission.region)
        alone = Exact().maximize(problem, tolerance=1e-3, rng=rng)
        assert baseline.greedy_lloyd <= len(models) * alone.upper_bound
        assert baseline.greedy >= 0.9 * alone.score
        if len(models) == 1:
            assert baseline.greedy_lloyd <= alone.upper_bound + 1e-9
    weights = np.random.default_rng(3).uniform(0, 2, 64)
    one, ten = (small(weights=(factor * weights).tolist()) for factor in (1.0, 10.0))
    first, second = (greedy_lloyd(m, build_models(m), rng=np.random.default_rng(0)) for m in (one, ten))
    assert second.greedy == pytest.approx(10.0 * first.greedy, rel=1e-9)
    assert second.greedy_lloyd == pytest.approx(10.0 * first.greedy_lloyd, rel=1e-3)


def test_the_baseline_of_a_users_sensor() -> None:
    mission = small(spacing=1.0)
    sensor = SensorSpec("tests.conformance.models:Spotlight", {"radius": 1.5})
    mission = replace(mission, agents=tuple(replace(agent, sensor=sensor) for agent in mission.agents))
    baseline = greedy_lloyd(mission, build_models(mission), rng=np.random.default_rng(0))
    assert 0.0 < baseline.greedy <= baseline.greedy_lloyd <= 16.0
