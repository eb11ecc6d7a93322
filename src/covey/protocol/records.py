"""Who owns each landmark and which pose each agent has committed: records that merge by their maximum.

A merge is commutative, associative and idempotent, so messages may come late, twice or in any order.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from covey.errors import ArgumentError
from covey.geometry import Pose2

GENERATION, VERSION, OWNER, INCARNATION = range(4)
"""Columns of a record, most significant first."""

_SIGNIFICANCE = np.array([8, 4, 2, 1])
"""The first column of two records in which they differ outweighs all that follow."""

NOBODY = -1
"""Owner in a record of generation 0."""

FIRST_GENERATION = 1
"""The generation of a mission's first records; an agent without memory holds generation 0 and never wins."""


class PoseRecord(NamedTuple):
    """The committed pose of one agent.

    Parameters
    ----------
    generation, version : int
        The newer record has the larger pair.  Every commit raises the version, so it also tells whether the agent's
        landmarks changed.
    pose : Pose2
    """

    generation: int
    version: int
    pose: Pose2

    def key(self) -> tuple[float, ...]:
        """Return what the maximum is taken over; the pose itself only makes the order total."""
        return (self.generation, self.version, self.pose.x, self.pose.y, self.pose.yaw)

    def next(self, pose: Pose2) -> PoseRecord:
        """Return the record that follows this one."""
        return PoseRecord(self.generation, self.version + 1, pose)

    def overrule(self, pose: Pose2) -> PoseRecord:
        """Return a record that wins against this one and all that follow it in the same generation."""
        return PoseRecord(self.generation + 1, 0, pose)


class PoseRecords:
    """The newest committed pose known of each agent.

    Parameters
    ----------
    records : mapping of agent to PoseRecord

    Examples
    --------
    >>> poses = PoseRecords.initial({3: Pose2(0.0, 0.0, 0.0)})
    >>> poses.merge(3, poses[3].next(Pose2(1.0, 0.0, 0.0))), poses.pose(3).x
    (True, 1.0)
    """

    def __init__(self, records: Mapping[int, PoseRecord]) -> None:
        self.changes = 0
        """How often a record has been replaced."""
        self._records = dict(records)

    @classmethod
    def initial(cls, poses: Mapping[int, Pose2]) -> PoseRecords:
        """Build the records of a mission's start."""
        return cls({agent: PoseRecord(FIRST_GENERATION, 0, pose) for agent, pose in poses.items()})

    def __getitem__(self, agent: int) -> PoseRecord:
        return self._records[agent]

    def __iter__(self) -> Iterator[int]:
        return iter(self._records)

    def __contains__(self, agent: int) -> bool:
        return agent in self._records

    def as_mapping(self) -> Mapping[int, PoseRecord]:
        """Return a copy of the records by agent."""
        return MappingProxyType(dict(self._records))

    def pose(self, agent: int) -> Pose2:
        """Return the pose of an agent."""
        return self._records[agent].pose

    def copy(self) -> PoseRecords:
        """Return an independent copy."""
        return PoseRecords(self._records)

    def merge(self, agent: int, record: PoseRecord) -> bool:
        """Keep the newer of the known record and this one; return whether it was this one."""
        known = self._records.get(agent)
        if known is not None and (known is record or known.key() >= record.key()):
            return False
        self._records[agent] = record
        self.changes += 1
        return True


@dataclass(frozen=True, eq=False)
class RecordSlice:
    """Records of some landmarks, as messages carry them.

    Parameters
    ----------
    indices : array, shape (k,)
        Landmarks, sorted.
    values : array, shape (k, 4)
        (generation, version, owner, incarnation of the owner) of each.
    """

    indices: NDArray[np.int64]
    values: NDArray[np.int64]

    def __post_init__(self) -> None:
        self.indices.setflags(write=False)
        self.values.setflags(write=False)

    def next(self, owner: int, incarnation: int) -> RecordSlice:
        """Return the records that follow these when all the landmarks go to one owner."""
        values = self.values.copy()
        values[:, VERSION] += 1
        values[:, OWNER] = owner
        values[:, INCARNATION] = incarnation
        return RecordSlice(self.indices, values)

    def adopted_by(self, owner: int, incarnation: int) -> RecordSlice:
        """Return the records with which an agent takes all the landmarks over, one generation above these."""
        values = self.values.copy()
        values[:, GENERATION] += 1
        values[:, VERSION] = 0
        values[:, OWNER] = owner
        values[:, INCARNATION] = incarnation
        return RecordSlice(self.indices, values)

    def select(self, indices: NDArray[np.int64]) -> RecordSlice:
        """Return the records of a sorted subset of the landmarks."""
        return RecordSlice(indices, self.values[np.searchsorted(self.indices, indices)])

    @staticmethod
    def join(first: RecordSlice, second: RecordSlice) -> RecordSlice:
        """Return both slices, of different landmarks, as one."""
        indices = np.concatenate([first.indices, second.indices])
        order = np.argsort(indices)
        return RecordSlice(indices[order], np.concatenate([first.values, second.values])[order])


