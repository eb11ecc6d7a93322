"""The mission file, version 1: every key, its type, its unit and what it means."""

from __future__ import annotations

from functools import cache
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Discriminator, Field, Tag

from covey.mission.flight_schema import FlightSection
from covey.mission.schema_base import (
    Corner,
    Degrees,
    FileName,
    Length,
    Metres,
    Name,
    Range,
    Ring,
    Section,
    Vector,
    Weight,
    one_of_keys,
)

SCHEMA_VERSIONS = (1,)
"""Versions of the file that this covey reads."""

BUILT_IN_MODELS = ("anisotropic", "isotropic", "oriented")
ORIENTED_MODELS = ("oriented",)
"""Built-in models that need landmarks with normals."""

SHAPES = ("grid", "points", "csv", "curve", "polygon", "geojson")
AREAS = ("box", "polygon", "geojson")
MAX_AGENTS = 1000

BRANCH = "\0"
"""Marks branches of unions in the paths of pydantic's errors: a character that no sensible key begins with."""


def _tag(**tags: type | tuple[type, ...]) -> Discriminator:
    """Choose a branch of a union by the kind of value; no kind fits: the union as a whole is refused."""

    def choose(value: Any) -> str | None:
        for tag, kinds in tags.items():
            if isinstance(value, kinds) and not isinstance(value, bool):
                return BRANCH + tag
        return None

    return Discriminator(choose)


class PolygonSection(Section):
    """An outline and its holes."""

    exterior: Ring = Field(description="Corners of the outline in order, not closed, metres")
    holes: list[Ring] = Field(default=[], description="Corners of each hole (no-fly zone) inside the outline, metres")


PolygonValue = Annotated[
    Annotated[PolygonSection, Tag(BRANCH + "polygon")] | Annotated[Ring, Tag(BRANCH + "corners")],
    _tag(polygon=dict, corners=list),
]


class GridSection(Section):
    """Square cells; a landmark sits at each centre."""

    x_m: Range = Field(description="[min, max] of x, metres; cells start at min")
    y_m: Range = Field(description="[min, max] of y, metres; cells start at min")
    spacing_m: Length = Field(
        description="Side of a cell, metres; where a range is no multiple of it, the strip narrower than a cell at the "
        "upper end gets no landmark"
    )


class LandmarksSection(Section):
    """What is to be seen: exactly one of grid, points, csv, curve, polygon, geojson."""

    model_config = ConfigDict(json_schema_extra=one_of_keys(*SHAPES))

    grid: GridSection | None = Field(default=None, description="Cell centres of a box")
    points: list[Corner] | None = Field(default=None, min_length=1, description="Landmarks one by one, [x, y], metres")
    csv: FileName | None = Field(
        default=None,
        description="CSV file beside the mission with columns x_m, y_m and optional weight, normal_x and normal_y, or "
        "normal_deg",
    )
    curve: list[Corner] | None = Field(
        default=None,
        min_length=2,
        description="Corners of a polyline, metres; landmarks with normals at equal lengths along it (needs spacing_m)",
    )
    polygon: PolygonValue | None = Field(
        default=None,
        description="Corners of a polygon, or {exterior, holes}; cell centres inside it (needs spacing_m)",
    )
    geojson: FileName | None = Field(
        default=None,
        description="GeoJSON file (WGS84) with one polygon, beside the mission; cell centres in it (needs spacing_m)",
    )
    spacing_m: Length | None = Field(
        default=None, description="For curve, polygon and geojson: length of a piece or side of a cell, metres"
    )
    closed: bool | None = Field(
        default=None, description="For curve: whether the last corner is joined to the first; false by default"
    )
    faces: Literal["left", "right", "outside", "inside"] | None = Field(
        default=None,
        description="For curve: side of its normals, seen along it from the first corner to the last, or outside or "
        "inside when it is closed; left by default, outside when closed",
    )
    weights: (
        Annotated[
            Annotated[Weight, Tag(BRANCH + "number")] | Annotated[list[Weight], Tag(BRANCH + "list")],
            _tag(number=(int, float), list=list),
        ]
        | None
    ) = Field(default=None, description="What a landmark is worth: one number for all, or a list, one each")
    normals_deg: (
        Annotated[
            Annotated[Degrees, Tag(BRANCH + "number")] | Annotated[list[Degrees], Tag(BRANCH + "list")],
            _tag(number=(int, float), list=list),
        ]
        | None
    ) = Field(
        default=None,
        description="Direction each landmark faces, degrees counter-clockwise from x: one for all, or a list, one each",
    )
    normals: list[Vector] | None = Field(
        default=None,
        description="Direction each landmark faces as a vector [x, y], one each; normals_deg instead of it",
    )


