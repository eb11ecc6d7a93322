"""Visibility models as a user would write them, for tests of what must work with any model."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from covey.environment import Landmarks
from covey.sensing import Anisotropic, VisibilityModel


@dataclass(frozen=True)
class Spotlight:
    """Visibility falls linearly with the distance from the spot that a camera lights ahead of itself."""

    reach: float = 1.0
    radius: float = 1.5

    name: ClassVar[str] = "spotlight"
    needs_normals: ClassVar[bool] = False
    maximum: ClassVar[float] = 1.0

    @property
    def lipschitz(self) -> tuple[float, float]:
        return 1.0 / self.radius, self.reach / self.radius

    def visibility(self, poses: NDArray[np.float64], landmarks: Landmarks) -> NDArray[np.float64]:
        spot = poses[:, :2] + self.reach * np.column_stack([np.cos(poses[:, 2]), np.sin(poses[:, 2])])
        away = np.linalg.norm(landmarks.positions_W[None, :, :] - spot[:, None, :], axis=2)
        seen: NDArray[np.float64] = np.maximum(0.0, 1.0 - away / self.radius)
        return seen


@dataclass(frozen=True)
class Lantern:
    """Shines all round, brightest at the landmark itself, above 1 there; its heading plays no part."""

    brightness: float = 2.5

    name: ClassVar[str] = "lantern"
    needs_normals: ClassVar[bool] = False

    @property
    def maximum(self) -> float:
        return self.brightness

    @property
    def lipschitz(self) -> tuple[float, float]:
        # of b exp(-r^2 / 2): steepest at r = 1
        return self.brightness * math.exp(-0.5), 0.0

    def visibility(self, poses: NDArray[np.float64], landmarks: Landmarks) -> NDArray[np.float64]:
        square = ((landmarks.positions_W[None, :, :] - poses[:, None, :2]) ** 2).sum(axis=2)
        seen: NDArray[np.float64] = self.brightness * np.exp(-0.5 * square)
        return seen


@dataclass(frozen=True)
class BlackBox:
    """A built-in model of which only values and constants are known: no compiled formulas are used for it."""

    model: VisibilityModel = Anisotropic()  # noqa: RUF009

    @property
    def name(self) -> str:
        return f"black box {self.model.name}"

    @property
    def needs_normals(self) -> bool:
        return self.model.needs_normals

    @property
    def maximum(self) -> float:
        return self.model.maximum

    @property
    def lipschitz(self) -> tuple[float, float]:
        return self.model.lipschitz

    def visibility(self, poses: NDArray[np.float64], landmarks: Landmarks) -> NDArray[np.float64]:
        return self.model.visibility(poses, landmarks)
