"""Ways around obstacles: clear of them, short, and none where there is none."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.unit.flight.scenes import random_obstacle

from covey.flight.fence import OPEN
from covey.flight.obstacles import Box, Obstacle, Sphere, clearance, pack
from covey.flight.route import Router, room_at

Array = NDArray[np.float64]


def length(start: Array, route: Array) -> float:
    return float(np.linalg.norm(np.diff(np.vstack([start, route]), axis=0), axis=1).sum())


def least_room(router: Router, start: Array, route: Array, keep_off: float) -> float:
    corners = np.vstack([start, route])
    return min(
        router.room(a + f * (b - a), keep_off)
        for a, b in itertools.pairwise(corners)
        for f in np.linspace(0.0, 1.0, 200)
    )


def test_straight_where_nothing_is_in_the_way() -> None:
    router = Router(pack([Box((0, 3, 0), (1, 4, 5))]), floor=0.5)
    goal = np.array([3.0, 0, 1])
    route = router.route(np.array([-3.0, 0, 1]), goal, 0.5)
    assert route is not None
    np.testing.assert_array_equal(route, [goal])


def test_around_a_wall_the_way_is_nearly_the_shortest() -> None:
    start, goal, keep = np.array([-3.0, 0, 1]), np.array([3.0, 0, 1]), 0.4
    router = Router(pack([Box((-0.1, -9, 0), (0.1, 1, 20))]), floor=0.5, ceiling=3.0)
    route = router.route(start, goal, keep)
    assert route is not None
    around = 2.0 * np.hypot(3.0, 1.0 + keep)
    assert around < length(start, route) < 1.1 * around
    assert least_room(router, start, route, keep) > 0.0


def test_over_a_low_wall_but_not_through_the_ceiling() -> None:
    start, goal, keep = np.array([-3.0, 0, 1]), np.array([3.0, 0, 1]), 0.4
    wall = pack([Box((-0.1, -9, 0), (0.1, 9, 2))])
    route = Router(wall, floor=0.5, ceiling=4.0).route(start, goal, keep)
    assert route is not None
    assert 2.4 <= route[:, 2].max() <= 3.2
    beside = Router(wall, floor=0.5, ceiling=2.2).route(start, goal, keep)
    assert beside is not None
    assert beside[:, 2].max() <= 2.2
    assert np.abs(beside[:, 1]).max() > 9.0


def test_random_routes_are_clear(seeds: Callable[[int, int], range]) -> None:
    found = 0
    for seed in seeds(40, 400):
        rng = np.random.default_rng(seed)
        obstacles: list[Obstacle] = [random_obstacle(rng, 4.0) for _ in range(12)]
        router = Router(pack(obstacles), floor=0.5, ceiling=4.0)
        keep = 0.3
        start, goal = (np.array([*rng.uniform(-5, 5, 2), 1.0]) for _ in range(2))
        if router.room(start, keep) < 0.0:
            continue
        route = router.route(start, goal, keep)
        if router.room(goal, keep) < 0.0:
            assert route is None
        elif route is not None:
            found += len(route) > 1
            np.testing.assert_array_equal(route[-1], goal)
            assert least_room(router, start, route, keep) > -0.02
            assert route[:, 2].max() <= 4.0
            assert route[:, 2].min() >= 0.5
    assert found > 5


def test_a_start_too_close_to_something_is_left() -> None:
    router = Router(pack([Box((-1, -1, 0), (1, 1, 9))]), floor=0.5, ceiling=3.0)
    start = np.array([-1.1, 0.0, 1.0])
    route = router.route(start, np.array([3.0, 0, 1]), 0.5)
    assert route is not None
    assert router.room(route[0], 0.5) > 0.0


def test_vehicles_block_the_way_in_the_scaled_distance() -> None:
    router = Router(pack([]), floor=0.5)
    start, goal = np.array([-3.0, 0, 1]), np.array([3.0, 0, 1])
    blocker = np.array([[0.0, 0.0, 2.5, 1.0, 2.0]])
    assert router.line_is_free(start, goal, 0.4)
    assert not router.line_is_free(start, goal, 0.4, blocker)
    route = router.route(start, goal, 0.4, blocker)
    assert route is not None
    assert np.abs(route[:, 1]).max() > 0.5
    assert router.route(start, goal, 0.4, np.array([[3.0, 0.5, 1.0, 1.0, 2.0]])) is None


def test_a_gap_just_wide_enough_is_found_and_a_narrower_one_is_not() -> None:
    start, goal, keep = np.array([-2.0, 0, 1]), np.array([3.0, 0, 1]), 0.4
    for width, there in ((0.9, True), (0.78, False)):
        court = [
            Box((-4.2, -2.2, 0), (-4.0, 2.2, 9)),
            Box((-4.2, 2.0, 0), (0.2, 2.2, 9)),
            Box((-4.2, -2.2, 0), (0.2, -2.0, 9)),
            Box((0.0, -2.2, 0), (0.2, 0.33, 9)),
            Box((0.0, 0.33 + width, 0), (0.2, 2.2, 9)),
        ]
        route = Router(pack(court), floor=0.5, ceiling=2.0).route(start, goal, keep)
        assert (route is not None) is there


def test_room_never_changes_faster_than_the_point_moves() -> None:
    rng = np.random.default_rng(2)
    obstacles: list[Obstacle] = [random_obstacle(rng, 3.0) for _ in range(8)]
    obstacles.append(Sphere((0.0, 0.0, 1.0), 0.4))
    rows, edges = pack(obstacles)
    blockers = np.array([[1.0, 1.0, 1.0, 0.9, 2.0]])
    for _ in range(2000):
        p = rng.uniform(-4, 4, 3)
        step = rng.normal(scale=0.3, size=3)
        change = room_at(rows, edges, OPEN, blockers, 0.3, *(p + step)) - room_at(rows, edges, OPEN, blockers, 0.3, *p)
        assert abs(change) <= np.linalg.norm(step) * (1.0 + 1e-9)
    assert room_at(rows, edges, OPEN, np.empty((0, 5)), 0.3, 9.0, 9.0, 9.0) == pytest.approx(
        clearance(rows, edges, 9.0, 9.0, 9.0) - 0.3
    )
