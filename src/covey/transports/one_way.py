"""Notices that a link to another agent no longer leads both ways."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from covey.protocol import Sender

RENEW_PAUSE = 5.0
"""So many leases pass at least between two times that a session is renewed."""


@dataclass
class _Other:
    sender: Sender
    heard_at: float
    odd_since: float | None = None


class OneWayLinks:
    """Whether what is heard of the others and their liveliness tokens tell the same.

    Parameters
    ----------
    lease : float
        After so many seconds without a word a peer is taken for lost.

    Notes
    -----
    When two peers have connected to each other, both links die and only one of the two notices before it connects
    again, the other takes the new link for one more of the old session and does not say again what it listens to
    (eclipse-zenoh/zenoh, issue 2806).  Such a session stays, and carries nothing one way or both.  One of the two then
    hears the other without its token, or has its token and does not hear it any more.  A new session is a new peer for
    all others, and begins with everything said again.

    Examples
    --------
    >>> links, red = OneWayLinks(lease=2.0), Sender(1, 1)
    >>> for now in (0.0, 1.0, 2.0):
    ...     links.hear(red, now)
    ...     print(links.must_renew({}, now))
    False
    False
    True
    """

    def __init__(self, lease: float) -> None:
        self._lease = lease
        self._others: dict[int, _Other] = {}
        self._not_before = -math.inf
        self._failed = False

    def hear(self, sender: Sender, now: float) -> None:
        """Note that an agent was heard."""
        other = self._others.get(sender.agent)
        if other is None or sender.incarnation > other.sender.incarnation:
            self._others[sender.agent] = _Other(sender, now)
        elif sender == other.sender:
            other.heard_at = now

    def must_renew(self, tokens: Mapping[int, tuple[int, bool]], now: float) -> bool:
        """Whether the session must be renewed; if so the caller does, and it begins from nothing.

        Parameters
        ----------
        tokens : mapping of int to (int, bool)
            The newest life of each agent of which a token has been seen, and whether it is there.
        now : float
            Seconds; ask at least a few times a lease.
        """
        longest = -math.inf
        for agent, other in list(self._others.items()):
            life, token = tokens.get(agent, (-1, False))
            if life > other.sender.incarnation:
                del self._others[agent]  # of the new life nothing has been heard yet
                continue
            token = token and life == other.sender.incarnation
            if token == (now - other.heard_at < self._lease):
                other.odd_since = None
            elif other.odd_since is None:
                other.odd_since = now
            else:  # the last words of the dead come at once with the end of its token
                longest = max(longest, (now if token else other.heard_at) - other.odd_since)
        if now < self._not_before or not (self._failed or longest >= self._lease):
            return False
        self._not_before = now + RENEW_PAUSE * self._lease
        self._failed = False
        self._others.clear()
        return True

    def try_again(self, now: float) -> None:
        """Note that the session could not be renewed: it must be a lease later."""
        self._failed = True
        self._not_before = now + self._lease
