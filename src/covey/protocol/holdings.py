"""What an agent has: its map of records, its own landmarks and pose, and what it holds in escrow."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from covey.geometry import Pose2
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


class Holdings:
    """The records that one agent knows, and what follows from them for itself.

    Parameters
    ----------
    sender : Sender
        This life of this agent.
    records : LandmarkRecords
        Copied.
    poses : mapping of agent to Pose2

    Notes
    -----
    `epoch` rises with every change of the agent's own pose or landmarks.
    """

    def __init__(self, sender: Sender, records: LandmarkRecords, poses: Mapping[int, Pose2]) -> None:
        self.sender = sender
        self.records = records.copy()
        self.poses = PoseRecords.initial(poses)
        self.escrow: Escrow | None = None
        self.avoid: tuple[Pose2, ...] = ()
        self.epoch = 0
        self._mine = np.zeros(len(records), dtype=np.bool_)
        self._take_stock()

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
        return bool(self._mine[records.indices].any())

    def is_ahead(self, records: RecordSlice) -> bool:
        """Whether a newer record is known for any of these."""
        return bool(self.records.is_ahead(records).any())

    def apply(self, commit: Commit, server: int) -> None:
        """Merge all that a trade changes, in one step."""
        self.records.merge(commit.records)
        self.poses.merge(server, commit.server_pose)
        self.poses.merge(commit.sender.agent, commit.client_pose)
        self._take_stock()

    def commit_pose(self, pose: Pose2) -> None:
        """Commit a pose for this agent itself."""
        self.poses.merge(self.sender.agent, self.pose_record.next(pose))
        self._renew()

    def never_again(self, pose: Pose2) -> None:
        """Remember a pose that could not be reached."""
        self.avoid += (pose,)
        self._renew()

    def _take_stock(self) -> None:
        self.own: RecordSlice = self.records.slice(self.records.owned_by(*self.sender))
        self._mine[:] = False
        self._mine[self.own.indices] = True
        self._renew()

    def _renew(self) -> None:
        self.epoch += 1
        self.state = AgentState(self.sender.agent, self.pose_record.pose, self.own.indices, self.avoid)
