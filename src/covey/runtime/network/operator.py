"""Who changes landmarks and agents of a team on the network."""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from typing import Protocol

from covey.errors import InputError, NetworkError
from covey.mission import ChangeSpec, Mission
from covey.protocol import EMPTY, Catalogue
from covey.runtime.changing import News, catalogue_of
from covey.runtime.network.network_file import NetworkPlan
from covey.runtime.network.observed_team import ObservedTeam
from covey.runtime.network.observer import Observer
from covey.runtime.network.remote_agent import mission_codec
from covey.transports.zenoh_observer import ZenohObserver

TICK = 0.05
"""How long to listen at a time, seconds."""

ROUNDS = 3
"""So many heartbeats are listened to before a change is made: who has not been heard by then is not asked."""

TELL_EVERY = 1.0
"""Seconds between two times that agents are told of a change that not all are known to know."""


class Megaphone(Protocol):
    """What an operator needs of the network; see `covey.transports.zenoh_observer.ZenohObserver`."""

    def announce(self, news: Catalogue) -> None:
        """Tell all agents of changes."""
        ...


@dataclass(frozen=True)
class Told:
    """A change that a team knows of.

    Parameters
    ----------
    event : str
        ``added``, ``removed``, ``reweighted``, ``joined`` or ``left``.
    detail : str
        What exactly, in words.
    agents : tuple of str
        Who is known to know of it.
    landmarks : tuple of int
        Those that it is about.
    """

    event: str
    detail: str
    agents: tuple[str, ...]
    landmarks: tuple[int, ...]


def change_team(
    mission: Mission,
    network: NetworkPlan,
    build: Callable[[ObservedTeam], ChangeSpec],
    *,
    timeout: float,
    check: Callable[[], object] = lambda: None,
) -> Told:
    """Make one change of a team that others have started.

    Parameters
    ----------
    mission, network : as for the agents
    build : callable
        ``build(team)``: the change, for the team as it is now.
    timeout : float, keyword-only
        How long to wait for agents to be heard, and then for all to know of the change, seconds.
    check : callable, keyword-only
        Called often; what it raises ends the wait.

    Raises
    ------
    InputError
        If the change cannot be made.
    NetworkError
        If the network cannot be joined, nobody is heard, or not all hear of the change.
    """
    with closing(ZenohObserver(mission_codec(mission), network.options)) as access:
        observer = Observer(mission, access, times=network.times)
        operator = Operator(observer, access, joining=network.joining)

        def wait(until: Callable[[], bool]) -> bool:
            end = observer.time + timeout
            while not until():
                check()
                observer.step(TICK)
                operator.step()
                if observer.time >= end:
                    return False
            return True

        listened = ROUNDS * network.times.heartbeat_every
        if not wait(lambda: observer.time >= listened and observer.informed):
            names = [observer.team.names[agent] for agent in observer.living]
            heard = f"of {', '.join(names)} alone, who do not agree" if names else "of none of its agents"
            raise NetworkError(
                f"the mission {mission.name!r} is heard {heard}; compare mission file, seed and --connect"
            )
        news = operator.change(build(observer.team))
        told = wait(lambda: operator.told)
        names = [observer.team.names[agent] for agent in sorted(observer.informed_agents)]
        if not told:
            raise NetworkError(
                f"told {', '.join(names) or 'nobody'} of {len(observer.living)} agents in {timeout:g} s, who tell "
                "the others. With an access list, this certificate must be among access.operators"
            )
    return Told(news.event, news.detail, tuple(names), tuple(sorted(news.catalogue.landmarks)))


class Operator:
    """Makes changes one after the other, and tells each to all agents until they know it.

    Parameters
    ----------
    observer : Observer
        Through it the operator knows the team; call `step` after each of its steps.
    access : Megaphone
    joining : tuple of str, optional
        Who may join, in the order in which they may: those of an access list.

    Notes
    -----
    A change has a version above all that the operator knows of.  Two operators at the same time may choose the same:
    then one of two changes of the same landmark or agent is lost, and `told` says so to whoever made it.
    """

    def __init__(self, observer: Observer, access: Megaphone, *, joining: tuple[str, ...] | None = None) -> None:
        self._observer = observer
        self._access = access
        self._joining = joining
        self._news = EMPTY
        self._told_at = -math.inf

    def change(self, change: ChangeSpec) -> News:
        """Make a change; its own observer learns of it at once.

        Raises
        ------
        InputError
            If an agent is to join that the access list does not let in now, or that cannot be built.
        """
        team = self._observer.team
        if change.join is not None and self._joining is not None:
            count = len(team.names) - len(team.first_mission.agents)
            next_one = self._joining[count] if count < len(self._joining) else None
            if change.join["name"] != next_one:
                expected = "nobody else" if next_one is None else repr(next_one)
                raise InputError(
                    f"join: the access list lets {expected} join now, got {change.join['name']!r}; "
                    "see access.joining of the network file"
                )
        news = catalogue_of(change, team.planner, team.names)
        self._observer.learn(news.catalogue)
        self._news, self._told_at = news.catalogue, -math.inf
        return news

    @property
    def told(self) -> bool:
        """Whether all that speak are known to know of the last change; True without one.

        Raises
        ------
        NetworkError
            If another operator has overruled it.
        """
        if not self._news:
            return True
        known = self._observer.team.planner.catalogue
        for mine, theirs in ((self._news.landmarks, known.landmarks), (self._news.agents, known.agents)):
            if any(theirs[key] != record for key, record in mine.items()):
                raise NetworkError("another operator changed the same at the same time, and that holds; try again")
        return self._observer.informed

    def step(self) -> None:
        """Tell the agents again, if it is time to."""
        now = self._observer.time
        if self._news and now >= self._told_at + TELL_EVERY and not self._observer.informed:
            self._told_at = now
            self._access.announce(self._news)
            self._observer.ask_soon()
