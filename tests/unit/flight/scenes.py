"""Scenes to navigate, and plants that follow references."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from covey.flight.navigation import NavigationOptions, Navigator, Status
from covey.flight.obstacles import Box, Obstacle, Prism, Sphere, clearance, pack
from covey.flight.parameters import VehicleParameters, load_vehicle
from covey.flight.route import Router
from covey.flight.separation import min_separation

Array = NDArray[np.float64]

DT = 0.01
IRIS = load_vehicle("iris")
CRAZYFLIE = load_vehicle("crazyflie")


@dataclass(frozen=True)
class Scene:
    """Vehicles of one kind with starts and goals that respect the separation, among obstacles."""

    starts: Array
    goals: Array
    obstacles: tuple[Obstacle, ...] = ()
    vehicle: str = "iris"

    def navigator(self, **overrides: float) -> Navigator:
        vehicle = load_vehicle(self.vehicle)
        options = NavigationOptions.for_vehicle(vehicle, **overrides)
        navigator = Navigator([vehicle] * len(self.starts), self.obstacles, options)
        for i, start in enumerate(self.starts):
            navigator.reset(i, start, 0.0)
        for i, goal in enumerate(self.goals):
            navigator.set_goal(i, goal, 1.0)
        return navigator


class Follower(Protocol):
    """What flies by references."""

    @property
    def p(self) -> Array:
        """True positions, shape (n, 3)."""
        ...

    def measure(self) -> tuple[Array, Array]:
        """Measured positions and velocities."""
        ...

    def follow(self, references: Array) -> None:
        """Fly for one control period."""
        ...


@dataclass
class Plant:
    """Follows references: exactly, or with a first-order lag; is measured with noise."""

    p: Array
    lag: float = 0.0
    noise: float = 0.0
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(0))

    def __post_init__(self) -> None:
        self.p = self.p.copy()
        self.v = np.zeros_like(self.p)

    def follow(self, references: Array) -> None:
        if self.lag == 0.0:
            self.p, self.v = references[:, 0:3].copy(), references[:, 3:6].copy()
            return
        before = self.p.copy()
        self.p += (references[:, 0:3] - self.p) * (1.0 - math.exp(-DT / self.lag))
        self.v = (self.p - before) / DT

    def measure(self) -> tuple[Array, Array]:
        if self.noise == 0.0:
            return self.p, self.v
        return (
            self.p + self.rng.normal(scale=self.noise, size=self.p.shape),
            self.v + self.rng.normal(scale=2.0 * self.noise, size=self.p.shape),
        )


@dataclass
class Outcome:
    """How a flight went."""

    time: float
    least_separation: float
    least_clearance: float
    status: list[Status]
    positions: Array
    references: Array

    @property
    def all_arrived(self) -> bool:
        return all(status is Status.ARRIVED_REFERENCE for status in self.status)


def fly(
    navigator: Navigator,
    plant: Follower,
    *,
    ratio: float,
    obstacles: Sequence[Obstacle] = (),
    longest: float = 180.0,
    log: bool = False,
    each: Callable[[float], None] | None = None,
    linger: float = 0.0,
) -> Outcome:
    """Fly until every goal is reached or given up, or time is over."""
    packed = pack(obstacles)
    separation, room = math.inf, math.inf
    positions, references = [], []
    steps = round(longest / DT)
    until = steps
    step = 0
    for step in range(steps):
        if each is not None:
            each(step * DT)
        reference = navigator.step(*plant.measure(), DT)
        plant.follow(reference)
        if log:
            positions.append(plant.p.copy())
            references.append(reference)
        if step % 2 == 0:
            separation = min(separation, min_separation(plant.p, ratio))
            for p in plant.p if obstacles else ():
                room = min(room, clearance(*packed, *(float(x) for x in p)))
        if step % 10 == 0 and until == steps:
            if not any(navigator.status(i) is Status.FLYING for i in range(len(navigator))):
                until = step + round(linger / DT)
        if step >= until:
            break
    status = [navigator.status(i) for i in range(len(navigator))]
    return Outcome(step * DT, separation, room, status, np.array(positions), np.array(references))


def random_obstacle(rng: np.random.Generator, size: float) -> Obstacle:
    x, y = rng.uniform(-size, size, 2)
    kind = rng.integers(3)
    if kind == 0:
        return Sphere((x, y, rng.uniform(0.5, 3.0)), rng.uniform(0.2, 0.8))
    w, d = rng.uniform(0.2, 1.2, 2)
    top = rng.uniform(1.0, 8.0)
    if kind == 1:
        return Box((x - w, y - d, 0.0), (x + w, y + d, top))
    angles = np.sort(rng.uniform(0.0, 2.0 * np.pi, 5))
    corners = tuple((x + w * math.cos(a), y + d * math.sin(a)) for a in angles)
    return Prism(corners, 0.0, top)


def spread(rng: np.random.Generator, n: int, obstacles: Sequence[Obstacle], size: float, keep: float) -> Array:
    """Draw n points a required separation from each other and clear of obstacles; fewer where there is no room."""
    packed = pack(obstacles)
    points: list[Array] = []
    for _ in range(50 * n):
        if len(points) == n:
            break
        p = np.array([*rng.uniform(-size, size, 2), rng.uniform(1.0, 3.0)])
        if clearance(*packed, *(float(x) for x in p)) < keep:
            continue
        if min_separation(np.array([*points, p]), 2.5) >= keep:
            points.append(p)
    return np.array(points)


def reachable(vehicle: VehicleParameters, starts: Array, goals: Array, obstacles: Sequence[Obstacle]) -> bool:
    """Whether every vehicle still finds a way when all the others are at their goals."""
    options = NavigationOptions.for_vehicle(vehicle)
    router = Router(pack(obstacles), floor=options.floor)
    for i in range(len(goals)):
        others = np.delete(goals, i, axis=0)
        blockers = np.column_stack(
            [others, np.full(len(others), 1.02 * options.separation), np.full(len(others), options.vertical_ratio)]
        )
        if router.route(starts[i], goals[i], options.keep_off, blockers) is None:
            return False
    return True


def random_scene(seed: int) -> Scene:
    """Two to twenty vehicles; every eighth scene is a symmetric one."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 21))
    name = "iris" if seed % 2 else "crazyflie"
    vehicle = load_vehicle(name)
    keep = vehicle.required_separation
    if seed % 8 == 0:
        return symmetric_scene(seed // 8, name)
    size = max(2.5, 0.9 * math.sqrt(n)) * keep / 0.6
    obstacles: list[Obstacle] = []
    for _ in range(int(rng.integers(0, 7))):
        obstacles.append(random_obstacle(rng, 0.8 * size))
    while True:
        starts = spread(rng, n, obstacles, size, 1.02 * keep)
        goals = spread(rng, n, obstacles, size, 1.02 * keep)
        if len(starts) == len(goals) == n and reachable(vehicle, starts, goals, obstacles):
            return Scene(starts, goals, tuple(obstacles), name)
        obstacles = obstacles[:-1]
        size *= 1.02


def symmetric_scene(kind: int, name: str = "iris") -> Scene:
    keep = load_vehicle(name).required_separation
    n = 2 + (kind // 6) % 19
    angles = 2.0 * np.pi * np.arange(n) / n
    radius = max(2.0 * keep, 1.3 * keep / (2.0 * math.sin(math.pi / n)))
    circle = np.column_stack([radius * np.cos(angles), radius * np.sin(angles), np.full(n, 1.5)])
    if kind % 6 == 0:  # to the antipodal points
        return Scene(circle, circle * np.array([-1.0, -1.0, 1.0]), (), name)
    if kind % 6 == 1:  # head-on
        a = np.array([[-3.0 * keep, 0.0, 1.5], [3.0 * keep, 0.0, 1.5]])
        return Scene(a, a[::-1].copy(), (), name)
    if kind % 6 == 2:  # crossing
        a = 3.0 * keep * np.array([[1.0, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]]) + np.array([0, 0, 1.5])
        return Scene(a, np.roll(a, 2, axis=0), (), name)
    if kind % 6 == 3:  # on one vertical
        a = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 1.0 + 5.0 * keep]])
        return Scene(a, a[::-1].copy(), (), name)
    if kind % 6 == 4:  # each to its neighbour's place
        return Scene(circle, np.roll(circle, 1, axis=0), (), name)
    line = np.column_stack([1.2 * keep * np.arange(n), np.zeros(n), np.full(n, 1.5)])
    return Scene(line, line[::-1].copy(), (), name)
