"""The reference simulator with control and avoidance for 1,000 vehicles, beside RotorPy's simulator and controller.

A vehicle-step is 10 ms of one vehicle: observation, avoidance (potential field and speed caps among all vehicles), the
practical control law, and physics of two steps of 5 ms, each with its rate loop and a Runge-Kutta step of order 4, with
drag and the check for collisions.  One thread.  RotorPy's is `SE3Control.update` and `Multirotor.step` of 10 ms,
without avoidance; it is left out where RotorPy is not installed.

Then whole missions in MuJoCo, as times real time.  Included is all that `covey.runtime.fly.fly` does, its kernels being
compiled: building the simulator, trading, proofs, control, physics and log.  Starting Python, loading the mission and
writing results and figures are not; they take as long for a short flight as for a long one.
"""

from __future__ import annotations

import importlib.util
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from covey.flight.backstepping import control_all
from covey.flight.layout import COMMAND, SIGNALS, P, V
from covey.flight.navigation import Navigator
from covey.flight.parameters import load_vehicle
from covey.mission import load_mission
from covey.runtime.fly import fly
from covey.runtime.result import Deployment
from covey.simulators.reference import ReferenceSimulator

EXAMPLES = Path(__file__).parents[1] / "examples"
PERIOD = 0.01
SPACING = 10.0
"""Metres between neighbours at the start, in the plane."""


class Swarm:
    """Vehicles that start on a lattice at two altitudes and fly to places of others chosen at random."""

    def __init__(self, n: int, seed: int = 0) -> None:
        rng = np.random.default_rng(seed)
        iris = load_vehicle("iris")
        side = int(np.ceil(np.sqrt(n)))
        k = np.arange(n)
        self.starts = np.stack([SPACING * (k % side), SPACING * (k // side), 10.0 + 5.0 * (k % 2)], axis=1)
        self.simulator = ReferenceSimulator([iris] * n, self.starts, np.zeros(n))
        self.navigator = Navigator([iris] * n)
        self.params = np.array([iris.row()] * n)
        self.commands, self.signals = np.zeros((n, COMMAND)), np.zeros((n, SIGNALS))
        goals = self.starts[rng.permutation(n)]
        for i in range(n):
            self.navigator.reset(i, self.starts[i], 0.0)
            self.navigator.set_goal(i, goals[i], 0.0)
        self.seconds = dict.fromkeys(("avoidance", "control", "physics"), 0.0)

    def step(self) -> None:
        """Go once around."""
        begun = time.perf_counter()
        seen = self.simulator.observe()
        references = self.navigator.step(seen[:, P : P + 3], seen[:, V : V + 3], PERIOD)
        led = time.perf_counter()
        control_all(seen, references, self.params, self.commands, self.signals)
        controlled = time.perf_counter()
        self.simulator.step(self.commands, PERIOD)
        done = time.perf_counter()
        self.seconds["avoidance"] += led - begun
        self.seconds["control"] += controlled - led
        self.seconds["physics"] += done - controlled


def swarm(n: int, periods: int) -> dict[str, Any]:
    """Fly, and tell how fast that went."""
    flight = Swarm(n)
    for _ in range(50):
        flight.step()
    best: dict[str, float] = {}
    for _ in range(5):
        flight.seconds = dict.fromkeys(flight.seconds, 0.0)
        for _ in range(periods // 5):
            flight.step()
        if not best or sum(flight.seconds.values()) < sum(best.values()):
            best = flight.seconds
    steps = n * (periods // 5)
    moved = np.linalg.norm(flight.simulator.state[:, :3] - flight.starts, axis=1)
    return {
        "vehicles": n,
        "vehicle_steps_per_second": steps / sum(best.values()),
        "ns_per_vehicle_step": {name: 1e9 * seconds / steps for name, seconds in best.items()},
        "collisions": len(flight.simulator.collisions),
        "mean_distance_flown_m": float(moved.mean()),
    }


def rotorpy(steps: int) -> float | None:
    """Vehicle-steps a second of RotorPy, the best of five runs; None where it is not installed."""
    if importlib.util.find_spec("rotorpy") is None:
        return None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from rotorpy.controllers.quadrotor_control import SE3Control
        from rotorpy.vehicles.crazyflie_params import quad_params
        from rotorpy.vehicles.multirotor import Multirotor

        speed = np.sqrt(quad_params["mass"] * 9.81 / (4.0 * quad_params["k_eta"]))
        state: Any = {"x": np.zeros(3), "v": np.zeros(3), "q": np.array([0.0, 0.0, 0.0, 1.0]), "w": np.zeros(3)}
        state |= {"wind": np.zeros(3), "rotor_speeds": np.full(4, speed)}
        vehicle, controller = Multirotor(quad_params, initial_state=state), SE3Control(quad_params)
        zero = np.zeros(3)
        goal: dict[str, Any] = {
            "x": np.array([1.0, 0.0, 1.0]),
            "x_dot": zero,
            "x_ddot": zero,
            "x_dddot": zero,
            "x_ddddot": zero,
        }
        goal |= {"yaw": 0.0, "yaw_dot": 0.0, "yaw_ddot": 0.0}
        best = 0.0
        for _ in range(5):
            begun = time.perf_counter()
            for k in range(steps // 5):
                state = vehicle.step(state, controller.update(k * PERIOD, state, goal), PERIOD)
            best = max(best, (steps // 5) / (time.perf_counter() - begun))
        assert np.linalg.norm(state["x"] - goal["x"]) < 1.5
    return best


def mission(name: str, repetitions: int) -> dict[str, Any]:
    """Fly a mission in MuJoCo and tell how fast that went at best."""
    loaded = load_mission(EXAMPLES / f"{name}.yaml")
    best = max((fly(loaded).deployment for _ in range(repetitions)), key=_factor)
    assert best.flight is not None
    return {
        "mission": name,
        "agents": len(best.agents),
        "times_real_time": _factor(best),
        "duration_s": best.flight.duration,
        "min_separation_m": best.flight.min_separation,
    }


def _factor(deployment: Deployment) -> float:
    return 0.0 if deployment.flight is None else deployment.flight.real_time_factor


def run(quick: bool) -> dict[str, Any]:
    """Both, in one run."""
    result: dict[str, Any] = {"swarm": swarm(200 if quick else 1000, 100 if quick else 500)}
    names = ("thesis-5.1",) if quick else ("thesis-5.1", "eight-agents", "sixteen-agents")
    result["missions"] = [mission(name, 1 if quick else 3) for name in names]
    other = rotorpy(500 if quick else 2000)
    if other is not None:
        result["rotorpy_vehicle_steps_per_second"] = other
        result["covey_over_rotorpy"] = result["swarm"]["vehicle_steps_per_second"] / other
    return result
