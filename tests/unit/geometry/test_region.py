"""Regions: what they accept, what is inside, and that projection and sampling stay inside."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from covey.errors import ArgumentError
from covey.geometry import Region
from covey.geometry.polygon import contains_point, nearest_on_edges

SQUARE = [[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]]
HOLE = [[1.0, 1.0], [3.0, 1.0], [3.0, 3.0], [1.0, 3.0]]
L_SHAPE = [[0.0, 0.0], [4.0, 0.0], [4.0, 1.0], [1.0, 1.0], [1.0, 4.0], [0.0, 4.0]]

REGIONS = {
    "box": Region.box(-2.0, 3.0, -1.0, 1.0),
    "hole": Region.polygon(SQUARE, [HOLE]),
    "l-shape": Region.polygon(L_SHAPE),
    "far away": Region.polygon([[x + 1e6, y - 1e6] for x, y in SQUARE]),
    "triangle": Region.polygon([[0.0, 0.0], [1.0, 0.1], [0.3, 2.0]]),
}

coordinate = st.floats(-10.0, 10.0, allow_nan=False)


@pytest.fixture(params=sorted(REGIONS))
def region(request: pytest.FixtureRequest) -> Region:
    return REGIONS[request.param]


def test_box_has_its_bounds_and_its_boundary_belongs_to_it() -> None:
    region = Region.box(-5, 5, -4, 4)
    assert region.bounds == (-5.0, 5.0, -4.0, 4.0)
    assert region.contains(5.0, 4.0)
    assert region.contains(-5.0, 0.0)
    assert not region.contains(5.0 + 1e-9, 0.0)


def test_inside_of_a_hole_is_outside() -> None:
    region = REGIONS["hole"]
    assert region.contains(0.5, 2.0)
    assert not region.contains(2.0, 2.0)
    assert region.contains(1.0, 2.0)  # the edge of the hole
    assert region.shape.area == pytest.approx(12.0)


def test_corners_may_run_either_way_and_repeat() -> None:
    clockwise = Region.polygon([*reversed(SQUARE), SQUARE[-1]])
    np.testing.assert_array_equal(np.sort(clockwise.exterior, axis=0), np.sort(np.array(SQUARE), axis=0))
    assert clockwise.shape.equals(Region.polygon(SQUARE).shape)


@pytest.mark.parametrize(
    ("exterior", "holes", "text"),
    [
        ([[0, 0], [1, 1], [1, 0], [0, 1]], [], "Self-intersection"),
        ([[0, 0], [1, 0], [2, 0]], [], "polygon: expected"),
        ([[0, 0], [1, 0]], [], "at least 3 corners"),
        ([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [], r"got shape \(3, 3\)"),
        ([[0, 0], [1, 0], [math.nan, 1]], [], "finite"),
        ([[0, 0], [1, 0], [0, math.inf]], [], "finite"),
        (SQUARE, [[[5, 5], [6, 5], [6, 6]]], "holes inside it"),
        (SQUARE, [SQUARE], "polygon: expected"),
        ([[0, 0], [1, 0], [1, 1e-10], [0, 1e-10]], [], "thinner than rounding"),
    ],
    ids=["crossed", "flat", "two", "3-d", "nan", "infinite", "hole outside", "all hole", "thin"],
)
def test_what_is_no_region_is_refused(exterior: list[list[float]], holes: list[list[list[float]]], text: str) -> None:
    with pytest.raises(ArgumentError, match=text):
        Region.polygon(exterior, holes)


@pytest.mark.parametrize("bounds", [(1, 1, 0, 1), (0, 1, 2, 1), (math.nan, 1, 0, 1)])
def test_box_without_area_is_refused(bounds: tuple[float, float, float, float]) -> None:
    with pytest.raises(ArgumentError, match="expected min < max"):
        Region.box(*bounds)


def test_samples_are_inside_and_fill_the_region(region: Region) -> None:
    points = region.sample(400, rng=np.random.default_rng(5))
    assert points.shape == (400, 2)
    assert all(region.contains(x, y) for x, y in points)
    x0, x1, y0, y1 = region.bounds
    spread = np.ptp(points, axis=0) / [x1 - x0, y1 - y0]
    assert (spread > 0.8).all()


def test_sampling_depends_on_the_generator_alone(region: Region) -> None:
    first, second = (region.sample(7, rng=np.random.default_rng(3)) for _ in range(2))
    np.testing.assert_array_equal(first, second)
    assert region.sample(0, rng=np.random.default_rng(3)).shape == (0, 2)


@given(x=coordinate, y=coordinate, name=st.sampled_from(sorted(set(REGIONS) - {"far away"})))
def test_projection_is_inside_and_nearest(x: float, y: float, name: str) -> None:
    import shapely

    region = REGIONS[name]
    px, py = region.project(x, y)
    assert region.contains(px, py)
    distance = region.shape.distance(shapely.Point(x, y))
    assert math.hypot(px - x, py - y) == pytest.approx(distance, abs=1e-7)
    if distance == 0.0 and region.shape.boundary.distance(shapely.Point(x, y)) > 1e-6:
        assert (px, py) == (x, y)


@pytest.mark.parametrize("x", [-1e7, 0.0, 1e7])
def test_projection_is_inside_far_from_the_origin(region: Region, x: float) -> None:
    assert region.contains(*region.project(x, -x))


def test_corners_project_inside(region: Region) -> None:
    for x, y in np.vstack([region.exterior, *region.holes]):
        px, py = region.project(x, y)
        assert region.contains(px, py)
        assert math.hypot(px - x, py - y) < 1e-8 * max(1.0, abs(x), abs(y)) + 1e-8


@given(x=coordinate, y=coordinate, name=st.sampled_from(sorted(set(REGIONS) - {"far away"})))
def test_even_odd_rule_agrees_with_shapely(x: float, y: float, name: str) -> None:
    import shapely

    region = REGIONS[name]
    point = shapely.Point(x, y)
    if region.shape.boundary.distance(point) > 1e-9:
        assert contains_point(region.edges, x, y) == region.shape.contains(point)


def test_nearest_on_edges_says_whether_it_is_within_an_edge() -> None:
    edges = Region.polygon(SQUARE).edges
    x, y, index, within = nearest_on_edges(edges, 2.0, -1.0)
    assert (x, y, within) == (2.0, 0.0, True)
    assert edges[index, 1] == edges[index, 3] == 0.0
    assert nearest_on_edges(edges, -1.0, -1.0)[:2] == (0.0, 0.0)
    assert not nearest_on_edges(edges, -1.0, -1.0)[3]
