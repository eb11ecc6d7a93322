"""Regions without discs: nothing closer is left, little else is taken, and two points agree who is in whose way."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from covey.geometry import Region
from covey.geometry.region import CORNER

BOX = Region.box(-5, 5, -5, 5)
HOLED = Region.polygon([[-4, -4], [4, -3], [4, 4], [-3, 4]], [[[-1, -2], [2, -1], [1, 1]]])


@pytest.mark.parametrize("region", [BOX, HOLED], ids=["box", "hole"])
def test_what_is_left_keeps_its_distance_and_nothing_else_is_taken(
    region: Region, seeds: Callable[[int, int], range]
) -> None:
    for seed in seeds(10, 300):
        rng = np.random.default_rng(seed)
        radius = rng.uniform(0.2, 2.0)
        centres = rng.uniform(-6, 6, (rng.integers(1, 12), 2))
        left = region.without_discs(centres, radius)
        points = rng.uniform(-5, 5, (400, 2))
        away = np.hypot(*(points[:, None, :] - centres[None, :, :]).transpose(2, 0, 1)).min(axis=1)
        for (x, y), distance in zip(points, away, strict=True):
            inside = left is not None and left.contains(x, y)
            if inside:
                assert region.contains(x, y)
                assert distance >= radius
            elif region.contains(x, y):
                assert distance <= CORNER * radius + 1e-6
        if left is not None:
            agreed = np.array([left.contains(x, y) for x, y in points])
            np.testing.assert_array_equal(left.contains_points(points), agreed)
            for x, y in points[:50]:
                px, py = left.project(x, y)
                assert left.contains(px, py)
                assert np.hypot(centres[:, 0] - px, centres[:, 1] - py).min() >= radius
            drawn = left.sample(50, rng=rng)
            assert left.contains_points(drawn).all()
            x0, x1, y0, y1 = left.bounds
            assert (drawn >= [x0, y0]).all()
            assert (drawn <= [x1, y1]).all()


def test_two_points_agree_whether_they_are_clear_of_each_other() -> None:
    rng = np.random.default_rng(1)
    for _ in range(500):
        first = rng.uniform(-3, 3, 2)
        turn, distance = rng.uniform(-math.pi, math.pi), rng.uniform(0.98, 1.04)
        second = first + distance * np.array([math.cos(turn), math.sin(turn)])
        around_first, around_second = (BOX.without_discs(centre, 1.0) for centre in (first, second))
        assert around_first is not None
        assert around_second is not None
        assert around_first.contains(*second) == around_second.contains(*first)


def test_a_region_may_fall_into_islands() -> None:
    corridor = Region.box(-5, 5, -0.5, 0.5)
    left = corridor.without_discs(np.array([[-2.0, 0.0], [2.0, 0.0]]), 1.0)
    assert left is not None
    assert len(left.islands) == 2
    assert [left.contains(x, 0.0) for x in (-4.0, -2.0, 0.0, 2.0, 4.0)] == [True, False, True, False, True]
    assert left.project(2.2, 0.0)[0] == pytest.approx(3.0, abs=0.02)
    assert left.project(1.8, 0.0)[0] == pytest.approx(1.0, abs=0.02)
    xs = left.sample(300, rng=np.random.default_rng(0))[:, 0]
    assert {int(np.sign(round(x / 2.5))) for x in xs} == {-1, 0, 1}
    assert left.shape.area < corridor.shape.area - 3.0


def test_discs_far_away_leave_the_region_itself_and_a_large_one_nothing() -> None:
    assert BOX.without_discs(np.array([[20.0, 0.0]]), 1.0) is BOX
    assert BOX.without_discs(np.array([[0.0, 0.0]]), 20.0) is None
