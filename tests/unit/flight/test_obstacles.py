"""Obstacles: what is refused, and that distances and normals are those of the shapes."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely

from covey.errors import ArgumentError
from covey.flight.obstacles import Box, Obstacle, Prism, Sphere, box_distance, clearance, nearest, pack

SHAPES: list[Obstacle] = [
    Sphere((1.0, -2.0, 0.5), 0.7),
    Box((-1.0, 0.0, 0.2), (2.0, 0.5, 3.0)),
    Prism(((0, 0), (3, 0), (3, 3), (2, 1), (0, 2)), 0.5, 2.0),
    Prism(((0, 2), (2, 1), (3, 3), (3, 0), (0, 0)), -1.0, 0.1),
]


@pytest.mark.parametrize(
    ("make", "name"),
    [
        (lambda: Sphere((0, 0, 0), 0.0), "radius"),
        (lambda: Sphere((0, 0, math.nan), 1.0), "center_W"),
        (lambda: Sphere((0, 0), 1.0), "center_W"),  # type: ignore[arg-type]
        (lambda: Box((0, 0, 0), (1, 0, 1)), "min_W"),
        (lambda: Box((0, 0, 0), (1, math.inf, 1)), "max_W"),
        (lambda: Prism(((0, 0), (1, 0)), 0, 1), "polygon"),
        (lambda: Prism(((0, 0), (1, 1), (1, 0), (0, 1)), 0, 1), "polygon"),
        (lambda: Prism(((0, 0), (1, 0), (2, 0)), 0, 1), "polygon"),
        (lambda: Prism(((0, 0), (1, 0), (0, 1)), 1, 1), "z_min"),
        (lambda: pack(["wall"]), "obstacles"),  # type: ignore[list-item]
    ],
)
def test_what_is_no_obstacle_is_refused(make: object, name: str) -> None:
    with pytest.raises(ArgumentError, match=name):
        make()  # type: ignore[operator]


def exact_distance(obstacle: Obstacle, p: np.ndarray) -> float:
    """Signed distance by other means: shapely in the plane."""
    if isinstance(obstacle, Sphere):
        return float(np.linalg.norm(p - obstacle.center_W)) - obstacle.radius
    if isinstance(obstacle, Box):
        outline = shapely.box(*obstacle.min_W[:2], *obstacle.max_W[:2])
        low, high = obstacle.min_W[2], obstacle.max_W[2]
    else:
        outline, low, high = shapely.Polygon(obstacle.polygon), obstacle.z_min, obstacle.z_max
    point = shapely.Point(p[:2])
    side = point.distance(outline) if not outline.contains(point) else -point.distance(outline.boundary)
    height = max(low - p[2], p[2] - high)
    return float(math.hypot(max(side, 0.0), max(height, 0.0)) + min(max(side, height), 0.0))


@pytest.mark.parametrize("k", range(len(SHAPES)))
def test_distance_and_normal(k: int) -> None:
    rows, edges = pack(SHAPES)
    rng = np.random.default_rng(k)
    for _ in range(400):
        p = rng.uniform(-3.0, 5.0, 3)
        d, *normal = nearest(rows, edges, k, *p)
        assert d == pytest.approx(exact_distance(SHAPES[k], p), abs=1e-9)
        assert np.linalg.norm(normal) == pytest.approx(1.0)
        assert box_distance(rows, k, *p) <= max(d, 0.0) + 1e-9
        step, *_ = nearest(rows, edges, k, *(p + 1e-6 * np.array(normal)))
        assert step - d == pytest.approx(1e-6, rel=1e-3)
        surface, *_ = nearest(rows, edges, k, *(p - d * np.array(normal)))
        assert surface == pytest.approx(0.0, abs=1e-9)


def test_normals_exist_everywhere() -> None:
    rows, edges = pack(SHAPES)
    for k, p in [(0, (1.0, -2.0, 0.5)), (1, (-1.0, 0.25, 1.0)), (1, (2.0, 0.5, 3.0)), (2, (3.0, 3.0, 1.0))]:
        _, *normal = nearest(rows, edges, k, *p)
        assert np.linalg.norm(normal) == pytest.approx(1.0)


def test_clearance_is_that_of_the_nearest() -> None:
    rows, edges = pack(SHAPES)
    rng = np.random.default_rng(9)
    for _ in range(300):
        p = rng.uniform(-3.0, 5.0, 3)
        assert clearance(rows, edges, *p) == pytest.approx(min(exact_distance(s, p) for s in SHAPES), abs=1e-9)
    assert clearance(*pack([]), 0.0, 0.0, 0.0) == math.inf
