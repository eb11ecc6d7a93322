"""What every simulator offers to those who fly in it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from covey.flight.obstacles import Obstacle
from covey.flight.parameters import VehicleParameters


@dataclass(frozen=True, slots=True)
class Collision:
    """The begin of a contact.

    Parameters
    ----------
    time : float
        Seconds since the simulator was made.
    vehicle : int
    other : int or None
        The other vehicle; None for an obstacle.
    """

    time: float
    vehicle: int
    other: int | None


class Simulator(Protocol):
    """A world with vehicles in it, advanced by commands.

    Touching the ground at z = 0 is no collision: vehicles take off from it and land on it.
    """

    @property
    def parameters(self) -> tuple[VehicleParameters, ...]:
        """The vehicles, one entry each."""
        ...

    @property
    def time(self) -> float:
        """Seconds simulated so far."""
        ...

    @property
    def state(self) -> NDArray[np.float64]:
        """True state, shape (n, STATE), columns as in `covey.flight.layout`; a copy."""
        ...

    @property
    def grounded(self) -> NDArray[np.bool_]:
        """Which vehicles stand or lie on the ground, shape (n,)."""
        ...

    @property
    def collisions(self) -> Sequence[Collision]:
        """Contacts between vehicles and with obstacles so far, in the order they began."""
        ...

    def observe(self) -> NDArray[np.float64]:
        """Measure every vehicle: shape (n, OBSERVATION), with noise and latency where configured."""
        ...

    def step(self, commands: NDArray[np.float64], duration: float) -> None:
        """Hold commands, shape (n, COMMAND), for a duration in seconds and advance the world."""
        ...

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
        """Place a vehicle; its rotors turn at hover speed, or stand still."""
        ...

    def fail_motor(self, vehicle: int, rotor: int) -> None:
        """Let a rotor give no thrust from now on."""
        ...

    def add_obstacle(self, obstacle: Obstacle) -> int:
        """Put an obstacle into the world; return its index."""
        ...

    def move_obstacle(self, index: int, position_W: Sequence[float]) -> None:
        """Put the centre of a spherical obstacle elsewhere."""
        ...

    def close(self) -> None:
        """Free what the simulator holds."""
        ...
