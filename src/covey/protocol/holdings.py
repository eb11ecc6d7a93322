"""What an agent has: its map of records, its own landmarks and pose, and what it holds in escrow."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from covey.geometry import Pose2
from covey.protocol.catalogue import EMPTY, Catalogue
from covey.protocol.messages import Commit, Sender, TradeId
from covey.protocol.planner import AgentState
from covey.protocol.records import LandmarkRecords, PoseRecord, PoseRecords, RecordSlice, difference


@dataclass(frozen=True, eq=False)
class Escrow:
    """What a server has offered: still watched by it, claimed by nobody until the client decides.

    Parameters
    ----------
    trade : TradeId
    landmarks : array, shape (k,)
        Sorted.
    """

    trade: TradeId
    landmarks: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Memory:
    """What a later life of an agent can be started from.

    Parameters
    ----------
    records : LandmarkRecords
    poses : PoseRecords
    avoid : tuple of Pose2
        Poses that the agent could not reach.
    catalogue : Catalogue
        What it knew to have changed since the mission began.
    """

    records: LandmarkRecords
    poses: PoseRecords
    avoid: tuple[Pose2, ...] = ()
    catalogue: Catalogue = EMPTY


class Holdings:
    """The records that one agent knows, and what follows from them for itself.

    Parameters
    ----------
    sender : Sender
        This life of this agent.
    records : LandmarkRecords
        Copied.
    poses : mapping of agent to Pose2, or PoseRecords
        Copied.
    avoid : tuple of Pose2
        Poses that could not be reached.
    catalogue : Catalogue
        What has changed since the mission began.

    Notes
    -----
    `epoch` rises with every change of the agent's own pose or landmarks.
    """

    def __init__(
        self,
        sender: Sender,
        records: LandmarkRecords,
        poses: Mapping[int, Pose2] | PoseRecords,
        avoid: tuple[Pose2, ...] = (),
        catalogue: Catalogue = EMPTY,
    ) -> None:
        self.sender = sender
        self.catalogue = catalogue
        self._alive: NDArray[np.bool_] | None = None
        self.records = records.copy()
        self.records.grow(max(catalogue.landmarks, default=-1) + 1)
        self.poses = poses.copy() if isinstance(poses, PoseRecords) else PoseRecords.initial(poses)
        self.escrow: Escrow | None = None
        self.avoid = avoid
        self.epoch = 0
        self._mine = np.zeros(len(records), dtype=np.bool_)
        self.own: RecordSlice
        self._take_stock()

    @property
    def alive(self) -> NDArray[np.bool_] | None:
        """Which landmarks are known and to be seen, shape (n,); None for all."""
        n = len(self.records)
        if not self.catalogue and n == self.records.first:
            return None
        if self._alive is None or len(self._alive) != n:
            self._alive = self.catalogue.alive(self.records.first, n)
        return self._alive

    @property
    def present(self) -> bool:
        """Whether the agent takes part."""
        return self.catalogue.is_present(self.sender.agent)

    @property
    def pose_record(self) -> PoseRecord:
        """The agent's own pose record."""
        return self.poses[self.sender.agent]

    def claims(self) -> NDArray[np.int64]:
        """Return the sorted landmarks owned and not in escrow."""
        if self.escrow is None:
            return self.own.indices
        return difference(self.own.indices, self.escrow.landmarks)

    def contradicts(self, records: RecordSlice) -> bool:
        """Whether another's own landmarks are among mine: then what it says is old."""
        indices = records.indices
        if len(indices) and indices[-1] >= len(self._mine):
            indices = indices[: np.searchsorted(indices, len(self._mine))]
        return bool(self._mine[indices].any())

    def are_alive(self, landmarks: NDArray[np.int64]) -> bool:
        """Whether all of these, sorted, are known and to be seen."""
        if len(landmarks) and landmarks[-1] >= len(self.records):
            return False
        alive = self.alive
        return alive is None or bool(alive[landmarks].all())

    def change(self, catalogue: Catalogue) -> None:
        """Go by a newer catalogue."""
        self.catalogue, self._alive = catalogue, None
        self.records.grow(max(catalogue.landmarks, default=-1) + 1)
        self.records.changes += 1
        self._take_stock()

    def is_ahead(self, records: RecordSlice) -> bool:
        """Whether a newer record is known for any of these."""
        return bool(self.records.is_ahead(records).any())

    def apply(self, commit: Commit, server: int) -> None:
        """Merge all that a trade changes, in one step."""
        self.records.merge(commit.records)
        self.poses.merge(server, commit.server_pose)
        self.poses.merge(commit.sender.agent, commit.client_pose)
        self._take_stock()

    def learn(self, records: RecordSlice, poses: Mapping[int, PoseRecord]) -> bool:
        """Merge what another knows; return whether the agent's own landmarks changed.

        The agent itself is the authority on its pose: where another knows a newer one, it overrules it.
        """
        for agent, record in poses.items():
            if agent != self.sender.agent:
                self.poses.merge(agent, record)
            elif record.key() > self.pose_record.key():
                self.poses.merge(agent, record.overrule(self.pose_record.pose))
        if not self.records.merge(records).any():
            return False
        before = self.own.indices
        own = self._owned()
        if np.array_equal(before, own):
            self.own = self.records.slice(own)
            return False
        self._take_stock()
        return True

    def adopt(self, landmarks: NDArray[np.int64]) -> RecordSlice:
        """Take landmarks over, one generation up; return their new records."""
        adopted = self.records.slice(landmarks).adopted_by(*self.sender)
        self.records.merge(adopted)
        self._take_stock()
        return adopted

    def overrule_pose(self) -> None:
        """Commit the same pose again so that no other record of it can win."""
        self.poses.merge(self.sender.agent, self.pose_record.overrule(self.pose_record.pose))

    def commit_pose(self, pose: Pose2) -> None:
        """Commit a pose for this agent itself."""
        self.poses.merge(self.sender.agent, self.pose_record.next(pose))
        self._renew()

    def never_again(self, pose: Pose2) -> None:
        """Remember a pose that could not be reached."""
        self.avoid += (pose,)
        self._renew()

    def _owned(self) -> NDArray[np.int64]:
        """Return the sorted landmarks that are the agent's and to be seen."""
        own, alive = self.records.owned_by(*self.sender), self.alive
        if alive is not None:
            own = own[alive[own]]
        return own if self.present else own[:0]

    def _take_stock(self) -> None:
        self.own = self.records.slice(self._owned())
        if len(self._mine) < len(self.records):
            self._mine = np.zeros(len(self.records), dtype=np.bool_)
        self._mine[:] = False
        self._mine[self.own.indices] = True
        self._renew()

    def _renew(self) -> None:
        self.epoch += 1
        self.state = AgentState(self.sender.agent, self.pose_record.pose, self.own.indices, self.avoid)
