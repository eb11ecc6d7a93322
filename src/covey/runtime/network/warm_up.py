"""Loads or compiles beforehand what an agent in a process of its own needs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from covey.geometry import Pose2
from covey.mission import Mission
from covey.protocol import AgentState
from covey.runtime.agent import build_planner
from covey.runtime.network.prover import Prover
from covey.runtime.network.remote_vehicle import build_vehicle


def warm_up(mission: Mission, agent: int, vehicles: str = "none") -> None:
    """Load or compile all that planning and flying need, so that an agent does not fall silent for it in the mission.

    Parameters
    ----------
    mission : Mission
    agent : int
    vehicles : str
        As for `build_vehicle`.
    """
    coverage = mission.coverage
    few = np.linspace(0, len(mission.landmarks) - 1, min(len(mission.landmarks), 32)).astype(np.int64)
    landmarks = mission.landmarks.subset(np.unique(few))
    small = replace(mission, landmarks=landmarks, coverage=replace(coverage, assignment={}))
    planner = build_planner(small)
    own = np.arange(len(landmarks))
    pose = mission.agents[agent].pose
    planner.improve(agent, pose, own)
    half = len(own) // 2
    other = (agent + 1) % len(mission.agents)
    if other != agent:
        planner.propose(AgentState(agent, pose, own[:half]), AgentState(other, mission.agents[other].pose, own[half:]))
    prover = Prover(small, agent, planner)
    prover.begin(0, pose, own)
    prover.result()
    prover.close()
    vehicle = build_vehicle(mission, agent, vehicles, pose, 0.0)
    x, _, y, _ = mission.agents[agent].region.bounds
    vehicle.go_to(0.0, Pose2(x, y, 0.0))
    vehicle.advance(1.0)
