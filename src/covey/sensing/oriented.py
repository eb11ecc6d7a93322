"""A camera that inspects surfaces: landmarks have a side to be seen from."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from covey.environment import Landmarks
from covey.errors import ArgumentError
from covey.sensing.base import Kernel
from covey.sensing.frames import check_optimal_distance, in_camera_frame


@dataclass(frozen=True)
class Oriented:
    """Visibility of `Anisotropic` times ``-cos(phi)``, phi the angle from the camera's heading to a landmark's normal.

    It is best when camera and landmark look at each other, and 0 where the landmark is seen from behind.

    Parameters
    ----------
    optimal_distance : float
        Distance at which a landmark straight ahead that faces the camera has visibility 1, metres.

    Notes
    -----
    Source: Sposato (2016), section 6.2.  Deviation: I1, I3.

    Examples
    --------
    >>> wall = Landmarks(np.array([[1.0, 0.0], [1.0, 0.0]]), normals_W=np.array([[-1.0, 0.0], [1.0, 0.0]]))
    >>> Oriented().visibility(np.array([[0.0, 0.0, 0.0]]), wall)
    array([[1., 0.]])
    """

    optimal_distance: float = 1.0

    name: ClassVar[str] = "oriented"
    needs_normals: ClassVar[bool] = True
    maximum: ClassVar[float] = 1.0
    kernel: ClassVar[Kernel] = Kernel.ORIENTED

    def __post_init__(self) -> None:
        check_optimal_distance(self.optimal_distance)

    @property
    def lipschitz(self) -> tuple[float, float]:
        """Change of the visibility at most per metre and per radian."""
        return 1.0 / self.optimal_distance, 1.0

    def visibility(self, poses: NDArray[np.float64], landmarks: Landmarks) -> NDArray[np.float64]:
        """Visibility of each landmark from each pose, shape (m, n); see `VisibilityModel.visibility`."""
        if landmarks.normals_W is None:
            raise ArgumentError("landmarks: the model 'oriented' needs normals, got none")
        ahead, square = in_camera_frame(poses, landmarks, self.optimal_distance)
        heading = np.stack([np.cos(poses[:, 2]), np.sin(poses[:, 2])], axis=1)
        facing = -(heading @ landmarks.normals_W.T)
        return np.maximum(0.0, ahead) * np.maximum(0.0, facing) / np.maximum(1.0, square)
