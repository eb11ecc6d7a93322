"""The reference simulator: ground, contacts, wind, faults, bad input, and the loop closed from anywhere."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from covey.errors import ArgumentError
from covey.flight.backstepping import control_all
from covey.flight.layout import (
    COMMAND,
    GRAVITY,
    OBSERVATION,
    OMEGA,
    QUAT,
    REF_YAW,
    REFERENCE,
    ROTORS,
    SIG_EP,
    SIG_EV,
    SIGNALS,
    V,
)
from covey.flight.obstacles import Box, Sphere
from covey.flight.parameters import load_vehicle, vehicle_names
from covey.flight.rotation import yaw_of
from covey.flight.sensing import SensorNoise
from covey.flight.simulator import Collision, Simulator
from covey.flight.trajectories import Circle, Hold
from covey.flight.wind import Wind
from covey.simulators.reference import ReferenceSimulator

IRIS = load_vehicle("iris")
HOVER = np.array([[GRAVITY, 0.0, 0.0, 0.0]])


def alone(p_W: tuple[float, float, float], **options: object) -> ReferenceSimulator:
    return ReferenceSimulator([IRIS], [p_W], [0.0], **options)  # type: ignore[arg-type]


def hold(simulator: ReferenceSimulator, targets: np.ndarray, seconds: float, yaw: float = 0.0) -> np.ndarray:
    """Hold positions; return positions over time, shape (k, n, 3)."""
    references = np.zeros((len(targets), REFERENCE))
    references[:, :3], references[:, REF_YAW] = targets, yaw
    history = []
    for _ in range(round(seconds / 0.01)):
        simulator.fly(references[None], 0.01)
        history.append(simulator.state[:, :3])
    return np.array(history)


def starts(n: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Places far apart, and states 5 m away at 3 m/s, tilted by up to 60 degrees, yaw at random, turning."""
    rng = np.random.default_rng(seed)
    goals = np.column_stack([20.0 * np.arange(n), np.zeros(n), np.full(n, 50.0)])
    states = np.zeros((n, OBSERVATION))
    for column, size in ((0, 5.0), (V, 3.0)):
        way = rng.standard_normal((n, 3))
        states[:, column : column + 3] = size * way / np.linalg.norm(way, axis=1, keepdims=True)
    states[:, :3] += goals
    tilt, around = np.radians(60.0) * np.sqrt(rng.random(n)), rng.uniform(-np.pi, np.pi, n)
    yaw = rng.uniform(-np.pi, np.pi, n)
    c, s, cy, sy = np.cos(0.5 * tilt), np.sin(0.5 * tilt), np.cos(0.5 * yaw), np.sin(0.5 * yaw)
    states[:, QUAT], states[:, QUAT + 3] = c * cy, c * sy
    states[:, QUAT + 1] = s * (np.cos(around) * cy + np.sin(around) * sy)
    states[:, QUAT + 2] = s * (np.sin(around) * cy - np.cos(around) * sy)
    states[:, OMEGA : OMEGA + 3] = rng.uniform(-1.0, 1.0, (n, 3))
    return goals, states


