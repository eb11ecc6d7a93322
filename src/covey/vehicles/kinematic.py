"""Vehicles without physics: each is exactly where its reference says."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from covey.flight.layout import OBSERVATION, QUAT, REF_P, REF_V, REF_YAW, STATE, P, V
from covey.flight.obstacles import Obstacle, Sphere
from covey.flight.parameters import VehicleParameters
from covey.flight.simulator import Collision


class KinematicSimulator:
    """A `Simulator` whose vehicles follow references instead of commands.

    Parameters
    ----------
    vehicles : sequence of VehicleParameters
    positions_W : array, shape (n, 3)
    yaws : array, shape (n,)
    obstacles : sequence of Obstacle, keyword-only

    Notes
    -----
    Nothing is in the way of such a vehicle, so there are no collisions and motors do not fail; it feels no wind and
    knows its state exactly.
    """

    def __init__(
        self,
        vehicles: Sequence[VehicleParameters],
        positions_W: NDArray[np.float64],
        yaws: NDArray[np.float64],
        *,
        obstacles: Sequence[Obstacle] = (),
    ) -> None:
        self.parameters = tuple(vehicles)
        self.time = 0.0
        self.collisions: tuple[Collision, ...] = ()
        self._obstacles = list(obstacles)
        self._state = np.zeros((len(vehicles), STATE))
        self._state[:, P : P + 3] = positions_W
        for i, yaw in enumerate(yaws):
            self._turn(i, float(yaw))

    @property
    def state(self) -> NDArray[np.float64]:
        """True state, shape (n, STATE); a copy."""
        return self._state.copy()

    @property
    def grounded(self) -> NDArray[np.bool_]:
        """Which vehicles are on the ground, shape (n,)."""
        return np.asarray(self._state[:, P + 2] <= 1e-3)

    def observe(self) -> NDArray[np.float64]:
        """Return the true state's first columns, shape (n, OBSERVATION)."""
        return self._state[:, :OBSERVATION].copy()

    def step(self, commands: NDArray[np.float64], duration: float) -> None:
        """Let time pass; commands change nothing."""
        self.time += duration

    def follow(self, references: NDArray[np.float64], flying: NDArray[np.bool_], duration: float) -> None:
        """Put every flying vehicle where its reference, shape (n, REFERENCE), is."""
        self.time += duration
        self._state[flying, P : P + 3] = references[flying, REF_P : REF_P + 3]
        self._state[flying, P + 2] = np.maximum(self._state[flying, P + 2], 0.0)  # the ground
        self._state[flying, V : V + 3] = references[flying, REF_V : REF_V + 3]
        self._state[~flying, V : V + 3] = 0.0
        for i in np.flatnonzero(flying):
            self._turn(int(i), float(references[i, REF_YAW]))

    def set_state(
        self,
        vehicle: int,
        p_W: Sequence[float],
        v_W: Sequence[float] = (0.0, 0.0, 0.0),
        quat_wxyz: Sequence[float] = (1.0, 0.0, 0.0, 0.0),
        omega_B: Sequence[float] = (0.0, 0.0, 0.0),
        *,
        hovering: bool = True,
    ) -> None:
        """Place a vehicle."""
        self._state[vehicle, :OBSERVATION] = [*p_W, *v_W, *quat_wxyz, *omega_B]

    def fail_motor(self, vehicle: int, rotor: int) -> None:
        """Do nothing: there are no motors."""

    def add_obstacle(self, obstacle: Obstacle) -> int:
        """Put an obstacle into the world; return its index."""
        self._obstacles.append(obstacle)
        return len(self._obstacles) - 1

    def move_obstacle(self, index: int, position_W: Sequence[float]) -> None:
        """Put the centre of a spherical obstacle elsewhere."""
        sphere = self._obstacles[index]
        assert isinstance(sphere, Sphere)
        x, y, z = position_W
        self._obstacles[index] = Sphere((x, y, z), sphere.radius)

    def close(self) -> None:
        """Do nothing."""

    def _turn(self, vehicle: int, yaw: float) -> None:
        self._state[vehicle, QUAT : QUAT + 4] = math.cos(0.5 * yaw), 0.0, 0.0, math.sin(0.5 * yaw)
