"""Where a vehicle may be at its altitude: the region without what stands in it."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np

from covey.errors import ArgumentError
from covey.flight.obstacles import Box, Obstacle, Prism, Sphere
from covey.geometry import Pose2, Region

if TYPE_CHECKING:
    import shapely


def clear_region(
    region: Region, obstacles: Iterable[Obstacle], altitude: float, clearance: float, *, near: Pose2
) -> Region | None:
    """Return the part of a region around a pose that keeps clear of obstacles at an altitude.

    Parameters
    ----------
    region : Region
    obstacles : iterable of Obstacle
    altitude : float
        Metres.
    clearance : float
        Distance to keep from each obstacle, metres.
    near : Pose2
        Where the vehicle is: of several parts, the one nearest to it is returned.

    Returns
    -------
    Region or None
        The region itself if nothing is in the way, None if nothing is left of it.
    """
    cuts = [shape for obstacle in obstacles if (shape := _cut(obstacle, altitude, clearance)) is not None]
    return _without(region, cuts, near)


def without_disc(region: Region, x: float, y: float, radius: float, *, near: Pose2) -> Region | None:
    """Return a region without a disc, metres: its part around `near`, or None if nothing is left."""
    import shapely

    return _without(region, [shapely.Point(x, y).buffer(radius, quad_segs=6)], near)


def cylinder(x: float, y: float, radius: float, height: float) -> Prism:
    """Return a cylinder that stands on the ground, metres, as a prism of 16 sides around it.

    Raises
    ------
    ArgumentError
        If it is smaller than 0.01 m, or larger than 1000 m.
    """
    for name, value in (("radius", radius), ("height", height)):
        if not 0.01 <= value <= 1000.0:
            raise ArgumentError(f"{name}: expected 0.01 m to 1000 m, got {value:g}")
    sides = 16
    reach = radius / math.cos(math.pi / sides)
    corners = [(x + reach * math.cos(turn), y + reach * math.sin(turn)) for turn in np.arange(sides) * math.tau / sides]
    return Prism(tuple(corners), 0.0, height)


def _cut(obstacle: Obstacle, altitude: float, clearance: float) -> shapely.Geometry | None:
    import shapely

    if isinstance(obstacle, Sphere):
        away = abs(altitude - float(obstacle.center_W[2]))
        reach = obstacle.radius + clearance
        if away >= reach:
            return None
        x, y, _ = obstacle.center_W
        return shapely.Point(x, y).buffer(math.sqrt(reach * reach - away * away), quad_segs=8)
    if isinstance(obstacle, Box):
        (x0, y0, z0), (x1, y1, z1) = obstacle.min_W, obstacle.max_W
        shape = shapely.box(x0, y0, x1, y1)
    else:
        z0, z1 = obstacle.z_min, obstacle.z_max
        shape = shapely.Polygon(obstacle.polygon)
    return shape.buffer(clearance, quad_segs=4) if z0 - clearance < altitude < z1 + clearance else None


def _without(region: Region, cuts: list[shapely.Geometry], near: Pose2) -> Region | None:
    import shapely

    if not cuts:
        return region
    rest = region.shape.difference(shapely.union_all(cuts))
    if rest.equals(region.shape):
        return region
    parts = [part for part in shapely.get_parts(rest) if part.geom_type == "Polygon" and part.area > 1e-6]
    if not parts:
        return None
    here = shapely.Point(near.x, near.y)
    part = min(parts, key=lambda shape: shape.distance(here))
    rings = [np.asarray(ring.coords)[:-1, :2] for ring in (part.exterior, *part.interiors)]
    return Region(rings[0], tuple(rings[1:]))