@pytest.mark.parametrize(("name", "settled"), [("iris", 8.0), ("crazyflie", 10.0)])
def test_recovers_from_any_start_within_the_limits(
    name: str, settled: float, seeds: Callable[[int, int], range]
) -> None:
    vehicle, n = load_vehicle(name), 1000
    limits = vehicle.limits
    for seed in seeds(1, 20):
        goals, states = starts(n, seed)
        simulator = ReferenceSimulator([vehicle] * n, goals, np.zeros(n))
        for i, row in enumerate(states):
            simulator.set_state(i, row[:3], row[V:QUAT], row[QUAT:OMEGA], row[OMEGA:])
        references = np.zeros((1, n, REFERENCE))
        references[0, :, :3] = goals
        recovered, signals = np.zeros(n, dtype=bool), np.empty((n, SIGNALS))
        most_tilt = most_rate = last_away = 0.0
        for k in range(1500):
            commands, signals = simulator.fly(references, 0.01)
            x = simulator.state
            tilt = 2.0 * np.arctan2(np.hypot(x[:, 7], x[:, 8]), np.hypot(x[:, 6], x[:, 9]))
            recovered |= tilt < 0.85 * limits.max_tilt
            most_tilt = max(most_tilt, float(tilt[recovered].max(initial=0.0)))
            most_rate = max(most_rate, float(np.abs(x[:, OMEGA + 2]).max()))
            if signals[:, SIG_EP].max() > 0.05:
                last_away = 0.01 * k
            assert x[:, ROTORS:].min() >= vehicle.rotor_speed_min - 1e-9
            assert x[:, ROTORS:].max() <= vehicle.rotor_speed_max + 1e-9
            assert commands[:, 0].min() >= limits.min_thrust
        assert recovered.all()
        assert most_tilt <= limits.max_tilt, math.degrees(most_tilt)
        assert most_rate <= limits.max_yaw_rate
        assert last_away < settled
        assert signals[:, SIG_EP].max() < 1e-6
        assert signals[:, SIG_EV].max() < 1e-6
        assert not simulator.collisions


@pytest.mark.parametrize("name", vehicle_names())
def test_tracks_the_circle(name: str) -> None:
    vehicle, circle = load_vehicle(name), Circle((0.0, 0.0, 1.5), yaw_rate=0.3)
    simulator = ReferenceSimulator([vehicle], [[1.0, 0.0, 1.5]], [0.0], aero=False)
    worst = []
    for _ in range(1500):
        simulator.fly(np.array([[circle(simulator.time)]]), 0.01)
        worst.append(np.linalg.norm(simulator.state[0, :3] - circle(simulator.time)[:3]))
    # rotor lag and 100 Hz leave some centimetres at 1 m/s
    assert max(worst[1000:]) < 0.06
    heading = simulator.state[0, QUAT:OMEGA]
    assert abs(math.remainder(yaw_of(heading) - 0.3 * simulator.time, 2.0 * math.pi)) < 0.05


def test_takes_off_from_the_ground_and_lands() -> None:
    simulator: Simulator = alone((0.0, 0.0, 0.0))
    assert simulator.grounded[0]
    np.testing.assert_array_equal(simulator.state[0, ROTORS:], 0.0)
    idle = np.zeros((1, COMMAND))
    for _ in range(100):
        simulator.step(idle, 0.01)
    assert simulator.grounded[0]
    np.testing.assert_array_equal(simulator.state[0, :ROTORS], [0.0] * 6 + [1.0] + [0.0] * 6)
    for _ in range(50):
        simulator.step(1.2 * HOVER, 0.01)
    assert not simulator.grounded[0]
    height = simulator.state[0, 2]
    assert 0.1 < height < 0.25  # 0.2 g for half a second, less the lag
    for _ in range(200):
        simulator.step(0.8 * HOVER, 0.01)
    assert simulator.grounded[0]
    np.testing.assert_array_equal(simulator.state[0, 2:6], 0.0)
    assert not simulator.collisions


@pytest.mark.parametrize("goal", [(1.0, 3.0, 2.0), (-20.0, 0.0, 1.0)])
def test_takes_off_towards_a_goal_aside(goal: tuple[float, float, float]) -> None:
    simulator = alone((0.0, 0.0, 0.0))
    path = hold(simulator, np.array([goal]), 16.0, yaw=0.5)
    assert path[:, 0, 2].min() >= 0.0
    # (drag brakes nothing at rest)
    np.testing.assert_allclose(path[-1, 0], goal, atol=1e-3)


def test_a_fall_ends_on_the_ground_and_a_wreck_stays() -> None:
    simulator = alone((0.0, 0.0, 3.0))
    upside_down = (0.0, 1.0, 0.0, 0.0)
    simulator.set_state(0, (0.0, 0.0, 3.0), (1.0, 0.0, 0.0), upside_down, (5.0, 0.0, 0.0), hovering=False)
    for _ in range(150):
        simulator.step(np.zeros((1, COMMAND)), 0.01)
    assert simulator.grounded[0]
    place = simulator.state[0]
    assert place[2] == 0.0
    assert not place[V:QUAT].any()
    hold(simulator, np.array([[0.0, 0.0, 2.0]]), 1.0)
    assert place[QUAT + 1] ** 2 + place[QUAT + 2] ** 2 > 0.25  # it lies
    assert simulator.grounded[0]
    np.testing.assert_array_equal(simulator.state[0, :ROTORS], place[:ROTORS])


