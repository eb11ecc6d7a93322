"""What only MuJoCo's simulator has: contacts that are felt, downwash, and what happens when it diverges."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
import shapely
from numpy.typing import NDArray

from covey.errors import ArgumentError, SolverError
from covey.flight.layout import GRAVITY, QUAT, P
from covey.flight.obstacles import Box, Obstacle, Prism, Sphere
from covey.flight.parameters import load_vehicle
from covey.simulators.downwash import AIR_DENSITY, downwash, wash_rows
from covey.simulators.mujoco import MujocoSimulator
from covey.simulators.mujoco_model import build, convex_pieces

IRIS = load_vehicle("iris")
HOVER = (GRAVITY, 0.0, 0.0, 0.0)
NOTCHED = Prism(((-3, -3), (3, -3), (3, -2), (-2, -2), (-2, 3), (-3, 3)), 0.5, 4.0)


def run(simulator: MujocoSimulator, command: tuple[float, ...], seconds: float) -> None:
    for _ in range(round(seconds / 0.01)):
        simulator.step([command] * len(simulator.parameters), 0.01)


def test_the_model_has_exactly_the_mass_and_inertia_of_the_parameters() -> None:
    vehicles = [IRIS, load_vehicle("crazyflie")]
    model = build(vehicles, [], 0.0025).model
    assert model.body_mass[1:].tolist() == [v.mass for v in vehicles]
    assert [tuple(row) for row in model.body_inertia[1:]] == [v.inertia for v in vehicles]
    np.testing.assert_array_equal(model.body_ipos[1:], 0.0)
    np.testing.assert_array_equal(model.body_iquat[1:], [[1.0, 0.0, 0.0, 0.0]] * 2)
    # what a unit thrust of each rotor does to the body, as the mixer says
    wrenches = np.column_stack([model.actuator_gear[:4, 2], *np.zeros((2, 4)), model.actuator_gear[:4, 5]])
    x, y = IRIS.rotor_positions_B.T
    np.testing.assert_allclose(model.site_pos[:4, :2], np.column_stack([x, y]))
    np.testing.assert_allclose(wrenches[:, [0, 3]], IRIS.mixer[[0, 3]].T)


def test_what_is_no_obstacle_is_refused() -> None:
    with pytest.raises(ArgumentError, match="obstacles: expected Sphere, Box or Prism"):
        build([IRIS], ["a tree"], 0.0025)  # type: ignore[list-item]


def test_convex_pieces_are_convex_and_cover_the_prism() -> None:
    assert len(convex_pieces(Prism(((0, 0), (2, 0), (2, 1), (0, 1)), 0.0, 1.0))) == 1
    pieces = [shapely.MultiPoint(corners[: len(corners) // 2, :2]).convex_hull for corners in convex_pieces(NOTCHED)]
    assert len(pieces) > 1
    outline = shapely.Polygon(NOTCHED.polygon)
    assert shapely.union_all(pieces).symmetric_difference(outline).area < 1e-9
    assert sum(piece.area for piece in pieces) == pytest.approx(outline.area)


@pytest.mark.parametrize(
    "obstacle",
    [
        Box((2.0, -3.0, 0.0), (2.2, 3.0, 6.0)),
        Sphere((3.0, 0.0, 2.0), 1.0),
        Prism(((2.0, -3.0), (2.5, -3.0), (2.5, 3.0), (2.0, 3.0)), 0.0, 6.0),
        Prism(
            ((2.0, -3.0), (6.0, -3.0), (6.0, 3.0), (5.5, 3.0), (5.5, -2.0), (2.5, -2.0), (2.5, 3.0), (2.0, 3.0)),
            0.0,
            6.0,
        ),
    ],
    ids=["box", "sphere", "convex prism", "notched prism"],
)
def test_obstacles_stop_a_vehicle(obstacle: Obstacle) -> None:
    simulator = MujocoSimulator([IRIS], [[0.0, 0.0, 2.0]], [0.0], obstacles=[obstacle], aero=False)
    simulator.set_state(0, [0.0, 0.0, 2.0], [3.0, 0.0, 0.0])
    farthest = 0.0
    for _ in range(100):
        run(simulator, HOVER, 0.01)
        farthest = max(farthest, float(simulator.state[0, P]))
    assert farthest < 2.0 - IRIS.body_radius + 0.05
    assert simulator.collisions[0].time == pytest.approx((2.0 - IRIS.body_radius) / 3.0, abs=0.01)
    assert all(collision.other is None for collision in simulator.collisions)


def test_vehicles_push_each_other_and_momentum_stays() -> None:
    simulator = MujocoSimulator([IRIS, IRIS], [[0.0, 0.0, 9.0], [1.0, 0.0, 9.0]], [0.0, 0.0], aero=False)
    simulator.set_state(0, [0.0, 0.0, 9.0], [2.0, 0.0, 0.0])
    run(simulator, HOVER, 0.4)
    assert simulator.state[1, 3] > 0.5
    assert simulator.state[:, 3].sum() == pytest.approx(2.0, abs=0.05)


def test_something_that_bounces_touches_once() -> None:
    floor = Box((-1.0, -1.0, 0.0), (1.0, 1.0, 1.0))
    simulator = MujocoSimulator([IRIS], [[0.0, 0.0, 1.5]], [0.0], obstacles=[floor])
    run(simulator, (0.0, 0.0, 0.0, 0.0), 2.0)
    assert len(simulator.collisions) == 1
    assert simulator.state[0, P + 2] == pytest.approx(1.0 + IRIS.body_height / 2.0, abs=5e-3)
    assert not simulator.grounded[0]


def test_a_vehicle_rests_on_the_ground_however_it_is_put_there() -> None:
    for roll, height in ((0.0, 0.0), (math.pi, IRIS.body_height), (math.pi / 2.0, IRIS.body_radius)):
        simulator = MujocoSimulator([IRIS], [[0.0, 0.0, 1.0]], [0.0])
        quat = [math.cos(roll / 2.0), math.sin(roll / 2.0), 0.0, 0.0]
        simulator.set_state(0, [0.0, 0.0, -0.5], quat_wxyz=quat, hovering=False)
        assert simulator.state[0, P + 2] == pytest.approx(height)
        assert simulator.grounded[0]
        highest = 0.0
        for _ in range(30):
            run(simulator, (0.0, 0.0, 0.0, 0.0), 0.01)
            highest = max(highest, float(simulator.state[0, P + 2]))
        assert highest < height + 0.02


def test_a_vehicle_that_tumbles_does_not_end_the_world() -> None:
    simulator = MujocoSimulator([IRIS] * 4, [[0.4 * i, 0.1 * i, 2.0 + i] for i in range(4)], np.zeros(4))
    for i in range(4):
        simulator.fail_motor(i, i)
    simulator.set_state(3, [0.0, 0.0, 6.0], [0.0, 5.0, -10.0], omega_B=[60.0, -40.0, 30.0])
    for _ in range(500):
        simulator.step(np.tile([15.0, 3.0, -3.0, 1.0], (4, 1)), 0.01)
    state = simulator.state
    assert np.isfinite(state).all()
    np.testing.assert_allclose(np.linalg.norm(state[:, QUAT : QUAT + 4], axis=1), 1.0, atol=1e-9)
    assert state[:, P + 2].max() < 3.0


@pytest.mark.parametrize("thrust_coefficient", [1.0, 1e12])
def test_divergence_is_told_as_an_error(thrust_coefficient: float) -> None:
    absurd = dataclasses.replace(IRIS, thrust_coefficient=thrust_coefficient)
    simulator = MujocoSimulator([IRIS, absurd], [[0.0, 0.0, 5.0], [5.0, 0.0, 5.0]], [0.0, 0.0])
    with pytest.raises(SolverError, match=r"MuJoCo: the motion of vehicle 1 diverges at .* s, state .*physics_step"):
        run(simulator, (1e30, 0.0, 0.0, 0.0), 1.0)


def test_adding_an_obstacle_far_away_does_not_change_the_flight() -> None:
    ends = []
    for add in (False, True):
        simulator = MujocoSimulator([IRIS, IRIS], [[0.0, 0.0, 0.0], [3.0, 0.0, 2.0]], [0.3, 0.0])
        run(simulator, (10.5, 0.2, 0.1, 0.1), 0.5)
        if add:
            simulator.add_obstacle(Sphere((50.0, 0.0, 1.0), 1.0))
        run(simulator, (10.5, -0.2, 0.1, 0.1), 0.5)
        ends.append(simulator.state)
    np.testing.assert_allclose(ends[1], ends[0], atol=1e-9)


def speeds(depth: float, offset: float, thrust: float = IRIS.mass * GRAVITY) -> NDArray[np.float64]:
    air = np.empty(2)
    p_W = np.array([[0.0, 0.0, 10.0], [offset, 0.0, 10.0 - depth]])
    downwash(p_W, np.array([thrust, thrust]), wash_rows([IRIS, IRIS]), air)
    return air


def test_a_wake_keeps_the_momentum_of_the_thrust() -> None:
    thrust, r = 14.0, np.linspace(0.0, 8.0, 2001)
    for depth in (0.5, 1.0, 3.0):
        w = np.array([speeds(depth, offset, thrust)[1] for offset in r])
        momentum = AIR_DENSITY * np.trapezoid(w * w * 2.0 * math.pi * r, r)
        assert momentum == pytest.approx(thrust, rel=1e-3)


def test_downwash_is_strongest_under_a_vehicle_and_vanishes_away() -> None:
    arm = float(np.max(np.hypot(*IRIS.rotor_positions_B.T)))
    disc_area = 4.0 * math.pi * (IRIS.body_radius - arm) ** 2
    induced = math.sqrt(IRIS.mass * GRAVITY / (2.0 * AIR_DENSITY * disc_area))
    below = [speeds(depth, 0.0)[1] for depth in (0.3, 0.6, 1.0, 2.0, 4.0, 20.0)]
    assert below == sorted(below, reverse=True)
    assert 0.5 * induced < below[2] < 2.0 * induced
    aside = [speeds(1.0, offset)[1] for offset in (0.0, 0.2, 0.5, 1.0, 2.0)]
    assert aside == sorted(aside, reverse=True)
    assert aside[-1] < 1e-3
    assert speeds(1.0, 0.0)[0] == 0.0, "nothing blows up"
    assert speeds(-1.0, 0.0)[1] == 0.0, "nothing blows up"
    assert speeds(1e-9, 0.3)[1] < 1e-6, "it sets in without a jump"


def test_downwash_pushes_the_lower_vehicle_down() -> None:
    def sink(offset: float, aero: bool = True) -> float:
        simulator = MujocoSimulator([IRIS, IRIS], [[0.0, 0.0, 6.0], [offset, 0.0, 5.0]], [0.0, 0.0], aero=aero)
        run(simulator, HOVER, 0.2)
        assert simulator.state[0, P + 2] == pytest.approx(6.0, abs=1e-6)
        return 5.0 - float(simulator.state[1, P + 2])

    sinks = [sink(offset) for offset in (0.0, 0.3, 0.8, 3.0)]
    assert sinks == sorted(sinks, reverse=True)
    # between a tenth of the weight and all of it
    assert 0.1 * 0.5 * GRAVITY * 0.2**2 < sinks[0] < 0.5 * GRAVITY * 0.2**2
    assert abs(sinks[-1]) < 1e-6
    assert abs(sink(0.0, aero=False)) < 1e-9
