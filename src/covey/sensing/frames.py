"""Landmarks as the camera sees them."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from covey.environment import Landmarks
from covey.errors import ArgumentError


def check_optimal_distance(optimal_distance: float) -> None:
    """Raise ArgumentError unless the distance is a finite number above zero."""
    if not (math.isfinite(optimal_distance) and optimal_distance > 0.0):
        raise ArgumentError(f"optimal_distance: expected a number of metres above 0, got {optimal_distance}")


def in_camera_frame(
    poses: NDArray[np.float64], landmarks: Landmarks, unit: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return s_x and |s|^2 of each landmark in each camera's frame, both of shape (m, n), in units of `unit` metres.

    `poses` has shape (m, 3): x, y (metres), yaw (radians).
    """
    dx = (landmarks.positions_W[None, :, 0] - poses[:, 0:1]) / unit
    dy = (landmarks.positions_W[None, :, 1] - poses[:, 1:2]) / unit
    ahead = dx * np.cos(poses[:, 2:3]) + dy * np.sin(poses[:, 2:3])
    return ahead, dx * dx + dy * dy
