"""What every visibility model offers."""

from __future__ import annotations

import enum
from typing import Protocol, TypeGuard

import numpy as np
from numpy.typing import NDArray

from covey.environment import Landmarks


class Kernel(enum.IntEnum):
    """Which compiled formulas of `sensing.kernels` a built-in model uses."""

    ANISOTROPIC = 0
    ISOTROPIC = 1
    ORIENTED = 2


class VisibilityModel(Protocol):
    """How well a camera at a pose sees a landmark.

    Notes
    -----
    Source: Sposato (2016), Definition 2, eq. (4.1)-(4.3).  An implementation is checked with
    `covey.testing.check_visibility_model`.
    """

    @property
    def name(self) -> str:
        """How mission files and results call the model."""
        ...

    @property
    def needs_normals(self) -> bool:
        """Whether landmarks must carry normals."""
        ...

    @property
    def maximum(self) -> float:
        """A number that no visibility exceeds."""
        ...

    @property
    def lipschitz(self) -> tuple[float, float]:
        """How fast the visibility of one landmark can change: per metre of position, per radian of heading.

        The proofs of `exact` rest on these two numbers and on `maximum`.
        """
        ...

    def visibility(self, poses: NDArray[np.float64], landmarks: Landmarks) -> NDArray[np.float64]:
        """Visibility of each landmark from each pose.

        Parameters
        ----------
        poses : array, shape (m, 3)
            (x, y, yaw) in W, metres and radians.
        landmarks : Landmarks
            The n landmarks; their weights play no part.

        Returns
        -------
        array, shape (m, n)
            At least 0, at most `maximum`.
        """
        ...


class CompiledModel(VisibilityModel, Protocol):
    """A built-in model, for which the optimisers have compiled values, gradients and bounds."""

    @property
    def kernel(self) -> Kernel:
        """Which compiled formulas are this model's."""
        ...

    @property
    def optimal_distance(self) -> float:
        """Distance at which a landmark straight ahead is seen best, metres."""
        ...


def is_compiled(model: VisibilityModel) -> TypeGuard[CompiledModel]:
    """Whether the compiled formulas are those of this very class; a class that inherits them may see otherwise."""
    return isinstance(vars(type(model)).get("kernel"), Kernel)
