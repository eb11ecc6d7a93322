"""A camera model of your own, for missions to name as ``own_model.py:Spotlight``."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from covey import Landmarks


@dataclass(frozen=True)
class Spotlight:
    """Visibility exp(-|s|²/2w²), s from the spot that the camera points at to the landmark.

    `distance_m` is how far ahead of the camera the spot is, `width_m` is w.
    """

    distance_m: float = 1.0
    width_m: float = 1.0
    name: str = "spotlight"
    needs_normals: bool = False
    maximum: float = 1.0  # no visibility exceeds it

    @property
    def lipschitz(self) -> tuple[float, float]:
        """How fast a visibility can change per metre and per radian; the proofs rest on it."""
        steepest = math.exp(-0.5) / self.width_m
        return steepest, steepest * self.distance_m

    def visibility(self, poses: NDArray[np.float64], landmarks: Landmarks) -> NDArray[np.float64]:
        """Visibility of n landmarks from m poses (x, y, yaw), in metres and radians: shape (m, n)."""
        ahead = np.column_stack([np.cos(poses[:, 2]), np.sin(poses[:, 2])])
        spots = poses[:, :2] + self.distance_m * ahead
        away = landmarks.positions_W[None, :, :] - spots[:, None, :]
        seen: NDArray[np.float64] = np.exp(-(away**2).sum(axis=2) / (2.0 * self.width_m**2))
        return seen
