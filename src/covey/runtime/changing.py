"""A team whose landmarks and agents change while it is at work."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from covey.geometry import Pose2
from covey.mission import Assignment, ChangeSpec, Mission, agent_text
from covey.protocol import (
    OPERATOR,
    AgentChange,
    Catalogue,
    Change,
    Event,
    GoTo,
    LandmarkChange,
    LandmarkRecords,
    LandmarksAdopted,
    Node,
    Sender,
    TradeCommitted,
)
from covey.protocol.records import OWNER
from covey.runtime.agent import TeamPlanner, nearest_first
from covey.runtime.result import HistoryEntry, Scores, Snapshot
from covey.runtime.streams import Stream, generator
from covey.runtime.team import Standing, Team, Travel

UNHEARD = "decided before all had heard of the change"
"""Why the score fell after a change, beside the change itself."""

_ROUNDING = 1e-9


@dataclass(frozen=True)
class News:
    """One change, as agents hear of it.

    Parameters
    ----------
    catalogue : Catalogue
    event : str
        ``added``, ``removed``, ``reweighted``, ``joined`` or ``left``.
    detail : str
        What exactly, in words.
    """

    catalogue: Catalogue
    event: str
    detail: str


def catalogue_of(change: ChangeSpec, planner: TeamPlanner, names: Sequence[str]) -> News:
    """Return what an operator tells the agents, given what has changed so far.

    Parameters
    ----------
    change : ChangeSpec
    planner : TeamPlanner
        It knows the landmarks and agents as they are now.
    names : sequence of str
        Of all agents that ever took part; who joins gets the next number.
    """
    version = planner.catalogue.version + 1
    if change.join is not None:
        entry = AgentChange(version, True, agent_text(change.join))
        return News(Catalogue(agents={len(names): entry}), "joined", str(change.join["name"]))
    if change.leave is not None:
        agent = list(names).index(change.leave)
        known = planner.catalogue.agents.get(agent)
        entry = AgentChange(version, False, "" if known is None else known.specification)
        return News(Catalogue(agents={agent: entry}), "left", change.leave)
    if change.add is not None:
        first, added = len(planner.landmarks), change.add
        normals = np.zeros((len(added), 2)) if added.normals_W is None else added.normals_W
        rows = zip(added.weights.tolist(), added.positions_W.tolist(), normals.tolist(), strict=True)
        records = {
            first + i: LandmarkChange(version, True, weight, *position, *normal)
            for i, (weight, position, normal) in enumerate(rows)
        }
        return News(Catalogue(records), "added", _numbers(records))
    weights = change.reweight or dict.fromkeys(change.remove, 0.0)
    alive = not change.remove
    records = {k: planner.landmark(k)._replace(version=version, alive=alive, weight=w) for k, w in weights.items()}
    return News(Catalogue(records), "reweighted" if alive else "removed", _numbers(records))


def standing_mission(mission: Mission, planner: TeamPlanner, agents: Sequence[int]) -> Mission:
    """Return a mission as it is after what the planner has learned, with the landmarks that are to be seen and these
    agents only, numbered anew.
    """
    coverage = mission.coverage
    if not isinstance(coverage.assignment, Assignment):  # it names landmarks by their first numbers
        coverage = replace(coverage, assignment=Assignment.RANDOM)
    return replace(
        mission,
        landmarks=planner.landmarks.subset(np.flatnonzero(planner.alive)),
        agents=tuple(planner.agents[agent] for agent in agents),
        coverage=coverage,
        changes=(),
    )


def differences(planner: TeamPlanner, merged: Catalogue) -> list[News]:
    """Return, as an operator's `News`, what a catalogue says that the planner has not learned yet."""
    known, alive = planner.catalogue, planner.alive
    landmarks: dict[str, dict[int, LandmarkChange]] = {"added": {}, "removed": {}, "reweighted": {}}
    for k, record in sorted(merged.landmarks.items()):
        seen = k < len(alive) and bool(alive[k])
        if record != known.landmarks.get(k) and (seen or record.alive):
            landmarks["removed" if not record.alive else "reweighted" if seen else "added"][k] = record
    news = [News(Catalogue(records), event, _numbers(records)) for event, records in landmarks.items() if records]
    for agent, change in sorted(merged.agents.items()):
        if change != known.agents.get(agent):
            here = change.present and not (agent < len(planner.agents) and known.is_present(agent))
            event = "left" if not change.present else "joined" if here else ""
            news += [News(Catalogue(agents={agent: change}), event, "")] if event else []
    return news


