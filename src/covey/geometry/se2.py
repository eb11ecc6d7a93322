"""Poses in the plane, SE(2)."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from covey.errors import ArgumentError


def wrap_angle(angle: float) -> float:
    """Wrap an angle in radians into [-pi, pi).

    Examples
    --------
    >>> wrap_angle(3 * math.pi)
    -3.141592653589793
    """
    wrapped = math.fmod(angle + math.pi, 2.0 * math.pi)
    if wrapped < 0.0:
        wrapped += 2.0 * math.pi
    result = wrapped - math.pi
    return -math.pi if result >= math.pi else result


@dataclass(frozen=True)
class Pose2:
    """A pose in SE(2), T_W_B: where the body is and where its camera points.

    Parameters
    ----------
    x, y : float
        Position in the world frame W (ENU), metres.
    yaw : float
        Heading, radians, counter-clockwise from the x axis, wrapped into [-pi, pi).

    Raises
    ------
    ArgumentError
        If a coordinate is not finite.

    Notes
    -----
    Source: Sposato (2016), Definition 1.

    Examples
    --------
    >>> Pose2(1.0, 2.0, 0.0).transform(np.array([[1.0, 0.0]]))
    array([[2., 2.]])
    """

    x: float
    y: float
    yaw: float

    def __post_init__(self) -> None:
        for name in ("x", "y", "yaw"):
            value = float(getattr(self, name))
            if not math.isfinite(value):
                raise ArgumentError(f"{name}: expected a finite number, got {value}")
            object.__setattr__(self, name, wrap_angle(value) if name == "yaw" else value)

    @classmethod
    def from_array(cls, array: Iterable[float]) -> Pose2:
        """Build a pose from (x, y, yaw), shape (3,)."""
        x, y, yaw = (float(value) for value in array)
        return cls(x, y, yaw)

    def as_array(self) -> NDArray[np.float64]:
        """Return (x, y, yaw), shape (3,)."""
        return np.array([self.x, self.y, self.yaw])

    @property
    def position_W(self) -> NDArray[np.float64]:
        """Position in W, shape (2,), metres."""
        return np.array([self.x, self.y])

    def matrix(self) -> NDArray[np.float64]:
        """Return T_W_B, shape (3, 3), which maps homogeneous points from B into W."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return np.array([[c, -s, self.x], [s, c, self.y], [0.0, 0.0, 1.0]])

    def compose(self, other: Pose2) -> Pose2:
        """Return self · other."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return Pose2(
            self.x + c * other.x - s * other.y,
            self.y + s * other.x + c * other.y,
            self.yaw + other.yaw,
        )

    def inverse(self) -> Pose2:
        """Return the inverse, T_B_W."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        return Pose2(-c * self.x - s * self.y, s * self.x - c * self.y, -self.yaw)

    def transform(self, points_B: NDArray[np.float64]) -> NDArray[np.float64]:
        """Map points, shape (n, 2), from B into W."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        points_W: NDArray[np.float64] = points_B @ np.array([[c, s], [-s, c]]) + self.position_W
        return points_W
