"""Fences: the border and the holes of a region, walls of any height that a vehicle's centre stays inside of."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from covey.compiled import kernel
from covey.geometry import Region
from covey.geometry.polygon import contains_point, nearest_on_edges

SLACK = 1e-3
"""Metres by which a reference may be outside: waypoints on the fence itself stay reachable in spite of rounding."""

OPEN = np.empty((0, 4))
"""No fence."""

_contains = kernel(contains_point)
_nearest_on_edges = kernel(nearest_on_edges)


def fence_of(region: Region | None) -> NDArray[np.float64]:
    """Return the edges of a region's border, holes and islands, shape (e, 4), metres; none without a region."""
    return OPEN if region is None else np.ascontiguousarray(region.edges, dtype=np.float64)


@kernel
def fence_room(fence: NDArray[np.float64], x: float, y: float) -> float:
    """Distance of a point to a fence, metres, negative outside it; infinite where there is none.

    Examples
    --------
    >>> fence = fence_of(Region.box(0, 4, 0, 4))
    >>> fence_room(fence, 1.0, 2.0), fence_room(fence, 2.0, 5.0), fence_room(OPEN, 0.0, 0.0)
    (1.0, -1.0, inf)
    """
    if fence.shape[0] == 0:
        return math.inf
    px, py, _edge, _within = _nearest_on_edges(fence, x, y)
    away = math.sqrt((x - px) ** 2 + (y - py) ** 2)
    return away if _contains(fence, x, y) else -away


@kernel
def in_view(fence: NDArray[np.float64], x0: float, y0: float, x1: float, y1: float) -> bool:
    """Whether no edge of a fence crosses the straight line between two points.

    Examples
    --------
    >>> fence = fence_of(Region.polygon([[0, 0], [4, 0], [4, 4], [2, 1], [0, 4]]))
    >>> in_view(fence, 0.5, 2.0, 3.5, 2.0), in_view(fence, 0.5, 0.5, 3.5, 0.5)
    (False, True)
    """
    dx, dy = x1 - x0, y1 - y0
    for k in range(fence.shape[0]):
        ax, ay = fence[k, 0] - x0, fence[k, 1] - y0
        bx, by = fence[k, 2] - x0, fence[k, 3] - y0
        ex, ey = bx - ax, by - ay
        if (dx * ay - dy * ax) * (dx * by - dy * bx) < 0.0:  # its ends lie on both sides of the line
            if (ex * -ay - ey * -ax) * (ex * (dy - ay) - ey * (dx - ax)) < 0.0:
                return False
    return True


@kernel
def _rooms(
    edges: NDArray[np.float64], spans: NDArray[np.int64], positions: NDArray[np.float64], out: NDArray[np.float64]
) -> None:
    for i in range(positions.shape[0]):
        out[i] = fence_room(edges[spans[i, 0] : spans[i, 1]], positions[i, 0], positions[i, 1])


class Fences:
    """One fence a vehicle, packed for kernels.

    Parameters
    ----------
    regions : sequence of Region or None
        Where each vehicle has to stay; None for one that may go anywhere.

    Attributes
    ----------
    edges : array, shape (e, 4)
        Of all fences, frame W, metres.
    spans : array of int, shape (n, 2)
        Edges spans[i, 0] to spans[i, 1] - 1 are those of vehicle i.
    """

    def __init__(self, regions: Sequence[Region | None]) -> None:
        parts: list[NDArray[np.float64]] = []
        known: dict[int, tuple[int, int]] = {}
        end = 0
        self.spans = np.zeros((len(regions), 2), dtype=np.int64)
        for i, region in enumerate(regions):
            if id(region) not in known:
                parts.append(fence_of(region))
                known[id(region)] = end, end + len(parts[-1])
                end += len(parts[-1])
            self.spans[i] = known[id(region)]
        self.edges = np.ascontiguousarray(np.vstack([OPEN, *parts]))

    def __getitem__(self, i: int) -> NDArray[np.float64]:
        begin, end = self.spans[i]
        edges: NDArray[np.float64] = self.edges[begin:end]
        return edges

    def rooms(self, positions_W: NDArray[np.float64]) -> NDArray[np.float64]:
        """Distance of each vehicle to its fence, metres, negative outside: shape (n,).

        Examples
        --------
        >>> fences = Fences([Region.box(0, 4, 0, 4), None])
        >>> fences.rooms(np.array([[1.0, 2.0, 9.0], [7.0, 7.0, 1.0]]))
        array([ 1., inf])
        """
        rooms = np.empty(len(self.spans))
        _rooms(self.edges, self.spans, np.ascontiguousarray(positions_W, dtype=np.float64), rooms)
        return rooms
