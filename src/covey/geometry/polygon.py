"""Scalar predicates on polygons given as an array of directed edges.

Plain functions on purpose: the optimisers compile them, everything else calls them as they are, so that both agree on
which point is inside.  An edge array has shape (e, 4), one row (x0, y0, x1, y1) an edge, all rings of a polygon with
holes in one array.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray


def contains_point(edges: NDArray[np.float64], x: float, y: float) -> bool:
    """Even-odd rule: whether (x, y) is inside; points on an edge may fall either way."""
    inside = False
    for i in range(edges.shape[0]):
        y0 = edges[i, 1]
        y1 = edges[i, 3]
        if (y0 > y) != (y1 > y):
            x0 = edges[i, 0]
            if x < x0 + (y - y0) * (edges[i, 2] - x0) / (y1 - y0):
                inside = not inside
    return inside


def nearest_on_edges(edges: NDArray[np.float64], x: float, y: float) -> tuple[float, float, int, bool]:
    """Nearest point of the boundary: (x, y, edge index, whether it is strictly within that edge)."""
    best = math.inf
    px, py, index, within = x, y, -1, False
    for i in range(edges.shape[0]):
        x0 = edges[i, 0]
        y0 = edges[i, 1]
        dx = edges[i, 2] - x0
        dy = edges[i, 3] - y0
        t = ((x - x0) * dx + (y - y0) * dy) / (dx * dx + dy * dy)
        inner = 0.0 < t < 1.0
        t = min(1.0, max(0.0, t))
        qx = x0 + t * dx
        qy = y0 + t * dy
        d2 = (x - qx) * (x - qx) + (y - qy) * (y - qy)
        if d2 < best:
            best, px, py, index, within = d2, qx, qy, i, inner
    return px, py, index, within
