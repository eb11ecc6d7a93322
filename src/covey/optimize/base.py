"""The pose problem and the evidence that comes with an answer to it."""

from __future__ import annotations

import enum
import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from covey.environment import Landmarks
from covey.errors import ArgumentError
from covey.geometry import Pose2, Region
from covey.sensing.base import VisibilityModel


@dataclass(frozen=True, eq=False)
class PoseProblem:
    """Find the pose A in SE(2)_Omega that maximises ``sum_k w_k max(0, vis(A, s_k) - lambda_k)``.

    Parameters
    ----------
    model : VisibilityModel
    landmarks : Landmarks
    region : Region
        Where the position may be.
    thresholds : array, shape (n,), optional
        lambda_k, at least 0; 0 by default, which is the thesis's problem.  With lambda_k the visibility from a
        partner it is the best response to that partner; with multipliers it is the inner problem of the team bound.

    Notes
    -----
    Source: Sposato (2016), eq. (4.4).
    """

    model: VisibilityModel
    landmarks: Landmarks
    region: Region
    thresholds: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        n = len(self.landmarks)
        if self.model.needs_normals and self.landmarks.normals_W is None and n:
            raise ArgumentError(f"landmarks: the model {self.model.name!r} needs normals, got none")
        if self.thresholds is not None:
            if self.thresholds.shape != (n,):
                raise ArgumentError(f"thresholds: expected shape ({n},), got {self.thresholds.shape}")
            if not (self.thresholds >= 0.0).all():
                raise ArgumentError("thresholds: expected numbers of at least 0")

    def score(self, pose: Pose2) -> float:
        """Return the objective at a pose."""
        visibility = self.model.visibility(pose.as_array()[None, :], self.landmarks)[0]
        if self.thresholds is not None:
            visibility = np.maximum(0.0, visibility - self.thresholds)
        return float(visibility @ self.landmarks.weights)


class Status(enum.Enum):
    """What an answer is worth."""

    PROVED = "proved"
    """No pose is better by more than the tolerance asked for; `upper_bound` says how much at most."""
    BUDGET = "budget"
    """The work limit came first; `upper_bound` still holds."""
    LOCAL = "local"
    """The best that was found; nothing is proved and `upper_bound` is infinite."""


@dataclass(frozen=True)
class PoseResult:
    """The best pose that an optimiser found, with its evidence.

    Parameters
    ----------
    pose : Pose2
    score : float
        The objective there, evaluated anew.
    upper_bound : float
        No pose in the region scores more; infinite when nothing is proved.
    status : Status
    evaluations : int
        How often the objective or a bound was computed.
    """

    pose: Pose2
    score: float
    upper_bound: float = math.inf
    status: Status = Status.LOCAL
    evaluations: int = 0

    @property
    def gap(self) -> float:
        """``upper_bound - score``."""
        return self.upper_bound - self.score


class PoseOptimizer(Protocol):
    """Something that solves pose problems: `search`, `exact`, `differential-evolution`."""

    @property
    def name(self) -> str:
        """How missions call it."""
        ...

    def maximize(
        self,
        problem: PoseProblem,
        *,
        start: Pose2 | None = None,
        tolerance: float = 1e-3,
        rng: np.random.Generator,
    ) -> PoseResult:
        """Solve a pose problem.

        Parameters
        ----------
        problem : PoseProblem
        start : Pose2, optional
            A pose to start from; the result is never worse.
        tolerance : float
            The gap asked for, where the optimiser proves one.
        rng : numpy.random.Generator
            The only source of randomness.
        """
        ...
