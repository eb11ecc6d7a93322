"""Who lives: lives and silences of the others, told apart by times that come in from outside."""

from __future__ import annotations

import enum
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from covey.errors import ArgumentError
from covey.protocol.messages import Sender

SUSPECT_AFTER = 0.5
"""Part of `MembershipOptions.dead_after` after which an agent that is silent is suspect."""


class Adopt(enum.Enum):
    """Who may declare others dead, and so adopt their landmarks."""

    ALL = "all"
    """Everyone: in a partition each side watches everything, and the heal decides."""
    MAJORITY = "majority"
    """Only an agent that hears more than half of the team, itself counted."""


class Status(enum.Enum):
    """What an agent thinks of another."""

    ALIVE = "alive"
    SUSPECT = "suspect"
    """Silent for a while, or its connection is lost: it is not asked, and nothing else changes."""
    DEAD = "dead"
    """Silent for too long: its landmarks are adopted."""


class Hearing(enum.Enum):
    """What a message says about the life of its sender."""

    OLD = "old"
    """It comes from a life that is over."""
    KNOWN = "known"
    MET = "met"
    """It is the first from its sender."""
    RETURNED = "returned"
    """The sender had been declared dead."""
    REBORN = "reborn"
    """The sender is in a newer life."""


@dataclass(frozen=True)
class MembershipOptions:
    """When an agent speaks, and when silence is death.

    Parameters
    ----------
    heartbeat_every : float
        Seconds between heartbeats.
    dead_after : float
        Seconds of silence after which an agent is declared dead; at least three heartbeats, and no less than the
        transport needs to notice a lost connection.
    map_every : float
        Seconds between maps that go to a random agent.
    adopt : Adopt

    Raises
    ------
    ArgumentError
        If a time is not above 0, or `dead_after` is below three heartbeats.
    """

    heartbeat_every: float = 1.0
    dead_after: float = 10.0
    map_every: float = 1.0
    adopt: Adopt = Adopt.ALL

    def __post_init__(self) -> None:
        for name in ("heartbeat_every", "map_every"):
            if not 0.0 < getattr(self, name) < math.inf:
                raise ArgumentError(f"{name}: expected more than 0, got {getattr(self, name)}")
        if not 3.0 * self.heartbeat_every <= self.dead_after < math.inf:
            raise ArgumentError(
                f"dead_after: expected at least three heartbeats, {3.0 * self.heartbeat_every}, got {self.dead_after}"
            )


class Membership:
    """What one agent knows about the lives of the others.

    Parameters
    ----------
    sender : Sender
        This life of this agent.
    others : iterable of int
        The rest of the team.
    options : MembershipOptions

    Examples
    --------
    >>> options = MembershipOptions(heartbeat_every=1.0, dead_after=4.0)
    >>> membership = Membership(Sender(0, 1), [1, 2], options)
    >>> membership.start(0.0)
    >>> membership.hear(3.0, Sender(1, 1)).value, membership.silenced(4.5)
    ('met', [2])
    >>> membership.status(1).value, membership.status(2).value, membership.hear(6.0, Sender(2, 1)).value
    ('alive', 'dead', 'returned')
    """

    def __init__(self, sender: Sender, others: Iterable[int], options: MembershipOptions) -> None:
        self.options = options
        self.changes = 0
        """How often somebody died, returned or began a new life."""
        self._sender = sender
        self._heard = dict.fromkeys(others, 0.0)
        self._lives = dict.fromkeys(self._heard, 0)
        self._status = dict.fromkeys(self._heard, Status.ALIVE)

    @property
    def living(self) -> Mapping[int, int]:
        """The newest known incarnation of each agent that is not dead, this one among them; sorted by agent."""
        lives = {a: self._lives[a] for a, status in self._status.items() if status is not Status.DEAD}
        return dict(sorted({**lives, self._sender.agent: self._sender.incarnation}.items()))

    def status(self, agent: int) -> Status:
        """Return what is thought of another agent."""
        return self._status.get(agent, Status.DEAD)

    def start(self, now: float) -> None:
        """Begin to count silences."""
        self._heard = dict.fromkeys(self._heard, now)

    def hear(self, now: float, sender: Sender) -> Hearing:
        """Note a message from an agent of the team; strangers count as old lives."""
        agent, incarnation = sender
        if incarnation < self._lives.get(agent, math.inf) or agent not in self._status:
            return Hearing.OLD
        was, life = self._status[agent], self._lives[agent]
        self._heard[agent], self._lives[agent], self._status[agent] = now, incarnation, Status.ALIVE
        self.changes += incarnation > life or was is Status.DEAD
        if incarnation > life > 0:
            return Hearing.REBORN
        if was is Status.DEAD:
            return Hearing.RETURNED
        return Hearing.KNOWN if life else Hearing.MET

    def lost(self, agent: int) -> None:
        """Suspect an agent: the transport has lost its connection."""
        if self._status.get(agent) is Status.ALIVE:
            self._status[agent] = Status.SUSPECT

    def join(self, now: float, agent: int) -> None:
        """Take a new agent in; it counts as dead until it is heard."""
        if agent not in self._status:
            self._heard[agent], self._status[agent] = now, Status.DEAD
            self._lives.setdefault(agent, 0)

    def leave(self, agent: int) -> None:
        """Let an agent go for good; what it says from now on counts as old."""
        if agent in self._status:
            del self._heard[agent], self._status[agent]
            self.changes += 1

    def bury(self, agent: int) -> bool:
        """Declare an agent dead; whether that is news."""
        if self.status(agent) is Status.DEAD:
            return False
        self._status[agent] = Status.DEAD
        self.changes += 1
        return True

    def silenced(self, now: float) -> list[int]:
        """Return who is newly dead, and suspect those who have been silent for half as long."""
        silent = {a for a, at in self._heard.items() if now >= at + self.options.dead_after}
        for agent, at in self._heard.items():
            if now >= at + SUSPECT_AFTER * self.options.dead_after:
                self.lost(agent)
        if self.options.adopt is Adopt.MAJORITY and 2 * (len(self._heard) + 1 - len(silent)) <= len(self._heard) + 1:
            return []
        return [agent for agent in sorted(silent) if self.bury(agent)]
