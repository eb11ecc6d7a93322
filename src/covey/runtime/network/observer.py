"""Somebody who watches a mission on the network and never takes part in it."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol, TypeAlias

import numpy as np
from numpy.typing import NDArray

from covey.errors import Drop, InputError
from covey.geometry import Pose2
from covey.mission import Mission
from covey.protocol import Catalogue, Event, Heartbeat, LandmarkRecords, Map, MembershipOptions, PoseRecords
from covey.protocol.adoption import map_digest, orphans
from covey.protocol.outputs import LandmarksAdopted
from covey.protocol.records import INCARNATION, NOBODY, OWNER, RecordSlice
from covey.runtime.network.observed_team import ObservedTeam
from covey.runtime.network.remote_agent import NETWORK_TIMES
from covey.runtime.team import initial_owners
from covey.transports.telemetry import Telemetry

Content: TypeAlias = Heartbeat | Event | Map | Telemetry

ASK_EVERY = 0.5
"""Seconds between two questions for maps while the mission goes on."""

MOST_EARLY = 1000
"""How many events may wait for what they are about."""

ASK_AT_LAST = 0.1
"""The same when the mission seems to be over."""


class Access(Protocol):
    """What an observer needs of the network; see `covey.transports.zenoh_observer.ZenohObserver`."""

    @property
    def dropped(self) -> Mapping[Drop, int]:
        """How many arrivals were dropped so far, by cause."""
        ...

    def receive(self) -> list[Content]:
        """Take what has arrived; never blocks."""
        ...

    def wait(self, timeout: float) -> bool:
        """Wait until something has arrived, seconds at most; whether it has."""
        ...

    def ask_for_maps(self) -> None:
        """Ask every agent for its map; the answers arrive like all else."""
        ...


@dataclass(frozen=True)
class Heard:
    """Something that an observer heard.

    Parameters
    ----------
    time : float
        Seconds since the observer began.
    content : Heartbeat, Event, Map or Telemetry
    """

    time: float
    content: Content


class Observer:
    """Hears a team, knows who lives and when the mission is over, and passes on what it hears.

    Parameters
    ----------
    mission : Mission
    access : Access
    times : MembershipOptions, keyword-only
        Those of the agents.
    late : bool, keyword-only
        Whether the team may have been at work for long: then its first map counts, unless an event comes before, of
        which the map need not know.
    clock : callable, keyword-only
        Seconds that only rise.

    Attributes
    ----------
    team : ObservedTeam
        Poses, owners, scores and history, as told by events.
    longest_unowned : float
        The longest time between the last heartbeat of a landmark's owner and the news of another owner, seconds: no
        landmark was unowned for longer, except by those that were not yet taken at all.

    Notes
    -----
    It says nothing that could change what a team does: agents answer its question for their maps beside their work.
    The mission is over when all that speak are quiescent, have the same map, and this map, fetched from one of them,
    gives every landmark an owner that speaks.  Whoever has not spoken within `dead_after` by then is dead, whether or
    not the observer was there to hear of it.  What changed since the mission began it learns from maps too; events and
    heartbeats of whom it has not heard of yet wait until then.
    """

    def __init__(
        self,
        mission: Mission,
        access: Access,
        *,
        times: MembershipOptions = NETWORK_TIMES,
        late: bool = False,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.team = ObservedTeam(mission, initial_owners(mission, mission.seed))
        self.longest_unowned = 0.0
        self._access = access
        self._dead_after = times.dead_after
        self._clock = clock
        self._began = clock()
        self._subscribers: list[Callable[[Heard], object]] = []
        self._beats: dict[int, Heartbeat] = {}
        self._heard: dict[int, float] = {}
        self._lives: dict[tuple[int, int], float] = {}  # when each life was heard last
        self._first = len(mission.landmarks)
        self._records = LandmarkRecords.unknown(self._first)
        self._maps: dict[bytes, Map] = {}  # the newest of each digest that agents have told
        self._catalogues: dict[int, bytes] = {}  # digest of what each agent knows to have changed
        self._early: list[Event] = []
        self._late = late
        self._asked_at = -np.inf

    def subscribe(self, listener: Callable[[Heard], object]) -> None:
        """From now on call somebody with everything that is heard, in order."""
        self._subscribers.append(listener)

    @property
    def time(self) -> float:
        """Seconds since it began."""
        return self._clock() - self._began

    @property
    def dropped(self) -> Mapping[Drop, int]:
        """How many arrivals were dropped so far, by cause."""
        return self._access.dropped

    @property
    def living(self) -> Mapping[int, int]:
        """The incarnation of each agent of the team that has been heard within `dead_after`."""
        now, team = self.time, self.team
        return {
            agent: beat.sender.incarnation
            for agent, beat in self._beats.items()
            if now < self._heard[agent] + self._dead_after and agent < len(team.poses) and agent not in team.gone
        }

    @property
    def informed_agents(self) -> frozenset[int]:
        """Who of those that speak is known to know of every change that this observer knows of."""
        digest = self.team.planner.catalogue.digest
        return frozenset(agent for agent in self.living if self._catalogues.get(agent) == digest)

    @property
    def informed(self) -> bool:
        """Whether those are all that speak, and somebody does."""
        return bool(self.living) and self.informed_agents == self.living.keys()

    @property
    def final_map(self) -> Map | None:
        """What all that speak have agreed on at the end; None while the mission is not over."""
        living = self.living
        if len(living) + len(self.team.gone) < len(self.team.poses) and self.time < self._dead_after:
            return None  # who has not been heard may yet speak
        digest = self._agreed(living)
        known = None if digest is None else self._maps.get(digest)
        planner = self.team.planner
        if known is None or known.catalogue.digest != planner.catalogue.digest:
            return None
        return None if len(orphans(self._records_of(known), living, planner.alive)) else known

    @property
    def over(self) -> bool:
        """Whether the mission is over; it may begin again, when somebody dies or returns."""
        return self.final_map is not None

    def step(self, timeout: float) -> list[Heard]:
        """Listen for a while, `timeout` seconds at most; return what was heard."""
        self._access.wait(timeout)
        news = [Heard(self.time, content) for content in self._access.receive()]
        for item in news:
            if isinstance(item.content, Heartbeat):
                self._hear(item.content, item.time)
        self.team.set_living(self.living)
        self._late &= not any(isinstance(item.content, Event) for item in news)
        for item in news:
            self._take(item)
        digest = self._agreed(self.living)
        hurry = digest is not None and digest not in self._maps
        hurry |= bool(self._early) or not self._beats.keys() <= set(range(len(self.team.poses)))
        if self._beats and self.time >= self._asked_at + (ASK_AT_LAST if hurry else ASK_EVERY):
            self._asked_at = self.time
            self._access.ask_for_maps()
        for item in news:
            for listener in self._subscribers:
                listener(item)
        return news

    def ask_soon(self) -> None:
        """Ask for maps as soon as what has just been said can have arrived."""
        self._asked_at = self.time - ASK_EVERY + ASK_AT_LAST

    def unowned(self) -> float:
        """Return for how long at most a landmark that had an owner has had none that speaks, seconds, now."""
        records = self._records.values[self.team.planner.alive]
        return max((self.time - self._lives.get(life, self.time) for life in self._owners(records)), default=0.0)

    def settle(self) -> bool:
        """Put the agreed map into the team; whether there is one."""
        known = self.final_map
        if known is None:
            return False
        owner = self._records_of(known).values[:, OWNER].copy()
        poses: dict[int, Pose2] = {agent: record.pose for agent, record in known.poses.items()}
        self.team.set_living(self.living)
        self.team.settle(owner, poses)
        return True

    def _hear(self, heartbeat: Heartbeat, now: float) -> None:
        agent = heartbeat.sender.agent
        self._beats[agent] = heartbeat
        self._heard[agent] = now
        self._lives[heartbeat.sender] = now

    def _take(self, item: Heard) -> None:
        content = item.content
        if isinstance(content, Map):
            try:
                self.learn(content.catalogue)
            except InputError:
                return  # it describes an agent that cannot be built
            self._catalogues[content.sender.agent] = content.catalogue.digest
            self._learn(content.records, item.time)
            digest = map_digest(self._records_of(content), PoseRecords(content.poses), content.catalogue)
            self._maps = {d: m for d, m in self._maps.items() if any(beat.digest == d for beat in self._beats.values())}
            self._maps[digest] = content
            if self._late:
                self._catch_up(content)
        elif isinstance(content, Event):
            if not self.team.knows(content):
                self._early = [*self._early[-MOST_EARLY:], content]
                return
            if isinstance(content, LandmarksAdopted):
                self._learn(content.records, item.time)
            self.team.take(content)

    def learn(self, catalogue: Catalogue) -> None:
        """Take in that landmarks or agents are others.

        Raises
        ------
        InputError
            If it describes an agent that cannot be built; nothing is learned then.
        """
        if self.team.learn(catalogue):
            self._records.grow(len(self.team.owner))
            early, self._early = self._early, []
            for event in early:
                self._take(Heard(self.time, event))

    def _catch_up(self, known: Map) -> None:
        """Take over what the team has come to before events told of it, if a map has everything."""
        owner = self._records_of(known).values[:, OWNER]
        if (owner[self.team.planner.alive] != NOBODY).all():
            self._late = False
            self.team.take_over(owner, {agent: record.pose for agent, record in known.poses.items()})

    def _records_of(self, known: Map) -> LandmarkRecords:
        """Return what a map says of all landmarks that its agent knows."""
        records = LandmarkRecords.unknown(self._first)
        records.grow(max(known.catalogue.landmarks, default=-1) + 1)
        records.merge(known.records)
        return records

    def _learn(self, records: RecordSlice, now: float) -> None:
        """Merge records, and note for how long the landmarks that changed hands had been without an owner."""
        newer = self._records.is_behind(records)
        before = self._records.values[records.indices[newer]]
        for life in self._owners(before):
            if life[0] in self.team.gone:
                continue
            self.longest_unowned = max(self.longest_unowned, now - self._lives.get(life, now))
        self._records.merge(records)

    @staticmethod
    def _owners(values: NDArray[np.int64]) -> list[tuple[int, int]]:
        return [(int(agent), int(life)) for agent, life in np.unique(values[:, [OWNER, INCARNATION]], axis=0)]

    def _agreed(self, living: Mapping[int, int]) -> bytes | None:
        """Return the digest on which all that live agree, all of them quiescent."""
        beats = [self._beats[agent] for agent in living]
        digests = {beat.digest if beat.quiescent else b"" for beat in beats}
        return digests.pop() if len(digests) == 1 and b"" not in digests else None
