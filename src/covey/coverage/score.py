"""Coverage scores."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from covey.environment import Landmarks
from covey.errors import ArgumentError
from covey.geometry import Pose2
from covey.sensing import VisibilityModel


def team_visibility(
    models: Sequence[VisibilityModel], poses: Sequence[Pose2], landmarks: Landmarks
) -> NDArray[np.float64]:
    """Visibility of each landmark from each agent, shape (m, n).

    Notes
    -----
    Source: Sposato (2016), eq. (4.3).
    """
    rows = [model.visibility(pose.as_array()[None, :], landmarks)[0] for model, pose in zip(models, poses, strict=True)]
    return np.array(rows).reshape(len(rows), len(landmarks))


def agent_scores(
    visibility: NDArray[np.float64], owner: NDArray[np.int64], weights: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Score of each agent over what it owns, shape (m,).

    Parameters
    ----------
    visibility : array, shape (m, n)
    owner : array, shape (n,)
        Index of each landmark's agent.
    weights : array, shape (n,)

    Raises
    ------
    ArgumentError
        If an owner is not an agent.

    Notes
    -----
    Source: Sposato (2016), eq. (4.4).

    Examples
    --------
    >>> agent_scores(np.array([[0.5, 1.0], [0.0, 0.25]]), np.array([0, 1]), np.ones(2))
    array([0.5 , 0.25])
    """
    m = len(visibility)
    if len(owner) and (owner.min() < 0 or owner.max() >= m):
        raise ArgumentError(f"owner: expected indices from 0 to {m - 1}, got {owner.min()} to {owner.max()}")
    own = visibility[owner, np.arange(len(owner))]
    return np.bincount(owner, weights=own * weights, minlength=m).astype(np.float64)
