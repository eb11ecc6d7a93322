"""A planner that needs no optimiser: a few poses an agent, visibilities in a table."""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray

from covey.geometry import Pose2
from covey.protocol import AgentState, Catalogue, Proposal

SIGMA = 0.01


class TablePlanner:
    """Poses are ``Pose2(i, 0, 0)`` with i an index of the table.

    Parameters
    ----------
    table : array, shape (agents, poses, n)
        Visibility of each landmark.
    weights : array, shape (n,)
    pairwise : bool
        Propose the best pair of poses with the best split, instead of Algorithm 6 alone.
    eager : bool
        Whether `improve` always finds the best pose; otherwise it fails on odd numbers of landmarks.
    """

    def __init__(
        self, table: NDArray[np.float64], weights: NDArray[np.float64], *, pairwise: bool, eager: bool = True
    ) -> None:
        self.table, self.weights, self.pairwise, self.eager = table, weights, pairwise, eager
        self.sigma = SIGMA
        self.proposals = 0

    def copy(self) -> TablePlanner:
        """Return a planner that may learn other things."""
        return TablePlanner(self.table, self.weights, pairwise=self.pairwise, eager=self.eager)

    def visibility(self, agent: int, pose: Pose2) -> NDArray[np.float64]:
        """Return the row of the table."""
        visibility: NDArray[np.float64] = self.table[agent, round(pose.x)]
        return visibility

    def scores(self, agent: int, landmarks: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return the score of these landmarks from each pose, shape (poses,)."""
        scores: NDArray[np.float64] = self.table[agent][:, landmarks] @ self.weights[landmarks]
        return scores

    def improve(self, agent: int, pose: Pose2, landmarks: NDArray[np.int64]) -> Pose2 | None:
        """Return the best pose if it is better."""
        scores = self.scores(agent, landmarks)
        if scores.max() <= scores[round(pose.x)] + 1e-9 or (len(landmarks) % 2 and not self.eager):
            return None
        return pose_at(int(scores.argmax()))

    def learn(self, catalogue: Catalogue) -> None:
        """Take changed weights over; the table has all landmarks and agents that ever will be."""
        self.weights = self.weights.copy()
        for k, record in catalogue.landmarks.items():
            self.weights[k] = record.weight

    def propose(self, server: AgentState, client: AgentState) -> Proposal | None:
        """Return the best split of the best pair of poses, or Algorithm 6."""
        self.proposals += 1
        union = np.union1d(server.landmarks, client.landmarks)
        assert len(union) == len(server.landmarks) + len(client.landmarks)
        if self.pairwise:
            proposal = self._pairwise(server, client, union)
            if proposal is not None:
                return proposal
        vis_s, vis_c = self.visibility(server.agent, server.pose), self.visibility(client.agent, client.pose)
        mine = np.zeros(self.table.shape[2], dtype=bool)
        mine[server.landmarks] = True
        stays = np.where(mine, vis_s >= vis_c - self.sigma, vis_c < vis_s - self.sigma)[union]
        if np.array_equal(union[stays], server.landmarks):
            return None
        return Proposal(server.pose, client.pose, union[stays], union[~stays])

    def _pairwise(self, server: AgentState, client: AgentState, union: NDArray[np.int64]) -> Proposal | None:
        vs, vc = self.table[server.agent][:, union], self.table[client.agent][:, union]
        best, chosen = -np.inf, (0, 0)
        taken_s, taken_c = ({round(pose.x) for pose in side.avoid} for side in (server, client))
        for i, j in itertools.product(range(len(vs)), range(len(vc))):
            value = float(np.maximum(vs[i], vc[j]) @ self.weights[union])
            if value > best and i not in taken_s and j not in taken_c:
                best, chosen = value, (i, j)
        now = sum(self.scores(s.agent, s.landmarks)[round(s.pose.x)] for s in (server, client))
        if best <= now + 1e-9:
            return None
        i, j = chosen
        stays = vs[i] >= vc[j]
        return Proposal(pose_at(i), pose_at(j), union[stays], union[~stays])


def pose_at(index: int) -> Pose2:
    """Return the pose with this index in the table."""
    return Pose2(float(index), 0.0, 0.0)


def random_planner(
    rng: np.random.Generator, *, agents: int, poses: int, landmarks: int, pairwise: bool, eager: bool = True
) -> TablePlanner:
    """Draw a table in which each pose sees about half of the landmarks; some weights are zero."""
    table = rng.random((agents, poses, landmarks)) * (rng.random((agents, poses, landmarks)) < 0.5)
    weights = rng.choice([0.0, 0.5, 1.0, 2.0], size=landmarks, p=[0.1, 0.2, 0.5, 0.2])
    return TablePlanner(table, weights, pairwise=pairwise, eager=eager)


def extended(
    planner: TablePlanner, rng: np.random.Generator, *, agents: int, landmarks: int, poses: int
) -> TablePlanner:
    """Return a planner with more agents and landmarks, which begin without weight, and the same table for the rest."""
    m, _, n = planner.table.shape
    shape = (m + agents, poses, n + landmarks)
    table = rng.random(shape) * (rng.random(shape) < 0.5)
    table[:m, :, :n] = planner.table
    weights = np.concatenate([planner.weights, np.zeros(landmarks)])
    return TablePlanner(table, weights, pairwise=planner.pairwise, eager=planner.eager)


def random_partition(rng: np.random.Generator, *, agents: int, landmarks: int) -> dict[int, NDArray[np.int64]]:
    """Assign each landmark at random; an agent may get none."""
    owner = rng.integers(agents, size=landmarks)
    return {agent: np.flatnonzero(owner == agent) for agent in range(agents)}
