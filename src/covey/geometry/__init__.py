"""Poses and regions."""

from covey.geometry.region import Region
from covey.geometry.se2 import Pose2, wrap_angle

__all__ = ["Pose2", "Region", "wrap_angle"]