def test_step_in_one_or_in_many_is_the_same() -> None:
    one, many = alone((0.0, 0.0, 5.0)), alone((0.0, 0.0, 5.0))
    command = np.array([[10.5, 0.2, -0.3, 0.1]])
    one.step(command, 0.1)
    for _ in range(10):
        many.step(command, 0.01)
    np.testing.assert_allclose(one.state, many.state, rtol=1e-12, atol=1e-14)
    assert one.time == pytest.approx(many.time)


def test_fly_is_the_loop_of_observe_control_and_step() -> None:
    quick, plain = alone((0.0, 0.0, 5.0)), alone((0.0, 0.0, 5.0))
    reference = Hold((1.0, 2.0, 6.0), 0.4)(0.0)[None]
    commands, signals = np.zeros((1, COMMAND)), np.zeros((1, SIGNALS))
    for _ in range(100):
        control_all(plain.observe(), reference, IRIS.row()[None], commands, signals)
        plain.step(commands, 0.01)
    ended = quick.fly(np.tile(reference, (100, 1, 1)), 0.01)
    np.testing.assert_array_equal(quick.state, plain.state)
    np.testing.assert_array_equal(ended[0], commands)
    np.testing.assert_array_equal(ended[1], signals)


def test_batch_is_as_each_alone() -> None:
    n = 37  # more than one block, and not a whole number of them
    rng = np.random.default_rng(3)
    positions = np.column_stack([10.0 * np.arange(n), np.zeros(n), rng.uniform(3.0, 9.0, n)])
    vehicles = [load_vehicle("iris" if k % 2 else "crazyflie") for k in range(n)]
    together = ReferenceSimulator(vehicles, positions, np.zeros(n))
    goals = positions + rng.uniform(-2.0, 2.0, (n, 3))
    path = hold(together, goals, 1.0)
    for k in (0, 15, 16, 36):
        single = ReferenceSimulator([vehicles[k]], positions[k : k + 1], [0.0])
        np.testing.assert_array_equal(hold(single, goals[k : k + 1], 1.0)[:, 0], path[:, k])


def test_a_motor_that_fails() -> None:
    simulator = alone((0.0, 0.0, 30.0))
    hold(simulator, np.array([[0.0, 0.0, 30.0]]), 1.0)
    simulator.fail_motor(0, 2)
    hold(simulator, np.array([[0.0, 0.0, 30.0]]), 10.0)
    assert simulator.state[0, ROTORS + 2] == 0.0
    assert simulator.grounded[0]
    # put back, it still has three rotors
    simulator.set_state(0, (0.0, 0.0, 5.0))
    assert simulator.state[0, ROTORS + 2] == 0.0


def test_contacts_are_told_once_each() -> None:
    # the first flies through the second and a ball, twice
    simulator = ReferenceSimulator(
        [IRIS, IRIS], [[-3.0, 0.0, 2.0], [0.0, 0.0, 2.0]], [0.0, 0.0], obstacles=[Sphere((3.0, 0.0, 2.0), 0.5)]
    )
    for goal in (5.0, -3.0):
        hold(simulator, np.array([[goal, 0.0, 2.0], [0.0, 0.0, 2.0]]), 8.0)
    told = [(c.vehicle, c.other) for c in simulator.collisions]
    assert told == [(0, 1), (0, None), (0, None), (0, 1)]
    times = [c.time for c in simulator.collisions]
    assert times == sorted(times)
    assert isinstance(simulator.collisions[0], Collision)


