"""A camera that looks all round."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from covey.environment import Landmarks
from covey.sensing.base import Kernel
from covey.sensing.frames import check_optimal_distance, in_camera_frame


@dataclass(frozen=True)
class Isotropic:
    """Visibility ``min(|s|, 1/|s|)``, whatever the heading, s in optimal distances.

    Parameters
    ----------
    optimal_distance : float
        Distance at which a landmark has visibility 1, metres.

    Notes
    -----
    Source: Sposato (2016), eq. (4.2) without its factor for centrality, ``s_x / |s|``.  Deviation: I3.

    Examples
    --------
    >>> camera = Isotropic(optimal_distance=2.0)
    >>> camera.visibility(np.array([[0.0, 0.0, 0.0]]), Landmarks(np.array([[-2.0, 0.0], [0.0, 4.0]])))
    array([[1. , 0.5]])
    """

    optimal_distance: float = 1.0

    name: ClassVar[str] = "isotropic"
    needs_normals: ClassVar[bool] = False
    maximum: ClassVar[float] = 1.0
    kernel: ClassVar[Kernel] = Kernel.ISOTROPIC

    def __post_init__(self) -> None:
        check_optimal_distance(self.optimal_distance)

    @property
    def lipschitz(self) -> tuple[float, float]:
        """Change of the visibility at most per metre and per radian."""
        return 1.0 / self.optimal_distance, 0.0

    def visibility(self, poses: NDArray[np.float64], landmarks: Landmarks) -> NDArray[np.float64]:
        """Visibility of each landmark from each pose, shape (m, n); see `VisibilityModel.visibility`."""
        _, square = in_camera_frame(poses, landmarks, self.optimal_distance)
        distance: NDArray[np.float64] = np.sqrt(square)
        return distance / np.maximum(1.0, square)
