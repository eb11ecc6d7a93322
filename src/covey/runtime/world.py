"""Builds what a flight needs from a mission: vehicles, simulator, navigator."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from covey.flight.navigation import NavigationOptions, Navigator
from covey.flight.obstacles import Obstacle
from covey.flight.parameters import VehicleParameters, load_vehicle
from covey.flight.sensing import SensorNoise
from covey.flight.simulator import Simulator
from covey.flight.wind import Wind
from covey.mission import Mission
from covey.mission.flight import FlightSpec, NoiseSpec, WindSpec
from covey.runtime.streams import Stream, generator
from covey.vehicles.fleet import Arrival, Fleet, Kind
from covey.vehicles.kinematic import KinematicSimulator

LOWEST = 0.5
"""Below this altitude, metres, vehicles go only to land, or where the mission itself is lower."""

LOG_EVERY = 0.1
"""Seconds between two rows of a mission's log."""


def build_simulator(
    kind: Kind,
    vehicles: Sequence[VehicleParameters],
    positions_W: NDArray[np.float64],
    yaws: NDArray[np.float64],
    *,
    obstacles: Sequence[Obstacle] = (),
    wind: WindSpec | None = None,
    noise: NoiseSpec | None = None,
    seed: int = 0,
) -> Simulator:
    """Build a simulator with vehicles, shape (n, 3) positions and (n,) yaws, on the ground."""
    if kind is Kind.KINEMATIC:
        return KinematicSimulator(vehicles, positions_W, yaws, obstacles=obstacles)
    air = None
    if wind is not None and not wind.calm:
        air = Wind(mean_W=wind.steady_W, gust_std=wind.gust, time_constant=wind.gust_time)
    errors = None
    if noise is not None and not noise.exact:
        errors = SensorNoise(
            position_std=noise.position,
            velocity_std=noise.velocity,
            attitude_std=noise.attitude,
            rate_std=noise.rate,
            latency=noise.latency,
        )
    rng = generator(seed, Stream.WEATHER)
    if kind is Kind.REFERENCE:
        from covey.simulators.reference import ReferenceSimulator

        return ReferenceSimulator(vehicles, positions_W, yaws, obstacles=obstacles, wind=air, noise=errors, rng=rng)
    from covey.simulators.mujoco import MujocoSimulator

    return MujocoSimulator(vehicles, positions_W, yaws, obstacles=obstacles, wind=air, noise=errors, rng=rng)


def build_fleet(mission: Mission, kind: Kind, *, realtime: bool = False, log_every: float = LOG_EVERY) -> Fleet:
    """Build the fleet of a mission, one vehicle an agent, standing at the agents' starting poses."""
    spec = mission.flight
    vehicle = load_vehicle(spec.vehicle)
    limits: dict[str, float] = {} if spec.max_speed is None else {"max_speed": spec.max_speed}
    if spec.ceiling < math.inf:
        limits |= {"ceiling": spec.ceiling, "floor": min(LOWEST, 0.5 * spec.altitude)}
    options = NavigationOptions.for_vehicle(vehicle, **limits)
    vehicles = [vehicle] * len(mission.agents)
    positions = np.array([[agent.pose.x, agent.pose.y, 0.0] for agent in mission.agents])
    yaws = np.array([agent.pose.yaw for agent in mission.agents])
    simulator = build_simulator(
        kind, vehicles, positions, yaws, obstacles=spec.obstacles, wind=spec.wind, noise=spec.noise, seed=mission.seed
    )
    return Fleet(
        simulator,
        [agent.name for agent in mission.agents],
        navigator=Navigator(vehicles, spec.obstacles, options, regions=[agent.region for agent in mission.agents]),
        kind=kind,
        arrival=Arrival(spec.arrival_position, spec.arrival_yaw),
        log_every=log_every,
        realtime=realtime,
    )


def not_felt(spec: FlightSpec, kind: Kind) -> str:
    """Say what of a mission's flight changes nothing for its vehicles: kinematic ones have no physics."""
    felt = {
        "wind": not spec.wind.calm,
        "noise": not spec.noise.exact,
        "motors that stop": any(fault.rotor is not None for fault in spec.faults),
    }
    return ", ".join(name for name, given in felt.items() if given) if kind is Kind.KINEMATIC else ""
