"""What takes an agent in a process of its own to its waypoints."""

from __future__ import annotations

import enum
import math
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from covey.geometry import Pose2
from covey.mission import Mission


class Leg(enum.Enum):
    """How far a vehicle is on its way to its waypoint."""

    UNDER_WAY = "under way"
    ARRIVED = "arrived"
    STUCK = "stuck"
    """It cannot get there."""


class Vehicle(Protocol):
    """Takes an agent to its waypoints while time passes outside."""

    @property
    def pose(self) -> Pose2:
        """Where it is, frame W."""
        ...

    @property
    def state(self) -> NDArray[np.float64] | None:
        """How it moves, shape (13,), columns of an observation in `covey.flight.layout`; None: nothing flies."""
        ...

    @property
    def battery(self) -> float:
        """Share that is left of its battery, from 0 to 1; NaN where unknown."""
        ...

    def go_to(self, now: float, pose: Pose2) -> None:
        """Set off to a waypoint; `now` in seconds."""
        ...

    def advance(self, now: float) -> Leg:
        """Let time pass up to now; return how far it is."""
        ...

    def hold(self) -> Pose2:
        """Stay where it is, or at the nearest pose that its agent may commit; return that pose."""
        ...

    def due(self, now: float) -> float | None:
        """Return when `advance` is wanted next, seconds; None: not before it is sent somewhere."""
        ...


class AtOnce:
    """A vehicle that is at each waypoint at once; nothing flies.

    Parameters
    ----------
    pose : Pose2
    """

    state = None
    battery = math.nan

    def __init__(self, pose: Pose2) -> None:
        self.pose = pose

    def go_to(self, now: float, pose: Pose2) -> None:
        """Be there."""
        self.pose = pose

    def advance(self, now: float) -> Leg:
        """Return ARRIVED."""
        return Leg.ARRIVED

    def hold(self) -> Pose2:
        """Return where it is."""
        return self.pose

    def due(self, now: float) -> float | None:
        """Return None."""
        return None


def build_vehicle(mission: Mission, agent: int, vehicles: str, pose: Pose2, now: float) -> Vehicle:
    """Build the vehicle of an agent.

    Parameters
    ----------
    mission : Mission
    agent : int
    vehicles : str
        ``none``, which is at each waypoint at once, or a `covey.vehicles.fleet.Kind`.
    pose : Pose2
        Where it begins.
    now : float
        Seconds.

    Raises
    ------
    InputError
        If the vehicle's parameters cannot be read.
    """
    if vehicles == "none":
        return AtOnce(pose)
    from covey.runtime.network.simulated_vehicle import SimulatedVehicle  # half a second of imports
    from covey.vehicles.fleet import Kind

    return SimulatedVehicle(mission, agent, Kind(vehicles), pose, now)