class LandmarkRecords:
    """The newest ownership record known of each landmark: (generation, version, owner, incarnation).

    Parameters
    ----------
    values : array, shape (n, 4)
        int64, one record a landmark.
    first : int, keyword-only
        How many landmarks the mission began with; all by default.

    Raises
    ------
    ArgumentError
        If the shape is another.

    Notes
    -----
    The merge is the lexicographic maximum of the four columns.  Deviation: V9.

    Examples
    --------
    >>> records = LandmarkRecords.initial(3, {0: np.array([0, 2]), 1: np.array([1])})
    >>> records.owned_by(0, 1)
    array([0, 2])
    >>> records.merge(records.slice(np.array([2])).next(owner=1, incarnation=1))
    array([ True])
    >>> records.owned_by(0, 1)
    array([0])
    """

    def __init__(self, values: NDArray[np.int64], *, first: int | None = None) -> None:
        self.changes = 0
        """How often something has been merged."""
        self.values: NDArray[np.int64] = np.array(values, dtype=np.int64)
        if self.values.ndim != 2 or self.values.shape[1] != 4:
            raise ArgumentError(f"values: expected shape (n, 4), got {self.values.shape}")
        self.first = len(self.values) if first is None else first
        """How many landmarks the mission began with; those beyond were added."""

    @classmethod
    def initial(cls, n: int, partition: Mapping[int, NDArray[np.int64]], *, incarnation: int = 1) -> LandmarkRecords:
        """Build the records of a mission's start from a partition of ``range(n)``.

        Raises
        ------
        ArgumentError
            If a landmark has no owner, two owners, or is not below n.
        """
        values = np.zeros((n, 4), dtype=np.int64)
        values[:, GENERATION] = FIRST_GENERATION
        values[:, INCARNATION] = incarnation
        claims = np.zeros(n, dtype=np.int64)
        for agent, landmarks in partition.items():
            indices = np.asarray(landmarks, dtype=np.int64)
            if indices.size and (indices.min() < 0 or indices.max() >= n):
                raise ArgumentError(f"partition: expected landmarks in [0, {n}), agent {agent} has others")
            np.add.at(claims, indices, 1)
            values[indices, OWNER] = agent
        if (claims != 1).any():
            k = int(np.flatnonzero(claims != 1)[0])
            raise ArgumentError(f"partition: expected each landmark once, landmark {k} is there {claims[k]} times")
        return cls(values)

    @classmethod
    def unknown(cls, n: int) -> LandmarkRecords:
        """Build the records of an agent that has lost its memory: generation 0, which loses to every other."""
        values = np.zeros((n, 4), dtype=np.int64)
        values[:, OWNER] = NOBODY
        return cls(values)

    def __len__(self) -> int:
        return len(self.values)

    def all(self) -> RecordSlice:
        """Return a copy of all records."""
        return RecordSlice(np.arange(len(self.values)), self.values.copy())

    def known(self) -> RecordSlice:
        """Return a copy of the records of all landmarks that anybody has owned."""
        return self.slice(np.flatnonzero(self.values[:, GENERATION] >= FIRST_GENERATION))

    def copy(self) -> LandmarkRecords:
        """Return an independent copy."""
        return LandmarkRecords(self.values, first=self.first)

    def grow(self, n: int) -> None:
        """Have a record for at least n landmarks; of the new ones nothing is known, and they win against nothing."""
        more = n - len(self.values)
        if more > 0:
            unknown = np.zeros((more, 4), dtype=np.int64)
            unknown[:, OWNER] = NOBODY
            self.values = np.concatenate([self.values, unknown])
            self.changes += 1

    def slice(self, indices: NDArray[np.int64]) -> RecordSlice:
        """Return a copy of the records of these landmarks, shape (k,), sorted."""
        return RecordSlice(indices, self.values[indices])

    def owned_by(self, agent: int, incarnation: int) -> NDArray[np.int64]:
        """Return the sorted landmarks of one life of one agent."""
        mine = (self.values[:, OWNER] == agent) & (self.values[:, INCARNATION] == incarnation)
        return np.flatnonzero(mine).astype(np.int64, copy=False)

    def is_behind(self, records: RecordSlice) -> NDArray[np.bool_]:
        """Return, shape (k,), which of these records are newer than the known ones."""
        return _newer(records.values, self._known(records.indices))

    def is_ahead(self, records: RecordSlice) -> NDArray[np.bool_]:
        """Return, shape (k,), for which of these records a newer one is known."""
        return _newer(self._known(records.indices), records.values)

    def merge(self, records: RecordSlice) -> NDArray[np.bool_]:
        """Keep the newer of each known record and the one given; return, shape (k,), where it was the one given."""
        newer = self.is_behind(records)
        self.values[records.indices[newer]] = records.values[newer]
        self.changes += 1
        return newer

    def _known(self, indices: NDArray[np.int64]) -> NDArray[np.int64]:
        if len(indices):
            self.grow(int(indices[-1]) + 1)
        return self.values[indices]


def difference(first: NDArray[np.int64], second: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return what is in the first of two sorted sets of landmarks and not in the second, sorted.

    Examples
    --------
    >>> difference(np.array([0, 2, 3]), np.array([1, 2]))
    array([0, 3])
    """
    if not len(second):
        return first
    kept: NDArray[np.int64] = first[second[np.minimum(np.searchsorted(second, first), len(second) - 1)] != first]
    return kept


def _newer(a: NDArray[np.int64], b: NDArray[np.int64]) -> NDArray[np.bool_]:
    newer: NDArray[np.bool_] = (a > b) @ _SIGNIFICANCE > (a < b) @ _SIGNIFICANCE
    return newer
