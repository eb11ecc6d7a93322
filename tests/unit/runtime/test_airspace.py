"""What obstacles leave of a region at an altitude."""

from __future__ import annotations

import math

import numpy as np
import pytest

from covey.flight.obstacles import Box, Obstacle, Prism, Sphere, clearance, pack
from covey.geometry import Pose2, Region
from covey.runtime.airspace import clear_region, without_disc

FIELD = Region.box(-5, 5, -5, 5)
HERE = Pose2(-4.0, 0.0, 0.0)
OBSTACLES: list[Obstacle] = [
    Sphere((2.0, 2.0, 1.0), 0.8),
    Box((-1.0, -3.0, 0.0), (0.0, 3.0, 2.5)),
    Prism(((2.0, -4.0), (4.0, -4.0), (3.0, -1.0)), 0.0, 5.0),
]


def test_nothing_in_the_way_leaves_the_region_itself() -> None:
    assert clear_region(FIELD, [], 1.0, 0.5, near=HERE) is FIELD
    assert clear_region(FIELD, OBSTACLES, 50.0, 0.5, near=HERE) is FIELD


@pytest.mark.parametrize("altitude", [0.5, 1.5, 2.2, 3.2, 5.2])
def test_what_is_left_keeps_its_distance(altitude: float) -> None:
    """Against the navigator's own measure of clearance, at random points; rounding of corners costs a little room."""
    region = clear_region(FIELD, OBSTACLES, altitude, 0.5, near=HERE)
    assert region is not None
    rows, edges = pack(OBSTACLES)
    rng = np.random.default_rng(0)
    inside = 0
    for x, y in rng.uniform(-5.0, 5.0, (2000, 2)):
        away = clearance(rows, edges, float(x), float(y), altitude)
        if region.contains(x, y):
            inside += 1
            assert away >= 0.48
    assert inside > 500


def test_of_two_parts_the_nearer_is_kept() -> None:
    wall = Box((-0.1, -6.0, 0.0), (0.1, 6.0, 9.0))
    left = clear_region(FIELD, [wall], 1.0, 0.4, near=HERE)
    right = clear_region(FIELD, [wall], 1.0, 0.4, near=Pose2(4.0, 0.0, 0.0))
    assert left is not None
    assert right is not None
    assert left.bounds == pytest.approx((-5.0, -0.5, -5.0, 5.0))
    assert right.bounds == pytest.approx((0.5, 5.0, -5.0, 5.0))


def test_nothing_may_be_left() -> None:
    assert clear_region(FIELD, [Sphere((0.0, 0.0, 0.0), 20.0)], 1.0, 0.4, near=HERE) is None


def test_a_disc_is_taken_out() -> None:
    region = without_disc(FIELD, 1.0, 1.0, 0.6, near=HERE)
    assert region is not None
    assert not region.contains(1.0, 1.0)
    assert FIELD.shape.area - region.shape.area == pytest.approx(math.pi * 0.36, rel=0.03)
