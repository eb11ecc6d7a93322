"""Notices that a link to another agent has come to lead one way only."""

from __future__ import annotations

import math

RENEW_PAUSE = 5.0
"""So many leases pass at least between two times that a session is renewed."""


class OneWayLinks:
    """Whom an agent hears although the other's liveliness token is not there.

    Parameters
    ----------
    lease : float
        After so many seconds without a word a peer is taken for lost.

    Notes
    -----
    When two peers have connected to each other, both links die and only one of the two notices before it connects
    again, the other takes the new link for one more of the old session and does not say again what it listens to
    (eclipse-zenoh/zenoh, issue 2806).  Then the first hears the other, but has no token of it and can send it nothing,
    for ever.  A new session is a new peer for all others, and begins with everything said again.

    Examples
    --------
    >>> links = OneWayLinks(lease=2.0)
    >>> for now in (0.0, 1.0, 2.0):
    ...     links.hear(1, now, token=False)
    >>> links.must_renew(2.0), links.must_renew(2.0)
    (True, False)
    """

    def __init__(self, lease: float) -> None:
        self._lease = lease
        self._heard: dict[int, tuple[float, float]] = {}
        self._not_before = -math.inf
        self._failed = False

    def hear(self, agent: int, now: float, *, token: bool) -> None:
        """Note that an agent was heard, and whether its token is there."""
        since, last = self._heard.pop(agent, (now, now))
        if not token:
            self._heard[agent] = (since if now - last <= self._lease else now), now

    def must_renew(self, now: float) -> bool:
        """Whether the session must be renewed; if so the caller does, and it begins from nothing."""
        split = self._failed or any(last - since >= self._lease for since, last in self._heard.values())
        if not split or now < self._not_before:
            return False
        self._not_before = now + RENEW_PAUSE * self._lease
        self._failed = False
        self._heard.clear()
        return True

    def try_again(self, now: float) -> None:
        """Note that the session could not be renewed: it must be a lease later."""
        self._failed = True
        self._not_before = now + self._lease