def _numbers(landmarks: Sequence[int] | dict[int, LandmarkChange]) -> str:
    shown = ", ".join(map(str, list(landmarks)[:8]))
    return f"landmarks {shown}{', ...' if len(landmarks) > 8 else ''}"


class ChangingTeam(Team):
    """The agents of a mission, what changes while they are at work, and the log that says why the score changed.

    Parameters
    ----------
    mission, planner, seed, travel
        As for `Team`; the mission has changes, or they come by `change`.

    Notes
    -----
    Everybody is told of a change over the bus, and the team counts a change as made when it is told: there the score of
    the history falls or rises.  Until all have heard of it and agree on who adopts what, an agent may still act by what
    it knew before, and an entry whose score falls for that says so (`UNHEARD`).  From then on it never falls until the
    next change.  Agents and landmarks keep their numbers; `standing` leaves out those that are gone.
    """

    def __init__(self, mission: Mission, planner: TeamPlanner, *, seed: int, travel: Travel | None = None) -> None:
        self._seed = seed
        self._first = mission
        self._pending = list(mission.changes)
        self._present = [True] * len(mission.agents)
        self._moments: dict[str, float] = {}
        self._standing: tuple[Catalogue, Standing] | None = None
        super().__init__(mission, planner, seed=seed, travel=travel)
        self._newest = self.nodes[0].records.copy()
        self._moments["initial"] = self.score

    @property
    def settled(self) -> bool:
        """Whether every agent that takes part says that the mission is over, and has heard of every change."""
        return all(
            node.over and node.catalogue.digest == self.planner.catalogue.digest
            for agent, node in enumerate(self.nodes)
            if self._present[agent]
        )

    def advance(self) -> bool:
        """Let the next thing happen, a change among others; False when nothing is left to do."""
        if self._pending and self._is_due(self._pending[0]):
            self.change(self._pending.pop(0))
            return True
        if super().advance():
            return True
        if self._pending:
            self.change(self._pending.pop(0))
            return True
        return False

    def _is_due(self, change: ChangeSpec) -> bool:
        trades = change.after_trades is not None and self.trades >= change.after_trades
        return trades or (change.at is not None and self.bus.now >= change.at)

    def change(self, change: ChangeSpec) -> None:
        """Change landmarks or agents, tell everybody, and put into the history what it did to the score."""
        news = catalogue_of(change, self.planner, [agent.name for agent in self.mission.agents])
        self.planner.learn(news.catalogue)
        landmarks = self.planner.landmarks
        self.mission = replace(self.mission, landmarks=landmarks, agents=tuple(self.planner.agents))
        agents = tuple(news.catalogue.agents)
        for agent in agents:
            if news.catalogue.agents[agent].present:
                self._join(agent)
            else:
                self._present[agent] = False
                self._detector.bury(agent)
        self.owner = self._owners()
        self.snapshots = []
        self.rescore()
        names = tuple(self.mission.agents[agent].name for agent in agents)
        self.history.append(HistoryEntry(news.event, names, self.score, news.detail))
        if self.onlooker is not None:
            changed = np.array(sorted(news.catalogue.landmarks), dtype=np.int64)
            self.onlooker.reshaped(news.event, agents, changed, news.detail)
        for agent, present in enumerate(self._present):
            if present:
                self.bus.send(agent, Change(Sender(OPERATOR, 1), news.catalogue))
        for agent in agents:
            if self._present[agent]:
                self._act(agent, self.bus.start(agent))

    def _join(self, agent: int) -> None:
        pose = self.planner.agents[agent].pose
        self.poses.append(pose)
        self._present.append(True)
        node = Node(
            agent,
            range(len(self._first.agents)),
            LandmarkRecords.unknown(len(self._first.landmarks)),
            {agent: pose},
            self.planner,
            order=nearest_first,
            options=self._options,
            links=self._links,
            catalogue=self.planner.catalogue,
        )
        self.nodes.append(node)
        self.bus.attach(node, generator(self._seed, Stream.NODE, agent), hears_heartbeats=True)
        self._detector.admit(agent)

    def _act(self, agent: int, outputs: Sequence[GoTo | Event]) -> None:
        for output in outputs:
            if isinstance(output, LandmarksAdopted):
                # Two may adopt the same at once, and one of them hears later that it is the other's.
                self._newest.merge(output.records)
                before = self.owner
                self.owner = self._owners()
                others = set(before[before != self.owner].tolist()) - {-1, output.agent}
                self._log("adoption", (output.agent, *sorted(others)))
            elif isinstance(output, TradeCommitted):
                self._newest.merge(self.nodes[output.client].records.all())
                super()._act(agent, (output,))
            else:
                super()._act(agent, (output,))

    def _log(self, event: str, agents: tuple[int, ...]) -> None:
        self.owner = self._owners()
        before = self.score
        super()._log(event, agents)
        if self.score < before - _ROUNDING:
            self.history[-1] = replace(self.history[-1], detail=UNHEARD)

    def _owners(self) -> NDArray[np.int64]:
        """Return who owns each landmark by the newest records; -1: nobody, it is removed, or its owner has left."""
        self._newest.grow(len(self.planner.landmarks))
        owner = self._newest.values[:, OWNER].copy()
        gone = [agent for agent, present in enumerate(self._present) if not present]
        owner[~self.planner.alive | np.isin(owner, gone)] = -1
        return owner

    def _all_scores(self) -> NDArray[np.float64]:
        weights = self.planner.weights
        return np.array(
            [
                self.planner.visibility(agent, pose)[own] @ weights[own]
                for agent, (pose, own) in enumerate(
                    (pose, np.flatnonzero(self.owner == agent)) for agent, pose in enumerate(self.poses)
                )
            ]
        )

    def _take_snapshot(self, label: str) -> None:
        self._moments[label] = self.score
        super()._take_snapshot(label)

    def summary(self) -> Scores:
        """Return the scores at the four moments, whatever the landmarks and agents were then."""
        nan, known = float("nan"), self._moments
        first_optimization = known.get("after_first_optimization", nan)
        return Scores(known["initial"], first_optimization, known.get("after_first_trade", nan), self.score)

    def standing(self) -> Standing:
        """Return the team as it is now: landmarks and agents are numbered anew, without those that are gone."""
        catalogue, landmarks = self.planner.catalogue, np.flatnonzero(self.planner.alive)
        agents = [agent for agent, present in enumerate(self._present) if present]
        sets = self.sets()
        if self._standing is None or self._standing[0] is not catalogue:
            mission = standing_mission(self.mission, self.planner, agents)
            models = tuple(self.planner.models[agent] for agent in agents)
            self._standing = (catalogue, Standing(mission, models, tuple(agents), (), (), ()))
        return replace(
            self._standing[1],
            poses=tuple(self.poses[agent] for agent in agents),
            scores=tuple(float(self.scores[agent]) for agent in agents),
            sets=tuple(np.searchsorted(landmarks, sets[agent]) for agent in agents),
        )

    def finish(self) -> tuple[Snapshot, ...]:
        """Return the state as it is now; those before a change had other landmarks or agents."""
        standing = self.standing()
        owner = np.full(len(standing.mission.landmarks), -1, dtype=np.int64)
        for index, own in enumerate(standing.sets):
            owner[own] = index
        poses: tuple[Pose2, ...] = standing.poses
        return (Snapshot("final", poses, owner, self.score),)
