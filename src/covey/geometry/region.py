"""Where an agent may be: boxes and polygons with holes."""

from __future__ import annotations

import math
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

QUARTER = 4
"""Into how many sides a quarter of a disc is cut where a region is to keep clear of it."""

CORNER = 1.0 / math.cos(math.pi / (4 * QUARTER))
"""How much further than the disc the corners of that polygon reach: it contains the disc."""

CRUMB = 1e-9
"""Parts smaller than this, square metres, are left out of what remains of a region."""

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
    islands : tuple of Region
        Further parts, which must not overlap this one or each other.

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
    islands: tuple[Region, ...] = ()
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
        inner = _inset(polygon)
        if inner.is_empty:
            raise ArgumentError("polygon: expected an area above zero, got a region thinner than rounding")
        object.__setattr__(self, "exterior", _corners(polygon.exterior))
        object.__setattr__(self, "holes", tuple(_corners(ring) for ring in polygon.interiors))
        for name, edges in (("edges", _edges(polygon)), ("inset_edges", _edges(inner))):
            object.__setattr__(self, name, np.vstack([edges, *(getattr(island, name) for island in self.islands)]))

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
        corners = self.edges[:, :2]
        (x0, y0), (x1, y1) = corners.min(axis=0), corners.max(axis=0)
        return float(x0), float(x1), float(y0), float(y1)

    @property
    def is_box(self) -> bool:
        """Whether the region is a box along the axes."""
        sides = self.edges[:, 2:] - self.edges[:, :2]
        return len(sides) == 4 and bool((sides == 0.0).any(axis=1).all())

    @property
    def shape(self) -> shapely.Polygon | shapely.MultiPolygon:
        """The region as a shapely polygon, or several where it has islands."""
        import shapely

        own = shapely.Polygon(self.exterior, self.holes)
        return shapely.MultiPolygon([own, *(island.shape for island in self.islands)]) if self.islands else own

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

    def without_discs(self, centres_W: NDArray[np.float64], radius: float) -> Region | None:
        """Return what is left of the region outside of discs around points, shape (k, 2), metres.

        Each disc is replaced by a polygon that contains it, its corners `CORNER` times as far.  It looks the same after
        half a turn, so that one point keeps clear of another exactly if the other keeps clear of the one.

        Returns
        -------
        Region or None
            The region itself if no disc touches it; None if nothing is left.

        Examples
        --------
        >>> import numpy as np
        >>> left = Region.box(-5, 5, -5, 5).without_discs(np.array([[0.0, 0.0]]), 1.0)
        >>> left.contains(0.999, 0.0), left.contains(1.02, 0.0)
        (False, True)

        Notes
        -----
        Crumbs of less than `CRUMB` square metres, and parts thinner than rounding, are left out.
        """
        import shapely

        points = shapely.points(np.reshape(centres_W, (-1, 2)))
        discs = shapely.buffer(points, radius * CORNER, quad_segs=QUARTER)
        shape = self.shape
        discs = discs[shapely.intersects(discs, shape)]
        if not len(discs):
            return self
        rest = shape.difference(shapely.union_all(discs))
        parts = [
            part
            for part in shapely.get_parts(rest)
            if part.geom_type == "Polygon" and part.area > max(CRUMB, 2.0 * _hair(part) * part.length)
        ]
        if not parts:
            return None
        islands = tuple(_region(part) for part in parts[1:])
        return _region(parts[0], islands)

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
        pieces = shapely.get_parts(self.shape)
        triangles = np.concatenate([shapely.get_parts(shapely.constrained_delaunay_triangles(p)) for p in pieces])
        areas = shapely.area(triangles)
        points = []
        for index in rng.choice(len(triangles), n, p=areas / areas.sum()):
            a, b, c = _corners(triangles[index].exterior)
            u, v = rng.random(2)
            u, v = (u, v) if u + v <= 1.0 else (1.0 - u, 1.0 - v)
            points.append(self.project(*(a + u * (b - a) + v * (c - a))))
        return points


def _region(polygon: shapely.Polygon, islands: tuple[Region, ...] = ()) -> Region:
    return Region(_corners(polygon.exterior), tuple(_corners(ring) for ring in polygon.interiors), islands)


def _inset(polygon: shapely.Polygon) -> shapely.Polygon | shapely.MultiPolygon:
    """Return a polygon a hair's breadth smaller, perhaps in several parts."""
    return polygon.buffer(-_hair(polygon), join_style="mitre")


def _hair(polygon: shapely.Polygon) -> float:
    return INSET * max(1.0, *(abs(float(bound)) for bound in polygon.bounds))


def _corners(ring: shapely.LinearRing) -> NDArray[np.float64]:
    return np.asarray(ring.coords, dtype=np.float64)[:-1, :2].copy()


def _edges(shape: shapely.Polygon | shapely.MultiPolygon) -> NDArray[np.float64]:
    """Edges of all rings, shape (e, 4), one ring after the other."""
    import shapely

    corners, ring = shapely.get_coordinates(shapely.get_rings(shape), return_index=True)
    edges: NDArray[np.float64] = np.hstack([corners[:-1], corners[1:]])[ring[:-1] == ring[1:]]
    return edges
