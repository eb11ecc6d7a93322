"""References: their derivatives are derivatives, and a follower follows."""

from __future__ import annotations

import math

import numpy as np
import pytest

from covey.errors import ArgumentError
from covey.flight.layout import REF_A, REF_J, REF_P, REF_V, REF_YAW, REF_YAW_RATE, REFERENCE
from covey.flight.parameters import load_vehicle
from covey.flight.trajectories import Circle, Follow, Hold
from covey.simulators.reference import ReferenceSimulator


def test_circle_is_that_of_the_thesis() -> None:
    for time in (0.0, 0.7, 3.0):
        np.testing.assert_allclose(Circle()(time)[:3], (math.cos(time), -math.sin(time), 0.5))


@pytest.mark.parametrize(("column", "derivative"), [(REF_P, REF_V), (REF_V, REF_A), (REF_A, REF_J)])
def test_circles_derivatives(column: int, derivative: int) -> None:
    circle, h = Circle((1.0, 2.0, 3.0), radius=2.0, rate=-0.7, yaw=0.2, yaw_rate=0.3), 1e-5
    for time in np.linspace(0.0, 9.0, 7):
        slope = (circle(time + h) - circle(time - h)) / (2.0 * h)
        np.testing.assert_allclose(slope[column : column + 3], circle(time)[derivative : derivative + 3], atol=1e-8)
        assert slope[REF_YAW] == pytest.approx(circle(time)[REF_YAW_RATE])


def test_hold_rests() -> None:
    reference = Hold((1.0, 2.0, 3.0), 0.4)(7.0)
    assert reference.shape == (REFERENCE,)
    np.testing.assert_array_equal(reference[:3], (1.0, 2.0, 3.0))
    assert reference[REF_YAW] == 0.4
    assert np.count_nonzero(reference) == 4


def test_follow_takes_derivatives_only_when_told() -> None:
    circle = Circle()
    plain = Follow(lambda: circle(1.0)[:12], (0.0, -1.0, 0.2), yaw=0.3)(0.0)
    full = Follow(lambda: circle(1.0)[:12], (0.0, -1.0, 0.2), derivatives=True)(0.0)
    np.testing.assert_allclose(plain[:3], np.add(circle(1.0)[:3], (0.0, -1.0, 0.2)))
    assert not plain[3:12].any()
    assert plain[REF_YAW] == 0.3
    np.testing.assert_allclose(full[3:12], circle(1.0)[3:12])
    with pytest.raises(ArgumentError, match="3, 6, 9 or 12"):
        Follow(lambda: np.zeros(5), (0.0, 0.0, 0.0))(0.0)


@pytest.mark.parametrize(("derivatives", "bound"), [(False, 0.9), (True, 0.1)])
def test_leader_and_follower_as_in_section_2_3_2(derivatives: bool, bound: float) -> None:
    # with derivatives zero the follower lags; with them it does not
    iris, circle = load_vehicle("iris"), Circle((0.0, 0.0, 2.0))
    simulator = ReferenceSimulator([iris, iris], [[1.0, 0.0, 2.0], [1.0, -2.5, 2.0]], [0.0, 0.0], aero=False)
    offset = (0.0, -2.5, 0.0)
    follow = Follow(
        lambda: np.concatenate([simulator.state[0, :6], circle(simulator.time)[6:12]]), offset, derivatives=derivatives
    )
    worst = []
    for _ in range(1500):
        time = simulator.time
        simulator.fly(np.array([[circle(time), follow(time)]]), 0.01)
        worst.append(np.linalg.norm(simulator.state[1, :3] - simulator.state[0, :3] - offset))
    late = max(worst[800:])
    assert late < bound
    assert derivatives or late > 0.3
    assert not simulator.collisions
