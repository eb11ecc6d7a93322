"""The state of a team as its events tell it: poses, owners, scores, and how they came about."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from covey.geometry import Pose2
from covey.mission import Mission, SensorSpec
from covey.protocol import (
    AgentBuried,
    AgentReturned,
    Catalogue,
    Cause,
    Event,
    LandmarksAdopted,
    PoseOptimized,
    Sender,
    TradeCommitted,
    WaypointAbandoned,
)
from covey.protocol.records import FIRST_GENERATION, GENERATION
from covey.runtime.agent import build_planner
from covey.runtime.changing import differences, standing_mission
from covey.runtime.result import HistoryEntry, Scores, Snapshot
from covey.runtime.team import Standing
from covey.sensing import build_model

CLOSE = 1e-9
"""Relative difference of two scores that are the same."""


class ObservedTeam:
    """What an observer knows of a team.

    Parameters
    ----------
    mission : Mission
    owner : array, shape (n,)
        To whom the landmarks are assigned first.

    Notes
    -----
    Events of different agents may come in another order than they happened in.  So a trade or a better pose adds what
    it gained to the team's score, whatever else is known.  From the first death, return, adoption or change on, the
    score is that of what is known: two agents that adopt the same both gain by it for a while, and the events of an
    agent that dies may not come at all.  `settle` puts the truth in the place of everything.  The dead see nothing.

    Attributes
    ----------
    score : float
        Team score, eq. (4.5).
    owner : array, shape (n,)
        -1: nobody, it is removed or its owner has left.
    planner : TeamPlanner
        Knows landmarks, agents and sensors as they are now.
    """

    def __init__(self, mission: Mission, owner: NDArray[np.int64]) -> None:
        self.first_mission = mission
        self.planner = build_planner(mission)
        self.poses: list[Pose2] = [agent.pose for agent in mission.agents]
        self.owner = owner.copy()
        self._generation = np.zeros(len(owner), dtype=np.int64)
        self._adopted = np.zeros(len(owner), dtype=np.bool_)  # and not traded since
        self._disturbed = False
        self.trades = 0
        self.optimizations = 0
        self.gone: frozenset[int] = frozenset()
        """Who has left for good."""
        self._buried: set[int] = set()
        self._returned: set[Sender] = set()
        self._living: frozenset[int] = frozenset()
        self.scores = self._all_scores()
        self.score = self._known_score()
        self.history = [HistoryEntry("initial", (), self.score)]
        self.snapshots = [self._snapshot("initial")]

    @property
    def names(self) -> list[str]:
        """The names of all agents that ever took part."""
        return [agent.name for agent in self.planner.agents]

    def learn(self, catalogue: Catalogue) -> bool:
        """Take in that landmarks or agents are others; whether that is news.

        Raises
        ------
        InputError
            If it describes an agent that cannot be built; nothing is learned then.
        """
        planner = self.planner
        news = differences(planner, catalogue)
        before = planner.catalogue
        planner.learn(catalogue)
        if planner.catalogue is before:
            return False
        more = len(planner.landmarks) - len(self.owner)
        self.owner = np.append(self.owner, np.full(more, -1, dtype=np.int64))
        self._generation = np.append(self._generation, np.zeros(more, dtype=np.int64))
        self._adopted = np.append(self._adopted, np.zeros(more, dtype=np.bool_))
        self._disturbed = True
        self.poses += [agent.pose for agent in planner.agents[len(self.poses) :]]
        self.gone = frozenset(agent for agent, record in planner.catalogue.agents.items() if not record.present)
        self.owner[~planner.alive | np.isin(self.owner, list(self.gone))] = -1
        self.scores = self._all_scores()
        self.score = self._known_score()
        for item in news:
            names = tuple(self.names[agent] for agent in item.catalogue.agents)
            self.history.append(HistoryEntry(item.event, names, self.score, item.detail or ", ".join(names)))
        self.snapshots = []
        return True

    def knows(self, event: Event) -> bool:
        """Whether all agents and landmarks that an event names are known."""
        agents = [
            getattr(event, name)
            for name in ("agent", "client", "server", "dead", "joined", "left")
            if hasattr(event, name)
        ]
        landmarks = [
            getattr(event, name)
            for name in ("landmarks", "client_landmarks", "server_landmarks", "give", "want")
            if hasattr(event, name)
        ]
        if isinstance(event, AgentReturned):
            agents.append(event.returned.agent)
        if isinstance(event, LandmarksAdopted):
            landmarks.append(event.records.indices)
        return all(agent < len(self.poses) for agent in agents) and all(
            not len(some) or some[-1] < len(self.owner) for some in landmarks
        )

    def take(self, event: Event) -> None:
        """Note an event; `knows` tells whether it can be."""
        match event:
            case PoseOptimized():
                self.poses[event.agent] = event.pose
                self.optimizations += 1
                gain = event.after - event.before
                self._log("proof" if event.cause is Cause.PROOF else "optimization", event.agent, gain=gain)
            case WaypointAbandoned():
                self.poses[event.agent] = event.held
                self._log("abandoned", event.agent, gain=event.after - event.before)
            case TradeCommitted():
                self.poses[event.client], self.poses[event.server] = event.client_pose, event.server_pose
                before = self.owner.copy()
                self.owner[event.client_landmarks] = event.client
                self.owner[event.server_landmarks] = event.server
                for landmarks in (event.client_landmarks, event.server_landmarks):
                    self._generation[landmarks] = np.maximum(self._generation[landmarks], FIRST_GENERATION)
                    self._adopted[landmarks] = False
                self.trades += 1
                self._log("trade", event.client, event.server, before=before, gain=event.after - event.before)
            case LandmarksAdopted():
                before = self.owner.copy()
                indices, generation = event.records.indices, event.records.values[:, GENERATION]
                newer = generation > self._generation[indices]  # else a trade of what was adopted came first
                tie = (generation == self._generation[indices]) & self._adopted[indices]
                newer |= tie & (event.agent > self.owner[indices])
                self._adopted[indices[newer]] = True
                self._generation[indices[newer]] = generation[newer]
                self.owner[indices[newer]] = event.agent
                if (self.owner != before).any():
                    self._log("adoption", event.agent, before=before)
            case AgentBuried() if event.dead not in self._buried | self.gone:
                self._buried.add(event.dead)
                self._log("death", event.dead)
            case AgentReturned() if event.returned not in self._returned:
                self._returned.add(event.returned)
                self._buried.discard(event.returned.agent)
                self._log("return", event.returned.agent)
            case _:
                pass

    @property
    def dead(self) -> frozenset[int]:
        """Who has been declared dead by others and is not heard."""
        return frozenset(self._buried - self._living)

    def set_living(self, living: Iterable[int]) -> None:
        """Say who is heard."""
        self._living = frozenset(living)

    def settle(self, owner: NDArray[np.int64], poses: Mapping[int, Pose2]) -> None:
        """Put what the team has agreed on in the place of what events told; who is not heard now is dead."""
        for agent in sorted(set(range(len(self.poses))) - self._living - self._buried - self.gone):
            self._buried.add(agent)
            self._log("death", agent)
        self.take_over(owner, poses)

    def take_over(self, owner: NDArray[np.int64], poses: Mapping[int, Pose2]) -> None:
        """Put what a map says in the place of what events told."""
        self.owner = owner.copy()
        self.owner[~self.planner.alive] = -1
        for agent, pose in poses.items():
            self.poses[agent] = pose
        self.scores = self._all_scores()
        self.score = self._known_score()
        if abs(self.history[-1].score - self.score) > CLOSE * max(1.0, self.score):
            self.history.append(HistoryEntry("settled", (), self.score))
        else:
            self.history[-1] = replace(self.history[-1], score=self.score)

    def standing(self) -> Standing:
        """Return the team as it is now: numbered anew, without what is gone, and the dead are blind."""
        agents = [agent for agent in range(len(self.poses)) if agent not in self.gone]
        mission = standing_mission(self.first_mission, self.planner, agents)
        dead, blind = self.dead, build_model("blind")
        specifications = tuple(
            replace(specification, sensor=SensorSpec("blind", {})) if agent in dead else specification
            for agent, specification in zip(agents, mission.agents, strict=True)
        )
        landmarks = np.flatnonzero(self.planner.alive)
        return Standing(
            mission=replace(mission, agents=specifications),
            models=tuple(blind if agent in dead else self.planner.models[agent] for agent in agents),
            agents=tuple(agents),
            poses=tuple(self.poses[agent] for agent in agents),
            scores=tuple(0.0 if agent in dead else float(self.scores[agent]) for agent in agents),
            sets=tuple(np.searchsorted(landmarks, np.flatnonzero(self.owner == agent)) for agent in agents),
        )

    def summary(self) -> Scores:
        """Return the scores at the start and the end; there is no moment at which all have optimised once."""
        return Scores(self.history[0].score, math.nan, math.nan, self.score)

    def finish(self) -> tuple[Snapshot, ...]:
        """Return the state at the start, unless landmarks or agents have changed since, and now."""
        standing = self.standing()
        owner = np.full(len(standing.mission.landmarks), -1, dtype=np.int64)
        for index, own in enumerate(standing.sets):
            owner[own] = index
        return (*self.snapshots, Snapshot("final", standing.poses, owner, self.score))

    def _known_score(self) -> float:
        return float(sum(score for agent, score in enumerate(self.scores) if agent not in self.dead))

    def _all_scores(self) -> NDArray[np.float64]:
        return np.array([self._score_of(agent) for agent in range(len(self.poses))])

    def score_from(self, agent: int, pose: Pose2) -> float:
        """Return what an agent's landmarks are worth as seen from a pose, eq. (4.4)."""
        planner, own = self.planner, np.flatnonzero(self.owner == agent)
        seen = planner.models[agent].visibility(pose.as_array()[None, :], planner.landmarks.subset(own))[0]
        return float(seen @ planner.weights[own])

    def _score_of(self, agent: int) -> float:
        return self.score_from(agent, self.poses[agent])

    def _log(
        self, event: str, *agents: int, before: NDArray[np.int64] | None = None, gain: float | None = None
    ) -> None:
        """Score anew whom an event concerns, with those that lost landmarks by it, and put it into the history."""
        concerned = set(agents)
        if before is not None:  # an event that was overtaken by another may take them from anybody
            concerned |= {int(agent) for agent in np.unique(before[before != self.owner]) if agent >= 0}
        for agent in concerned:
            self.scores[agent] = self._score_of(agent)
        self._disturbed |= gain is None
        self.score = self._known_score() if gain is None or self._disturbed else self.score + gain
        names = tuple(self.planner.agents[agent].name for agent in agents)
        self.history.append(HistoryEntry(event, names, self.score))

    def _snapshot(self, label: str) -> Snapshot:
        return Snapshot(label, tuple(self.poses), self.owner.copy(), self.score)
