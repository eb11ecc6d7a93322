"""The in-process bus: missions on it end, and the same seed gives the same run."""

from __future__ import annotations

import numpy as np
import pytest

from covey.errors import ArgumentError
from covey.faults.table import pose_at, random_partition, random_planner
from covey.protocol import (
    Event,
    GoTo,
    LandmarkRecords,
    Node,
    Offer,
    PoseOptimized,
    Publish,
    TerminationDetector,
    TradeCommitted,
)
from covey.transports import Loopback

AGENTS, LANDMARKS = 5, 30


class Team:
    """The least that runs a mission on the bus."""

    def __init__(
        self,
        seed: int,
        *,
        hears_heartbeats: bool = False,
        delay: tuple[float, float] = (0.5e-3, 1.5e-3),
        pairwise: bool = True,
    ) -> None:
        scene, bus, *rngs = np.random.default_rng(seed).spawn(AGENTS + 2)
        self.planner = random_planner(
            scene, agents=AGENTS, poses=4, landmarks=LANDMARKS, pairwise=pairwise, eager=False
        )
        records = LandmarkRecords.initial(LANDMARKS, random_partition(scene, agents=AGENTS, landmarks=LANDMARKS))
        team = range(AGENTS)
        poses = {agent: pose_at(0) for agent in team}
        self.nodes = [Node(agent, team, records, poses, self.planner) for agent in team]
        self.bus, self.detector = Loopback(rng=bus, delay=delay), TerminationDetector(team)
        self.bus.observe(self.detector.receive)
        self.events: list[tuple[float, Event]] = []
        for node, rng in zip(self.nodes, rngs, strict=True):
            self.bus.attach(node, rng, hears_heartbeats=hears_heartbeats)
        for agent in team:
            self.act(agent, self.bus.start(agent))

    def act(self, agent: int | None, outputs: tuple[GoTo | Event, ...]) -> None:
        for output in outputs:
            if isinstance(output, GoTo):
                assert agent is not None
                self.act(agent, self.bus.apply(agent, self.nodes[agent].waypoint_reached(self.bus.now)))
            else:
                self.events.append((self.bus.now, output))

    def settle(self) -> None:
        while not self.detector.terminated:
            step = self.bus.step()
            assert step is not None, "the bus fell silent before termination was detected"
            self.act(step.agent, step.outputs)

    def score(self) -> float:
        return sum(float(self.planner.scores(node.agent, node.landmarks)[round(node.pose.x)]) for node in self.nodes)


@pytest.mark.parametrize("hears_heartbeats", [False, True])
@pytest.mark.parametrize("delay", [(0.0, 0.0), (0.5e-3, 1.5e-3), (0.0, 100.0)])
def test_a_mission_ends(hears_heartbeats: bool, delay: tuple[float, float]) -> None:
    for seed in range(5):
        team = Team(seed, hears_heartbeats=hears_heartbeats, delay=delay)
        start = team.score()
        team.settle()
        assert team.score() > start
        assert all(node.quiescent for node in team.nodes)
        owned = np.concatenate([node.claims() for node in team.nodes])
        assert sorted(owned) == list(range(LANDMARKS))
        while (step := team.bus.step()) is not None:
            assert step.outputs == ()


def test_the_same_seed_gives_the_same_run() -> None:
    def trace(seed: int) -> list[str]:
        team = Team(seed)
        team.settle()
        return [f"{now} {event}" for now, event in team.events]

    assert trace(1) == trace(1)
    assert trace(1) != trace(2)


def test_a_proof_sets_the_team_going_again() -> None:
    found = 0
    for seed in range(20):
        team = Team(seed, pairwise=False)
        team.settle()
        before = team.score()
        for node in team.nodes:
            best = int(team.planner.scores(node.agent, node.landmarks).argmax())
            outputs = node.adopt_pose(team.bus.now, pose_at(best))
            for output in outputs:
                if isinstance(output, Publish):
                    team.detector.receive(output.heartbeat)
            team.act(node.agent, team.bus.apply(node.agent, outputs))
            found += any(isinstance(output, PoseOptimized) for output in outputs)
            assert team.detector.terminated is not any(isinstance(output, PoseOptimized) for output in outputs)
            team.settle()
        assert team.score() >= before
    assert found > 0


def test_events_are_reported_when_they_happen() -> None:
    team = Team(4)
    team.settle()
    times = [now for now, _ in team.events]
    assert times == sorted(times)
    assert any(isinstance(event, TradeCommitted) for _, event in team.events)


def test_messages_overtake_each_other() -> None:
    team = Team(0)
    arrived = []
    while (step := team.bus.step()) is not None:
        team.act(step.agent, step.outputs)
        if step.received is not None and not isinstance(step.received, Offer):
            arrived.append(step.now)
    assert arrived == sorted(arrived)
    bus = Loopback(rng=np.random.default_rng(0))
    a, b = bus.endpoint(0), bus.endpoint(1)
    beats = [team.nodes[0].heartbeat() for _ in range(50)]
    for beat in beats:
        a.send(1, beat)
    while bus.step() is not None:
        pass
    got = b.receive()
    assert len(got) == 50
    assert got != beats


def test_an_agent_is_on_the_bus_once() -> None:
    team = Team(0)
    with pytest.raises(ArgumentError, match="expected one that is not on the bus yet, got 3"):
        team.bus.endpoint(3)
    with pytest.raises(ArgumentError, match="got 2"):
        team.bus.attach(team.nodes[2], np.random.default_rng(0))


@pytest.mark.parametrize("delay", [(-1.0, 1.0), (2.0, 1.0), (0.0, float("inf")), (float("nan"), 1.0)])
def test_delays_must_be_in_order(delay: tuple[float, float]) -> None:
    with pytest.raises(ArgumentError, match="delay"):
        Loopback(rng=np.random.default_rng(0), delay=delay)
