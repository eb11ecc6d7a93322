"""What is left of batteries: the law of momentum theory, and what becomes of it in flight."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from covey.flight.battery import Batteries
from covey.flight.layout import GRAVITY, ROTORS, STATE
from covey.flight.parameters import VehicleParameters, load_vehicle, vehicle_names

IRIS, CRAZYFLIE = load_vehicle("iris"), load_vehicle("crazyflie")


def turning(*speeds: float) -> NDArray[np.float64]:
    """States of vehicles all of whose rotors turn at a speed each, rad/s."""
    states = np.zeros((len(speeds), STATE))
    states[:, ROTORS:] = np.array(speeds)[:, None]
    return states


@pytest.mark.parametrize("name", vehicle_names())
def test_a_full_battery_lasts_as_long_in_hover_as_the_file_says(name: str) -> None:
    vehicle = load_vehicle(name)
    batteries = Batteries([vehicle])
    assert batteries.shares.tolist() == [1.0]
    for _ in range(100):
        batteries.drain(turning(vehicle.hover_speed), 0.009 * vehicle.endurance)
    assert batteries.shares[0] == pytest.approx(0.1)
    batteries.drain(turning(vehicle.hover_speed), vehicle.endurance)
    assert batteries.shares[0] == 0.0


@given(st.floats(0.0, 3.0), st.floats(0.0, 30.0))
def test_power_rises_with_the_thrust_to_the_one_and_a_half(ratio: float, duration: float) -> None:
    speed = math.sqrt(ratio * IRIS.mass * GRAVITY / (4.0 * IRIS.thrust_coefficient))
    batteries = Batteries([IRIS])
    batteries.drain(turning(speed), duration)
    assert 1.0 - batteries.shares[0] == pytest.approx(ratio**1.5 * duration / IRIS.endurance, abs=1e-12)


def test_uneven_rotors_need_more_than_even_ones() -> None:
    even, uneven = turning(IRIS.hover_speed), turning(IRIS.hover_speed)
    uneven[0, ROTORS:] *= np.sqrt([1.5, 0.5, 1.5, 0.5])  # the same thrust in all
    batteries = Batteries([IRIS, IRIS])
    batteries.drain(np.vstack([even, uneven]), 60.0)
    assert batteries.shares[1] < batteries.shares[0]


def test_each_vehicle_has_a_battery_of_its_own() -> None:
    unknown = replace(IRIS, endurance=math.nan)
    vehicles: list[VehicleParameters] = [IRIS, CRAZYFLIE, unknown, IRIS]
    speeds = [700.0, 1800.0, 700.0, 0.0]
    together = Batteries(vehicles)
    together.drain(turning(*speeds), 20.0)
    for i, (vehicle, speed) in enumerate(zip(vehicles, speeds, strict=True)):
        alone = Batteries([vehicle])
        alone.drain(turning(speed), 20.0)
        np.testing.assert_array_equal(alone.shares, together.shares[i : i + 1])
    assert np.isnan(together.shares).tolist() == [False, False, True, False]
    assert together.shares[3] == 1.0  # its motors are off
