"""Which agents of a mission can trade with each other, where not all can."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from covey.geometry import Pose2
from covey.mission import Mission
from covey.protocol import Links, between, within


def build_links(mission: Mission) -> Links | None:
    """Return the links of a mission's agents by their index; None where everybody can trade with everybody.

    A link between agents of which one is not in the mission links nobody.
    """
    spec = mission.communication
    if spec is None:
        return None
    if spec.range is not None:
        return within(spec.range)
    index = {agent.name: i for i, agent in enumerate(mission.agents)}
    return between((index[a], index[b]) for a, b in spec.links or () if a in index and b in index)


def link_matrix(mission: Mission, poses: Sequence[Pose2]) -> NDArray[np.bool_] | None:
    """Return which agents are linked at these poses, shape (m, m), false on the diagonal; None for all."""
    links = build_links(mission)
    if links is None:
        return None
    return np.array(
        [[i != j and links(i, pose, j, other) for j, other in enumerate(poses)] for i, pose in enumerate(poses)],
        dtype=np.bool_,
    ).reshape(len(poses), len(poses))