@pytest.mark.parametrize(
    ("offset", "touching"),
    [
        ((0.75, 0.0, 0.0), True),
        ((0.77, 0.0, 0.0), False),
        ((0.5, 0.5, 0.1), True),
        ((0.55, 0.55, 0.0), False),
        ((0.0, 0.0, 0.1), True),
        ((0.0, 0.0, 0.12), False),
    ],
)
def test_vehicles_are_cylinders(offset: tuple[float, float, float], touching: bool) -> None:
    simulator = ReferenceSimulator(
        [IRIS, IRIS], np.array([(0.0, 0.0, 2.0), np.add((0.0, 0.0, 2.0), offset)]), [0.0, 0.0]
    )
    simulator.step(np.tile(HOVER, (2, 1)), 0.001)
    assert bool(simulator.collisions) == touching


@pytest.mark.parametrize(
    ("place", "touching"),
    [((1.35, 0.0, 2.0), True), ((1.4, 0.0, 2.0), False), ((0.0, 0.0, 3.05), True), ((0.0, 0.0, 3.06), False)],
)
def test_obstacles_are_touched_by_rim_and_bottom(place: tuple[float, float, float], touching: bool) -> None:
    simulator = alone(place, obstacles=[Box((-1.0, -1.0, 0.5), (1.0, 1.0, 3.0))])
    simulator.step(HOVER, 0.001)
    assert simulator.collisions == ((Collision(0.001, 0, None),) if touching else ())


def test_moving_and_new_obstacles() -> None:
    simulator = alone((0.0, 0.0, 2.0), obstacles=[Sphere((5.0, 0.0, 2.0), 0.5), Box((8.0, 8.0, 0.0), (9.0, 9.0, 9.0))])
    simulator.step(HOVER, 0.01)
    assert not simulator.collisions
    simulator.move_obstacle(0, (0.8, 0.0, 2.0))
    simulator.step(HOVER, 0.01)
    assert len(simulator.collisions) == 1
    assert simulator.add_obstacle(Sphere((0.0, 0.8, 2.0), 0.5)) == 2
    simulator.step(HOVER, 0.01)
    assert len(simulator.collisions) == 2
    with pytest.raises(ArgumentError, match="Sphere"):
        simulator.move_obstacle(1, (0.0, 0.0, 0.0))
    with pytest.raises(ArgumentError, match="index"):
        simulator.move_obstacle(3, (0.0, 0.0, 0.0))


def test_contacts_of_many_are_those_of_all_pairs() -> None:
    rng = np.random.default_rng(8)
    n = 150
    positions = rng.uniform(-2.0, 2.0, (n, 3)) * (1.0, 1.0, 0.2) + (0.0, 0.0, 10.0)
    vehicles = [load_vehicle("iris" if k % 3 else "crazyflie") for k in range(n)]
    simulator = ReferenceSimulator(vehicles, positions, np.zeros(n))
    simulator.step(np.tile(HOVER, (n, 1)), 1e-6)
    expected = set()
    for i in range(n):
        for j in range(i + 1, n):
            a, b, d = vehicles[i], vehicles[j], positions[j] - positions[i]
            if math.hypot(d[0], d[1]) < a.body_radius + b.body_radius:
                if abs(d[2]) < 0.5 * (a.body_height + b.body_height):
                    expected.add((i, j))
    assert len(expected) > 64  # more than fit into the first buffer
    assert {(c.vehicle, c.other) for c in simulator.collisions} == expected


@pytest.mark.parametrize(("wind", "bound"), [(Wind((3.0, 0.0, 0.0)), 0.2), (Wind(gust_std=3.0), 0.8)])
def test_holds_its_place_in_wind(wind: Wind, bound: float) -> None:
    # no integral action: a steady wind of 3 m/s leaves 0.16 m, gusts of 3 m/s rms take it 0.8 m away at worst
    n = 20
    places = np.column_stack([5.0 * np.arange(n), np.zeros(n), np.full(n, 5.0)])
    simulator = ReferenceSimulator([IRIS] * n, places, np.zeros(n), wind=wind, rng=np.random.default_rng(5))
    away = np.linalg.norm(hold(simulator, places, 20.0) - places, axis=2)
    assert away.max() < bound
    assert away[-500:].mean() > 0.02


