"""The set Q of partners that an agent still has to ask, in which order, and when."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from collections.abc import Set as AbstractSet
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from covey.errors import ArgumentError
from covey.geometry import Pose2
from covey.protocol.membership import MembershipOptions
from covey.protocol.records import PoseRecords

Order: TypeAlias = Callable[[int, PoseRecords, Sequence[int], np.random.Generator], Iterable[int]]
"""``order(agent, poses, candidates, rng)``: the candidates, the most promising partner first."""

Links: TypeAlias = Callable[[int, Pose2, int, Pose2], bool]
"""``links(agent, pose, other, other_pose)``: whether two agents at these poses may trade; symmetric."""

_DOUBLINGS = 6


def within(radius: float) -> Links:
    """Return the links of agents that are no further apart than this, metres.

    Examples
    --------
    >>> within(2.0)(0, Pose2(0.0, 0.0, 0.0), 1, Pose2(0.0, 2.0, 1.0))
    True
    """
    return lambda agent, pose, other, other_pose: math.hypot(pose.x - other_pose.x, pose.y - other_pose.y) <= radius


def between(pairs: Iterable[tuple[int, int]]) -> Links:
    """Return the links of these pairs of agents, wherever they are.

    Examples
    --------
    >>> here = Pose2(0.0, 0.0, 0.0)
    >>> between([(0, 1)])(1, here, 0, here), between([(0, 1)])(1, here, 2, here)
    (True, False)
    """
    linked = {frozenset(pair) for pair in pairs}
    return lambda agent, pose, other, other_pose: frozenset((agent, other)) in linked


def random_order(agent: int, poses: PoseRecords, candidates: Sequence[int], rng: np.random.Generator) -> Iterable[int]:
    """Ask partners in random order."""
    return [candidates[i] for i in rng.permutation(len(candidates))]


@dataclass(frozen=True)
class NodeOptions:
    """Waiting times, and when two poses are the same.

    Parameters
    ----------
    backoff : float
        After BUSY a client waits up to this long, seconds, and as long as the answer took, doubled with each failure
        in a row.
    pause : float
        Longest random wait, seconds, after a trade, and as long as it took, so that others find the agent free
        however slow the network is.
    resend_after : float
        Seconds after which a message that got no answer is sent again.
    give_up_after : float
        Seconds after which a client withdraws a request, doubled like the back-off, so that a slow network is waited
        for; never after the commit, and never a server.
    same_position, same_yaw : float
        Two poses no further apart than this, metres and radians, are the same unreachable pose.
    membership : MembershipOptions or None
        How the team survives crashes; None for a team of which nobody dies.
    prove : bool
        Whether an agent is quiescent only when its pose has been proved (`Node.pose_proved`).

    Raises
    ------
    ArgumentError
        If a time is negative, or one of the last two times is not above 0.
    """

    backoff: float = 0.01
    pause: float = 0.02
    resend_after: float = 1.0
    give_up_after: float = 10.0
    same_position: float = 0.05
    same_yaw: float = 0.05
    membership: MembershipOptions | None = None
    prove: bool = False

    def __post_init__(self) -> None:
        for name in ("backoff", "pause", "same_position", "same_yaw"):
            if not getattr(self, name) >= 0.0:
                raise ArgumentError(f"{name}: expected at least 0, got {getattr(self, name)}")
        for name in ("resend_after", "give_up_after"):
            if not getattr(self, name) > 0.0:
                raise ArgumentError(f"{name}: expected more than 0, got {getattr(self, name)}")


class Partners:
    """The set Q of one agent.

    Parameters
    ----------
    agent : int
    others : sequence of int
        The rest of the team.
    order : Order
    options : NodeOptions

    Notes
    -----
    Source: Sposato (2016), section 4.5.  Deviation: V6, V7.
    """

    def __init__(self, agent: int, others: Sequence[int], order: Order, options: NodeOptions) -> None:
        self.waiting: set[int] = set()
        self.ask_at = 0.0
        self._agent = agent
        self._others = tuple(others)
        self._order = order
        self._options = options
        self._line: list[int] = []  # who is asked next, last first
        self._failures_in_a_row = 0

    def refill(self) -> None:
        """Put all others back, after any change of the agent's own pose or landmarks."""
        self.waiting = set(self._others)
        self._line = []

    def drop(self, partner: int) -> None:
        """Take a partner out: a completed trade found nothing."""
        self.waiting.discard(partner)

    def leave(self, partner: int) -> None:
        """Take a partner out for good: it is dead."""
        self._others = tuple(other for other in self._others if other != partner)
        self.waiting.discard(partner)

    def join(self, partner: int) -> None:
        """Take a partner in again, and put all others back."""
        self._others = tuple(sorted({*self._others, partner}))
        self.refill()

    def next(self, poses: PoseRecords, rng: np.random.Generator, willing: AbstractSet[int]) -> int:
        """Return whom to ask of those that are willing; all have their turn before anyone is asked again.

        Raises
        ------
        ArgumentError
            If `order` does not return the candidates it was given.
        """
        while self._line and self._line[-1] not in willing:
            self._line.pop()
        if not self._line:
            candidates = [other for other in self._others if other in willing]
            self._line = [int(other) for other in self._order(self._agent, poses, candidates, rng)]
            if sorted(self._line) != sorted(candidates):
                raise ArgumentError(f"order: expected the candidates {candidates}, got {self._line}")
            self._line.reverse()
        return self._line.pop()

    def patience(self) -> float:
        """Return how long to wait for an answer, seconds."""
        return self._options.give_up_after * 2.0 ** min(self._failures_in_a_row, _DOUBLINGS)

    def back_off(self, now: float, took: float, rng: np.random.Generator) -> None:
        """Wait before the next request, longer with each failure in a row; `took` is how long this one took."""
        window = (self._options.backoff + took) * 2.0 ** min(self._failures_in_a_row, _DOUBLINGS)
        self._failures_in_a_row += 1
        self.ask_at = now + rng.random() * window

    def rest(self, now: float, took: float, rng: np.random.Generator) -> None:
        """Pause after a completed trade that took this long."""
        self._failures_in_a_row = 0
        self.ask_at = now + rng.random() * (self._options.pause + took)
