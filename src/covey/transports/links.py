"""Who is there, by liveliness tokens and by what is heard, and whether the two tell the same."""

from __future__ import annotations

import math
import threading
from dataclasses import dataclass

from covey.protocol import Sender

RENEW_PAUSE = 5.0
"""So many leases pass at least between two times that a session is renewed."""

LONGEST_PAUSE = 32.0
"""So many times that long at most, when renewing does not help."""


@dataclass
class _Voice:
    sender: Sender
    heard_at: float
    odd_since: float | None = None


class Links:
    """The others on a network; every method may be called from any thread.

    Parameters
    ----------
    lease : float
        After so many seconds without a word a peer is taken for lost, and its token with it.
    silence : float
        Who takes part is heard more often than this, seconds.

    Notes
    -----
    When two peers have connected to each other, both links die and only one of the two notices before it connects
    again, the other takes the new link for one more of the old session and does not say again what it listens to
    (eclipse-zenoh/zenoh, issue 2806).  Such a session stays, and carries nothing one way or both.  One of the two then
    hears the other without its token, or has its token and does not hear it any more.  A new session is a new peer for
    all others, and begins with everything said again.

    Examples
    --------
    >>> links, red = Links(lease=2.0, silence=3.0), Sender(1, 1)
    >>> for now in (0.0, 1.0, 2.0):
    ...     links.hear(red, now)
    ...     print(links.must_renew(now))
    False
    False
    True
    """

    def __init__(self, lease: float, silence: float) -> None:
        self._lease, self._silence = lease, silence
        self._lock = threading.Lock()
        self._tokens: dict[int, tuple[int, bool]] = {}  # by agent: its newest life, and whether its token is there
        self._voices: dict[int, _Voice] = {}
        self._pause = RENEW_PAUSE * lease
        self._renewed_at = -math.inf
        self._not_before = -math.inf
        self._failed = False

    @property
    def peers(self) -> frozenset[Sender]:
        """The others whose tokens are there, each in its newest life."""
        return self._with_token(present=True)

    @property
    def suspects(self) -> frozenset[Sender]:
        """The others whose tokens were there and are lost."""
        return self._with_token(present=False)

    def see(self, sender: Sender, *, present: bool) -> None:
        """Note that the token of an agent's life has come or gone."""
        with self._lock:
            if sender.incarnation >= self._tokens.get(sender.agent, (-1, False))[0]:
                self._tokens[sender.agent] = sender.incarnation, present

    def hear(self, sender: Sender, now: float) -> None:
        """Note that an agent was heard."""
        with self._lock:
            voice = self._voices.get(sender.agent)
            if voice is None or sender.incarnation > voice.sender.incarnation:
                self._voices[sender.agent] = _Voice(sender, now)
            elif sender == voice.sender:
                voice.heard_at = now

    def must_renew(self, now: float) -> bool:
        """Whether the session must be renewed; if so the caller does, and all that is known here is forgotten.

        Ask at least a few times a lease.
        """
        with self._lock:
            odd = max((self._odd_for(agent, now) for agent in list(self._voices)), default=0.0)
            if now < self._not_before or not (self._failed or odd >= self._lease):
                return False
            helped = now - self._renewed_at > 2.0 * self._pause
            self._pause = RENEW_PAUSE * self._lease if helped else min(2.0 * self._pause, self._longest_pause)
            self._renewed_at, self._not_before = now, now + self._pause
            self._failed = False
            self._voices.clear()
            self._tokens.clear()
            return True

    def try_again(self, now: float) -> None:
        """Note that the session could not be renewed: it must be a lease later."""
        with self._lock:
            self._failed = True
            self._not_before = now + self._lease

    @property
    def _longest_pause(self) -> float:
        return LONGEST_PAUSE * RENEW_PAUSE * self._lease

    def _odd_for(self, agent: int, now: float) -> float:
        """Return for how long an agent's token and its voice have not gone together, seconds."""
        voice = self._voices[agent]
        life, token = self._tokens.get(agent, (-1, False))
        if life > voice.sender.incarnation:
            del self._voices[agent]  # of the new life nothing has been heard yet
            return 0.0
        token = token and life == voice.sender.incarnation
        if token == (now - voice.heard_at < self._silence):
            voice.odd_since = None
            return 0.0
        if voice.odd_since is None:
            voice.odd_since = now
        # The last words of the dead come at once with the end of its token.
        return (now if token else voice.heard_at) - voice.odd_since

    def _with_token(self, *, present: bool) -> frozenset[Sender]:
        with self._lock:
            return frozenset(Sender(agent, life) for agent, (life, there) in self._tokens.items() if there is present)
