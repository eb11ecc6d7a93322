"""Things to keep clear of: spheres, boxes and prisms, and how far away they are."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from covey.compiled import kernel
from covey.errors import ArgumentError
from covey.geometry.polygon import contains_point, nearest_on_edges

# columns of a packed obstacle: bounding box, then radius (0 for a prism), then its edges [begin, end)
LOW, HIGH, RADIUS, BEGIN, END, ROW = 0, 3, 6, 7, 8, 9

_contains = kernel(contains_point)
_nearest_on_edges = kernel(nearest_on_edges)


def _finite(name: str, values: Sequence[float], n: int) -> tuple[float, ...]:
    numbers = tuple(float(value) for value in values)
    if len(numbers) != n or not all(math.isfinite(number) for number in numbers):
        raise ArgumentError(f"{name}: expected {n} finite numbers (metres), got {values!r}")
    return numbers


@dataclass(frozen=True, slots=True)
class Sphere:
    """A ball; the only obstacle that may move.

    Parameters
    ----------
    center_W : three floats
        Frame W, metres.
    radius : float
        Metres, above zero.

    Raises
    ------
    ArgumentError
        If a number is missing, not finite, or the radius not above zero.
    """

    center_W: tuple[float, float, float]
    radius: float

    def __post_init__(self) -> None:
        x, y, z = _finite("center_W", self.center_W, 3)
        object.__setattr__(self, "center_W", (x, y, z))
        if not (math.isfinite(self.radius) and self.radius > 0.0):
            raise ArgumentError(f"radius: expected metres above zero, got {self.radius!r}")


@dataclass(frozen=True, slots=True)
class Box:
    """A box along the axes of W.

    Parameters
    ----------
    min_W, max_W : three floats
        Opposite corners, frame W, metres.

    Raises
    ------
    ArgumentError
        If a number is missing, not finite, or the box has no volume.
    """

    min_W: tuple[float, float, float]
    max_W: tuple[float, float, float]

    def __post_init__(self) -> None:
        x0, y0, z0 = _finite("min_W", self.min_W, 3)
        x1, y1, z1 = _finite("max_W", self.max_W, 3)
        object.__setattr__(self, "min_W", (x0, y0, z0))
        object.__setattr__(self, "max_W", (x1, y1, z1))
        if not (x0 < x1 and y0 < y1 and z0 < z1):
            raise ArgumentError(f"min_W, max_W: expected min < max along every axis, got {self.min_W}, {self.max_W}")


@dataclass(frozen=True, slots=True)
class Prism:
    """An upright prism, such as a building or a no-fly zone.

    Parameters
    ----------
    polygon : corners (x, y), at least 3
        Outline in order, either way round, not closed, frame W, metres.
    z_min, z_max : float
        Bottom and top, metres.

    Raises
    ------
    ArgumentError
        If a number is not finite, the outline crosses itself or has no area, or z_min >= z_max.
    """

    polygon: tuple[tuple[float, float], ...]
    z_min: float
    z_max: float

    def __post_init__(self) -> None:
        import shapely

        corners = []
        for corner in self.polygon:
            x, y = _finite("polygon", corner, 2)
            corners.append((x, y))
        _finite("z_min, z_max", (self.z_min, self.z_max), 2)
        if self.z_min >= self.z_max:
            raise ArgumentError(f"z_min, z_max: expected z_min < z_max, got {self.z_min}, {self.z_max}")
        shape = shapely.Polygon(corners) if len(corners) >= 3 else shapely.Polygon()
        if shape.is_empty or not shape.is_valid or shape.area <= 0.0:
            raise ArgumentError(
                f"polygon: expected at least 3 corners of an outline that does not cross itself, got {corners}"
            )
        ring = shapely.get_coordinates(shapely.remove_repeated_points(shapely.geometry.polygon.orient(shape)))[:-1]
        object.__setattr__(self, "polygon", tuple((float(x), float(y)) for x, y in ring))


Obstacle: TypeAlias = Sphere | Box | Prism


class PackedObstacles(NamedTuple):
    """Obstacles as kernels want them.

    Parameters
    ----------
    rows : array, shape (m, ROW)
        Bounding box, radius (0 unless a sphere), first and last edge.
    edges : array, shape (e, 4)
        Outlines of boxes and prisms, anticlockwise, frame W, metres.
    """

    rows: NDArray[np.float64]
    edges: NDArray[np.float64]


def pack(obstacles: Sequence[Obstacle]) -> PackedObstacles:
    """Pack obstacles for `nearest` and `clearance`.

    Examples
    --------
    >>> rows, edges = pack([Sphere((0, 0, 1), 0.5), Box((2, -1, 0), (3, 1, 2))])
    >>> distance, *normal = nearest(rows, edges, 0, 0.0, 2.0, 1.0)
    >>> distance, normal
    (1.5, [0.0, 1.0, 0.0])
    >>> clearance(rows, edges, 1.5, 0.0, 1.0)
    0.5
    """
    rows = np.zeros((len(obstacles), ROW))
    edges: list[tuple[float, float, float, float]] = []
    for row, obstacle in zip(rows, obstacles, strict=True):
        if isinstance(obstacle, Sphere):
            place_sphere(row, obstacle)
            continue
        if isinstance(obstacle, Box):
            (x0, y0, z0), (x1, y1, z1) = obstacle.min_W, obstacle.max_W
            corners: Sequence[tuple[float, float]] = [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]
        elif isinstance(obstacle, Prism):
            corners, z0, z1 = obstacle.polygon, obstacle.z_min, obstacle.z_max
        else:
            raise ArgumentError(f"obstacles: expected Sphere, Box or Prism, got {obstacle!r}")
        row[BEGIN] = len(edges)
        edges += [(*a, *b) for a, b in zip(corners, [*corners[1:], corners[0]], strict=True)]
        row[END] = len(edges)
        row[LOW:HIGH] = *np.min(corners, axis=0), z0
        row[HIGH:RADIUS] = *np.max(corners, axis=0), z1
    return PackedObstacles(rows, np.array(edges, dtype=np.float64).reshape(len(edges), 4))


def place_sphere(row: NDArray[np.float64], sphere: Sphere) -> None:
    """Write a sphere into its packed row, shape (ROW,)."""
    row[:] = 0.0
    row[LOW:HIGH] = np.asarray(sphere.center_W) - sphere.radius
    row[HIGH:RADIUS] = np.asarray(sphere.center_W) + sphere.radius
    row[RADIUS] = sphere.radius


@kernel
def box_distance(rows: NDArray[np.float64], k: int, x: float, y: float, z: float) -> float:
    """Distance to an obstacle's bounding box, metres, 0 inside: a quick lower bound."""
    dx = max(rows[k, 0] - x, x - rows[k, 3], 0.0)
    dy = max(rows[k, 1] - y, y - rows[k, 4], 0.0)
    dz = max(rows[k, 2] - z, z - rows[k, 5], 0.0)
    return math.sqrt(dx * dx + dy * dy + dz * dz)


