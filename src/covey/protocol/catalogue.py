"""What has changed since the mission began: landmarks and agents, as records that merge by their maximum.

An operator writes the records; an agent may write that it leaves itself.  A catalogue holds only what differs from the
mission that every agent began with, so that a mission without changes has an empty one.
"""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from types import MappingProxyType
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

_R = TypeVar("_R", "LandmarkChange", "AgentChange")

_LANDMARK = struct.Struct("<qqq?ddddd")
_AGENT = struct.Struct("<qqq?q")


class LandmarkChange(NamedTuple):
    """The newest word on one landmark.

    Parameters
    ----------
    version : int
        The newer record has the larger one; it rises with every change that an operator makes.
    alive : bool
        Whether it is still to be seen.  One that is removed stays in the catalogue, or it would come back.
    weight : float
        What it is worth.
    x, y : float
        Where it is, metres, frame W.
    normal_x, normal_y : float
        Which way it faces, a unit vector; both 0 for none.
    """

    version: int
    alive: bool
    weight: float
    x: float
    y: float
    normal_x: float = 0.0
    normal_y: float = 0.0


class AgentChange(NamedTuple):
    """The newest word on one agent.

    Parameters
    ----------
    version : int
        The newer record has the larger one.
    present : bool
        Whether it takes part.
    specification : str
        What others must know to reckon with it, as a planner understands it; empty for agents of the mission's file.
    """

    version: int
    present: bool
    specification: str = ""


@dataclass(frozen=True)
class Catalogue:
    """All changes that are known.

    Parameters
    ----------
    landmarks : mapping of int to LandmarkChange
    agents : mapping of int to AgentChange

    Examples
    --------
    >>> removed = Catalogue({4: LandmarkChange(1, False, 0.0, 2.0, 1.0)})
    >>> heavier = Catalogue({4: LandmarkChange(2, True, 5.0, 2.0, 1.0)})
    >>> removed.merged(heavier) == heavier.merged(removed) == heavier
    True
    """

    landmarks: Mapping[int, LandmarkChange] = field(default_factory=lambda: MappingProxyType({}))
    agents: Mapping[int, AgentChange] = field(default_factory=lambda: MappingProxyType({}))

    def __bool__(self) -> bool:
        return bool(self.landmarks or self.agents)

    @property
    def version(self) -> int:
        """The largest version of any record, 0 for none: an operator's next change has one more."""
        return max(
            (record.version for records in (self.landmarks, self.agents) for record in records.values()), default=0
        )

    def merged(self, other: Catalogue) -> Catalogue:
        """Return the newer record of each landmark and agent; this very catalogue if the other adds nothing."""
        landmarks, agents = _newest(self.landmarks, other.landmarks), _newest(self.agents, other.agents)
        if landmarks is self.landmarks and agents is self.agents:
            return self
        return Catalogue(landmarks, agents)

    def alive(self, first: int, count: int) -> NDArray[np.bool_]:
        """Return which landmarks are to be seen, shape (count,), of a mission that began with the `first` ones."""
        alive = np.arange(count) < first
        for k, record in self.landmarks.items():
            if k < count:
                alive[k] = record.alive
        return alive

    def is_present(self, agent: int) -> bool:
        """Whether an agent takes part, as far as the catalogue says."""
        return agent not in self.agents or self.agents[agent].present

    @cached_property
    def digest(self) -> bytes:
        """8 bytes that are the same for equal catalogues; none for an empty one."""
        if not self:
            return b""
        digest = hashlib.blake2b(digest_size=8)
        for k in sorted(self.landmarks):
            digest.update(_LANDMARK.pack(0, k, *self.landmarks[k]))
        for agent in sorted(self.agents):
            version, present, specification = self.agents[agent]
            text = specification.encode()
            digest.update(_AGENT.pack(1, agent, version, present, len(text)) + text)
        return digest.digest()


EMPTY = Catalogue()
"""Of a mission that is as it began."""


def _newest(known: Mapping[int, _R], others: Mapping[int, _R]) -> Mapping[int, _R]:
    newer = {key: record for key, record in others.items() if key not in known or record > known[key]}
    return MappingProxyType({**known, **newer}) if newer else known
