"""Navigator, controller and equations of motion together: real lag, drag, wind and noise."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from tests.unit.flight.scenes import DT, Array, Scene, fly, random_scene, symmetric_scene
from tests.unit.flight.test_navigation import FIGURES

from covey.flight.backstepping import control_all
from covey.flight.disturbance import DisturbanceEstimate
from covey.flight.layout import COMMAND, SIGNALS, P, V
from covey.flight.parameters import load_vehicle
from covey.flight.sensing import SensorNoise
from covey.flight.wind import Wind
from covey.simulators.mujoco import MujocoSimulator
from covey.simulators.reference import ReferenceSimulator


class Flown:
    """A plant that is flown by the controller in a simulator."""

    def __init__(
        self,
        scene: Scene,
        *,
        wind: Wind | None = None,
        noise: SensorNoise | None = None,
        simulator: type[ReferenceSimulator | MujocoSimulator] = ReferenceSimulator,
    ) -> None:
        n = len(scene.starts)
        self.simulator = simulator(
            [load_vehicle(scene.vehicle)] * n,
            scene.starts,
            np.zeros(n),
            obstacles=scene.obstacles,
            wind=wind,
            noise=noise,
            rng=np.random.default_rng(0),
        )
        self.params = np.array([vehicle.row() for vehicle in self.simulator.parameters])
        self.commands, self.signals = np.zeros((n, COMMAND)), np.zeros((n, SIGNALS))
        self.observed = self.simulator.observe()
        self.disturbance = DisturbanceEstimate(self.simulator.parameters)

    @property
    def p(self) -> Array:
        return self.simulator.state[:, P : P + 3]

    def measure(self) -> tuple[Array, Array]:
        self.observed = self.simulator.observe()
        return self.observed[:, P : P + 3], self.observed[:, V : V + 3]

    def follow(self, references: Array) -> None:
        flying = np.ones(len(references), dtype=np.bool_)
        self.disturbance.update(self.observed, references, flying, DT)
        leaning = self.disturbance.compensate(references)
        control_all(self.observed, leaning, self.params, self.commands, self.signals)
        self.simulator.step(self.commands, DT)


def check(
    scene: Scene,
    *,
    allowed: float = 0.0,
    clear: float = 1.0,
    wind: Wind | None = None,
    noise: SensorNoise | None = None,
    simulator: type[ReferenceSimulator | MujocoSimulator] = ReferenceSimulator,
) -> float:
    """Fly a scene: nobody closer than required but for what is allowed (a part of it), no contact, all arrive.

    Obstacles are `clear` body radii away at least.
    """
    vehicle = load_vehicle(scene.vehicle)
    plant = Flown(scene, wind=wind, noise=noise, simulator=simulator)
    outcome = fly(scene.navigator(), plant, ratio=vehicle.vertical_ratio, obstacles=scene.obstacles)
    assert not plant.simulator.collisions
    assert outcome.least_clearance > clear * vehicle.body_radius
    assert outcome.all_arrived
    margin = outcome.least_separation / vehicle.required_separation
    assert margin >= 1.0 - allowed
    return margin


@pytest.mark.parametrize("name", FIGURES)
def test_figures_of_the_thesis(name: str) -> None:
    assert check(FIGURES[name]) * 0.96 >= 0.5


@pytest.mark.parametrize("kind", [0, 1, 2, 3, 6 * 18, 6 * 6 + 4])
def test_symmetric_meetings(kind: int) -> None:
    check(symmetric_scene(kind), allowed=0.01)


def test_random_scenes(seeds: Callable[[int, int], range]) -> None:
    for seed in seeds(60, 1000):
        check(random_scene(9000 + seed))


def test_random_scenes_in_mujoco(seeds: Callable[[int, int], range]) -> None:
    """With rigid bodies, contacts and downwash.

    A Crazyflie is blown down by another up to 17 cm, once onto a flat roof, which no margin provides for.
    """
    for seed in seeds(2, 30):
        check(random_scene(7000 + seed), clear=0.7, simulator=MujocoSimulator)


def test_random_scenes_in_wind_and_noise(seeds: Callable[[int, int], range]) -> None:
    """An Iris+ in 1.5 m/s of wind with gusts of 0.5 m/s, a Crazyflie in a fifth of that, which suits 30 g and 7 cm of
    margin; position noise 1 % of the body radius, 10 ms of latency.
    """
    for seed in seeds(10, 300):
        scene = random_scene(8000 + seed)
        small = 0.01 * load_vehicle(scene.vehicle).body_radius
        noise = SensorNoise(small, 2.0 * small, 0.002, 0.01, 0.01)
        wind = Wind((1.5, 0.0, 0.0), 0.5) if scene.vehicle == "iris" else Wind((0.3, 0.0, 0.0), 0.1)
        check(scene, allowed=0.02, wind=wind, noise=noise)
