"""The inner loop: what it asks of the rotors, and in which order it gives way."""

from __future__ import annotations

import numpy as np
import pytest

from covey.flight.layout import COMMAND, GRAVITY, OMEGA, QUAT, ROTORS, STATE
from covey.flight.parameters import VehicleParameters, load_vehicle, vehicle_names
from covey.flight.rate_loop import allocate, rotor_commands
from covey.simulators.reference import ReferenceSimulator


def thrusts(vehicle: VehicleParameters, force: float, roll: float, pitch: float, yaw: float) -> np.ndarray:
    out = np.empty(4)
    allocate(force, roll, pitch, yaw, vehicle.row(), out)
    return out


def bounds(vehicle: VehicleParameters) -> tuple[float, float]:
    c = vehicle.thrust_coefficient
    return c * vehicle.rotor_speed_min**2, c * vehicle.rotor_speed_max**2


@pytest.mark.parametrize("name", vehicle_names())
def test_what_is_possible_is_met(name: str) -> None:
    vehicle = load_vehicle(name)
    weight, arm = vehicle.mass * GRAVITY, vehicle.body_radius
    wanted = np.array([1.1 * weight, 0.05 * weight * arm, -0.04 * weight * arm, 0.05 * weight * vehicle.moment_ratio])
    np.testing.assert_allclose(vehicle.mixer @ thrusts(vehicle, *wanted), wanted, rtol=1e-9)


@pytest.mark.parametrize("name", vehicle_names())
def test_limits_hold_and_roll_and_pitch_go_first(name: str) -> None:
    vehicle = load_vehicle(name)
    low, high = bounds(vehicle)
    weight, arm = vehicle.mass * GRAVITY, vehicle.body_radius
    rng = np.random.default_rng(1)
    for _ in range(200):
        roll, pitch, yaw = rng.uniform(-1.0, 1.0, 3) * weight * np.array([arm, arm, 20.0 * vehicle.moment_ratio])
        force = rng.uniform(-0.5, 3.0) * weight
        out = thrusts(vehicle, force, roll, pitch, yaw)
        assert np.all(out >= low - 1e-12)
        assert np.all(out <= high + 1e-12)
        got = vehicle.mixer @ out
        # roll and pitch are scaled together, never turned about
        scale = np.hypot(got[1], got[2]) / np.hypot(roll, pitch)
        np.testing.assert_allclose(got[1:3], scale * np.array([roll, pitch]), atol=1e-9 * weight)
        assert -1e-9 <= scale <= 1.0 + 1e-9
        # yaw never exceeds or opposes what was asked
        assert -1e-9 <= got[3] / yaw <= 1.0 + 1e-9
        if scale < 0.999:
            # they were cut to leave room: the weight could still be lifted
            most = vehicle.mixer @ thrusts(vehicle, 10.0 * weight, roll, pitch, 0.0)
            assert most[0] > weight
        if got[0] < force - 1e-9 * weight:
            # thrust is kept back only where a rotor has no room, even without yaw
            assert thrusts(vehicle, force, roll, pitch, 0.0).max() > high - 1e-9 * weight


def test_yaw_gives_way_to_thrust() -> None:
    vehicle = load_vehicle("iris")
    _, high = bounds(vehicle)
    out = thrusts(vehicle, 4.0 * high, 0.0, 0.0, 1.0)
    np.testing.assert_allclose(out, high)


@pytest.mark.parametrize("name", vehicle_names())
def test_rates_are_reached(name: str) -> None:
    # 0.8 rad/s about x, then y, within half a second; yaw within two
    vehicle = load_vehicle(name)
    for axis, duration in ((0, 0.3), (1, 0.3), (2, 2.0)):
        simulator = ReferenceSimulator([vehicle], [[0.0, 0.0, 50.0]], [0.0], aero=False)
        command = np.zeros((1, COMMAND))
        command[0, 0] = GRAVITY
        command[0, 1 + axis] = 0.8
        history = []
        for _ in range(round(duration / 0.005)):
            simulator.step(command, 0.005)
            history.append(simulator.state[0, OMEGA : OMEGA + 3])
        rates = np.array(history)
        assert rates[-1, axis] == pytest.approx(0.8, abs=0.04)
        assert rates[:, axis].max() < 0.8 * 1.2
        others = [other for other in range(3) if other != axis]
        assert np.abs(rates[:, others]).max() < 0.05


def test_lead_drives_rotors_harder() -> None:
    vehicle = load_vehicle("crazyflie")
    state = np.zeros(STATE)
    state[QUAT], state[ROTORS:] = 1.0, vehicle.hover_speed
    out = np.empty(4)
    rotor_commands(state, np.array([1.1 * GRAVITY, 0.0, 0.0, 0.0]), vehicle.row(), out)
    wanted = np.sqrt(1.1) * vehicle.hover_speed
    np.testing.assert_allclose(out - vehicle.hover_speed, vehicle.rotor_lead * (wanted - vehicle.hover_speed))
