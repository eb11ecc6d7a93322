"""A camera that sees nothing: that of a vehicle which can no longer fly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from covey.environment import Landmarks


@dataclass(frozen=True)
class Blind:
    """Sees nothing, so that whatever its agent owns is better off with anybody else.

    Examples
    --------
    >>> Blind().visibility(np.zeros((1, 3)), Landmarks(np.zeros((2, 2))))
    array([[0., 0.]])
    """

    name = "blind"
    needs_normals = False
    maximum = 0.0
    lipschitz = (0.0, 0.0)

    def visibility(self, poses: NDArray[np.float64], landmarks: Landmarks) -> NDArray[np.float64]:
        """Return zeros, shape (m, n), for poses of shape (m, 3) and n landmarks."""
        return np.zeros((len(poses), len(landmarks)))
