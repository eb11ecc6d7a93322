"""Landmarks without a living owner: which they are, who takes them over, and when two maps are the same."""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from covey.protocol.catalogue import EMPTY, Catalogue
from covey.protocol.planner import Planner
from covey.protocol.records import FIRST_GENERATION, GENERATION, INCARNATION, OWNER, LandmarkRecords, PoseRecords

_POSE = struct.Struct("<qqqddd")


def orphans(
    records: LandmarkRecords, living: Mapping[int, int], alive: NDArray[np.bool_] | None = None
) -> NDArray[np.int64]:
    """Return the sorted landmarks whose owner is dead, or was an earlier life of an agent, or that nobody ever owned.

    Parameters
    ----------
    records : LandmarkRecords
    living : mapping of agent to int
        The newest known incarnation of each living agent.
    alive : array, shape (n,), optional
        Which landmarks are to be seen; all by default.

    Examples
    --------
    >>> records = LandmarkRecords.initial(3, {0: np.array([0]), 1: np.array([1]), 2: np.array([2])})
    >>> orphans(records, {0: 1, 1: 2})
    array([1, 2])
    """
    owner, incarnation = records.values[:, OWNER], records.values[:, INCARNATION]
    owned = np.zeros(len(records), dtype=np.bool_)
    for agent, life in living.items():
        owned |= (owner == agent) & (incarnation >= life)
    return np.flatnonzero(~owned if alive is None else alive & ~owned)


def adopters(
    planner: Planner,
    records: LandmarkRecords,
    poses: PoseRecords,
    living: Mapping[int, int],
    assigned: NDArray[np.int64] | None = None,
) -> NDArray[np.int64] | None:
    """Return, shape (n,), who takes each landmark over if it has no owner: who sees it best, then the smallest agent.

    A landmark that nobody has owned yet goes to the agent that it is assigned to, if there is one that lives.  None
    while the committed pose of a living agent is not known.
    """
    agents = sorted(living)
    if not all(agent in poses for agent in agents):
        return None
    n = len(records)
    best, seen = np.full(n, agents[0], dtype=np.int64), planner.visibility(agents[0], poses.pose(agents[0]))[:n].copy()
    for agent in agents[1:]:
        visibility = planner.visibility(agent, poses.pose(agent))[:n]
        best[visibility > seen] = agent
        np.maximum(seen, visibility, out=seen)
    if assigned is not None:
        # landmarks that came later are assigned to nobody
        fresh = (records.values[: len(assigned), GENERATION] < FIRST_GENERATION) & np.isin(assigned, agents)
        best[: len(assigned)][fresh] = assigned[fresh]
    return best


def map_digest(records: LandmarkRecords, poses: PoseRecords, catalogue: Catalogue = EMPTY) -> bytes:
    """Return 8 bytes that are the same for two agents whose maps are equal, and else, in practice, differ."""
    digest = hashlib.blake2b(records.values.tobytes(), digest_size=8)
    for agent in sorted(poses):
        generation, version, pose = poses[agent]
        digest.update(_POSE.pack(agent, generation, version, pose.x, pose.y, pose.yaw))
    digest.update(catalogue.digest)
    return digest.digest()
