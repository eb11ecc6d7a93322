"""The thesis's camera: best straight ahead at the optimal distance."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from covey.environment import Landmarks
from covey.sensing.base import Kernel
from covey.sensing.frames import check_optimal_distance, in_camera_frame


@dataclass(frozen=True)
class Anisotropic:
    """Visibility ``s_x min(1, 1/|s|^2)`` ahead of the camera and 0 behind it, s in optimal distances.

    Parameters
    ----------
    optimal_distance : float
        Distance at which a landmark straight ahead has visibility 1, metres.

    Notes
    -----
    Source: Sposato (2016), eq. (4.1)-(4.3).  Deviation: V1, I3.

    Examples
    --------
    >>> camera = Anisotropic()
    >>> camera.visibility(np.array([[0.0, 0.0, 0.0]]), Landmarks(np.array([[0.5, 0.0], [2.0, 0.0], [-1.0, 0.0]])))
    array([[0.5, 0.5, 0. ]])
    """

    optimal_distance: float = 1.0

    name: ClassVar[str] = "anisotropic"
    needs_normals: ClassVar[bool] = False
    maximum: ClassVar[float] = 1.0
    kernel: ClassVar[Kernel] = Kernel.ANISOTROPIC

    def __post_init__(self) -> None:
        check_optimal_distance(self.optimal_distance)

    @property
    def lipschitz(self) -> tuple[float, float]:
        """Change of the visibility at most per metre and per radian."""
        return 1.0 / self.optimal_distance, 1.0

    def visibility(self, poses: NDArray[np.float64], landmarks: Landmarks) -> NDArray[np.float64]:
        """Visibility of each landmark from each pose, shape (m, n); see `VisibilityModel.visibility`."""
        ahead, square = in_camera_frame(poses, landmarks, self.optimal_distance)
        return np.maximum(0.0, ahead) / np.maximum(1.0, square)