@kernel
def nearest(
    rows: NDArray[np.float64], edges: NDArray[np.float64], k: int, x: float, y: float, z: float
) -> tuple[float, float, float, float]:
    """Distance of a point to the surface of obstacle k, and the direction away from it.

    Parameters
    ----------
    rows, edges : arrays
        As from `pack`.
    k : int
        Which obstacle.
    x, y, z : float
        Point, frame W, metres.

    Returns
    -------
    distance : float
        Metres, negative inside.
    nx, ny, nz : float
        Outward unit normal at the nearest point of the surface; up where there is no single one.
    """
    if rows[k, 6] > 0.0:
        dx = x - 0.5 * (rows[k, 0] + rows[k, 3])
        dy = y - 0.5 * (rows[k, 1] + rows[k, 4])
        dz = z - 0.5 * (rows[k, 2] + rows[k, 5])
        d = math.sqrt(dx * dx + dy * dy + dz * dz)
        if d < 1e-9:
            return -rows[k, 6], 0.0, 0.0, 1.0
        return d - rows[k, 6], dx / d, dy / d, dz / d

    outline = edges[int(rows[k, 7]) : int(rows[k, 8])]
    inside = _contains(outline, x, y)
    px, py, edge, _within = _nearest_on_edges(outline, x, y)
    gx = x - px
    gy = y - py
    side = math.sqrt(gx * gx + gy * gy)
    if side > 1e-9:
        sign = -1.0 if inside else 1.0
        gx *= sign / side
        gy *= sign / side
    else:
        gx = outline[edge, 3] - outline[edge, 1]
        gy = outline[edge, 0] - outline[edge, 2]
        length = math.sqrt(gx * gx + gy * gy)
        gx /= length
        gy /= length
    if inside:
        side = -side
    below = rows[k, 2] - z
    above = z - rows[k, 5]
    height = max(below, above)
    up = 1.0 if above >= below else -1.0
    if side > 0.0 and height > 0.0:
        d = math.sqrt(side * side + height * height)
        return d, gx * side / d, gy * side / d, up * height / d
    if side > height:
        return side, gx, gy, 0.0
    return height, 0.0, 0.0, up


@kernel
def clearance(rows: NDArray[np.float64], edges: NDArray[np.float64], x: float, y: float, z: float) -> float:
    """Distance of a point to the nearest obstacle, metres, negative inside one, infinite when there are none."""
    best = math.inf
    for k in range(rows.shape[0]):
        if box_distance(rows, k, x, y, z) <= max(best, 0.0):
            d, _nx, _ny, _nz = nearest(rows, edges, k, x, y, z)
            best = min(best, d)
    return best
