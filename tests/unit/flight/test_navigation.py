"""The navigator: arrival, separation, giving up, and the laws that its references obey."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from tests.unit.flight.scenes import (
    CRAZYFLIE,
    DT,
    IRIS,
    Array,
    Plant,
    Scene,
    fly,
    random_scene,
    symmetric_scene,
)

from covey.errors import ArgumentError
from covey.flight.layout import REF_A, REF_J, REF_P, REF_V, REF_YAW, REF_YAW_RATE
from covey.flight.navigation import NavigationOptions, Navigator, Status
from covey.flight.obstacles import Box, Obstacle, Prism, Sphere, clearance, pack
from covey.flight.parameters import load_vehicle

FIGURES = {
    "3.3": Scene(np.array([[0, 0, 1.0], [2, 0, 1]]), np.array([[2, 2, 2.0], [0, 2, 2]])),
    "3.4": Scene(np.array([[0, 0, 1.0], [2, 0, 1], [-2, 0, 1]]), np.array([[0, 3, 3.0], [-2, 3, 3], [2, 3, 3]])),
    "swap": Scene(np.array([[0, 0, 1.0], [2, 0, 1]]), np.array([[2, 0, 1.0], [0, 0, 1]])),
    "vertical swap": Scene(np.array([[0, 0, 1.0], [0, 0, 5]]), np.array([[0, 0, 5.0], [0, 0, 1]])),
}


def check(scene: Scene, *, lag: float = 0.0, noise: float = 0.0, longest: float = 180.0) -> float:
    """Fly a scene: nobody too close, everybody arrives.  Returns the separation."""
    vehicle = load_vehicle(scene.vehicle)
    plant = Plant(scene.starts, lag, noise * vehicle.body_radius)
    navigator = scene.navigator(lag=0.4 + lag) if lag else scene.navigator()
    outcome = fly(
        navigator, plant, ratio=vehicle.vertical_ratio, obstacles=scene.obstacles, longest=longest, linger=5.0
    )
    assert outcome.least_separation >= vehicle.required_separation
    assert outcome.least_clearance > vehicle.body_radius
    assert outcome.all_arrived, outcome.status
    np.testing.assert_allclose(plant.p, scene.goals, atol=0.1 if noise else 0.05)
    return outcome.least_separation


@pytest.mark.parametrize("lag", [0.0, 0.3])
@pytest.mark.parametrize("name", FIGURES)
def test_figures_of_the_thesis(name: str, lag: float) -> None:
    assert check(FIGURES[name], lag=lag, noise=0.02 if lag else 0.0, longest=40.0) >= 0.5


@pytest.mark.parametrize("kind", [*range(24), 6 * 10, 6 * 18, 6 * 18 + 4, 6 * 18 + 5])
def test_symmetric_meetings(kind: int) -> None:
    """Circles to antipodal points and to neighbours, head-on, crossings, lines, one vertical: up to 20 vehicles."""
    check(symmetric_scene(kind))


def test_random_scenes(seeds: Callable[[int, int], range]) -> None:
    for seed in seeds(80, 1000):
        check(random_scene(seed))


def test_random_scenes_with_lag_and_noise(seeds: Callable[[int, int], range]) -> None:
    """First-order lag of 0.25 s, which the navigator is told of; position noise of 2 % of the body radius."""
    for seed in seeds(40, 1000):
        check(random_scene(5000 + seed), lag=0.25, noise=0.02)


@pytest.mark.parametrize("seed", [3, 4, 7, 9])
def test_references_are_feasible_and_continuous(seed: int) -> None:
    scene = random_scene(seed)
    options = NavigationOptions.for_vehicle(load_vehicle(scene.vehicle))
    plant = Plant(scene.starts)
    r = fly(scene.navigator(), plant, ratio=2.0, log=True).references
    p, v, a, j = (r[:, :, c : c + 3] for c in (REF_P, REF_V, REF_A, REF_J))
    most = 2.0 * options.max_acceleration / options.filter_time
    assert np.linalg.norm(v, axis=2).max() <= options.max_speed * (1.0 + 1e-9)
    assert np.linalg.norm(a, axis=2).max() <= options.max_acceleration * (1.0 + 1e-9)
    assert np.linalg.norm(j, axis=2).max() <= most * (1.0 + 1e-9)
    assert np.linalg.norm(v, axis=2).max() > 0.5 * options.max_speed  # else nothing was tested
    # each column is the derivative of the one before, to the order of a step
    assert np.abs(np.diff(p, axis=0) - 0.5 * DT * (v[1:] + v[:-1])).max() <= most * DT**3
    assert np.abs(np.diff(v, axis=0) - 0.5 * DT * (a[1:] + a[:-1])).max() <= most * DT**2
    assert np.abs(np.diff(a, axis=0) - DT * j[1:]).max() <= 0.05 * most * DT
    assert np.abs(np.diff(r[:, :, REF_YAW_RATE], axis=0)).max() <= options.yaw_acceleration * DT * (1.0 + 1e-9)


@pytest.mark.parametrize(("start", "goal"), [(0.0, 1.0), (3.0, -3.0), (-3.0, 3.0), (0.0, math.pi), (1.0, 1.0 + 7.0)])
def test_yaw_turns_the_shorter_way_at_a_limited_rate(start: float, goal: float) -> None:
    navigator = Navigator([IRIS])
    navigator.reset(0, (0, 0, 1), start)
    navigator.set_goal(0, (0, 0, 1), goal)
    p, v = np.array([[0.0, 0, 1]]), np.zeros((1, 3))
    yaws, rates = [start], [0.0]
    for _ in range(1000):
        reference = navigator.step(p, v, DT)
        yaws.append(reference[0, REF_YAW])
        rates.append(reference[0, REF_YAW_RATE])
    turned = np.unwrap(yaws)
    shorter = (goal - start + math.pi) % (2.0 * math.pi) - math.pi
    assert abs(turned[-1] - start) == pytest.approx(abs(shorter), abs=1e-3)
    assert math.cos(turned[-1] - goal) == pytest.approx(1.0, abs=1e-6)
    assert np.abs(rates).max() <= navigator.options[0].max_yaw_rate
    assert np.abs(turned - start).max() <= abs(shorter) + 1e-3
    np.testing.assert_allclose(np.diff(turned), 0.5 * DT * (np.array(rates[1:]) + rates[:-1]), atol=1e-9)


def states(scene: Scene, steps: int = 300) -> Array:
    return fly(scene.navigator(), Plant(scene.starts), ratio=2.0, longest=steps * DT, log=True).references


def test_the_same_scene_flies_the_same_way() -> None:
    np.testing.assert_array_equal(states(random_scene(4)), states(random_scene(4)))


def test_rotating_a_scene_rotates_the_answer() -> None:
    rng = np.random.default_rng(3)
    angles = 2.0 * math.pi * np.arange(5) / 5 + 0.1 * rng.normal(size=5)
    starts = np.column_stack([3 * np.cos(angles), 3 * np.sin(angles), rng.uniform(1, 2, 5)])
    ball = Sphere((0.3, 0.4, 1.5), 0.3)
    c, s = math.cos(0.7), math.sin(0.7)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    x, y, z = turn @ ball.center_W
    plain = Scene(starts, starts * np.array([-1.0, -1.0, 1.0]), (ball,))
    turned = Scene(starts @ turn.T, plain.goals @ turn.T, (Sphere((x, y, z), 0.3),))
    # Routes are searched on a grid along the axes, so compare without one.
    flights = []
    for scene in (plain, turned):
        navigator = scene.navigator()
        for i, goal in enumerate(scene.goals):
            navigator._assign(i, goal, 0.0, goal[np.newaxis])
        flights.append(fly(navigator, Plant(scene.starts), ratio=2.0, longest=4.0, log=True).references)
    np.testing.assert_allclose(flights[0][:, :, :3] @ turn.T, flights[1][:, :, :3], atol=1e-6)


def test_the_order_of_vehicles_does_not_matter() -> None:
    """But for ties; the patience of those that have stalled does depend on it."""
    scene = random_scene(3)
    order = np.random.default_rng(0).permutation(len(scene.starts))
    shuffled = Scene(scene.starts[order], scene.goals[order], scene.obstacles, scene.vehicle)
    np.testing.assert_allclose(states(scene)[:, order], states(shuffled), atol=1e-7)


def test_one_vehicle_alone_computes_the_same_as_the_team() -> None:
    scene = random_scene(7)
    n = len(scene.starts)
    team = scene.navigator()
    alone = [scene.navigator() for _ in range(n)]
    plant = Plant(scene.starts)
    for _ in range(400):
        p, v = plant.measure()
        reference = team.step(p, v, DT)
        for i in range(n):
            np.testing.assert_allclose(alone[i].step_one(i, p, v, DT), reference[i], atol=1e-9)
        plant.follow(reference)


def test_a_vehicle_above_counts_as_nearer_than_one_beside() -> None:
    """Past one that hovers 1.5 m beside the way a vehicle flies straight on, but not past one as far below it."""
    sideways = {}
    for name, offset in (("beside", [0.0, 1.5, 0.0]), ("below", [0.0, 0.0, -1.5])):
        hover = np.array([0.0, 0.0, 3.0]) + offset
        scene = Scene(np.array([[-4.0, 0, 3], hover]), np.array([[4.0, 0, 3], hover]))
        check(scene)
        r = fly(scene.navigator(), Plant(scene.starts), ratio=2.0, log=True).references
        sideways[name] = np.linalg.norm(r[:, :, 1:3] - scene.starts[:, 1:3], axis=2).max()
    assert sideways["beside"] < 0.15
    assert sideways["below"] > 0.2


@pytest.mark.parametrize("distance", [0.0, 1e-12, 0.3, 0.9])
def test_vehicles_that_start_too_close_are_pushed_apart(distance: float) -> None:
    starts = np.array([[0.0, 0.0, 1.5], [distance, 0.0, 1.5]])
    scene = Scene(starts, np.array([[-3.0, 0.0, 1.5], [3.0, 0.0, 1.5]]))
    navigator, plant = scene.navigator(), Plant(starts)
    gaps = []
    for _ in range(1500):
        reference = navigator.step(*plant.measure(), DT)
        assert np.isfinite(reference).all()
        plant.follow(reference)
        gaps.append(float(np.linalg.norm(plant.p[0] - plant.p[1])))
    apart = next(k for k, gap in enumerate(gaps) if gap >= IRIS.required_separation)
    assert np.diff(gaps[: apart + 1]).min() > 0.0
    assert min(gaps[apart:]) >= IRIS.required_separation
    assert navigator.status(0) is navigator.status(1) is Status.ARRIVED_REFERENCE


def test_goals_a_separation_apart_are_reached_exactly() -> None:
    starts = np.array([[0.0, 0, 1.5], [4, 0, 1.5], [0, 4, 1.5], [4, 4, 1.5]])
    goals = IRIS.required_separation * np.array([[1.0, 1, 0], [0, 1, 0], [1, 0, 0], [0, 0, 0]]) + [2, 2, 1.5]
    check(Scene(starts, goals))


def test_a_vehicle_blown_off_is_not_run_away_from() -> None:
    navigator = Navigator([IRIS])
    navigator.reset(0, (0, 0, 2), 0.0)
    navigator.set_goal(0, (8, 0, 2), 0.0)
    p, v = np.array([[0.0, 0, 2]]), np.zeros((1, 3))
    reference = navigator.step(p, v, DT)
    for _ in range(500):
        reference = navigator.step(p, v, DT)  # it does not move at all
    lag = navigator.options[0].tracking_reset
    assert np.linalg.norm(reference[0, :3] - p[0]) <= lag + 2.0 * DT
    reference = navigator.step(p + 50.0, v, DT)
    assert np.linalg.norm(reference[0, :3] - p[0] - 50.0) <= lag + 2.0 * DT


def test_hold_stops_at_once_and_arrives() -> None:
    navigator, plant = FIGURES["swap"].navigator(), Plant(FIGURES["swap"].starts)
    before = plant.p
    for step in range(800):
        if step == 100:
            before = plant.p.copy()
            navigator.hold(0)
            navigator.hold(1)
        plant.follow(navigator.step(*plant.measure(), DT))
    assert np.linalg.norm(plant.p - before, axis=1).max() < 1.5
    assert np.linalg.norm(plant.v) < 1e-3
    assert [navigator.status(i) for i in (0, 1)] == [Status.ARRIVED_REFERENCE] * 2


# --- what cannot be reached ------------------------------------------------------------------------------------------


def ring(x: float, y: float, radius: float, *, gap: int = -1, top: float = 30.0) -> tuple[Obstacle, ...]:
    angles = np.linspace(0.0, 2.0 * math.pi, 13)
    walls = []
    for k in range(12):
        a, b = angles[k], angles[k + 1]
        corners = [(radius, a), (radius + 0.3, a), (radius + 0.3, b), (radius, b)]
        if k != gap:
            walls.append(Prism(tuple((x + r * math.cos(t), y + r * math.sin(t)) for r, t in corners), 0.0, top))
    return tuple(walls)


def test_a_goal_in_a_ring_is_refused_at_once_and_one_behind_an_open_ring_is_reached() -> None:
    start, goal = np.array([[-5.0, 0, 1.5]]), np.array([[0.0, 0, 1.5]])
    closed = Scene(start, goal, ring(0, 0, 2.5)).navigator(ceiling=4.0)
    assert closed.status(0) is Status.BLOCKED
    assert closed.stalled(0)
    outcome = fly(closed, Plant(start), ratio=2.0, longest=5.0)
    assert outcome.status == [Status.BLOCKED]
    over = Scene(start, goal, ring(0, 0, 2.5, top=2.0))
    check(over)
    opened = Scene(start, goal, ring(0, 0, 3.0, gap=0))
    vehicle = fly(opened.navigator(ceiling=4.0), Plant(start), ratio=2.0, obstacles=opened.obstacles)
    assert vehicle.all_arrived
    assert vehicle.least_clearance > IRIS.body_radius


@pytest.mark.parametrize("goal", [(2.0, 0.0, 1.0), (2.6, 0.0, 1.0)])
def test_a_goal_in_an_obstacle_or_too_close_to_it_is_refused_at_once(goal: tuple[float, float, float]) -> None:
    navigator = Navigator([IRIS], [Box((1.5, -1, 0), (2.5, 1, 3))])
    navigator.reset(0, (-2, 0, 1), 0.0)
    navigator.set_goal(0, goal, 0.0)
    assert navigator.status(0) is Status.BLOCKED
    navigator.set_goal(0, (4, 0, 1), 0.0)
    assert navigator.status(0) is Status.FLYING


def test_a_goal_that_is_occupied_is_given_up_and_nobody_collides() -> None:
    """By a vehicle on the ground that is inactive, and by one that hovers there."""
    for active in (False, True):
        navigator = Navigator([IRIS, IRIS])
        navigator.reset(0, (-4, 0, 1.2), 0.0)
        if active:
            navigator.reset(1, (0, 0, 1.2), 0.0)
        navigator.set_goal(0, (0.1, 0, 1.2), 0.0)
        plant = Plant(np.array([[-4.0, 0, 1.2], [0, 0, 1.2 if active else 0.9]]))
        outcome = fly(navigator, plant, ratio=2.0 if active else 1.0, longest=180.0)
        assert outcome.status[0] is Status.BLOCKED
        assert outcome.time < 120.0
        assert outcome.least_separation >= IRIS.required_separation
        hovers = Status.ARRIVED_REFERENCE if active else Status.INACTIVE
        assert outcome.status[1] is hovers


def test_an_obstacle_that_appears_on_the_goal_or_in_the_way() -> None:
    for centre, expected in (((4.0, 0.0, 1.5), Status.BLOCKED), ((2.0, 0.1, 1.5), Status.ARRIVED_REFERENCE)):
        navigator = Navigator([IRIS, IRIS])
        starts = np.array([[-2.0, 0, 1.5], [0, 5, 1.5]])
        for i in range(2):
            navigator.reset(i, starts[i], 0.0)
        navigator.set_goal(0, (4, 0, 1.5), 0.0)
        ball = Sphere(centre, 0.5)

        def appear(t: float, navigator: Navigator = navigator, ball: Sphere = ball) -> None:
            if t == 1.0:
                navigator.add_obstacle(ball)

        plant = Plant(starts)
        outcome = fly(navigator, plant, ratio=2.0, obstacles=[ball], longest=120.0, each=appear)
        assert outcome.status[0] is expected
        assert outcome.least_clearance > IRIS.body_radius
        assert outcome.time < 60.0


def test_a_hovering_vehicle_makes_way_for_a_moving_object_and_comes_back() -> None:
    """Section 3.4.3 with all of the navigator: an object passes through where the vehicle hovers."""
    navigator = Navigator([IRIS], [Sphere((-4.0, 0.0, 1.2), 0.05)])
    navigator.reset(0, (0, 0, 1.2), 0.0)
    plant = Plant(np.array([[0.0, 0, 1.2]]), lag=0.1)
    rooms, away = [], []
    for step in range(2000):
        x = min(-4.0 + 0.5 * step * DT, 4.0)
        navigator.move_obstacle(0, (x, 0.01, 1.2))
        plant.follow(navigator.step(*plant.measure(), DT))
        rooms.append(clearance(*pack([Sphere((x, 0.01, 1.2), 0.05)]), *(float(c) for c in plant.p[0])))
        away.append(float(np.linalg.norm(plant.p[0] - [0, 0, 1.2])))
    assert min(rooms) > IRIS.body_radius
    assert max(away) > 0.3
    assert away[-1] < 0.1


def test_mixed_kinds_keep_the_mean_of_their_separations() -> None:
    navigator = Navigator([IRIS, CRAZYFLIE])
    starts = np.array([[-3.0, 0, 1.5], [3, 0, 1.5]])
    for i in range(2):
        navigator.reset(i, starts[i], 0.0)
        navigator.set_goal(i, starts[1 - i], 0.0)
    outcome = fly(navigator, Plant(starts), ratio=2.5)
    assert outcome.all_arrived
    assert outcome.least_separation >= 0.5 * (IRIS.required_separation + CRAZYFLIE.required_separation)


def test_the_floor_holds_but_for_landing() -> None:
    navigator = Navigator([IRIS, IRIS])
    starts = np.array([[-3.0, 0, 0.7], [3, 0, 0.7]])
    for i in range(2):
        navigator.reset(i, starts[i], 0.0)
        navigator.set_goal(i, starts[1 - i], 0.0)
    plant = Plant(starts)
    outcome = fly(navigator, plant, ratio=2.0, log=True)
    assert outcome.all_arrived
    assert outcome.positions[:, :, 2].min() >= 0.5 - 1e-3
    navigator.set_goal(0, (3, 0, 0.05), 0.0)
    landed = fly(navigator, plant, ratio=2.0, longest=20.0)
    assert landed.all_arrived
    assert plant.p[0, 2] == pytest.approx(0.05, abs=0.03)


def test_wrong_arguments_are_refused() -> None:
    navigator = Navigator([IRIS], [Box((5, 5, 0), (6, 6, 1))])
    p, v = np.zeros((1, 3)), np.zeros((1, 3))
    for call, told in (
        (lambda: Navigator([]), "options"),
        (lambda: Navigator([IRIS], options=[]), "options"),
        (lambda: navigator.set_goal(0, (0, 0, 1), 0.0), "reset it first"),
        (lambda: navigator.reset(0, (0, 0, math.nan), 0.0), "p_W"),
        (lambda: navigator.reset(0, (0, 0, 1), math.inf), "yaw"),
        (lambda: navigator.step(np.zeros((2, 3)), v, DT), "positions_W"),
        (lambda: navigator.step(p, v * math.nan, DT), "velocities_W"),
        (lambda: navigator.step(p, v, 0.0), "dt"),
        (lambda: navigator.move_obstacle(0, (0, 0, 0)), "sphere"),
    ):
        with pytest.raises(ArgumentError, match=told):
            call()
