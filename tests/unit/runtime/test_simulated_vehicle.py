"""One simulated vehicle in the time of its agent: it arrives, or says that it cannot."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from tests.unit.runtime.small import small

from covey.flight.layout import OBSERVATION, QUAT, P, V
from covey.flight.obstacles import Box
from covey.flight.parameters import load_vehicle
from covey.flight.rotation import yaw_of
from covey.geometry import Pose2, wrap_angle
from covey.mission import Mission
from covey.runtime.network.remote_vehicle import AtOnce, Leg, build_vehicle
from covey.runtime.network.simulated_vehicle import BEHIND, SimulatedVehicle
from covey.vehicles.fleet import Kind

START, GOAL = Pose2(1.5, -1.0, 0.0), Pose2(-1.0, 1.5, 2.0)


@pytest.fixture
def mission() -> Mission:
    return small()


def fly(vehicle: SimulatedVehicle, *, begin: float, until: float, tick: float = 0.02) -> tuple[Leg, float]:
    now = begin
    leg = vehicle.advance(now)
    while leg is Leg.UNDER_WAY and now < until:
        now += tick
        leg = vehicle.advance(now)
    return leg, now


@pytest.mark.parametrize("kind", [Kind.KINEMATIC, Kind.REFERENCE])
def test_it_begins_in_the_air_and_arrives(mission: Mission, kind: Kind) -> None:
    vehicle = SimulatedVehicle(mission, 2, kind, START, 100.0)
    altitude = mission.flight.altitudes(3)[2]
    state = vehicle._fleet.simulator.state[0]
    assert state[P : P + 3].tolist() == [START.x, START.y, altitude]
    vehicle.go_to(100.0, GOAL)
    assert vehicle.advance(100.0) is Leg.UNDER_WAY
    leg, now = fly(vehicle, begin=100.0, until=160.0)
    assert leg is Leg.ARRIVED
    away = math.hypot(GOAL.x - START.x, GOAL.y - START.y)
    assert now - 100.0 > away / vehicle._fleet.navigator.options[0].max_speed
    assert math.hypot(vehicle.pose.x - GOAL.x, vehicle.pose.y - GOAL.y) <= mission.flight.arrival_position
    assert abs(wrap_angle(vehicle.pose.yaw - GOAL.yaw)) <= mission.flight.arrival_yaw
    assert abs(vehicle._fleet.simulator.state[0, P + 2] - altitude) < 0.2
    # and the next waypoint, after a long rest
    vehicle.go_to(now + 500.0, START)
    assert vehicle.advance(now + 500.0) is Leg.UNDER_WAY
    assert fly(vehicle, begin=now + 500.0, until=now + 560.0)[0] is Leg.ARRIVED


def test_what_is_to_be_seen_of_it(mission: Mission) -> None:
    vehicle = SimulatedVehicle(mission, 2, Kind.KINEMATIC, START, 0.0)
    vehicle.go_to(0.0, GOAL)
    for step in range(1, 101):
        vehicle.advance(0.02 * step)
    state = vehicle.state
    assert state.shape == (OBSERVATION,)
    assert state[P : P + 2].tolist() == [vehicle.pose.x, vehicle.pose.y]
    assert yaw_of(state[QUAT : QUAT + 4]) == pytest.approx(vehicle.pose.yaw)
    assert np.linalg.norm(state[V : V + 3]) > 0.5
    leg, _ = fly(vehicle, begin=2.0, until=60.0)
    assert leg is Leg.ARRIVED
    assert vehicle.state[V : V + 3].tolist() == [0.0, 0.0, 0.0]  # nothing moves it any more
    assert math.isnan(vehicle.battery)
    assert state is not vehicle.state


def test_a_vehicle_with_rotors_has_a_battery(mission: Mission) -> None:
    vehicle = SimulatedVehicle(mission, 0, Kind.REFERENCE, START, 0.0)
    assert vehicle.battery == 1.0
    _, now = fly(vehicle, begin=0.0, until=5.0)
    assert 1.0 - vehicle.battery == pytest.approx(now / load_vehicle("iris").endurance, rel=0.1)


def test_a_kinematic_vehicle_that_has_arrived_needs_no_time(mission: Mission) -> None:
    vehicle = SimulatedVehicle(mission, 0, Kind.KINEMATIC, START, 0.0)
    assert vehicle.due(0.0) is not None
    assert fly(vehicle, begin=0.0, until=10.0)[0] is Leg.ARRIVED
    assert vehicle.due(10.0) is None
    vehicle.go_to(10.0, GOAL)
    assert vehicle.due(10.0) is not None


def test_one_that_cannot_get_there_says_so_and_holds_a_pose_in_its_region(mission: Mission) -> None:
    low, high = (-1.4, 1.1, 0.0), (-0.6, 1.9, 9.0)
    blocked = replace(mission, flight=replace(mission.flight, obstacles=(Box(low, high),)))
    vehicle = SimulatedVehicle(blocked, 0, Kind.KINEMATIC, START, 0.0)
    vehicle.go_to(0.0, GOAL)
    leg, now = fly(vehicle, begin=0.0, until=120.0)
    assert leg is Leg.STUCK
    held = vehicle.hold()
    assert blocked.agents[0].region.contains(held.x, held.y)
    assert fly(vehicle, begin=now, until=now + 30.0)[0] is Leg.ARRIVED
    assert math.hypot(vehicle.pose.x - held.x, vehicle.pose.y - held.y) <= blocked.flight.arrival_position


def test_a_simulation_that_is_far_behind_does_not_catch_up_for_ever(mission: Mission) -> None:
    vehicle = SimulatedVehicle(mission, 0, Kind.KINEMATIC, START, 0.0)
    vehicle.go_to(0.0, GOAL)
    before = vehicle._fleet.time
    assert vehicle.advance(1000.0) is Leg.UNDER_WAY
    due = vehicle.due(1000.0)
    assert due is not None
    assert vehicle._fleet.time - before <= BEHIND
    for _ in range(20):
        vehicle.advance(1000.0)
    assert vehicle._fleet.time <= BEHIND + 0.02


def test_vehicles_by_name(mission: Mission) -> None:
    vehicle = build_vehicle(mission, 0, "none", START, 0.0)
    assert isinstance(vehicle, AtOnce)
    vehicle.go_to(0.0, GOAL)
    assert (vehicle.advance(0.0), vehicle.pose, vehicle.hold(), vehicle.due(0.0)) == (Leg.ARRIVED, GOAL, GOAL, None)
    assert vehicle.state is None
    assert isinstance(build_vehicle(mission, 0, "kinematic", START, 0.0), SimulatedVehicle)
