"""What a node asks its planner, and the rule by which both sides judge a proposal."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from covey.geometry import Pose2
from covey.protocol.catalogue import Catalogue
from covey.protocol.records import difference

MARGIN = 1e-12
"""How much better, relative to the score, better must be: rounding is never taken for a gain, so gains are finite."""


@dataclass(frozen=True, eq=False)
class AgentState:
    """One side of a meeting.

    Parameters
    ----------
    agent : int
    pose : Pose2
        The committed pose.
    landmarks : array, shape (k,)
        Sorted landmarks of the agent.
    avoid : tuple of Pose2
        Poses that the agent could not reach; a proposal must not contain them.
    """

    agent: int
    pose: Pose2
    landmarks: NDArray[np.int64]
    avoid: tuple[Pose2, ...] = ()


@dataclass(frozen=True, eq=False)
class Proposal:
    """What a server proposes: both poses and a new split of the union.

    Parameters
    ----------
    server_pose, client_pose : Pose2
    server_landmarks, client_landmarks : array, shape (k,)
        The whole new sets, sorted.
    """

    server_pose: Pose2
    client_pose: Pose2
    server_landmarks: NDArray[np.int64]
    client_landmarks: NDArray[np.int64]


class Planner(Protocol):
    """Knows the landmarks and the sensors; the node itself knows neither.

    Attributes
    ----------
    sigma : float
        The tolerance of Definition 3.
    weights : array, shape (n,)
        What each landmark is worth; those that are removed are nobody's, whatever stands here.
    """

    @property
    def sigma(self) -> float:
        """The tolerance of Definition 3."""
        ...

    @property
    def weights(self) -> NDArray[np.float64]:
        """What each landmark is worth, shape (n,)."""
        ...

    def visibility(self, agent: int, pose: Pose2) -> NDArray[np.float64]:
        """Visibility, shape (n,), of every landmark for an agent's sensor at a pose; without the weights."""
        ...

    def improve(self, agent: int, pose: Pose2, landmarks: NDArray[np.int64]) -> Pose2 | None:
        """Return a pose with a strictly better score on these landmarks (Algorithm 3), or None.  Deviation: V3."""
        ...

    def learn(self, catalogue: Catalogue) -> None:
        """Reckon with changed landmarks and agents from now on; one that is known already changes nothing.

        Then `weights` and `visibility` have at least as many landmarks as the catalogue knows.
        """
        ...

    def propose(self, server: AgentState, client: AgentState) -> Proposal | None:
        """Return a better split of the union, perhaps with better poses, or None when there is nothing to trade."""
        ...


def coverage_score(planner: Planner, agent: int, pose: Pose2, landmarks: NDArray[np.int64]) -> float:
    """Return ``sum_k w_k vis(pose, s_k)`` over these landmarks.

    Notes
    -----
    Source: Sposato (2016), eq. (4.4).
    """
    return float(planner.visibility(agent, pose).take(landmarks) @ planner.weights.take(landmarks))


def is_better(before: float, after: float) -> bool:
    """Whether a score is better by more than rounding.

    Examples
    --------
    >>> is_better(1.0, 1.0 + 1e-15), is_better(1.0, 1.0 + 1e-9)
    (False, True)
    """
    return after - before > MARGIN * max(1.0, abs(before))


@dataclass(frozen=True)
class Verdict:
    """How a proposal was judged.

    Parameters
    ----------
    accepted : bool
    before, after : float
        The joint coverage score of the two.
    """

    accepted: bool
    before: float
    after: float


def judge(planner: Planner, server: AgentState, client: AgentState, proposal: Proposal) -> Verdict:
    """Judge a proposal as both sides do: the server before it offers, the client before it commits.

    It is accepted when the sets are another split of the same union and either the joint score rises, or the poses
    stay and each landmark that moves is seen better by more than sigma by whom it goes to.  The second is what
    Definition 3 asks for, and can leave the score as it is where weights are zero.

    Notes
    -----
    Source: Sposato (2016), Algorithm 6.  Deviation: V3, V6.
    """
    old_union = np.sort(np.concatenate([server.landmarks, client.landmarks]))
    new_union = np.sort(np.concatenate([proposal.server_landmarks, proposal.client_landmarks]))
    if not np.array_equal(old_union, new_union) or (old_union[1:] == old_union[:-1]).any():
        return Verdict(False, 0.0, 0.0)
    before = coverage_score(planner, server.agent, server.pose, server.landmarks) + coverage_score(
        planner, client.agent, client.pose, client.landmarks
    )
    after = coverage_score(planner, server.agent, proposal.server_pose, proposal.server_landmarks) + coverage_score(
        planner, client.agent, proposal.client_pose, proposal.client_landmarks
    )
    accepted = is_better(before, after)
    if not accepted and proposal.server_pose == server.pose and proposal.client_pose == client.pose:
        advantage = planner.visibility(client.agent, client.pose) - planner.visibility(server.agent, server.pose)
        give = difference(server.landmarks, proposal.server_landmarks)
        want = difference(client.landmarks, proposal.client_landmarks)
        moves = len(give) + len(want) > 0
        accepted = moves and bool((advantage[give] > planner.sigma).all() and (advantage[want] < -planner.sigma).all())
    return Verdict(accepted, before, after)
