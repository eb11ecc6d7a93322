"""What the agents of a mission think with: sensors, regions, optimisers and the rule of trade, a node's `Planner`."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from covey.coverage import transfer
from covey.environment import Landmarks
from covey.environment.lattice import find_lattice
from covey.errors import InputError
from covey.geometry import Pose2, Region
from covey.mission import AgentSpec, Mission, OptimizerName, SensorSpec, Trade, read_agent
from covey.optimize import (
    DifferentialEvolution,
    Exact,
    PairProblem,
    PairSearch,
    PoseOptimizer,
    PoseProblem,
    Search,
)
from covey.protocol import (
    EMPTY,
    AgentState,
    Catalogue,
    LandmarkChange,
    PoseRecords,
    Proposal,
    coverage_score,
)
from covey.runtime.airspace import Airspace
from covey.runtime.streams import Stream, generator
from covey.sensing import VisibilityModel, build_model, is_compiled

LEAST_GAIN = 0.1
"""What a new pose or a joint re-optimisation must gain, in units of sigma, to be worth a flight."""

FEW, FAR = 24, 2.0
"""In a team of more than FEW, two agents whose landmarks lie further apart than FAR optimal distances only compare what
they see: that saves most of the time, and costs much only where few landmarks lie scattered.
"""

BLIND = SensorSpec("blind", {})
"""Of an agent that sees nothing."""

PROBES = 8
PROBED_LANDMARKS = 200
"""At how many poses, and on how many landmarks at most, a user's model is tried out."""


def build_optimizer(name: OptimizerName) -> PoseOptimizer:
    """Build the pose optimiser that a mission names."""
    optimizers: dict[OptimizerName, PoseOptimizer] = {
        OptimizerName.SEARCH: Search(),
        OptimizerName.EXACT: Exact(),
        OptimizerName.DIFFERENTIAL_EVOLUTION: DifferentialEvolution(),
    }
    return optimizers[name]


def build_models(mission: Mission) -> tuple[VisibilityModel, ...]:
    """Build each agent's sensor; agents with the same specification share one.

    Raises
    ------
    InputError
        If a sensor cannot be built, needs normals that the landmarks do not have, or gives nonsense at a few poses.
    """
    folder = mission.path.parent if mission.path is not None else None
    built: list[tuple[object, VisibilityModel]] = []
    models = []
    for agent in mission.agents:
        for specification, known in built:
            if specification == agent.sensor:
                models.append(known)
                break
        else:
            model = build_model(agent.sensor.model, agent.sensor.options, folder=folder)
            if model.needs_normals and mission.landmarks.normals_W is None:
                raise InputError(f"sensor model {agent.sensor.model!r}: expected landmarks with normals, got none")
            if not is_compiled(model):
                _probe(model, agent.region, mission.landmarks)
            built.append((agent.sensor, model))
            models.append(model)
    return tuple(models)


def _probe(model: VisibilityModel, region: Region, landmarks: Landmarks) -> None:
    """Ask a user's model, which checks its answers, at a few poses: a fault shows before planning begins."""
    positions = region.sample(PROBES, rng=np.random.default_rng(0))
    yaws = np.linspace(-np.pi, np.pi, PROBES, endpoint=False)
    n = len(landmarks)
    chosen = np.linspace(0, n - 1, min(n, PROBED_LANDMARKS)).astype(np.int64)
    model.visibility(np.column_stack([positions, yaws]), landmarks.subset(chosen))