class BoxSection(Section):
    """An axis-aligned box."""

    x_m: Range = Field(description="[min, max] of x, metres")
    y_m: Range = Field(description="[min, max] of y, metres")


class RegionSection(Section):
    """Where an agent may be: exactly one of box, polygon, geojson."""

    model_config = ConfigDict(json_schema_extra=one_of_keys(*AREAS))

    box: BoxSection | None = Field(default=None, description="An axis-aligned box")
    polygon: PolygonValue | None = Field(
        default=None, description="Corners [x, y] of the outline, metres, or {exterior, holes}; holes are no-fly zones"
    )
    geojson: FileName | None = Field(
        default=None, description="GeoJSON file (WGS84) beside the mission with one polygon; its holes are no-fly zones"
    )


class EnvironmentSection(Section):
    """Where the mission takes place."""

    landmarks: LandmarksSection = Field(description="What is to be seen")
    region: RegionSection = Field(description="Omega: where agents may be")


class SensorSection(Section):
    """How well a camera sees a landmark."""

    model: str = Field(
        default="anisotropic",
        min_length=1,
        max_length=1000,
        description="anisotropic, isotropic, oriented (needs normals), or a class of your own: file.py:Class beside "
        "the mission, or package.module:Class",
    )
    optimal_distance_m: Length | None = Field(
        default=None, description="Distance at which a landmark is seen best, metres; 1 by default"
    )
    options: dict[str, float] | None = Field(
        default=None, description="Only for a class of your own: its other keyword arguments, numbers"
    )


class PoseSection(Section):
    """A position and a heading in the plane."""

    x_m: Metres = Field(description="East, metres")
    y_m: Metres = Field(description="North, metres")
    yaw_deg: Degrees = Field(default=0.0, description="Heading, degrees counter-clockwise from x (east)")


class AgentSection(Section):
    """One agent."""

    name: Name = Field(description="How results call it; each name once")
    pose: PoseSection | None = Field(
        default=None, description="Where it starts, inside its region; drawn from the seed when left out"
    )
    sensor: SensorSection | None = Field(default=None, description="Its own sensor instead of the mission's")
    region: RegionSection | None = Field(default=None, description="Its own region instead of the environment's")


class CountSection(Section):
    """Agents agent-1, agent-2, ... with poses drawn from the seed."""

    count: int = Field(ge=1, le=MAX_AGENTS, description="How many agents")


class CoverageOptions(Section):
    """How the team trades."""

    sigma: float = Field(
        default=0.01, gt=0.0, le=1e9, description="Tolerance of the equilibrium, in units of the score"
    )
    trade: Literal["pairwise", "thesis"] = Field(
        default="pairwise", description="Optimise two agents together, or the rule of the thesis"
    )
    optimizer: Literal["search", "exact", "differential-evolution"] = Field(
        default="search", description="What looks for better poses"
    )
    assignment: Annotated[
        Annotated[Literal["random", "nearest"], Tag(BRANCH + "name")]
        | Annotated[dict[str, list[Annotated[int, Field(ge=0)]]], Tag(BRANCH + "mapping")],
        _tag(name=str, mapping=dict),
    ] = Field(
        default="random",
        description="Owners at the start: random, nearest, or by agent the indices of its landmarks, each once",
    )


class CommunicationSection(Section):
    """Which agents can trade with each other: exactly one of range_m, links."""

    model_config = ConfigDict(json_schema_extra=one_of_keys("range_m", "links"))

    range_m: Length | None = Field(default=None, description="Those whose poses are no further apart, metres")
    links: list[Annotated[list[Name], Field(min_length=2, max_length=2)]] | None = Field(
        default=None, description="Those that are named: pairs of agents, [name, name]"
    )


class AddedSection(Section):
    """Landmarks to be seen as well."""

    points: list[Corner] = Field(min_length=1, description="Where, [x, y], metres")
    weight: Weight = Field(default=1.0, description="What each is worth")
    normal_deg: Degrees | None = Field(
        default=None, description="Direction that each faces, degrees counter-clockwise from x"
    )


class ReweightedSection(Section):
    """Landmarks that are worth something else."""

    landmarks: list[Annotated[int, Field(ge=0)]] = Field(min_length=1, description="Their numbers")
    weight: Weight = Field(description="What each is worth from then on")


