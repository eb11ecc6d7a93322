"""What every visibility model offers."""

from __future__ import annotations

import enum
from typing import Protocol, runtime_checkable

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

    Attributes
    ----------
    name : str
        How mission files and results call the model.
    needs_normals : bool
        Whether landmarks must carry normals.
    maximum : float
        A number that no visibility exceeds.
    lipschitz : tuple of two floats
        (per metre of position, per radian of heading): how fast the visibility of one landmark can change.  The proofs
        of `exact` rest on these two numbers and on `maximum`.

    Notes
    -----
    Source: Sposato (2016), Definition 2, eq. (4.1)-(4.3).  An implementation is checked with
    `covey.testing.check_visibility_model`.
    """

    name: str
    needs_normals: bool
    maximum: float
    lipschitz: tuple[float, float]

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


@runtime_checkable
class CompiledModel(VisibilityModel, Protocol):
    """A built-in model, for which the optimisers have compiled values, gradients and bounds.

    Attributes
    ----------
    kernel : Kernel
    optimal_distance : float
        The distance at which a landmark straight ahead is seen best, metres.
    """

    kernel: Kernel
    optimal_distance: float
