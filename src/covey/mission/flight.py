"""How a mission is flown: the file's `flight` section as SI data."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from covey.flight.obstacles import Obstacle

LAYER_MARGIN = 1.25
"""How far apart two layers lie by default, in units of the required vertical separation."""


@dataclass(frozen=True)
class WindSpec:
    """The weather.

    Parameters
    ----------
    steady_W : tuple of 3 floats
        Mean wind: where the air moves to, m/s.
    gust : float
        Standard deviation of gusts in each direction, m/s.
    gust_time : float
        How long a gust lasts, seconds.
    """

    steady_W: tuple[float, float, float] = (0.0, 0.0, 0.0)
    gust: float = 0.0
    gust_time: float = 2.0

    @property
    def calm(self) -> bool:
        """Whether no air moves."""
        return self.gust == 0.0 and self.steady_W == (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class NoiseSpec:
    """Errors of measurement: standard deviations in SI units, and latency in seconds."""

    position: float = 0.0
    velocity: float = 0.0
    attitude: float = 0.0
    rate: float = 0.0
    latency: float = 0.0

    @property
    def exact(self) -> bool:
        """Whether a vehicle knows its state as it is."""
        return self == NoiseSpec()


@dataclass(frozen=True)
class Fault:
    """Something that happens during the flight: a motor stops, or an obstacle appears.

    Parameters
    ----------
    at : float
        Seconds after take-off began.
    agent, rotor : int or None
        Whose motor, and which.
    obstacle : Obstacle or None
    """

    at: float
    agent: int | None = None
    rotor: int | None = None
    obstacle: Obstacle | None = None


@dataclass(frozen=True)
class FlightSpec:
    """How a mission is flown; lengths in metres, angles in radians.

    Parameters
    ----------
    vehicle : str
        Name or file of the vehicle's parameters.
    altitude : float
        Of the first agent; the others fly in layers above it.
    layer_spacing : float or None
        Height between two layers; None: `LAYER_MARGIN` times the vertical separation of the vehicle.
    ceiling : float
        Largest altitude.
    max_speed : float or None
        Instead of the vehicle's.
    obstacles : tuple of Obstacle
    wind : WindSpec
    noise : NoiseSpec
    arrival_position, arrival_yaw : float
        When a waypoint counts as reached.
    faults : tuple of Fault
        In the order of time.
    start_spacing : float
        How far apart poses are drawn that the mission leaves open; 0 for a mission that does not speak of flight.
    """

    vehicle: str = "iris"
    altitude: float = 1.5
    layer_spacing: float | None = None
    ceiling: float = math.inf
    max_speed: float | None = None
    obstacles: tuple[Obstacle, ...] = ()
    wind: WindSpec = field(default_factory=WindSpec)
    noise: NoiseSpec = field(default_factory=NoiseSpec)
    arrival_position: float = 0.15
    arrival_yaw: float = math.radians(5.0)
    faults: tuple[Fault, ...] = ()
    start_spacing: float = 0.0

    def altitudes(self, agents: int) -> tuple[float, ...]:
        """Return each agent's altitude, metres.

        Raises
        ------
        InputError
            If the vehicle's parameter file cannot be read.
        """
        from covey.flight.parameters import load_vehicle

        spacing = self.layer_spacing
        if spacing is None:
            vehicle = load_vehicle(self.vehicle)
            spacing = LAYER_MARGIN * vehicle.required_separation * vehicle.vertical_ratio
        return tuple(self.altitude + k * spacing for k in range(agents))
