"""The exercise file, version 1: a small flight without landmarks, every key with its type, unit and meaning."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field
from pydantic.json_schema import GenerateJsonSchema, JsonSchemaValue
from pydantic_core import core_schema

from covey.mission.flight_schema import (
    ArrivalSection,
    NoiseSection,
    ObstacleSection,
    Point,
    Seconds,
    Speed,
    WindSection,
)
from covey.mission.schema_base import Corner, Degrees, FileName, Length, Metres, Name, Section, one_of_keys

TASKS = ("goal", "circle", "follow", "hold")
"""What a vehicle may be asked to do; exactly one of them."""

MAX_VEHICLES = 100

Altitude = Annotated[float, Field(ge=0.0, le=1e4)]
Gain = Annotated[float, Field(gt=0.0, le=1e3)]


class PlaceSection(Section):
    """A position and a heading in space."""

    x_m: Metres = Field(description="East, metres")
    y_m: Metres = Field(description="North, metres")
    z_m: Altitude = Field(description="Height above the ground, metres")
    yaw_deg: Degrees = Field(default=0.0, description="Heading, degrees counter-clockwise from x (east)")


class GoalSection(PlaceSection):
    """A waypoint."""

    direct: bool = Field(
        default=False,
        description="Whether the controller gets the goal as its reference at once, without navigation and its "
        "avoidance of others",
    )


class CircleSection(Section):
    """A circle at constant height, begun at the angle zero."""

    center_m: Corner = Field(default=[0.0, 0.0], description="[x, y] of its centre, metres")
    radius_m: Length = Field(description="Its radius, metres")
    rate_rad_s: Annotated[float, Field(ge=-20.0, le=20.0)] = Field(
        description="Angular rate, rad/s, counter-clockwise seen from above; clockwise when negative"
    )
    altitude_m: Altitude = Field(description="Height above the ground, metres")


class FollowSection(Section):
    """Going where another vehicle goes."""

    leader: Name = Field(description="Name of the vehicle to follow")
    offset_m: Point = Field(
        description="[x, y, z] from the leader to this vehicle, along the axes of the world, metres"
    )
    feed_forward: bool = Field(
        default=False, description="Whether it also uses the leader's velocity; the thesis uses the position only"
    )


class VehicleSection(Section):
    """One vehicle and its task: exactly one of goal, circle, follow, hold."""

    model_config = ConfigDict(json_schema_extra=one_of_keys(*TASKS))

    name: Name = Field(description="How results call it; each name once")
    model: FileName = Field(
        default="iris", description="iris, crazyflie, or a parameter file of your own beside the exercise (.toml)"
    )
    start: PlaceSection = Field(description="Where it is when the exercise begins: hovering, or standing at z_m: 0")
    goal: GoalSection | None = Field(default=None, description="A waypoint to navigate to")
    circle: CircleSection | None = Field(default=None, description="A circle to fly")
    follow: FollowSection | None = Field(default=None, description="Another vehicle to follow")
    hold: bool | None = Field(default=None, description="true: stay at the start, making way for what comes near")


class ObjectSection(Section):
    """A ball that moves along a path and stays at its end."""

    name: Name = Field(description="How results call it; each name once")
    radius_m: Length = Field(description="Its radius, metres")
    path_m: Annotated[list[Point], Field(min_length=2, max_length=10_000)] = Field(
        description="Corners [x, y, z] of its path, metres"
    )
    speed_m_s: Speed = Field(description="Speed along the path, m/s")
    start_s: Seconds = Field(default=0.0, description="When it sets off, seconds")


class NavigationSection(Section):
    """Gains of the potential field, eq. (3.1) and (3.2); left out ones have their defaults."""

    k_wp: Gain | None = Field(default=None, description="Attraction by the waypoint, 1/s²")
    k_v: Gain | None = Field(default=None, description="Damping of the velocity, 1/s")
    k_rep: Gain | None = Field(default=None, description="Repulsion by vehicles and obstacles, m²/s²")
    threshold_m: Length | None = Field(default=None, description="Distance at which repulsion begins, metres")
    max_speed_m_s: Speed | None = Field(default=None, description="Largest speed of a reference, m/s")


class ExerciseSection(Section):
    """What is flown."""

    duration_s: Annotated[float, Field(gt=0.0, le=3600.0)] = Field(description="How long, seconds")
    vehicles: Annotated[list[VehicleSection], Field(min_length=1, max_length=MAX_VEHICLES)] = Field(
        description="The vehicles and their tasks"
    )
    objects: Annotated[list[ObjectSection], Field(max_length=100)] = Field(
        default=[], description="Moving balls to make way for"
    )
    obstacles: Annotated[list[ObstacleSection], Field(max_length=1000)] = Field(
        default=[], description="Bodies to fly around"
    )
    navigation: NavigationSection = Field(default=NavigationSection(), description="Gains of the potential field")
    wind: WindSection = Field(default=WindSection(), description="The weather; calm by default")
    noise: NoiseSection = Field(default=NoiseSection(), description="Errors of measurement; none by default")
    arrival: ArrivalSection = Field(default=ArrivalSection(), description="When a goal counts as reached")


class ExerciseFile(Section):
    """A covey flight exercise."""

    model_config = ConfigDict(title="covey exercise")

    schema_version: Literal[1] = Field(description="Version of this format: 1")
    name: Name = Field(description="How results call the exercise")
    seed: int = Field(default=0, ge=0, lt=2**63, description="Root of all randomness: gusts and noise")
    exercise: ExerciseSection = Field(description="What is flown")


def json_schema() -> dict[str, Any]:
    """Return the JSON Schema (2020-12) of the exercise file."""
    schema = ExerciseFile.model_json_schema(schema_generator=_WithoutNull)
    return {"$schema": GenerateJsonSchema.schema_dialect, **schema}


class _WithoutNull(GenerateJsonSchema):
    """Optional keys may be left out, but are never null."""

    def nullable_schema(self, schema: core_schema.NullableSchema) -> JsonSchemaValue:
        return self.generate_inner(schema["schema"])

    def default_schema(self, schema: core_schema.WithDefaultSchema) -> JsonSchemaValue:
        if schema.get("default", 0) is None:
            return self.generate_inner(schema["schema"])
        return super().default_schema(schema)
