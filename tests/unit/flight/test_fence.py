"""Fences: vehicles stay inside their region's border and out of its holes, and get to waypoints on them."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
import shapely
from tests.unit.flight.scenes import IRIS, Plant, fly

from covey.errors import ArgumentError
from covey.flight.fence import SLACK, Fences, fence_of, fence_room
from covey.flight.navigation import Navigator, Status
from covey.geometry import Region


def random_region(rng: np.random.Generator) -> Region:
    """A star-shaped outline with up to four holes, some of them sharp."""
    angles = np.linspace(0.0, 2.0 * np.pi, int(rng.integers(4, 12)), endpoint=False)
    radii = rng.uniform(5.0, 10.0, len(angles))
    shape = shapely.Polygon(np.column_stack([radii * np.cos(angles), radii * np.sin(angles)]))
    for _ in range(rng.integers(1, 5)):
        x, y = rng.uniform(-4.0, 4.0, 2)
        around = np.sort(rng.uniform(0.0, 2.0 * np.pi, 5))
        hole = shapely.Polygon([(x + 1.5 * math.cos(a), y + 1.5 * math.sin(a)) for a in around])
        rest = shape.difference(hole.convex_hull)
        # what is left hangs together by gaps that a vehicle fits through
        if rest.geom_type == "Polygon" and rest.buffer(-0.3).geom_type == "Polygon":
            shape = rest
    return Region(np.array(shape.exterior.coords)[:-1], tuple(np.array(ring.coords)[:-1] for ring in shape.interiors))


def place(region: Region, rng: np.random.Generator, *, on_edge: bool) -> tuple[float, float]:
    """A point of a region, or of its fence."""
    if not on_edge:
        x, y = (
            region.shape.buffer(-0.3).representative_point().coords[0]
            if rng.random() < 0.2
            else region.sample(1, rng=rng)[0]
        )
        return float(x), float(y)
    x0, y0, x1, y1 = region.edges[rng.integers(len(region.edges))]
    part = rng.random()
    return region.project(float(x0 + part * (x1 - x0)), float(y0 + part * (y1 - y0)))


def test_room_is_the_distance_to_the_boundary(seeds: Callable[[int, int], range]) -> None:
    for seed in seeds(5, 100):
        rng = np.random.default_rng(seed)
        region = random_region(rng)
        for x, y in rng.uniform(-10.0, 10.0, (40, 2)):
            away = region.shape.boundary.distance(shapely.Point(x, y))
            expected = away if region.contains(x, y) else -away
            assert fence_room(fence_of(region), x, y) == pytest.approx(expected, abs=1e-9)


def test_references_stay_inside_and_reach_waypoints_on_the_fence(seeds: Callable[[int, int], range]) -> None:
    for seed in seeds(25, 1000):
        rng = np.random.default_rng(seed)
        region = random_region(rng)
        start, goal = (place(region, rng, on_edge=bool(rng.random() < 0.7)) for _ in range(2))
        navigator = Navigator([IRIS], regions=[region])
        navigator.reset(0, (*start, 1.5), 0.0)
        navigator.set_goal(0, (*goal, 1.5), 1.0)
        outcome = fly(navigator, Plant(np.array([[*start, 1.5]])), ratio=1.0, longest=90.0, log=True)
        assert outcome.status == [Status.ARRIVED_REFERENCE], seed
        rooms = [fence_room(fence_of(region), x, y) for x, y in outcome.positions[:, 0, :2]]
        assert min(rooms) >= -SLACK, seed


def test_several_in_one_region_keep_to_it(seeds: Callable[[int, int], range]) -> None:
    """Also when they push each other aside."""
    region = Region.polygon([[-5, -5], [5, -5], [5, 5], [-5, 5]], [[[-1, -1], [1, -1], [1, 1], [-1, 1]]])
    corners = [(-4.9, -4.9), (4.9, -4.9), (4.9, 4.9), (-4.9, 4.9)]
    for seed in seeds(3, 60):
        order = np.random.default_rng(seed).permutation(4)
        starts = np.array([[*corner, 1.5] for corner in corners])
        navigator = Navigator([IRIS] * 4, regions=[region] * 4)
        for i, start in enumerate(starts):
            navigator.reset(i, start, 0.0)
        for i, start in enumerate(starts[order]):
            navigator.set_goal(i, start, 0.0)
        outcome = fly(navigator, Plant(starts), ratio=1.0, log=True)
        assert outcome.all_arrived
        assert outcome.least_separation >= IRIS.required_separation
        assert min(navigator.fences.rooms(p).min() for p in outcome.positions) >= -SLACK


def test_a_goal_outside_is_blocked_at_once() -> None:
    region = Region.polygon([[-5, -5], [5, -5], [5, 5], [-5, 5]], [[[-1, -1], [1, -1], [1, 1], [-1, 1]]])
    navigator = Navigator([IRIS], regions=[region])
    navigator.reset(0, (-3.0, 0.0, 1.5), 0.0)
    for goal in ((0.0, 0.0, 1.5), (7.0, 0.0, 1.5)):
        navigator.set_goal(0, goal, 0.0)
        assert navigator.stalled(0)


def test_each_vehicle_has_its_own_fence() -> None:
    fences = Fences([Region.box(0, 1, 0, 1), None, Region.box(0, 9, 0, 9)])
    np.testing.assert_array_equal(fences.rooms(np.full((3, 3), 2.0)), [-math.sqrt(2.0), math.inf, 2.0])
    with pytest.raises(ArgumentError, match="regions"):
        Navigator([IRIS], regions=[])
