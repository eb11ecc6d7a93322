"""Laws of physics that the model has to keep, and its order of accuracy."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from covey.flight import dynamics, rotation
from covey.flight.layout import GRAVITY, OMEGA, QUAT, ROTORS, STATE, P, V
from covey.flight.parameters import (
    BODY_DRAG,
    INERTIA,
    MASS,
    ROTOR_DRAG,
    TAU_DOWN,
    TAU_UP,
    load_vehicle,
    vehicle_names,
)

CALM = np.zeros(3)


def start(name: str, *, rotors: float | None = None, tumbling: bool = False) -> np.ndarray:
    state = np.zeros(STATE)
    state[QUAT] = 1.0
    state[ROTORS:] = load_vehicle(name).hover_speed if rotors is None else rotors
    if tumbling:
        state[V : V + 3], state[OMEGA : OMEGA + 3] = (2.0, 1.0, -0.5), (3.0, -2.0, 1.0)
        rotation.from_yaw_pitch_roll(0.4, 0.3, -0.5, state[QUAT:OMEGA])
    return state


def run(
    state: np.ndarray,
    row: np.ndarray,
    commands: np.ndarray,
    duration: float,
    dt: float,
    working: np.ndarray | None = None,
    wind: np.ndarray = CALM,
) -> np.ndarray:
    state = state.copy()
    half_up, half_down = dynamics.kept(0.5 * dt, row[TAU_UP]), dynamics.kept(0.5 * dt, row[TAU_DOWN])
    work, turning = np.empty((3, dynamics.WRENCH)), np.ones(4) if working is None else working
    for _ in range(round(duration / dt)):
        dynamics.advance(state, commands, turning, wind, row, dt, half_up, half_down, work)
    return state


def without_drag(name: str) -> np.ndarray:
    row = load_vehicle(name).row()
    row[ROTOR_DRAG] = 0.0
    row[BODY_DRAG : BODY_DRAG + 3] = 0.0
    return row


@pytest.mark.parametrize("name", vehicle_names())
def test_integrator_has_order_four(name: str) -> None:
    row, state = load_vehicle(name).row(), start(name, tumbling=True)
    commands = load_vehicle(name).hover_speed * np.array([1.02, 0.99, 1.01, 1.0])
    wind = np.array([1.0, -2.0, 0.5])
    ends = [run(state, row, commands, 0.4, h, wind=wind)[:13] for h in (0.02, 0.01, 0.005, 0.0025, 0.00125)]
    gaps = [float(np.linalg.norm(a - b)) for a, b in pairwise(ends)]
    orders = np.log2(np.array(gaps[:-1]) / np.array(gaps[1:]))
    assert np.all(np.abs(orders - 4.0) < 0.25), orders


@pytest.mark.parametrize("name", vehicle_names())
def test_hover_thrust_is_the_weight(name: str) -> None:
    vehicle, state = load_vehicle(name), start(name)
    end = run(state, vehicle.row(), np.full(4, vehicle.hover_speed), 2.0, 0.005)
    np.testing.assert_allclose(end, state, atol=1e-10)


def test_free_fall() -> None:
    row, state = without_drag("iris"), start("iris", rotors=0.0)
    end = run(state, row, np.zeros(4), 1.0, 0.005)
    assert end[P + 2] == pytest.approx(-0.5 * GRAVITY, abs=1e-12)
    assert end[V + 2] == pytest.approx(-GRAVITY, abs=1e-12)


def test_energy_and_momentum_without_forces() -> None:
    row, state = without_drag("iris"), start("iris", rotors=0.0, tumbling=True)
    inertia = row[INERTIA : INERTIA + 3]

    def kept(x: np.ndarray) -> list[np.ndarray]:
        energy = 0.5 * row[MASS] * x[V : V + 3] @ x[V : V + 3] + row[MASS] * GRAVITY * x[P + 2]
        energy += 0.5 * float(inertia @ x[OMEGA : OMEGA + 3] ** 2)
        angular = np.empty(3)
        rotation.rotate(x[QUAT:OMEGA], inertia * x[OMEGA : OMEGA + 3], angular)
        return [np.array(energy), angular, np.asarray(row[MASS] * x[V : V + 2])]

    end = run(state, row, np.zeros(4), 3.0, 0.005)
    for before, after in zip(kept(state), kept(end), strict=True):
        np.testing.assert_allclose(after, before, rtol=1e-6)
    # and it did turn
    assert np.linalg.norm(end[OMEGA : OMEGA + 3] - state[OMEGA : OMEGA + 3]) > 0.1


def test_drag_takes_energy_until_the_air_is_matched() -> None:
    vehicle = load_vehicle("iris")
    wind = np.array([2.0, -1.0, 0.0])
    still = run(start("iris"), vehicle.row(), np.full(4, vehicle.hover_speed), 60.0, 0.005, wind=wind)
    np.testing.assert_allclose(still[V : V + 2], wind[:2], atol=1e-3)
    moving = start("iris")
    moving[V] = 3.0
    # (drag of rotors and body) / mass
    rate = (4.0 * vehicle.rotor_drag * vehicle.hover_speed + vehicle.body_drag[0]) / vehicle.mass
    after = run(moving, vehicle.row(), np.full(4, vehicle.hover_speed), 1.0, 0.005)
    assert after[V] == pytest.approx(3.0 * np.exp(-rate), rel=1e-6)


@pytest.mark.parametrize(("factor", "column"), [(1.1, TAU_UP), (0.9, TAU_DOWN)])
def test_rotors_lag_with_their_time_constants(factor: float, column: int) -> None:
    vehicle = load_vehicle("iris")
    row = vehicle.row()
    end = run(start("iris"), row, np.full(4, factor * vehicle.hover_speed), row[column], row[column] / 5.0)
    share = (end[ROTORS:] - vehicle.hover_speed) / ((factor - 1.0) * vehicle.hover_speed)
    np.testing.assert_allclose(share, 1.0 - np.exp(-1.0), rtol=1e-9)


def test_torques_turn_the_right_way() -> None:
    vehicle = load_vehicle("iris")
    for i, (x, y) in enumerate(vehicle.rotor_positions_B):
        commands = np.full(4, vehicle.hover_speed)
        commands[i] *= 1.05
        rates = run(start("iris"), vehicle.row(), commands, 0.05, 0.005)[OMEGA : OMEGA + 3]
        assert np.sign(rates[0]) == np.sign(y)
        assert np.sign(rates[1]) == -np.sign(x)
        assert np.sign(rates[2]) == -vehicle.rotor_spins[i]


def test_a_failed_rotor_gives_nothing() -> None:
    vehicle = load_vehicle("iris")
    working = np.array([1.0, 1.0, 0.0, 1.0])
    end = run(start("iris"), vehicle.row(), np.full(4, vehicle.hover_speed), 0.1, 0.005, working=working)
    assert end[ROTORS + 2] == 0.0
    # the rotor at the front left is missing: it falls, and drops that corner
    assert end[V + 2] < 0.0
    assert end[OMEGA] < 0.0
    assert end[OMEGA + 1] > 0.0


def test_kinematic_model_is_the_dynamic_one_without_lag() -> None:
    # (2.2): the derivatives are those of a rigid body with that thrust and those rates
    vehicle, state = load_vehicle("iris"), start("iris", tumbling=True)
    out = np.empty(10)
    omega = (0.5, -0.2, 0.1)
    dynamics.kinematic_derivative(state, 11.0, np.array(omega), out)
    velocity, quat = tuple(state[V : V + 3]), tuple(state[QUAT:OMEGA])
    row = without_drag("iris")
    np.testing.assert_allclose(out[:3], velocity)
    expected = dynamics.acceleration(velocity, quat, 11.0 * vehicle.mass, 0.0, CALM, row)
    np.testing.assert_allclose(out[3:6], expected, rtol=1e-12)
    np.testing.assert_allclose(out[6:], dynamics.turning(quat, omega), rtol=1e-12)
