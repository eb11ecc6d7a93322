"""Whole missions over a network that delays, reorders, loses and doubles, with every invariant checked all the time."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.protocol.world import FAIR, Weather, World

from covey.protocol import Cause, PoseOptimized, TradeCommitted, WaypointAbandoned

WEATHERS = {
    "fair": FAIR,
    "twice": Weather(twice=True),
    "lossy": Weather(loss=0.3, duplicates=0.2),
    "flying": Weather(flying=0.5, unreachable=0.1),
    "proofs": Weather(proofs=0.1),
    "all": Weather(loss=0.2, duplicates=0.2, flying=0.5, unreachable=0.1, proofs=0.1, lag=20.0),
}


@pytest.mark.parametrize("pairwise", [True, False], ids=["pairwise", "thesis"])
@pytest.mark.parametrize("weather", WEATHERS)
def test_every_invariant_holds(weather: str, pairwise: bool, seeds: Callable[[int, int], range]) -> None:
    trades = 0
    for seed in seeds(25, 2000):
        world = World(seed, WEATHERS[weather], pairwise=pairwise, eager=seed % 2 == 0)
        world.run()
        trades += sum(isinstance(event, TradeCommitted) for event in world.log)
    assert trades > 25


@given(
    st.integers(0, 2**32 - 1),
    st.integers(1, 6),
    st.integers(1, 5),
    st.integers(1, 20),
    st.booleans(),
    st.builds(
        Weather,
        loss=st.sampled_from([0.0, 0.1, 0.5]),
        duplicates=st.sampled_from([0.0, 0.3]),
        spread=st.sampled_from([0.0, 0.02, 1.0]),
        flying=st.sampled_from([0.0, 0.5]),
        unreachable=st.sampled_from([0.0, 0.3]),
        proofs=st.sampled_from([0.0, 0.1]),
    ),
)
def test_teams_and_networks_of_any_kind(
    seed: int, agents: int, poses: int, landmarks: int, pairwise: bool, weather: Weather
) -> None:
    world = World(seed, weather, pairwise=pairwise, agents=agents, poses=poses, landmarks=landmarks)
    world.run()
    assert world.detector.terminated


def test_duplicates_change_nothing() -> None:
    world = World(3, Weather(twice=True))
    world.run()
    committed = [event.trade for event in world.log if isinstance(event, TradeCommitted)]
    assert committed
    assert len(set(committed)) == len(committed)


def test_the_log_tells_the_whole_story() -> None:
    kinds: set[object] = set()
    for seed in range(10):
        world = World(seed, Weather(flying=0.5, unreachable=0.3, proofs=0.3), eager=False, pairwise=seed % 2 == 0)
        partition = {node.agent: node.landmarks for node in world.nodes}
        poses = {node.agent: node.pose for node in world.nodes}
        world.run()
        for event in world.log:
            kinds.add(event.cause if isinstance(event, PoseOptimized) else type(event))
            if isinstance(event, TradeCommitted):
                partition[event.client], partition[event.server] = event.client_landmarks, event.server_landmarks
                poses[event.client], poses[event.server] = event.client_pose, event.server_pose
                assert event.after >= event.before - 1e-9
            elif isinstance(event, PoseOptimized):
                poses[event.agent] = event.pose
                assert event.after > event.before
            elif isinstance(event, WaypointAbandoned):
                assert poses[event.agent] == event.abandoned
                poses[event.agent] = event.held
        for node in world.nodes:
            assert partition[node.agent].tolist() == node.landmarks.tolist()
            assert poses[node.agent] == node.pose
    assert {Cause.PROOF, Cause.OPTIMIZER, TradeCommitted, WaypointAbandoned} <= kinds


def test_nobody_is_asked_twice_about_the_same_states() -> None:
    """Without loss, the number of meetings is bounded by the changes: each change makes one agent ask all others."""
    for seed in range(10):
        world = World(seed, FAIR)
        world.run()
        changes = sum(node.epoch for node in world.nodes)
        assert world.planner.proposals <= 2 * changes * (len(world.nodes) - 1)