class ChangeSection(Section):
    """One change: exactly one of add, remove, reweight, join, leave; by default when the team has settled."""

    model_config = ConfigDict(json_schema_extra=one_of_keys("add", "remove", "reweight", "join", "leave"))

    after_trades: int | None = Field(default=None, ge=0, description="When so many trades have been made")
    at_s: float | None = Field(
        default=None, ge=0.0, le=1e9, description="When the team has been at work so long, seconds"
    )
    add: AddedSection | None = Field(
        default=None, description="Landmarks to be seen as well; they get the next numbers"
    )
    remove: list[Annotated[int, Field(ge=0)]] | None = Field(
        default=None, min_length=1, description="Numbers of landmarks to be seen no more"
    )
    reweight: ReweightedSection | None = Field(default=None, description="Landmarks that are worth something else")
    join: AgentSection | None = Field(default=None, description="An agent that takes part from then on, with its pose")
    leave: Name | None = Field(default=None, description="The agent that takes part no more")


class GeoreferenceSection(Section):
    """Where on earth the origin of the mission's metres is."""

    lon_deg: Annotated[float, Field(ge=-180.0, le=180.0)] = Field(description="Longitude, WGS84, degrees")
    lat_deg: Annotated[float, Field(ge=-90.0, le=90.0)] = Field(description="Latitude, WGS84, degrees")
    alt_m: Annotated[float, Field(ge=-20000.0, le=20000.0)] = Field(
        default=0.0, description="Height above the ellipsoid, metres"
    )


class MissionFile(Section):
    """A covey mission."""

    model_config = ConfigDict(title="covey mission")

    schema_version: Literal[1] = Field(description="Version of this format: 1")
    name: Name = Field(description="How results call the mission")
    seed: int = Field(default=0, ge=0, lt=2**63, description="Root of all randomness")
    environment: EnvironmentSection = Field(description="Landmarks and region")
    sensor: SensorSection = Field(default=SensorSection(), description="Of every agent without its own")
    agents: Annotated[
        Annotated[list[AgentSection], Field(min_length=1, max_length=MAX_AGENTS), Tag(BRANCH + "list")]
        | Annotated[CountSection, Tag(BRANCH + "count")],
        _tag(list=list, count=dict),
    ] = Field(description="The team: a list, or {count: n} for n agents with drawn poses")
    coverage: CoverageOptions = Field(default=CoverageOptions(), description="How the team trades")
    communication: CommunicationSection | None = Field(
        default=None, description="Which agents can trade with each other; all by default"
    )
    changes: list[ChangeSection] = Field(
        default=[], description="What an operator changes while the mission runs, in order; `covey fly` refuses it"
    )
    flight: FlightSection | None = Field(default=None, description="How it is flown; only `covey fly` reads it")
    georeference: GeoreferenceSection | None = Field(
        default=None,
        description="Origin of the mission's metres on earth; by default the centroid of the first GeoJSON polygon: of "
        "the landmarks, else of the region, else of the first agent with one",
    )


def json_schema() -> dict[str, Any]:
    """Return the JSON Schema (2020-12) of the mission file."""
    schema = MissionFile.model_json_schema()
    _drop_null(schema)
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **schema}


def _drop_null(node: Any) -> None:
    """Say that optional keys may be left out, but are never null."""
    if isinstance(node, list):
        for item in node:
            _drop_null(item)
    elif isinstance(node, dict):
        for item in node.values():
            _drop_null(item)
        branches = node.get("anyOf")
        if isinstance(branches, list) and {"type": "null"} in branches:
            branches.remove({"type": "null"})
            if node.get("default", 0) is None:
                del node["default"]
            if len(branches) == 1:
                (only,) = branches
                del node["anyOf"]
                node.update({key: value for key, value in only.items() if key not in node})


@cache
def known_keys(file: type[BaseModel]) -> dict[tuple[str, ...], list[str]]:
    """Keys known at each place of a file, with "[]" for an index.

    In a mission file they are x_m, y_m and yaw_deg at ("agents", "[]", "pose").
    """
    result: dict[tuple[str, ...], list[str]] = {}

    def visit(path: tuple[str, ...], annotation: Any) -> None:
        if isinstance(annotation, type) and issubclass(annotation, BaseModel):
            for key, info in annotation.model_fields.items():
                keys = result.setdefault(path, [])
                if key not in keys:
                    keys.append(key)
                visit((*path, key), info.annotation)
        for part in getattr(annotation, "__args__", ()):
            visit((*path, "[]") if getattr(annotation, "__origin__", None) is list else path, part)

    visit((), file)
    return result
