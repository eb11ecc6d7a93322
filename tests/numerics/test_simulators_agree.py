"""Two simulators written apart fly alike: the reference's equations and MuJoCo's rigid bodies.

Largest differences in position measured, without aerodynamic effects and with the same physics step, 2.5 ms: 3 µm in
20 s of closed loop, 20 µm in 3 s of open loop; the bounds are ten times that.  With drag they are 0.1 mm and 1 mm, as
MuJoCo holds the drag over a physics step.  With each simulator's own physics step (5 ms and 2.5 ms) their rate loops
lag differently: 0.8 mm and 5 mm, within the 1 cm that is asked for.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from covey.flight.backstepping import control_all
from covey.flight.layout import COMMAND, OMEGA, QUAT, REFERENCE, ROTORS, SIGNALS, P
from covey.flight.parameters import VehicleParameters, load_vehicle
from covey.flight.trajectories import Circle, Hold
from covey.simulators.mujoco import MujocoSimulator
from covey.simulators.reference import ReferenceSimulator

Array = NDArray[np.float64]
PERIOD = 0.01


def closed_loop(
    make: Callable[..., MujocoSimulator | ReferenceSimulator],
    vehicles: Sequence[VehicleParameters],
    **options: Any,
) -> Array:
    """Fly 20 s: two circles, one with turning yaw, begun with an error, and a step in position at half time."""
    circles = [Circle((0.0, 0.0, 1.5), 1.0, 1.0, yaw=0.2, yaw_rate=0.3), Circle((6.0, 0.0, 2.0), 1.5, 0.8)]
    corner = Hold((13.0, 1.0, 3.0), 2.0)
    simulator = make(vehicles, [[1.5, 0.3, 1.0], [6.5, 0.0, 1.5], [12.0, 0.0, 2.0]], [0.0, 1.0, -0.5], **options)
    rows = np.array([vehicle.row() for vehicle in vehicles])
    commands, signals, references = np.zeros((3, COMMAND)), np.zeros((3, SIGNALS)), np.zeros((3, REFERENCE))
    states = []
    for k in range(2000):
        time = k * PERIOD
        references[:] = circles[0](time), circles[1](time), corner(time) if k >= 1000 else circles[1](0.0)
        if k < 1000:
            references[2, :3] = 12.0, 0.0, 2.0
            references[2, 3:] = 0.0
        control_all(simulator.observe(), references, rows, commands, signals)
        simulator.step(commands, PERIOD)
        states.append(simulator.state)
    return np.array(states)


SAME_STEP = {"physics_step": 0.0025}


@pytest.mark.parametrize(
    ("options", "bound"),
    [({"aero": False, **SAME_STEP}, 5e-5), ({"aero": True, **SAME_STEP}, 1e-3), ({"aero": False}, 1e-2)],
    ids=["same step", "same step and drag", "own steps"],
)
@pytest.mark.parametrize("name", ["iris", "crazyflie"])
def test_closed_loop(name: str, options: dict[str, Any], bound: float) -> None:
    vehicles = [load_vehicle(name)] * 3
    mujoco, reference = (closed_loop(make, vehicles, **options) for make in (MujocoSimulator, ReferenceSimulator))
    assert np.ptp(reference[:, :2, P : P + 2], axis=0).min() > 1.9, "a manoeuvre"
    assert np.linalg.norm(reference[-1, 2, P : P + 3] - [13.0, 1.0, 3.0]) < (0.3 if options["aero"] else 0.02)
    assert np.abs(mujoco - reference)[:, :, P : P + 3].max() < bound
    assert np.abs(mujoco - reference)[:, :, QUAT:OMEGA].max() < bound
    assert np.abs(mujoco - reference)[:, :, OMEGA:ROTORS].max() < 20.0 * bound


def open_loop(make: Callable[..., MujocoSimulator | ReferenceSimulator], **options: Any) -> Array:
    """Fly 3 s under given thrust and rates, which nothing corrects."""
    simulator = make([load_vehicle("iris")], [[0.0, 0.0, 50.0]], [0.4], **options)
    for k in range(300):
        t = k * PERIOD
        rates = 0.8 * math.cos(2.0 * t), 0.6 * math.cos(2.5 * t), 0.5 * math.sin(t)
        simulator.step(np.array([[9.81 + 2.0 * math.sin(3.0 * t), *rates]]), PERIOD)
    end: Array = simulator.state[0]
    return end


@pytest.mark.parametrize(
    ("options", "bound"),
    [({"aero": False, **SAME_STEP}, 2e-4), ({"aero": True, **SAME_STEP}, 5e-3), ({"aero": False}, 1e-2)],
    ids=["same step", "same step and drag", "own steps"],
)
def test_open_loop(options: dict[str, Any], bound: float) -> None:
    mujoco, reference = open_loop(MujocoSimulator, **options), open_loop(ReferenceSimulator, **options)
    assert np.linalg.norm(reference[:2]) > 5.0, "a long way"
    assert np.abs(mujoco - reference)[P : P + 3].max() < bound
    assert np.abs(mujoco - reference)[QUAT:ROTORS].max() < bound


def tumble(make: Callable[..., MujocoSimulator | ReferenceSimulator], step: float) -> Array:
    """A vehicle that spins about all axes, its rotors failed one after the other: nothing but gyroscopic torques."""
    simulator = make([load_vehicle("crazyflie")], [[0.0, 0.0, 50.0]], [0.0], aero=False, physics_step=step)
    simulator.set_state(0, [0.0, 0.0, 50.0], omega_B=[6.0, -4.0, 5.0], hovering=False)
    for rotor in range(4):
        simulator.fail_motor(0, rotor)
    for _ in range(100):
        simulator.step(np.zeros((1, COMMAND)), PERIOD)
    end: Array = simulator.state[0]
    return end


def test_torque_free_rotation_and_its_order() -> None:
    exact = tumble(ReferenceSimulator, 1e-4)
    assert np.abs(exact[OMEGA:ROTORS] - [6.0, -4.0, 5.0]).max() > 1.0
    errors = [np.abs(tumble(MujocoSimulator, step) - exact)[QUAT:ROTORS].max() for step in (0.01, 0.005)]
    assert errors[1] < 1e-6
    assert 12.0 < errors[0] / errors[1] < 20.0, "fourth order"
