"""Chapter 3 of the thesis: its figures, and what the printed formulas would do."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from covey.flight.potential_field import FieldGains, fly_field
from covey.flight.separation import closest_approach, min_separation

Array = NDArray[np.float64]

# starts, goals, k_rep; k_wp = 1, k_v = 5, threshold 1.5 m
FIGURE_3_3 = ([[0, 0, 0], [2, 0, 0]], [[2, 2, 1], [0, 2, 1]], 2.0)
FIGURE_3_4 = ([[0, 0, 0], [2, 0, 0], [-2, 0, 0]], [[0, 3, 2], [-2, 3, 2], [2, 3, 2]], 3.0)
SWAP = ([[0, 0, 0], [2, 0, 0]], [[2, 0, 0], [0, 0, 0]], 2.0)
Case = tuple[list[list[int]], list[list[int]], float]


def least(positions: Array) -> float:
    return min(min_separation(p) for p in positions)


@pytest.mark.parametrize(
    ("case", "expected"), [(FIGURE_3_3, 0.61), (FIGURE_3_4, 0.56), (SWAP, 0.61)], ids=["3.3", "3.4", "swap"]
)
def test_teams_pass_each_other_and_arrive(case: Case, expected: float) -> None:
    starts, goals, k_rep = case
    gains = FieldGains(k_wp=1.0, k_v=5.0, k_rep=k_rep, threshold=1.5)
    positions, velocities = fly_field(np.array(starts, float), np.array(goals, float), gains, duration=60.0)
    assert least(positions) >= 0.5
    assert least(positions) == pytest.approx(expected, abs=0.006)
    np.testing.assert_allclose(positions[-1], goals, atol=1e-3)
    assert np.abs(velocities[-1]).max() < 1e-3


def test_attraction_alone_brings_position_and_speed_to_rest() -> None:
    """Figures 3.1 and 3.2, k_wp = k_v = 5: against the closed form of the damped spring."""
    gains = FieldGains(k_wp=5.0, k_v=5.0)
    goal = np.array([[1.0, 3.0, 2.0]])
    positions, velocities = fly_field(np.zeros((1, 3)), goal, gains, duration=8.0, dt=0.0005)
    t = 0.0005 * np.arange(len(positions))
    fast, slow = (5.0 + 5.0**0.5) / 2.0, (5.0 - 5.0**0.5) / 2.0
    left = (fast * np.exp(-slow * t) - slow * np.exp(-fast * t)) / (fast - slow)
    np.testing.assert_allclose(positions[:, 0], goal * (1.0 - left[:, None]), atol=2e-3)
    assert np.linalg.norm(positions[-1] - goal) < 1e-3
    assert np.linalg.norm(velocities[-1]) < 1e-3


def test_a_hovering_vehicle_makes_way_for_a_moving_object_and_comes_back() -> None:
    """Section 3.4.3: hover at (0, 0, 1.2), k_wp 1, k_v 5, k_rep 1, threshold 1 m."""
    gains = FieldGains(k_wp=1.0, k_v=5.0, k_rep=1.0, threshold=1.0)
    hover = np.array([[0.0, 0.0, 1.2]])
    dt, steps = 0.005, 8001
    path = np.zeros((steps, 1, 3))
    path[:, 0, 0] = np.minimum(-2.0 + 0.2 * dt * np.arange(steps), 2.0)
    path[:, 0, 2] = 1.2
    positions, _ = fly_field(hover, hover, gains, duration=dt * (steps - 1), dt=dt, objects_W=path)
    away = np.linalg.norm(positions[:, 0] - hover, axis=1)
    assert np.linalg.norm(positions - path, axis=2).min() > 0.2
    assert away.max() > 0.2
    assert away[-1] < 0.05


def fly_printed(
    case: Case, *, sign: float, active: Callable[[Array, Array], bool], turning: bool, duration: float = 20.0
) -> Array:
    """Fly by (3.2) with sign +1 as printed (−1: repelling), when `active(v, offset)`, with or without g_perp."""
    starts, goals, k_rep = case
    p, goal = np.array(starts, float), np.array(goals, float)
    v, dt, log = np.zeros_like(p), 0.01, [p]
    for _ in range(round(duration / dt)):
        a = (goal - p) - 5.0 * v
        for i in range(len(p)):
            for j in range(len(p)):
                offset = p[j] - p[i]
                d = max(float(np.linalg.norm(offset)), 1e-3)
                if i != j and d < 1.5 and active(v[i], offset):
                    g = sign * 0.5 * k_rep * offset / d * (1.0 / d - 1.0 / 1.5)
                    g[2] = 0.0
                    a[i] += g + (np.array([-g[1], g[0], 0.0]) if turning else 0.0)
        v = v + dt * a
        p = p + dt * v
        log.append(p)
    return np.array(log)


def departing(v: Array, offset: Array) -> bool:
    return float(v @ offset) < 0.0


def approaching(v: Array, offset: Array) -> bool:
    return float(v @ offset) > 0.0


def always(v: Array, offset: Array) -> bool:
    return True


@pytest.mark.parametrize("case", [FIGURE_3_3, FIGURE_3_4, SWAP], ids=["3.3", "3.4", "swap"])
def test_as_printed_vehicles_collide(case: Case) -> None:
    """Deviation P1, P2: the printed sign attracts, the printed gate is open to those who depart."""
    assert least(fly_printed(case, sign=1.0, active=departing, turning=True)) < 0.05
    assert least(fly_printed(case, sign=1.0, active=always, turning=True)) < 0.2


@pytest.mark.parametrize(
    ("case", "expected"), [(FIGURE_3_3, 0.54), (FIGURE_3_4, 0.44), (SWAP, 0.61)], ids=["3.3", "3.4", "swap"]
)
def test_gated_on_approach_separation_is_smaller(case: Case, expected: float) -> None:
    """Deviation P2."""
    assert least(fly_printed(case, sign=-1.0, active=approaching, turning=True)) == pytest.approx(expected, abs=0.03)


def test_without_the_tangential_term_a_swap_ends_in_deadlock() -> None:
    """Deviation P2."""
    p = fly_printed(SWAP, sign=-1.0, active=always, turning=False)
    np.testing.assert_allclose(p[-1], p[-500], atol=1e-3)
    assert np.abs(p[-1] - np.array(SWAP[1])).max() > 0.5


def test_without_a_vertical_term_a_swap_on_one_vertical_collides() -> None:
    """Deviation P3: with g_z = 0 the two meet; with the radial term in space and the lateral one they pass."""
    swap = ([[0, 0, 1], [0, 0, 4]], [[0, 0, 4], [0, 0, 1]], 2.0)
    assert least(fly_printed(swap, sign=-1.0, active=always, turning=True)) < 0.01
    gains = FieldGains(k_wp=1.0, k_v=5.0, k_rep=2.0, threshold=1.5)
    positions, _ = fly_field(np.array(swap[0], float), np.array(swap[1], float), gains, duration=60.0)
    assert least(positions) > 0.4
    np.testing.assert_allclose(positions[-1], swap[1], atol=1e-3)


def test_closest_approach_of_the_field_alone() -> None:
    """Deviation P4: k_rep = threshold = 1, closing at 2 m/s: 5 cm; checked by letting two vehicles meet."""
    assert closest_approach(1.0, 1.0, 2.0) == pytest.approx(0.05, abs=0.005)
    d, speed, dt = 1.0, -2.0, 1e-5
    while speed < 0.0:
        speed += dt * (1.0 / d - 1.0)
        d += dt * speed
    assert d == pytest.approx(closest_approach(1.0, 1.0, 2.0), rel=0.01)
