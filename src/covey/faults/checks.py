"""What must hold at every instant of a simulated mission, and what at its end."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from covey.errors import CoveyError
from covey.faults.table import TablePlanner
from covey.protocol import (
    EMPTY,
    AgentBuried,
    AgentReturned,
    Catalogue,
    LandmarkRecords,
    LandmarksAdopted,
    Links,
    Lock,
    Node,
    Output,
    PoseRecord,
    PoseRecords,
    RecordSlice,
    TradeCommitted,
    TradeId,
    WaypointAbandoned,
)
from covey.protocol.records import GENERATION, INCARNATION, OWNER

_ROUNDING = 1e-9


class Violation(CoveyError):
    """An invariant does not hold.

    Parameters
    ----------
    invariant : str
    detail : str
    """

    exit_code = 1

    def __init__(self, invariant: str, detail: str) -> None:
        super().__init__(f"{invariant}: {detail}")
        self.invariant = invariant
        self.detail = detail


def require(holds: bool, invariant: str, detail: str) -> None:
    """Raise `Violation` unless it holds."""
    if not holds:
        raise Violation(invariant, detail)


class Checker:
    """Sees every step of a simulated team, and raises `Violation`.

    Parameters
    ----------
    planner : TablePlanner
    nodes : mapping of agent to Node
        Those that live; the caller keeps it up to date.

    Notes
    -----
    I2 allows two claims on a landmark in two generations, and in one generation that two agents have begun: both come
    of a death that was declared, perhaps wrongly.  I3 speaks of the time between such events: it is checked from step
    to step wherever the newest record of every landmark names a life that lives, nobody claims by an older one, and
    every agent has its newest committed pose or waits to be told of it, and all know the same changes of landmarks and
    agents.
    """

    def __init__(self, planner: TablePlanner, nodes: Mapping[int, Node]) -> None:
        self.planner = planner
        self.nodes = nodes
        self.checked_scores = 0
        self.catalogue = EMPTY
        """All that the operator has changed."""
        self._score = -np.inf
        self._newest = LandmarkRecords.unknown(len(planner.weights))
        self._poses = PoseRecords({})
        self._seen: dict[int, LandmarkRecords] = {}
        self._prepared: dict[int, tuple[TradeId, PoseRecord] | None] = {}
        self._looked: dict[int, tuple[object, ...]] = {}
        self._claims: dict[int, NDArray[np.int64]] = {}
        self._began: dict[tuple[int, int], set[tuple[int, int]]] = {}  # whose lives began (landmark, generation)
        for node in nodes.values():
            self._note_begun(node.records.slice(node.landmarks))
        self._broken: set[TradeId] = set()
        self._committed: set[TradeId] = set()

    def forget(self, agent: int) -> None:
        """Note that an agent has died."""
        for known in (self._seen, self._looked, self._claims, self._prepared):
            known.pop(agent, None)
        self._newest = LandmarkRecords.unknown(len(self.planner.weights))
        self._poses = PoseRecords({})
        for node in self.nodes.values():
            self._merge(node)
        self._score = -np.inf

    def changed(self, catalogue: Catalogue) -> None:
        """Note that the operator has changed something."""
        self.catalogue = catalogue
        self._score = -np.inf

    def broke(self, trade: TradeId) -> None:
        """Note that a server no longer holds to a trade that its client may yet commit."""
        self._broken.add(trade)

    def check(self, agent: int, outputs: Sequence[Output]) -> None:
        """Check I2, I3 and I5 after an agent has done something."""
        node = self.nodes[agent]
        for output in outputs:
            self._note(output)
        prepared = None if node.escrow is None else (node.escrow.trade, node.poses[agent])
        before, self._prepared[agent] = self._prepared.get(agent), prepared
        if before is not None and prepared is not None and before[0] == prepared[0]:
            require(before == prepared, "lock", f"agent {agent} moved in the middle of trade {prepared[0]}")
        looks = (node.epoch, node.escrow, node.records.changes, node.poses.changes)
        if looks == self._looked.get(agent):
            return
        self._looked[agent] = looks
        if agent in self._seen:
            shrunk = np.flatnonzero(node.records.is_behind(self._seen[agent].all()))
            require(len(shrunk) == 0, "I5", f"the records of landmarks {shrunk} shrank at agent {agent}")
        self._seen[agent] = node.records.copy()
        self._merge(node)
        self._claims[agent] = node.claims()
        self._check_claims()
        self._check_score()

    def _note(self, output: Output) -> None:
        if isinstance(output, LandmarksAdopted):
            self._note_begun(output.records)
        if isinstance(output, TradeCommitted):
            self._committed.add(output.trade)
        broken = isinstance(output, TradeCommitted) and output.trade in self._broken
        if broken or isinstance(output, AgentBuried | AgentReturned | LandmarksAdopted | WaypointAbandoned):
            self._score = -np.inf

    def _note_begun(self, records: RecordSlice) -> None:
        for k, record in zip(records.indices.tolist(), records.values.tolist(), strict=True):
            self._began.setdefault((k, record[GENERATION]), set()).add((record[OWNER], record[INCARNATION]))

    def _merge(self, node: Node) -> None:
        self._newest.merge(node.records.all())
        for agent in node.poses:
            self._poses.merge(agent, node.poses[agent])

    def _check_claims(self) -> None:
        claims = np.zeros(len(self._newest), dtype=np.int64)
        for own in self._claims.values():
            claims[own] += 1
        for k in np.flatnonzero(claims > 1).tolist():
            generations = [
                int(self.nodes[agent].records.values[k, GENERATION]) for agent, own in self._claims.items() if k in own
            ]
            for generation in set(generations):
                twice = generations.count(generation) > 1 and len(self._began.get((k, generation), ())) < 2
                require(not twice, "I2", f"landmark {k} is claimed twice in generation {generation}")

    def _check_score(self) -> None:
        if not self._is_calm():
            self._score = -np.inf
            return
        owner = np.where(self._alive(), self._newest.values[:, OWNER], -1)
        score = sum(
            float(self.planner.scores(agent, np.flatnonzero(owner == agent))[round(self._poses.pose(agent).x)])
            for agent in self.nodes
        )
        require(score >= self._score - _ROUNDING, "I3", f"the score fell from {self._score:.6f} to {score:.6f}")
        self.checked_scores += self._score > -np.inf
        self._score = score

    def _is_calm(self) -> bool:
        """Whether the newest records are what the living go by, but for a trade that its server has yet to merge."""
        newest = self._newest.values
        if any(node.catalogue.digest != self.catalogue.digest for node in self.nodes.values()):
            return False  # who does not know of a change yet may trade by what was true before
        lives = {(node.agent, node.sender.incarnation) for node in self.nodes.values()}
        return (
            lives.issuperset(map(tuple, newest[self._alive()][:, [OWNER, INCARNATION]].tolist()))
            and all(np.array_equal(self.nodes[a].records.values[own], newest[own]) for a, own in self._claims.items())
            and all(
                node.poses[agent] == self._poses[agent]
                or (node.escrow is not None and node.escrow.trade in self._committed)
                for agent, node in self.nodes.items()
            )
        )

    def _alive(self) -> NDArray[np.bool_]:
        first = next(iter(self.nodes.values())).records.first
        return self.catalogue.alive(first, len(self._newest))

    def check_end(self, links: Links | None, *, eager: bool) -> None:
        """Check I1 and I4 when the faults have stopped and every agent says that the mission is over."""
        owned = np.zeros(len(self._newest), dtype=np.int64)
        first = next(iter(self.nodes.values()))
        for agent, node in self.nodes.items():
            require(node.lock is Lock.IDLE and node.escrow is None, "I4", f"agent {agent} is in a trade")
            require(np.array_equal(node.records.values, first.records.values), "I4", f"agent {agent} has another map")
            require(set(node.poses) == set(first.poses), "I4", f"agent {agent} knows other poses")
            require(
                all(node.poses[other] == first.poses[other] for other in node.poses), "I4", f"agent {agent}: old poses"
            )
            require(node.catalogue == self.catalogue, "I4", f"agent {agent} has not heard of every change")
            owned[node.claims()] += 1
        wrong = np.flatnonzero(owned != self._alive())
        require(len(wrong) == 0, "I1", f"landmarks {wrong} have not one owner that lives, or are removed and have one")
        for agent, node in self.nodes.items():
            if eager and not node.avoid:  # who holds a pose because it could not reach another keeps it (V8)
                scores = self.planner.scores(agent, node.landmarks)
                gap = float(scores.max() - scores[round(node.pose.x)])
                require(gap <= self.planner.sigma, "Definition 3", f"agent {agent} could see {gap:.6f} more")
        for a, b in itertools.permutations(self.nodes.values(), 2):
            if links is None or links(a.agent, a.pose, b.agent, b.pose):
                mine, theirs = (self.planner.visibility(node.agent, node.pose)[a.landmarks] for node in (a, b))
                better = a.landmarks[mine < theirs - self.planner.sigma]
                require(len(better) == 0, "Definition 3", f"agent {b.agent} sees {better} of agent {a.agent} better")
