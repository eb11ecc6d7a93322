"""Separation: the distance, the caps, the check at load time."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.distance import pdist

from covey.errors import ArgumentError
from covey.flight.navigation import NavigationOptions
from covey.flight.parameters import load_vehicle
from covey.flight.separation import (
    cap_velocity,
    check_separation,
    closest_approach,
    excess_speed,
    min_separation,
    safe_speed,
    speed_cap,
)


def excess(v: NDArray[np.float64], ways: NDArray[np.float64], caps: NDArray[np.float64], count: int) -> float:
    return excess_speed(float(v[0]), float(v[1]), float(v[2]), ways, caps, count)


@pytest.mark.parametrize("n", [2, 3, 10, 200])
def test_least_separation_is_that_of_all_pairs(n: int) -> None:
    rng = np.random.default_rng(n)
    for flat in (1.0, 0.0, 1e-9):
        for spread in ((1, 1, 1), (30, 0.1, 2), (0, 0, 9), (0, 5, 0)):
            p = rng.uniform(0, 1, (n, 3)) * spread * np.array([1.0, 1.0, flat])
            assert min_separation(p, 2.0) == pytest.approx(pdist(p / [1, 1, 2]).min(), abs=1e-12)


def test_a_single_vehicle_is_infinitely_far_from_others() -> None:
    assert min_separation(np.zeros((1, 3))) == math.inf
    assert min_separation(np.zeros((2, 3))) == 0.0
    with pytest.raises(ArgumentError, match="positions_W"):
        min_separation(np.zeros((2, 2)))


def test_closest_approach_and_safe_speed_are_inverse() -> None:
    for k_rep, threshold, speed in ((1.0, 1.0, 2.0), (6.0, 3.7, 2.8), (0.3, 0.5, 0.1), (1.0, 1.0, 0.0)):
        d = closest_approach(k_rep, threshold, speed)
        assert 0.0 < d <= threshold
        assert safe_speed(k_rep, threshold, d) == pytest.approx(speed, abs=1e-6)
        assert d > closest_approach(k_rep, threshold, speed + 0.1)
    with pytest.raises(ArgumentError, match="k_rep"):
        closest_approach(0.0, 1.0, 1.0)


def test_without_reaction_time_the_cap_is_that_of_plain_braking() -> None:
    assert speed_cap(0.8, 2.0, 0.0, 2.0) == pytest.approx(math.sqrt(2.0 * 0.8))
    assert speed_cap(0.8, 2.0, 0.0, 1.0) == pytest.approx(math.sqrt(2.0 * 2.0 * 0.8))
    assert speed_cap(0.0, 2.0, 0.3, 2.0) == 0.0
    assert speed_cap(-0.1, 2.0, 0.0, 2.0) == 0.0


@pytest.mark.parametrize("sides", [1.0, 2.0])
def test_the_cap_leaves_room_to_react_and_to_brake(sides: float) -> None:
    for gap in (0.001, 0.1, 1.0, 5.0):
        cap = speed_cap(gap, 1.5, 0.3, sides)
        assert sides * (cap * 0.3 + cap * cap / (2.0 * 1.5)) == pytest.approx(gap)
    assert speed_cap(-0.3, 1.5, 0.3, sides) == pytest.approx(-1.0 / sides)


def test_projection_keeps_limits_and_finds_velocities_within_all_caps() -> None:
    rng = np.random.default_rng(5)
    braked = 0
    for _ in range(2000):
        count = int(rng.integers(0, 6))
        ways = rng.normal(size=(6, 3))
        ways /= np.linalg.norm(ways, axis=1)[:, None]
        old = rng.normal(size=3)
        old /= max(1.0, float(np.linalg.norm(old)))
        caps = np.maximum(ways @ old, 0.0) + rng.uniform(0.0, 0.02, 6)  # the last velocity is within all
        v = old + rng.normal(scale=0.05, size=3)
        cap_velocity(v, old, ways, caps, count, 1.0, 0.02)
        assert np.linalg.norm(v) <= 1.0 + 1e-12
        assert np.linalg.norm(v - old) <= 0.02 + 1e-12
        assert excess(v, ways, caps, count) <= 1.1e-3
        braked += count > 0
    assert braked > 1000


def test_where_caps_contradict_each_other_the_vehicle_brakes_or_does_better() -> None:
    ways = np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]])
    caps = np.array([-0.3, 0.1])
    old = np.array([0.2, 0.5, 0.0])
    v = np.array([0.25, 0.5, 0.0])
    cap_velocity(v, old, ways, caps, 2, 1.0, 0.02)
    braking = old * (1.0 - 0.02 / np.linalg.norm(old))
    assert excess(v, ways, caps, 2) <= excess(braking, ways, caps, 2) + 1e-12
    assert np.linalg.norm(v - old) <= 0.02 + 1e-12


GOOD: dict[str, float] = {
    "required": 0.96,
    "k_rep": 6.3,
    "threshold": 3.7,
    "max_speed": 1.38,
    "max_acceleration": 2.0,
    "brake_acceleration": 1.0,
}


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"k_rep": 1.0}, "k_rep >= "),
        ({"max_speed": 2.0}, "max_speed <= "),
        ({"threshold": 0.9}, "threshold"),
        ({"required": 1.6}, "would come within"),
        ({"brake_acceleration": 1.9}, "brake_acceleration"),
        ({"required": 0.0}, "required"),
    ],
)
def test_the_check_refuses_and_says_what_to_change(change: dict[str, float], told: str) -> None:
    check_separation(**GOOD)
    with pytest.raises(ArgumentError, match=told):
        check_separation(**{**GOOD, **change})


def test_what_the_check_proposes_passes_it() -> None:
    with pytest.raises(ArgumentError) as refused:
        check_separation(**{**GOOD, "k_rep": 3.0})
    text = str(refused.value)
    speed = float(text.split("max_speed <= ")[1].split()[0])
    check_separation(**{**GOOD, "k_rep": 3.0, "max_speed": speed})
    stronger = float(text.split("k_rep >= ")[1].split(",")[0])
    check_separation(**{**GOOD, "k_rep": stronger})


@pytest.mark.parametrize("name", ["iris", "crazyflie"])
def test_derived_options_pass_the_check_and_heed_the_vehicle(name: str) -> None:
    vehicle = load_vehicle(name)
    options = NavigationOptions.for_vehicle(vehicle)
    assert options.separation == vehicle.required_separation
    assert options.max_speed <= vehicle.limits.max_speed
    assert options.max_acceleration <= vehicle.limits.max_acceleration
    assert 2.0 * options.max_acceleration / options.filter_time <= vehicle.limits.max_jerk * (1.0 + 1e-12)
    assert closest_approach(options.k_rep, options.threshold, 2.0 * options.max_speed) >= options.separation
    for change, told in (
        ({"max_speed": 5.0}, "brake_acceleration"),
        ({"k_rep": 0.5}, "k_rep"),
        ({"vertical_ratio": 0.5}, "vertical_ratio"),
        ({"ceiling": 0.2}, "ceiling"),
        ({"stall_time": 0.0}, "stall_time"),
        ({"tracking_reset": math.nan}, "tracking_reset"),
    ):
        overrides: dict[str, Any] = change
        with pytest.raises(ArgumentError, match=told):
            NavigationOptions.for_vehicle(vehicle, **overrides)
