"""The state of a team as its events tell it: poses, owners, scores, and how they came about."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from covey.coverage import agent_scores, team_visibility
from covey.geometry import Pose2
from covey.mission import Mission, SensorSpec
from covey.protocol import (
    AgentBuried,
    AgentReturned,
    Cause,
    Event,
    LandmarksAdopted,
    PoseOptimized,
    Sender,
    TradeCommitted,
    WaypointAbandoned,
)
from covey.protocol.records import FIRST_GENERATION, GENERATION
from covey.runtime.agent import build_models
from covey.runtime.result import AgentResult, HistoryEntry, Scores, Snapshot
from covey.sensing import VisibilityModel, build_model

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
    it gained to the team's score, whatever else is known, and only a death, a return or an adoption makes it that of
    what is known.  The events of an agent that dies may not come at all; `settle` puts the truth in the place of
    everything.  The dead see nothing.

    Attributes
    ----------
    score : float
        Team score, eq. (4.5).
    """

    def __init__(self, mission: Mission, owner: NDArray[np.int64]) -> None:
        self.mission = mission
        self.models = build_models(mission)
        self.poses: list[Pose2] = [agent.pose for agent in mission.agents]
        self.owner = owner.copy()
        self._generation = np.zeros(len(owner), dtype=np.int64)
        self.trades = 0
        self.optimizations = 0
        self._buried: set[int] = set()
        self._returned: set[Sender] = set()
        self._living: frozenset[int] = frozenset()
        self.scores = self._all_scores()
        self.score = self._known_score()
        self.history = [HistoryEntry("initial", (), self.score)]
        self.snapshots = [self._snapshot("initial")]

    def take(self, event: Event) -> None:
        """Note an event."""
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
                self.trades += 1
                self._log("trade", event.client, event.server, before=before, gain=event.after - event.before)
            case LandmarksAdopted():
                before = self.owner.copy()
                indices, generation = event.records.indices, event.records.values[:, GENERATION]
                newer = generation > self._generation[indices]  # else a trade of what was adopted came first
                self._generation[indices[newer]] = generation[newer]
                self.owner[indices[newer]] = event.agent
                if (self.owner != before).any():
                    self._log("adoption", event.agent, before=before)
            case AgentBuried() if event.dead not in self._buried:
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
        """Put what the team has agreed on in the place of what events told: who does not speak now is dead."""
        self._buried |= set(range(len(self.poses))) - self._living
        self.owner = owner.copy()
        for agent, pose in poses.items():
            self.poses[agent] = pose
        self.scores = self._all_scores()
        self.score = self._known_score()
        if abs(self.history[-1].score - self.score) > CLOSE * max(1.0, self.score):
            self.history.append(HistoryEntry("settled", (), self.score))
        else:
            self.history[-1] = replace(self.history[-1], score=self.score)

    def sets(self) -> list[NDArray[np.int64]]:
        """Return the sorted landmarks of each agent."""
        return [np.flatnonzero(self.owner == agent) for agent in range(len(self.poses))]

    def present(self) -> Mission:
        """Return the mission as it is for those that live: the dead are blind."""
        blind = SensorSpec("blind", {})
        agents = tuple(
            replace(specification, sensor=blind) if agent in self.dead else specification
            for agent, specification in enumerate(self.mission.agents)
        )
        return replace(self.mission, agents=agents)

    def present_models(self) -> tuple[VisibilityModel, ...]:
        """Return the sensors of `present`."""
        blind = build_model("blind")
        return tuple(blind if agent in self.dead else model for agent, model in enumerate(self.models))

    def agents(self) -> tuple[AgentResult, ...]:
        """Return where each agent is and what it watches."""
        return tuple(
            AgentResult(specification.name, self.poses[i], 0.0 if i in self.dead else float(self.scores[i]), landmarks)
            for i, (specification, landmarks) in enumerate(zip(self.mission.agents, self.sets(), strict=True))
        )

    def summary(self) -> Scores:
        """Return the scores at the start and the end; there is no moment at which all have optimised once."""
        return Scores(self.history[0].score, math.nan, math.nan, self.score)

    def finish(self) -> tuple[Snapshot, ...]:
        """Return the state at the start and now."""
        return (*self.snapshots, self._snapshot("final"))

    def _known_score(self) -> float:
        return float(sum(score for agent, score in enumerate(self.scores) if agent not in self.dead))

    def _all_scores(self) -> NDArray[np.float64]:
        landmarks = self.mission.landmarks
        return agent_scores(team_visibility(self.models, self.poses, landmarks), self.owner, landmarks.weights)

    def _log(
        self, event: str, *agents: int, before: NDArray[np.int64] | None = None, gain: float | None = None
    ) -> None:
        """Score anew whom an event concerns, with those that lost landmarks by it, and put it into the history."""
        concerned = set(agents)
        if before is not None:  # an event that was overtaken by another may take them from anybody
            concerned |= {int(agent) for agent in np.unique(before[before != self.owner])}
        weights = self.mission.landmarks.weights
        for agent in concerned:
            own = np.flatnonzero(self.owner == agent)
            pose = self.poses[agent].as_array()[None, :]
            seen = self.models[agent].visibility(pose, self.mission.landmarks.subset(own))[0]
            self.scores[agent] = float(seen @ weights[own])
        self.score = self._known_score() if gain is None else self.score + gain
        names = tuple(self.mission.agents[agent].name for agent in agents)
        self.history.append(HistoryEntry(event, names, self.score))

    def _snapshot(self, label: str) -> Snapshot:
        return Snapshot(label, tuple(self.poses), self.owner.copy(), self.score)
