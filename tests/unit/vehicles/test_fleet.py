"""The loop around a simulator: arrival, loss, separation and the log of it."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from covey.errors import ResultError
from covey.flight.arrival import TUMBLING, arrived, tumbling
from covey.flight.disturbance import LARGEST, DisturbanceEstimate
from covey.flight.layout import OBSERVATION, QUAT, REF_A, REFERENCE, P, V
from covey.flight.navigation import Navigator
from covey.flight.parameters import load_vehicle
from covey.flight.trajectories import Circle
from covey.simulators.reference import ReferenceSimulator
from covey.vehicles.fleet import CONTROL_PERIOD, Fleet, Kind
from covey.vehicles.flight_log import FlightLog
from covey.vehicles.kinematic import KinematicSimulator

IRIS = load_vehicle("iris")
STARTS = np.array([[0.0, 0.0, 0.0], [3.0, 0.0, 0.0]])


def make(kind: Kind = Kind.REFERENCE) -> Fleet:
    """Return two vehicles on the ground, 3 m apart."""
    simulators = {Kind.REFERENCE: ReferenceSimulator, Kind.KINEMATIC: KinematicSimulator}
    simulator = simulators[kind]([IRIS, IRIS], STARTS, np.zeros(2))
    return Fleet(simulator, ["a", "b"], navigator=Navigator([IRIS, IRIS]), kind=kind, log_every=0.1)


@pytest.mark.parametrize("kind", [Kind.REFERENCE, Kind.KINEMATIC])
def test_vehicles_stand_until_they_are_told_to_fly(kind: Kind) -> None:
    fleet = make(kind)
    fleet.run(lambda: False, 1.0)
    np.testing.assert_allclose(fleet.state[:, P : P + 3], STARTS, atol=1e-9)
    fleet.go_to(0, (0.0, 1.0, 1.5), 1.0)
    assert fleet.run(lambda: fleet.reached(0), 20.0)
    assert math.dist(fleet.state[0, P : P + 3], (0.0, 1.0, 1.5)) <= 0.15
    assert abs(fleet.yaw(0) - 1.0) <= math.radians(5.0)
    np.testing.assert_allclose(fleet.state[1, P : P + 3], STARTS[1], atol=1e-9)
    assert not fleet.reached(1)
    assert fleet.min_separation == math.inf, "one of two in the air"
    assert fleet.time == pytest.approx(fleet.simulator.time)


def test_hovering_takes_its_share_of_the_battery_and_standing_takes_none() -> None:
    fleet = make()
    fleet.go_to(0, (0.0, 0.0, 1.5), 0.0)
    assert fleet.run(lambda: fleet.reached(0), 20.0)
    before = fleet.battery
    fleet.run(lambda: False, 10.0)
    used = before - fleet.battery
    assert used[0] == pytest.approx(10.0 / IRIS.endurance, rel=0.01)
    assert used[1] < 0.01 * used[0]  # its rotors idle
    assert 0.0 < before[0] < before[1] <= 1.0


def test_a_vehicle_without_rotors_has_no_battery() -> None:
    fleet = make(Kind.KINEMATIC)
    fleet.go_to(0, (0.0, 0.0, 1.5), 0.0)
    fleet.run(lambda: False, 1.0)
    assert np.isnan(fleet.battery).all()


def test_a_place_counts_as_reached_only_when_it_is_held() -> None:
    fleet = make(Kind.KINEMATIC)
    fleet.go_to(0, (0.0, 0.0, 0.1), 0.0)  # nearly there, and nearly at rest, from the start
    fleet.step()
    assert not fleet.reached(0)
    assert fleet.run(lambda: fleet.reached(0), 2.0)
    assert fleet.time >= 0.2
    fleet.go_to(0, (0.0, 0.0, 2.0), 0.0)
    assert not fleet.reached(0), "another goal"


def test_the_separation_is_watched_between_the_rows_of_the_log() -> None:
    fleet = make(Kind.KINEMATIC)
    fleet.go_to(0, (3.0, 0.0, 2.0), 0.0)
    fleet.go_to(1, (0.0, 0.0, 2.0), 0.0)
    assert fleet.run(lambda: fleet.reached(0) and fleet.reached(1), 60.0)
    log = fleet.log()
    assert IRIS.required_separation <= fleet.min_separation <= np.nanmin(log.separation)
    apart = (log.state[:, 0, :3] - log.state[:, 1, :3]) / [1.0, 1.0, IRIS.vertical_ratio]
    flying = np.isfinite(log.separation)
    np.testing.assert_allclose(np.linalg.norm(apart[flying], axis=1), log.separation[flying], rtol=1e-12)


def test_a_vehicle_that_tips_over_is_given_up() -> None:
    fleet = make()
    fleet.go_to(0, (0.0, 0.0, 30.0), 0.0)
    fleet.run(lambda: fleet.state[0, 2] > 20.0, 60.0)
    fleet.simulator.fail_motor(0, 0)
    assert fleet.run(lambda: 0 in fleet.lost, 8.0)
    assert fleet.blocked(0)
    assert [event.kind for event in fleet.recorder.events] == ["lost"]
    assert not fleet.simulator.grounded[0], "it was still falling"


def test_a_trajectory_is_tracked_whatever_is_in_its_way() -> None:
    fleet = make(Kind.KINEMATIC)
    circle = Circle((0.0, 0.0, 1.0), 1.0, 1.0, 0.0)
    fleet.track(0, circle)
    fleet.run(lambda: False, 2.0)
    np.testing.assert_allclose(fleet.state[0, :3], circle(fleet.time - CONTROL_PERIOD)[:3], atol=1e-12)


def test_arrival_needs_place_heading_and_rest() -> None:
    states = np.zeros((5, OBSERVATION))
    states[:, QUAT] = 1.0
    goals = np.zeros((5, 4))
    states[1, P + 2] = 0.11
    states[2, V + 1] = 0.3
    goals[3, 3] = 0.2
    goals[4] = np.nan
    out = np.ones(5, dtype=np.bool_)
    arrived(states, goals, 0.1, 0.1, 0.2, out)
    assert out.tolist() == [True, False, False, False, False]
    goals[3, 3] = 2.0 * math.pi + 0.05
    arrived(states, goals, 0.1, 0.1, 0.2, out)
    assert out[3], "headings are compared round the circle"


def test_tumbling_is_a_matter_of_tilt_alone() -> None:
    angles = [0.0, TUMBLING - 0.01, TUMBLING + 0.01, math.pi]
    states = np.zeros((4, OBSERVATION))
    states[:, QUAT] = np.cos(np.array(angles) / 2.0)
    states[:, QUAT + 1] = np.sin(np.array(angles) / 2.0)
    out = np.zeros(4, dtype=np.bool_)
    tumbling(states, out)
    assert out.tolist() == [False, False, True, True]


def test_a_constant_push_is_learnt_and_leaves_no_error() -> None:
    """Point mass under the law's acceleration with a push it does not know: the error vanishes, the estimate is it."""
    estimate = DisturbanceEstimate([IRIS])
    gains = IRIS.gains
    k_p, k_d = gains.alpha / gains.beta * (1 + gains.k1 * gains.k2), gains.k1 + gains.alpha / gains.beta * gains.k2
    push = np.array([0.4, -0.3, 0.2])
    state, reference = np.zeros((1, OBSERVATION)), np.zeros((1, REFERENCE))
    flying = np.array([True])
    for _ in range(4000):
        estimate.update(state, reference, flying, 0.01)
        leaning = estimate.compensate(reference)
        pull = leaning[0, REF_A : REF_A + 3] - k_p * state[0, P : P + 3] - k_d * state[0, V : V + 3] + push
        state[0, V : V + 3] += 0.01 * pull
        state[0, P : P + 3] += 0.01 * state[0, V : V + 3]
    np.testing.assert_allclose(estimate.values[0], push, atol=1e-6)
    np.testing.assert_allclose(state[0, P : P + 3], 0.0, atol=1e-6)


def test_the_estimate_is_bounded_and_forgotten_on_the_ground() -> None:
    estimate = DisturbanceEstimate([IRIS])
    state, reference = np.zeros((1, OBSERVATION)), np.zeros((1, REFERENCE))
    state[0, V] = 5.0
    for _ in range(1000):
        estimate.update(state, reference, np.array([True]), 0.01)
    assert estimate.values[0, 0] == LARGEST
    estimate.update(state, reference, np.array([False]), 0.01)
    assert estimate.values[0, 0] == 0.0


@pytest.mark.parametrize("content", [b"", b"nonsense", b"PK\x03\x04cut"])
def test_what_is_no_log_is_refused(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "flight.npz"
    path.write_bytes(content)
    with pytest.raises(ResultError, match=r"flight\.npz: expected a flight log"):
        FlightLog.load(path)


def test_pickles_are_not_loaded(tmp_path: Path) -> None:
    path = tmp_path / "flight.npz"
    np.savez(path, head=np.array([{"a": 1}], dtype=object))
    with pytest.raises(ResultError, match="expected a flight log"):
        FlightLog.load(path)
