"""How a mission is flown: the file's `flight` section as SI data."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from covey.geometry import Pose2
from covey.geometry.region import CORNER

if TYPE_CHECKING:
    from covey.flight.obstacles import Obstacle

LAYER_MARGIN = 1.25
"""How far apart two layers lie by default, in units of the required vertical separation."""


@dataclass(frozen=True)
class Separation:
    """Which agents share an altitude, and how far apart in the plane those keep.

    Parameters
    ----------
    spacing : float
        What the committed positions of two agents of one layer keep between them at least, metres.
    layers : tuple of int or None
        Each agent's layer; None for one that does not fly any more.
    """

    spacing: float
    layers: tuple[int | None, ...]

    @property
    def clear(self) -> float:
        """Distance at which two are out of each other's way in any direction: see `Region.without_discs`, metres."""
        return self.spacing * CORNER

    def __str__(self) -> str:
        """Say it in a few words.

        Examples
        --------
        >>> print(Separation(1.06, (0, 1, 0, 1)))
        4 agents in 2 layers; those that share one keep 1.06 m apart
        """
        count = len(set(self.layers) - {None})
        layers = f"{count} layer{'s' * (count != 1)}"
        return f"{len(self.layers)} agents in {layers}; those that share one keep {self.spacing:.3g} m apart"

    def sharing(self, agent: int) -> tuple[int, ...]:
        """Return the other agents in the layer of an agent."""
        layer = self.layers[agent]
        if layer is None:
            return ()
        return tuple(other for other, its in enumerate(self.layers) if its == layer and other != agent)

    def without(self, agent: int) -> Separation:
        """Return what holds when an agent does not fly any more."""
        return replace(self, layers=(*self.layers[:agent], None, *self.layers[agent + 1 :]))

    def too_close(self, poses: Sequence[Pose2], distance: float) -> list[tuple[int, int, float]]:
        """Return the pairs of one layer that are closer than a distance, and how far apart they are, metres."""
        return [
            (agent, other, away)
            for agent in range(len(self.layers))
            for other in self.sharing(agent)
            if other > agent
            and (away := math.hypot(poses[agent].x - poses[other].x, poses[agent].y - poses[other].y)) < distance
        ]


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
        Of the first layer.
    layers : int or None
        How many altitudes the agents share in turn, at most one each; None: as many as fit below the ceiling.
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
    layers: int | None = None
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

    def layer_of(self, agents: int) -> tuple[int, ...]:
        """Return each agent's layer: they take the layers in turn.

        Raises
        ------
        InputError
            If the vehicle's parameter file cannot be read.
        """
        count = agents if self.layers is None else min(self.layers, agents)
        if self.layers is None and self.ceiling < math.inf:
            fit = math.floor((self.ceiling - self.altitude) / self._spacing() + 1e-9) + 1
            count = min(agents, max(1, fit))
        return tuple(agent % count for agent in range(agents))

    def altitudes(self, agents: int) -> tuple[float, ...]:
        """Return each agent's altitude, metres.

        Raises
        ------
        InputError
            If the vehicle's parameter file cannot be read.
        """
        spacing = self._spacing()
        return tuple(self.altitude + layer * spacing for layer in self.layer_of(agents))

    def separation(self, agents: int) -> Separation | None:
        """Return who must keep apart in the plane; None where every agent has a layer of its own.

        Waypoints lie apart by what navigation keeps between two vehicles on their way, which is more than the required
        separation by an allowance for tracking errors, and by that allowance once more, so that it holds at the
        waypoints for vehicles that are off by it.

        Raises
        ------
        InputError
            If the vehicle's parameter file cannot be read.
        """
        layers = self.layer_of(agents)
        if len(set(layers)) == agents:
            return None
        from covey.flight.navigation_options import NavigationOptions
        from covey.flight.parameters import load_vehicle

        vehicle = load_vehicle(self.vehicle)
        options = NavigationOptions.for_vehicle(vehicle)
        return Separation(options.separation + 2.0 * options.allowance, layers)

    def _spacing(self) -> float:
        """Height between two layers, metres."""
        from covey.flight.parameters import load_vehicle

        if self.layer_spacing is not None:
            return self.layer_spacing
        vehicle = load_vehicle(self.vehicle)
        return LAYER_MARGIN * vehicle.required_separation * vehicle.vertical_ratio
