"""Detects that the mission is over, from heartbeats alone."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from covey.protocol.messages import Heartbeat


class TerminationDetector:
    """Declares termination over one consistent set of heartbeats.

    It does so when the newest heartbeat of every agent says quiescent, and each pair agrees on how many trades the one
    has committed as client and the other merged as server.

    Parameters
    ----------
    agents : iterable of int

    Notes
    -----
    Source: Sposato (2016), section 4.6.  Deviation: V10.

    Why this is enough: heartbeats are of different instants, so an agent may have changed after its own.  Take the
    first such change.  A quiescent agent changes only by a commit that it merges as server.  Its client is not
    quiescent while that trade is open, and was not woken after its heartbeat before this first change, so its
    heartbeat came after the commit and counts it; the server's came before and does not.  Both counts of a pair only
    rise and commits of a pair are merged in order, so they differ.  A pose adopted from outside is not a change of
    this kind: who calls `Node.adopt_pose` hands the heartbeat that it returns to the detector at once.

    Where the team survives crashes, counts of a pair can differ for ever, and heartbeats carry digests of the agents'
    maps instead: they must be equal.  The same change shows in the client's map and not in the server's, and no map
    on its way between equal maps changes anything.  The dead are left out; who returns counts as active.

    Examples
    --------
    >>> TerminationDetector([]).terminated
    True
    >>> TerminationDetector([0, 1]).terminated
    False
    """

    def __init__(self, agents: Iterable[int]) -> None:
        self._newest: dict[int, Heartbeat | None] = dict.fromkeys(agents)
        self._active = set(self._newest)
        self._dead: set[int] = set()

    def receive(self, heartbeat: Heartbeat) -> bool:
        """Take a heartbeat in, in any order; return whether the mission is over.  Strangers are ignored."""
        agent = heartbeat.sender.agent
        if agent in self._newest:
            known = self._newest[agent]
            if known is None or _age(heartbeat) > _age(known):
                self._newest[agent] = heartbeat
                if heartbeat.quiescent:
                    self._active.discard(agent)
                else:
                    self._active.add(agent)
        return self.terminated

    def bury(self, agent: int) -> None:
        """Leave a dead agent out."""
        self._dead.add(agent)

    def admit(self, agent: int) -> None:
        """Count an agent that is new, has returned, or begun a new life, as active until it says otherwise."""
        self._newest.setdefault(agent, None)
        self._dead.discard(agent)
        self._active.add(agent)

    @property
    def terminated(self) -> bool:
        """Whether the heartbeats so far prove that nothing will happen any more."""
        return self._active <= self._dead and self._no_trade_in_flight()

    def versions(self) -> Mapping[int, tuple[int, int]]:
        """Return (incarnation, epoch) of each living agent heard of: the set over which termination is judged."""
        return {
            agent: (heartbeat.sender.incarnation, heartbeat.epoch)
            for agent, heartbeat in self._newest.items()
            if heartbeat is not None and agent not in self._dead
        }

    def _no_trade_in_flight(self) -> bool:
        beats = {a: beat for a, beat in self._newest.items() if beat is not None and a not in self._dead}
        digests = {beat.digest for beat in beats.values()}
        if digests - {b""}:
            return len(digests) == 1
        committed = {(a, b): count for a, beat in beats.items() for b, count in beat.committed.items()}
        served = {(b, a): count for a, beat in beats.items() for b, count in beat.served.items()}
        return committed == served


def _age(heartbeat: Heartbeat) -> tuple[int, int]:
    return heartbeat.sender.incarnation, heartbeat.sequence