class TeamPlanner:
    """Implements `covey.protocol.Planner` for the agents of a mission.

    Parameters
    ----------
    mission : Mission
    models : sequence of VisibilityModel
        Each agent's sensor.
    trade : Trade
        The rule of trade.
    optimizer : OptimizerName
        What solves pose problems (Algorithm 3).
    seed : int
        Root of all randomness.
    """

    def __init__(
        self,
        mission: Mission,
        models: Sequence[VisibilityModel],
        *,
        trade: Trade,
        optimizer: OptimizerName,
        seed: int,
    ) -> None:
        self.sigma = mission.coverage.sigma
        self.landmarks: Landmarks = mission.landmarks
        self.weights: NDArray[np.float64] = mission.landmarks.weights
        self.models = list(models)
        self.regions: list[Region] = [agent.region for agent in mission.agents]
        self.optimizer = build_optimizer(optimizer)
        self.optimizations = 0
        self.agents = list(mission.agents)
        self.catalogue = EMPTY
        """All that has changed since the mission began."""
        self.alive: NDArray[np.bool_] = np.ones(len(mission.landmarks), dtype=np.bool_)
        """Which landmarks are to be seen, shape (n,)."""
        self._mission, self._seed = mission, seed
        self._began_with = (len(mission.landmarks), len(mission.agents))
        self.airspace: Airspace | None = None
        """Set by the team if agents share layers: the regions are then narrowed to what is free at the moment."""
        self._trade = trade
        self._rngs = [generator(seed, Stream.PLANNER, agent) for agent in range(len(mission.agents))]
        self._pair = PairSearch()
        self._seen: list[dict[Pose2, NDArray[np.float64]]] = [{} for _ in mission.agents]

    def learn(self, catalogue: Catalogue) -> None:
        """Reckon with changed landmarks and agents from now on; one that is known already changes nothing.

        Raises
        ------
        InputError
            If it describes an agent that cannot be built; nothing is learned then.
        """
        merged = self.catalogue.merged(catalogue)
        if merged is self.catalogue:
            return
        joined: list[tuple[int, AgentSpec, VisibilityModel]] = []
        for agent, record in sorted(merged.agents.items()):
            known = self.catalogue.agents.get(agent)
            if agent >= self._began_with[1] and record != known and record.specification:
                specification = read_agent(self._mission, agent, record.specification)
                (model,) = build_models(replace(self._mission, agents=(specification,)))
                joined.append((agent, specification, model))
        self._make_room(max(merged.agents, default=-1) + 1)
        for agent, specification, model in joined:
            self.agents[agent], self.regions[agent] = specification, specification.region
            self.replace_model(agent, model)
        if merged.landmarks is not self.catalogue.landmarks:
            self._relist(merged)
        self.catalogue = merged

    def landmark(self, k: int) -> LandmarkChange:
        """Return what is known of a landmark, as a change that changes nothing."""
        if k in self.catalogue.landmarks:
            return self.catalogue.landmarks[k]
        x, y = self.landmarks.positions_W[k].tolist()
        normal = (0.0, 0.0) if self.landmarks.normals_W is None else self.landmarks.normals_W[k].tolist()
        return LandmarkChange(0, bool(self.alive[k]), float(self.weights[k]), x, y, *normal)

    def _make_room(self, agents: int) -> None:
        """Reckon with so many agents; their numbers are given in order, but may become known in another."""
        while len(self.models) < agents:
            number = len(self.models)
            self.models.append(build_model("blind", {}))
            self.regions.append(self._mission.region)
            self.agents.append(AgentSpec(f"agent {number}", Pose2(0.0, 0.0, 0.0), BLIND, self._mission.region))
            self._rngs.append(generator(self._seed, Stream.PLANNER, number))
            self._seen.append({})

    def _relist(self, catalogue: Catalogue) -> None:
        """List the landmarks anew, those that are removed without weight."""
        n = max(len(self.landmarks), max(catalogue.landmarks) + 1)
        more = n - len(self.landmarks)
        positions = np.concatenate([self.landmarks.positions_W, np.zeros((more, 2))])
        weights = np.concatenate([self.weights, np.zeros(more)])
        normals = self.landmarks.normals_W
        if normals is not None:
            normals = np.concatenate([normals, np.tile([1.0, 0.0], (more, 1))])
        for k, record in catalogue.landmarks.items():
            positions[k], weights[k] = (record.x, record.y), record.weight if record.alive else 0.0
            if normals is not None and (record.normal_x or record.normal_y):
                normals[k] = record.normal_x, record.normal_y
        self.landmarks = Landmarks(positions, weights, normals, self.landmarks.cell_size)
        if find_lattice(self.landmarks) is None:  # hardly any of them are cells any more
            self.landmarks = replace(self.landmarks, cell_size=None)
        self.weights = self.landmarks.weights
        self.alive = catalogue.alive(self._began_with[0], n)
        for seen in self._seen:
            seen.clear()

    def restrict(self, agent: int, region: Region) -> None:
        """From now on offer an agent only positions in this region."""
        self.regions[agent] = region

    def replace_model(self, agent: int, model: VisibilityModel) -> None:
        """Give an agent another sensor."""
        self.models[agent] = model
        self._seen[agent].clear()

    def visibility(self, agent: int, pose: Pose2) -> NDArray[np.float64]:
        """Visibility of every landmark for an agent at a pose, shape (n,); the last few answers are kept."""
        seen = self._seen[agent]
        row = seen.get(pose)
        if row is None:
            row = self.models[agent].visibility(pose.as_array()[None, :], self.landmarks)[0]
            if len(seen) >= 4:
                del seen[next(iter(seen))]
            seen[pose] = row
        return row

    def improve(self, agent: int, pose: Pose2, landmarks: NDArray[np.int64]) -> Pose2 | None:
        """Return a pose that is better by more than `LEAST_GAIN`, or None (Algorithm 3).  Deviation: V3."""
        if self._is_blind(agent):
            return None
        self.optimizations += 1
        problem = PoseProblem(self.models[agent], self.landmarks.subset(landmarks), self._room(agent))
        result = self.optimizer.maximize(problem, start=pose, tolerance=0.5 * self.sigma, rng=self._rngs[agent])
        before = coverage_score(self, agent, pose, landmarks)
        return result.pose if result.score > before + LEAST_GAIN * self.sigma else None

    def propose(self, server: AgentState, client: AgentState) -> Proposal | None:
        """Return the trade that the mission's rule finds, or None."""
        if self._trade is Trade.PAIRWISE:
            proposal = self._reoptimise(server, client)
            if proposal is not None:
                return proposal
        return self._transfer(server, client)

    def _transfer(self, server: AgentState, client: AgentState) -> Proposal | None:
        """Algorithm 6: poses stay."""
        mine, yours = transfer(
            self.visibility(server.agent, server.pose),
            self.visibility(client.agent, client.pose),
            server.landmarks,
            client.landmarks,
            self.sigma,
        )
        if np.array_equal(mine, server.landmarks):
            return None
        return Proposal(server.pose, client.pose, mine, yours)

    def _reoptimise(self, server: AgentState, client: AgentState) -> Proposal | None:
        """Both poses and the split of the union together."""
        union = np.concatenate([server.landmarks, client.landmarks])
        union.sort()
        blind = self._is_blind(server.agent) or self._is_blind(client.agent)
        if not len(union) or blind or self._apart(server, client):
            return None
        models = (self.models[server.agent], self.models[client.agent])
        problem = PairProblem(
            models,
            self._rooms(server.agent, client.agent),
            (server.pose, client.pose),
            self.landmarks.subset(union),
            0.0 if self.airspace is None else self.airspace.clear(server.agent, client.agent),
        )
        before = sum(coverage_score(self, state.agent, state.pose, state.landmarks) for state in (server, client))
        poses, score = self._pair.maximize(problem, rng=self._rngs[server.agent])
        if score <= before + LEAST_GAIN * self.sigma:
            return None
        seen = problem.visibility(poses)
        mine = seen[0] > seen[1]
        tie = seen[0] == seen[1]
        if tie.any():
            mine = np.where(tie, np.isin(union, server.landmarks, assume_unique=True), mine)
        return Proposal(poses[0], poses[1], union[mine], union[~mine])

    def _room(self, agent: int, beside: int | None = None) -> Region:
        """Return where an agent may be now, in its region and airspace; a partner `beside` it is not looked at."""
        region = self.regions[agent]
        return region if self.airspace is None else self.airspace.room(agent, region, beside=beside)

    def _rooms(self, first: int, second: int) -> tuple[Region, Region]:
        """Return where each of two agents that move together may be, apart from what they keep between them."""
        room = self._room(first, second)
        if self.regions[first] is self.regions[second] and (
            self.airspace is None or self.airspace.clear(first, second)
        ):
            return room, room  # one and the same, which spares half of the work
        return room, self._room(second, first)

    def _is_blind(self, agent: int) -> bool:
        return self.models[agent].maximum == 0.0

    def _apart(self, server: AgentState, client: AgentState) -> bool:
        """Whether the landmarks of the two lie so far apart that sharing them anew is seldom worth its time."""
        if len(self.models) <= FEW or not (len(server.landmarks) and len(client.landmarks)):
            return False
        first = self.landmarks.positions_W[server.landmarks]
        second = self.landmarks.positions_W[client.landmarks]
        gap = np.maximum(first.min(axis=0) - second.max(axis=0), second.min(axis=0) - first.max(axis=0))
        unit = max(getattr(self.models[state.agent], "optimal_distance", np.inf) for state in (server, client))
        return bool(np.hypot(*np.maximum(0.0, gap)) > FAR * unit)


def build_planner(mission: Mission) -> TeamPlanner:
    """Return what the agents of a mission think with.

    Raises
    ------
    InputError
        If a sensor cannot be built.
    """
    coverage = mission.coverage
    return TeamPlanner(
        mission, build_models(mission), trade=coverage.trade, optimizer=coverage.optimizer, seed=mission.seed
    )


def nearest_first(agent: int, poses: PoseRecords, candidates: Sequence[int], rng: np.random.Generator) -> Iterable[int]:
    """Ask the partners whose poses are nearest first: they have most to trade."""
    own = poses.pose(agent)

    def away(other: int) -> float:
        if other not in poses:
            return math.inf
        pose = poses.pose(other)
        return math.hypot(pose.x - own.x, pose.y - own.y)

    return sorted(candidates, key=away)
