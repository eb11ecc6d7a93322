"""Section 2.3.1: regulation and circle, with the law as corrected and as printed."""

from __future__ import annotations

import math

import numpy as np
import pytest
from tests.unit.flight.printed_law import Law, matrix

from covey.flight.layout import SIG_EP, SIG_EV, SIG_V3
from covey.flight.parameters import Gains, load_vehicle, vehicle_names
from covey.flight.trajectories import Circle, Hold
from covey.simulators.ideal import fly_ideal

REGULATION = Hold((1.0, 3.0, 2.0))
CIRCLE = Circle((0.0, 0.0, 0.5), radius=1.0, rate=1.0)
LEVEL = [0.0] * 6 + [1.0, 0.0, 0.0, 0.0]
ERRATA = Gains(alpha=1.0, beta=1.0, gamma=5.0, k1=1.0, k2=1.0, k_theta=5.0, k_yaw=1.0)


@pytest.mark.parametrize("name", vehicle_names())
@pytest.mark.parametrize("trajectory", [REGULATION, CIRCLE], ids=["figures 2.2 to 2.5", "figures 2.6 to 2.9"])
def test_v_falls_at_every_step_and_errors_vanish(trajectory: Hold | Circle, name: str) -> None:
    flight = fly_ideal(trajectory, LEVEL, load_vehicle(name), duration=25.0, dt=0.005)
    v = flight.signals[:, SIG_V3]
    # once V is down at what the integrator errs by, 1e-15, it need not fall further
    assert np.diff(v).max() < 1e-15
    assert np.all(np.diff(v)[v[:-1] > 1e-12] < 0.0)
    assert flight.signals[-1, SIG_EP] < 1e-6
    assert flight.signals[-1, SIG_EV] < 1e-6
    assert v[-1] < 1e-12 * v[0]


def test_law_as_corrected_with_the_gains_of_the_errata() -> None:
    states, v = Law(ERRATA).fly(REGULATION, 15.0)
    assert np.diff(v).max() < 1e-9
    assert np.linalg.norm(states[-1, :3] - (1.0, 3.0, 2.0)) < 1e-3


def test_law_as_printed_flips_the_vehicle() -> None:
    # C1
    states, v = Law(ERRATA, printed_coupling=True, printed_yaw=True).fly(REGULATION, 15.0)
    assert min(matrix(x[6:10])[2, 2] for x in states) < 0.0
    assert np.diff(v).max() > 1.0
    assert np.linalg.norm(states[-1, :3] - (1.0, 3.0, 2.0)) > 1.0


def test_gain_as_printed_never_gets_there() -> None:
    # C2: kP is zero at k1 = k2 = 1
    states, _ = Law(ERRATA, printed_k_p=True).fly(REGULATION, 30.0)
    assert np.linalg.norm(states[-1, :3] - (1.0, 3.0, 2.0)) > 0.5


def test_without_feedforward_the_circle_is_missed() -> None:
    # C7: V rises, centimetres stay
    states, v = Law(ERRATA, no_feedforward=True).fly(CIRCLE, 20.0, on_it=True)
    assert v[0] < 1e-12
    assert v[-1] > 1e-4
    error = np.linalg.norm(states[-1, :3] - CIRCLE(20.0)[:3])
    assert 0.02 < error < 0.2
    states, v = Law(ERRATA).fly(CIRCLE, 20.0, on_it=True)
    assert v.max() < 1e-9
    assert np.linalg.norm(states[-1, :3] - CIRCLE(20.0)[:3]) < 1e-4


def test_yaw_as_printed_is_off_on_the_circle() -> None:
    # C6: milliradians stay
    def error(law: Law) -> float:
        states, _ = law.fly(CIRCLE, 20.0)
        rotations = [matrix(x[6:10]) for x in states[-300:]]
        return max(abs(math.atan2(r[1, 0], r[0, 0])) for r in rotations)

    assert 1e-3 < error(Law(ERRATA, printed_yaw=True)) < 2e-2
    assert error(Law(ERRATA)) < 1e-6
