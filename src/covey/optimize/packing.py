"""Problems as the arrays that the compiled code works on."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from covey.environment import Landmarks


def landmark_columns(landmarks: Landmarks, thresholds: NDArray[np.float64] | None = None) -> NDArray[np.float64]:
    """Landmarks as rows x, y (metres), normal x, y, weight, threshold: shape (6, n)."""
    columns = np.zeros((6, len(landmarks)))
    columns[:2] = landmarks.positions_W.T
    if landmarks.normals_W is not None:
        columns[2:4] = landmarks.normals_W.T
    columns[4] = landmarks.weights
    if thresholds is not None:
        columns[5] = thresholds
    return columns
