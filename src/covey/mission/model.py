"""A mission: what is to be seen, by whom, from where, and how the team goes about it."""

from __future__ import annotations

import enum
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from covey.environment import GeoReference, Landmarks
from covey.geometry import Pose2, Region
from covey.mission.flight import FlightSpec, Separation

_POSE_STREAM = 1
"""Spawn key that keeps the numbers drawn for poses apart from all others of the mission's seed."""

DRAWS = 500
"""How often a pose is drawn at most until it lies far enough from the others."""


class Trade(enum.Enum):
    """What two agents do when they meet."""

    THESIS = "thesis"
    """The client hands over the landmarks that the server sees better (Algorithm 6), then both move."""
    PAIRWISE = "pairwise"
    """Both poses and the split of the union are optimised together."""


class OptimizerName(enum.Enum):
    """Which optimiser looks for poses."""

    SEARCH = "search"
    EXACT = "exact"
    DIFFERENTIAL_EVOLUTION = "differential-evolution"


class Assignment(enum.Enum):
    """Who owns which landmarks at the start."""

    RANDOM = "random"
    """Each landmark goes to an agent drawn at random (Algorithm 2)."""
    NEAREST = "nearest"
    """Each landmark goes to the agent whose pose is nearest."""


@dataclass(frozen=True)
class SensorSpec:
    """Which visibility model a camera has.

    Parameters
    ----------
    model : str
        ``"anisotropic"``, ``"isotropic"``, ``"oriented"``, or a user's own: ``"package.module:Class"`` or
        ``"/absolute/path/file.py:Class"``.
    options : mapping of str to float
        Keyword arguments of the model, SI units, for example ``{"optimal_distance": 1.0}``.
    """

    model: str = "anisotropic"
    options: Mapping[str, float] = field(default_factory=lambda: {"optimal_distance": 1.0})


@dataclass(frozen=True)
class AgentSpec:
    """One agent, the mission's defaults filled in.

    Parameters
    ----------
    name : str
    pose : Pose2
        Where it starts, inside its region.
    sensor : SensorSpec
    region : Region
        Where its position may be.
    drawn : bool
        Whether the pose was drawn from the mission's seed because the file gives none.
    """

    name: str
    pose: Pose2
    sensor: SensorSpec
    region: Region
    drawn: bool = False


@dataclass(frozen=True)
class CoverageSpec:
    """How the team trades.

    Parameters
    ----------
    sigma : float
        Tolerance of the equilibrium, in units of the score, above 0.
    trade : Trade
    optimizer : OptimizerName
    assignment : Assignment or mapping of str to tuple of int
        The rule, or by an agent's name the indices of its landmarks; then each landmark has one owner.

    Notes
    -----
    Source: Sposato (2016), Definition 3 (sigma), Algorithm 2 (assignment).  Deviation: V3.
    """

    sigma: float = 0.01
    trade: Trade = Trade.PAIRWISE
    optimizer: OptimizerName = OptimizerName.SEARCH
    assignment: Assignment | Mapping[str, tuple[int, ...]] = Assignment.RANDOM


@dataclass(frozen=True)
class Mission:
    """All that planning needs to know; build one with `load_mission` or `parse_mission`.

    Parameters
    ----------
    schema_version : int
        Version of the file format.
    name : str
    seed : int
        Root of all randomness of the mission.
    landmarks : Landmarks
    region : Region
        Omega, of every agent without a region of its own.
    sensor : SensorSpec
        Of every agent without a sensor of its own.
    agents : tuple of AgentSpec
    coverage : CoverageSpec
    flight : FlightSpec
        How it is flown.
    separation : Separation or None
        Which agents keep apart because they share an altitude; None if nobody has to.
    georeference : GeoReference or None
        Where on earth the frame W is.
    source : mapping
        The file as plain data, for the record.
    path : Path or None
        The file.
    """

    schema_version: int
    name: str
    seed: int
    landmarks: Landmarks
    region: Region
    sensor: SensorSpec
    agents: tuple[AgentSpec, ...]
    coverage: CoverageSpec
    flight: FlightSpec = field(default_factory=FlightSpec)
    separation: Separation | None = None
    georeference: GeoReference | None = None
    source: Mapping[str, Any] = field(default_factory=dict, repr=False)
    path: Path | None = None

    def with_seed(self, seed: int) -> Mission:
        """Return the mission with another seed, the poses that were drawn being drawn anew.

        ``dataclasses.replace(mission, seed=...)`` changes the seed and keeps the poses.
        """
        return replace(self, seed=seed, agents=draw_poses(self.agents, seed=seed, spacing=self.flight.start_spacing))


def draw_poses(agents: Sequence[AgentSpec], *, seed: int, spacing: float = 0.0) -> tuple[AgentSpec, ...]:
    """Draw the initial poses that a mission leaves open.

    A position nearer than `spacing` metres to that of an agent before it, or to one that the mission gives, is drawn
    again, `DRAWS` times at most.
    """
    taken = [agent.pose for agent in agents if not agent.drawn]
    result = []
    for index, agent in enumerate(agents):
        if agent.drawn:
            pose = draw_pose(agent.region, seed=seed, index=index)
            draw = 1
            while draw < DRAWS and any(math.dist((pose.x, pose.y), (other.x, other.y)) < spacing for other in taken):
                pose = draw_pose(agent.region, seed=seed, index=index, draw=draw)
                draw += 1
            taken.append(pose)
            agent = replace(agent, pose=pose)
        result.append(agent)
    return tuple(result)


def draw_pose(region: Region, *, seed: int, index: int, draw: int = 0) -> Pose2:
    """Draw the initial pose of agent `index`: position uniform in its region, yaw uniform; `draw` numbers the tries.

    Each agent has a stream of its own, so that another agent more or less moves no one else.
    """
    rng = np.random.default_rng(
        np.random.SeedSequence(seed, spawn_key=(_POSE_STREAM, index, *([draw] if draw else [])))
    )
    x, y = region.sample(1, rng=rng)[0]
    return Pose2(float(x), float(y), float(rng.uniform(-math.pi, math.pi)))
