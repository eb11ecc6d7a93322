"""Where an agent may be: boxes and polygons with holes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from covey.errors import ArgumentError
from covey.geometry.polygon import contains_point, nearest_on_edges

if TYPE_CHECKING:
    import shapely

INSET = 1e-9
"""How far inside its edges a region's working polygon lies, times its size: rounding never puts a pose outside."""

TRIES = 100
"""Random points tried for each one wanted before a region is cut into triangles."""


@dataclass(frozen=True, eq=False)
class Region:
    """A region Omega of the plane in which an agent's position must stay: a polygon, perhaps with holes.

    Parameters
    ----------
    exterior : array, shape (k, 2)
        Corners of the outline in order, frame W, metres, not closed.
    holes : sequence of arrays, each of shape (k, 2)
        No-fly zones inside the outline.

    Raises
    ------
    ArgumentError
        If the polygon crosses itself, has no area, or is not finite.

    Notes
    -----
    Source: Sposato (2016), section 4.2: SE(2) restricted to Omega.  Build one with `Region.box` or `Region.polygon`.

    Examples
    --------
    >>> region = Region.box(-5, 5, -5, 5)
    >>> region.contains(0.0, 0.0), region.contains(6.0, 0.0)
    (True, False)
    """

    exterior: NDArray[np.float64]
    holes: tuple[NDArray[np.float64], ...] = ()
    edges: NDArray[np.float64] = field(init=False, repr=False)
    inset_edges: NDArray[np.float64] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        import shapely
        from shapely.validation import explain_validity

        rings = [np.asarray(ring, dtype=np.float64) for ring in (self.exterior, *self.holes)]
        for ring in rings:
            if ring.ndim != 2 or ring.shape[1] != 2 or len(ring) < 3:
                raise ArgumentError(f"polygon: expected at least 3 corners [x, y], got shape {ring.shape}")
            if not np.isfinite(ring).all():
                raise ArgumentError("polygon: expected finite coordinates, got NaN or infinity")
        polygon = shapely.Polygon(rings[0], rings[1:])
        if not polygon.is_valid:
            found = explain_validity(polygon)
            raise ArgumentError(f"polygon: expected one simple outline with holes inside it, got {found}")
        if polygon.area <= 0.0:
            raise ArgumentError("polygon: expected an area above zero, got an empty region")
        polygon = shapely.remove_repeated_points(shapely.geometry.polygon.orient(polygon))
        x0, y0, x1, y1 = polygon.bounds
        inner = polygon.buffer(-INSET * max(1.0, abs(x0), abs(x1), abs(y0), abs(y1)), join_style="mitre")
        if inner.is_empty:
            raise ArgumentError("polygon: expected an area above zero, got a region thinner than rounding")
        object.__setattr__(self, "exterior", _corners(polygon.exterior))
        object.__setattr__(self, "holes", tuple(_corners(ring) for ring in polygon.interiors))
        object.__setattr__(self, "edges", _edges([self.exterior, *self.holes]))
        parts = list(inner.geoms) if isinstance(inner, shapely.MultiPolygon) else [inner]
        inner_rings = [_corners(ring) for part in parts for ring in (part.exterior, *part.interiors)]
        object.__setattr__(self, "inset_edges", _edges(inner_rings))

    @classmethod
    def box(cls, x_min: float, x_max: float, y_min: float, y_max: float) -> Region:
        """Build the box [x_min, x_max] x [y_min, y_max], metres."""
        if not (x_min < x_max and y_min < y_max):
            raise ArgumentError(f"box: expected min < max, got x [{x_min}, {x_max}], y [{y_min}, {y_max}]")
        return cls(np.array([[x_min, y_min], [x_max, y_min], [x_max, y_max], [x_min, y_max]], dtype=np.float64))

    @classmethod
    def polygon(cls, exterior: Sequence[Sequence[float]], holes: Sequence[Sequence[Sequence[float]]] = ()) -> Region:
        """Build a polygon from its corners and those of its holes, metres."""
        return cls(np.asarray(exterior, dtype=np.float64), tuple(np.asarray(hole, dtype=np.float64) for hole in holes))

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """(x_min, x_max, y_min, y_max), metres."""
        (x0, y0), (x1, y1) = self.exterior.min(axis=0), self.exterior.max(axis=0)
        return float(x0), float(x1), float(y0), float(y1)

    @property
    def is_box(self) -> bool:
        """Whether the region is a box along the axes."""
        sides = self.edges[:, 2:] - self.edges[:, :2]
        return len(sides) == 4 and bool((sides == 0.0).any(axis=1).all())

    @property
    def shape(self) -> shapely.Polygon:
        """The region as a shapely polygon."""
        import shapely

        return shapely.Polygon(self.exterior, self.holes)

    def contains(self, x: float, y: float) -> bool:
        """Whether (x, y), metres, is in the region; its boundary belongs to it."""
        import shapely

        return bool(self.shape.covers(shapely.Point(x, y)))

    def contains_points(self, points_W: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Whether points, shape (n, 2), metres, are inside, a hair's breadth from the boundary at least: shape (n,)."""
        x, y = points_W[:, 0:1], points_W[:, 1:2]
        x0, y0, x1, y1 = self.inset_edges.T
        with np.errstate(divide="ignore", invalid="ignore"):
            crossing = x0 + (y - y0) * ((x1 - x0) / (y1 - y0))
        crossed = ((y0 > y) != (y1 > y)) & (x < crossing)
        inside: NDArray[np.bool_] = crossed.sum(axis=1) % 2 == 1
        return inside

    def project(self, x: float, y: float) -> tuple[float, float]:
        """Return the point itself when it is inside, else the nearest point of the region, always inside it."""
        if contains_point(self.inset_edges, x, y):
            return x, y
        px, py, _, _ = nearest_on_edges(self.inset_edges, x, y)
        return px, py

    def sample(self, n: int, *, rng: np.random.Generator) -> NDArray[np.float64]:
        """Draw n points uniformly, shape (n, 2), metres."""
        x0, x1, y0, y1 = self.bounds
        points: list[tuple[float, float]] = []
        tries = 0
        while len(points) < n and tries < TRIES * n:
            x, y = rng.uniform(x0, x1), rng.uniform(y0, y1)
            tries += 1
            if contains_point(self.inset_edges, x, y):
                points.append((x, y))
        points += self._sample_triangles(n - len(points), rng=rng)
        return np.array(points, dtype=np.float64).reshape(n, 2)

    def _sample_triangles(self, n: int, *, rng: np.random.Generator) -> list[tuple[float, float]]:
        """Draw n points uniformly where trial and error takes too long: where the bounding box is mostly empty."""
        import shapely

        if n <= 0:
            return []
        triangles = shapely.get_parts(shapely.constrained_delaunay_triangles(self.shape))
        areas = shapely.area(triangles)
        points = []
        for index in rng.choice(len(triangles), n, p=areas / areas.sum()):
            a, b, c = _corners(triangles[index].exterior)
            u, v = rng.random(2)
            u, v = (u, v) if u + v <= 1.0 else (1.0 - u, 1.0 - v)
            points.append(self.project(*(a + u * (b - a) + v * (c - a))))
        return points


def _corners(ring: shapely.LinearRing) -> NDArray[np.float64]:
    return np.asarray(ring.coords, dtype=np.float64)[:-1, :2].copy()


def _edges(rings: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
    return np.ascontiguousarray(np.vstack([np.hstack([ring, np.roll(ring, -1, axis=0)]) for ring in rings]))
