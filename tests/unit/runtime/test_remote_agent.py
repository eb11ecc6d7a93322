"""Agents that plan over Zenoh, in real time: the outcome is that of a team on the bus, whatever the order of trades."""

from __future__ import annotations

import subprocess
import sys
import textwrap
from contextlib import ExitStack, closing
from pathlib import Path

import numpy as np
import pytest
from tests.net import connect_team, free_endpoint
from tests.unit.runtime.small import small

from covey.errors import ArgumentError
from covey.mission import Mission, load_mission
from covey.protocol import AgentState, Event, Node, Sender, TradeCommitted
from covey.runtime.agent import TeamPlanner, build_models
from covey.runtime.remote_agent import RemoteAgent, join_mission, mission_codec
from covey.runtime.streams import Stream, generator
from covey.runtime.team import initial_owners
from covey.transports.network import NetworkOptions
from covey.transports.zenoh import ZenohObserver, ZenohTransport

AGENTS = 2


@pytest.fixture
def mission() -> Mission:
    return small(agents={"count": AGENTS})


def planner_of(mission: Mission) -> TeamPlanner:
    return TeamPlanner(
        mission,
        build_models(mission),
        trade=mission.coverage.trade,
        optimizer=mission.coverage.optimizer,
        seed=mission.seed,
    )


def score(planner: TeamPlanner, nodes: list[Node]) -> float:
    return sum(
        float(planner.visibility(node.agent, node.pose)[node.landmarks] @ planner.weights[node.landmarks])
        for node in nodes
    )


def test_two_agents_plan_a_mission(mission: Mission) -> None:
    events: list[Event] = []
    with ExitStack() as stack:
        meeting_point = free_endpoint()
        transports = connect_team(range(AGENTS), mission_codec(mission), meeting_point)
        for transport in transports:
            stack.callback(transport.close)
        agents = [join_mission(mission, transport.agent, transport, on_event=events.append) for transport in transports]
        for agent in agents:
            agent.start()
        while not all(agent.over for agent in agents):
            for agent in agents:
                agent.step(0.01)
    nodes = [agent.node for agent in agents]
    assert all(node.quiescent and node.escrow is None for node in nodes)
    owned = np.concatenate([node.landmarks for node in nodes])
    assert np.sort(owned).tolist() == list(range(len(mission.landmarks)))
    assert len([event for event in events if isinstance(event, TradeCommitted)]) >= 1
    assert [transport.dropped for transport in transports] == [{}, {}]

    planner = planner_of(mission)
    states = [AgentState(node.agent, node.pose, node.landmarks) for node in nodes]
    assert planner.propose(*states) is None
    assert all(planner.improve(state.agent, state.pose, state.landmarks) is None for state in states)
    owner = initial_owners(mission, mission.seed)
    first = sum(
        float(planner.visibility(agent, mission.agents[agent].pose)[owner == agent] @ planner.weights[owner == agent])
        for agent in range(AGENTS)
    )
    assert score(planner, nodes) > first


CHILD = """
    import sys
    from covey.mission import load_mission
    from covey.protocol import Sender
    from covey.runtime.remote_agent import join_mission, mission_codec
    from covey.transports.network import NetworkOptions
    from covey.transports.zenoh import ZenohTransport

    mission = load_mission(sys.argv[1])
    agent, connect = int(sys.argv[2]), sys.argv[3]
    transport = ZenohTransport(Sender(agent, 1), mission_codec(mission), NetworkOptions(connect=(connect,)))
    over = join_mission(mission, agent, transport, on_event=transport.log).run(timeout=120.0)
    transport.close()
    sys.exit(not over)
"""


def test_agents_in_processes_of_their_own_plan_the_thesis_mission(root: Path) -> None:
    path = root / "examples" / "thesis-5.1.yaml"
    mission = load_mission(path)
    codec = mission_codec(mission)
    meeting_point = free_endpoint()
    program = [sys.executable, "-W", "error", "-c", textwrap.dedent(CHILD), str(path)]
    with ExitStack() as stack:
        transport = stack.enter_context(
            closing(ZenohTransport(Sender(0, 1), codec, NetworkOptions(listen=(meeting_point,))))
        )
        observer = stack.enter_context(closing(ZenohObserver(codec, NetworkOptions(connect=(meeting_point,)))))
        children = [
            stack.enter_context(subprocess.Popen([*program, str(agent), meeting_point]))
            for agent in range(1, len(mission.agents))
        ]
        assert join_mission(mission, 0, transport, on_event=transport.log).run(timeout=120.0)
        assert [child.wait(120.0) for child in children] == [0] * len(children)
        heard = observer.receive()
    trades = [event for event in heard if isinstance(event, TradeCommitted)]
    assert trades
    newest = {}
    for trade in trades:
        newest[trade.client] = newest[trade.server] = trade
    assert set(newest) == set(range(len(mission.agents)))
    assert transport.dropped == {}


def test_the_transport_must_be_the_agents_own(mission: Mission) -> None:
    with closing(ZenohTransport(Sender(1, 1), mission_codec(mission), NetworkOptions())) as transport:
        agent = join_mission(mission, 1, transport)
        assert not agent.over
        assert not agent.run(timeout=0.0)
        with pytest.raises(ArgumentError, match="transport"):
            join_mission(mission, 0, transport)
        with pytest.raises(ArgumentError, match="heartbeat_every"):
            RemoteAgent(agent.node, range(AGENTS), transport, rng=generator(1, Stream.NODE, 1), heartbeat_every=0.0)
