"""The part of the mission file that only flying needs: vehicles, altitudes, obstacles, weather and faults."""

from __future__ import annotations

from typing import Annotated

from pydantic import ConfigDict, Field

from covey.mission.schema_base import FileName, Length, Metres, Name, Range, Ring, Section, one_of_keys

Speed = Annotated[float, Field(gt=0.0, le=100.0)]
Deviation = Annotated[float, Field(ge=0.0, le=1e3)]
Seconds = Annotated[float, Field(ge=0.0, le=1e6)]
Point = Annotated[list[Metres], Field(min_length=3, max_length=3, description="[x, y, z], metres")]
Wind = Annotated[
    list[Annotated[float, Field(ge=-50.0, le=50.0)]],
    Field(min_length=2, max_length=3, description="[x, y] or [x, y, z] of where it blows to, m/s"),
]

SIMULATORS = ("mujoco", "reference", "kinematic")
"""What `covey fly --vehicles` knows."""


class SphereSection(Section):
    """A ball."""

    center_m: Point = Field(description="[x, y, z] of its centre, metres")
    radius_m: Length = Field(description="Its radius, metres")


class BlockSection(Section):
    """A box along the axes."""

    x_m: Range = Field(description="[min, max] of x, metres")
    y_m: Range = Field(description="[min, max] of y, metres")
    z_m: Range = Field(description="[min, max] of height, metres")


class PrismSection(Section):
    """An upright prism."""

    corners: Ring = Field(description="Corners [x, y] of its outline in order, not closed, metres")
    z_m: Range = Field(description="[min, max] of height, metres")


class ObstacleSection(Section):
    """A body to fly around: exactly one of sphere, box, prism."""

    model_config = ConfigDict(json_schema_extra=one_of_keys("sphere", "box", "prism"))

    sphere: SphereSection | None = Field(default=None, description="A ball")
    box: BlockSection | None = Field(default=None, description="A box along the axes")
    prism: PrismSection | None = Field(default=None, description="An outline with a height")


class WindSection(Section):
    """The weather."""

    steady_m_s: Wind = Field(default=[0.0, 0.0], description="Mean wind: [x, y] of where it blows to, m/s")
    gust_m_s: Deviation = Field(default=0.0, description="Standard deviation of gusts in each direction, m/s")
    gust_time_s: Annotated[float, Field(gt=0.0, le=1e4)] = Field(
        default=2.0, description="How long a gust lasts, seconds"
    )


class NoiseSection(Section):
    """How badly a vehicle knows its own state; standard deviations."""

    position_m: Deviation = Field(default=0.0, description="Of the position, metres")
    velocity_m_s: Deviation = Field(default=0.0, description="Of the velocity, m/s")
    attitude_deg: Deviation = Field(default=0.0, description="Of the attitude, degrees")
    rate_deg_s: Deviation = Field(default=0.0, description="Of the body rates, degrees a second")
    latency_s: Annotated[float, Field(ge=0.0, le=1.0)] = Field(
        default=0.0, description="How old a measurement is, seconds"
    )


class MotorFaultSection(Section):
    """A motor that stops."""

    agent: Name = Field(description="Whose")
    rotor: Annotated[int, Field(ge=0, le=3)] = Field(default=0, description="Which rotor, 0 to 3")


class FaultSection(Section):
    """Something that happens during the flight: exactly one of motor, obstacle."""

    model_config = ConfigDict(json_schema_extra=one_of_keys("motor", "obstacle"))

    at_s: Seconds = Field(description="When, seconds after take-off began")
    motor: MotorFaultSection | None = Field(default=None, description="A motor stops")
    obstacle: ObstacleSection | None = Field(default=None, description="An obstacle appears")


class ArrivalSection(Section):
    """When a waypoint counts as reached."""

    position_m: Length = Field(default=0.15, description="Largest distance from it, metres")
    yaw_deg: Annotated[float, Field(gt=0.0, le=180.0)] = Field(default=5.0, description="Largest error of yaw, degrees")


class FlightSection(Section):
    """How the mission is flown."""

    vehicle: FileName = Field(
        default="iris", description="iris, crazyflie, or a parameter file of your own beside the mission (.toml)"
    )
    altitude_m: Annotated[float, Field(gt=0.0, le=1e4)] = Field(
        default=1.5, description="Altitude of the first layer, metres; the others lie above it"
    )
    layers: Annotated[int, Field(ge=1, le=10_000)] | None = Field(
        default=None,
        description="How many altitudes the agents share in turn; those of one layer keep apart in the plane; "
        "by default one each, fewer where the ceiling leaves no room",
    )
    layer_spacing_m: Length | None = Field(
        default=None, description="Height between two layers, metres; by default what the vehicles' downwash asks for"
    )
    ceiling_m: Length | None = Field(default=None, description="Largest altitude, metres; unlimited by default")
    max_speed_m_s: Speed | None = Field(default=None, description="Instead of the vehicle's largest speed, m/s")
    obstacles: list[ObstacleSection] = Field(default=[], description="Bodies to fly around")
    wind: WindSection = Field(default=WindSection(), description="The weather; calm by default")
    noise: NoiseSection = Field(default=NoiseSection(), description="Errors of measurement; none by default")
    arrival: ArrivalSection = Field(default=ArrivalSection(), description="When a waypoint counts as reached")
    faults: list[FaultSection] = Field(default=[], description="What goes wrong, to try how the team copes")