def test_wind_needs_aero() -> None:
    simulator = alone((0.0, 0.0, 5.0), aero=False, wind=Wind((9.0, 0.0, 0.0)), rng=np.random.default_rng(0))
    hold(simulator, np.array([[0.0, 0.0, 5.0]]), 1.0)
    np.testing.assert_allclose(simulator.state[0, :3], (0.0, 0.0, 5.0), atol=1e-12)


def test_flies_on_noisy_and_late_measurements() -> None:
    noise = SensorNoise(position_std=0.005, velocity_std=0.02, attitude_std=0.01, rate_std=0.01, latency=0.02)
    simulator = alone((0.0, 0.0, 5.0), noise=noise, rng=np.random.default_rng(2))
    reference = Hold((0.5, 0.0, 5.0))(0.0)[None]
    commands, signals, away = np.zeros((1, COMMAND)), np.zeros((1, SIGNALS)), []
    for _ in range(1500):
        control_all(simulator.observe(), reference, IRIS.row()[None], commands, signals)
        simulator.step(commands, 0.01)
        away.append(np.linalg.norm(simulator.state[0, :3] - reference[0, :3]))
    assert max(away[500:]) < 0.08
    with pytest.raises(ArgumentError, match="fly"):
        simulator.fly(reference[None], 0.01)


def test_the_same_seed_gives_the_same_flight() -> None:
    def flight(seed: int) -> np.ndarray:
        simulator = alone(
            (0.0, 0.0, 5.0),
            wind=Wind(gust_std=2.0),
            noise=SensorNoise(position_std=0.01, latency=0.01),
            rng=np.random.default_rng(seed),
        )
        commands, signals = np.zeros((1, COMMAND)), np.zeros((1, SIGNALS))
        for _ in range(100):
            control_all(simulator.observe(), Hold((0.0, 0.0, 5.0))(0.0)[None], IRIS.row()[None], commands, signals)
            simulator.step(commands, 0.01)
        return simulator.state

    np.testing.assert_array_equal(flight(1), flight(1))
    assert not np.array_equal(flight(1), flight(2))


def test_state_is_a_copy() -> None:
    simulator = alone((0.0, 0.0, 5.0))
    simulator.state[:] = 7.0
    simulator.observe()[:] = 7.0
    simulator.grounded[:] = True
    assert simulator.state[0, 2] == 5.0
    assert not simulator.grounded[0]
    assert simulator.parameters == (IRIS,)
    simulator.close()


def test_bad_input() -> None:
    for arguments, name in (
        (([IRIS], [[0.0, 0.0]], [0.0]), "positions_W"),
        (([IRIS], [[0.0, 0.0, math.nan]], [0.0]), "positions_W"),
        (([IRIS], [[0.0, 0.0, 0.0]], [0.0, 1.0]), "yaws"),
    ):
        with pytest.raises(ArgumentError, match=name):
            ReferenceSimulator(*arguments)
    with pytest.raises(ArgumentError, match="rng"):
        alone((0.0, 0.0, 1.0), wind=Wind())
    with pytest.raises(ArgumentError, match="physics_step"):
        alone((0.0, 0.0, 1.0), physics_step=0.0)
    simulator = alone((0.0, 0.0, 1.0))
    for commands, duration, name in (
        (np.zeros((2, COMMAND)), 0.01, "commands"),
        (np.full((1, COMMAND), math.inf), 0.01, "commands"),
        (HOVER, 0.0, "duration"),
        (HOVER, math.nan, "duration"),
    ):
        with pytest.raises(ArgumentError, match=name):
            simulator.step(commands, duration)
    with pytest.raises(ArgumentError, match="vehicle"):
        simulator.set_state(1, (0.0, 0.0, 0.0))
    with pytest.raises(ArgumentError, match="quat_wxyz"):
        simulator.set_state(0, (0.0, 0.0, 1.0), quat_wxyz=(1.0, 1.0, 0.0, 0.0))
    with pytest.raises(ArgumentError, match="rotor"):
        simulator.fail_motor(0, 4)
    with pytest.raises(ArgumentError, match="references"):
        simulator.fly(np.zeros((3, 2, REFERENCE)), 0.01)
