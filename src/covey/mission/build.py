"""From a mission file's plain data to a `Mission`: what pydantic cannot check is checked here."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from covey.environment import Landmarks
from covey.environment.json_text import KeyPath, describe
from covey.geometry import Pose2, Region
from covey.mission.changes import ChangeSpec
from covey.mission.changes_build import ChangeBuilder
from covey.mission.flight_build import build_flight, check_room, check_starts
from covey.mission.flight_schema import FlightSection
from covey.mission.model import (
    AgentSpec,
    Assignment,
    CommunicationSpec,
    CoverageSpec,
    Mission,
    OptimizerName,
    SensorSpec,
    Trade,
    draw_pose,
    draw_poses,
)
from covey.mission.report import Report, nearest, one_of, plain_path, wrong_version
from covey.mission.schema import (
    BUILT_IN_MODELS,
    MAX_AGENTS,
    ORIENTED_MODELS,
    SCHEMA_VERSIONS,
    AgentSection,
    ChangeSection,
    CommunicationSection,
    CountSection,
    CoverageOptions,
    GeoreferenceSection,
    LandmarksSection,
    MissionFile,
    RegionSection,
    SensorSection,
)
from covey.mission.schema_base import Section
from covey.mission.sites import SiteBuilder

S = TypeVar("S", bound=Section)

_THINNEST = 1e-3
"""Share of its bounding box that a region must fill for poses to be drawn: draws go on until one is inside."""


@dataclass
class _Parts:
    """The sections that are right in themselves; None or missing where a mistake is reported already."""

    landmarks: LandmarksSection | None
    region: RegionSection | None
    sensor: SensorSection | None
    agents: list[AgentSection | None]
    coverage: CoverageOptions | None
    communication: CommunicationSection | None
    changes: list[ChangeSection]
    georeference: GeoreferenceSection | None
    flight: FlightSection | None


def build(data: Any, report: Report, *, folder: Path, path: Path | None, seed: int | None) -> Mission | None:
    """Build the mission, or note every mistake in the report and return None."""
    if not isinstance(data, dict):
        report.add((), f"expected the keys of a mission, got {describe(data)}")
        return None
    version = data.get("schema_version")
    if "schema_version" in data and (type(version) is not int or version not in SCHEMA_VERSIONS):
        report.add(("schema_version",), wrong_version(version))
        if type(version) is int:
            return None  # another version has other keys: more complaints would mislead
    _refuse_nulls(data, (), report)
    file: MissionFile | None = None
    try:
        file = MissionFile.model_validate(data)
        parts = _Parts(
            file.environment.landmarks,
            file.environment.region,
            file.sensor,
            list(_agents(file.agents)),
            file.coverage,
            file.communication,
            file.changes,
            file.georeference,
            file.flight,
        )
    except ValidationError as error:
        errors = error.errors(include_url=False)
        report.add_pydantic(errors)
        parts = _salvage(_without(data, _wrong(errors)))
    return _Builder(report, folder).mission(file, parts, data, path, seed)


def _refuse_nulls(value: Any, path: KeyPath, report: Report) -> None:
    if value is None:
        report.add(path, "expected a value, got nothing", "give it one or leave the key out")
    elif isinstance(value, dict):
        for key, item in value.items():
            _refuse_nulls(item, (*path, key), report)
    elif isinstance(value, list):
        for i, item in enumerate(value):
            if not isinstance(item, float):
                _refuse_nulls(item, (*path, i), report)


def _wrong(errors: list[ErrorDetails]) -> set[KeyPath]:
    """Entries to leave out so that the rest can be checked, chosen such that nothing else then seems wrong."""
    result: set[KeyPath] = set()
    for error in errors:
        path = plain_path(error["loc"])
        match path:
            case _ if error["type"] == "extra_forbidden":
                result.add(path)
            case ("sensor" | "coverage" | "flight" | "communication", _, *_):
                result.add(path[:2])
            case ("environment", "landmarks", key, *_) if key not in ("normals", "normals_deg"):
                result.add(path[:3])
            case ("agents", int(), "sensor", _, *_):
                result.add(path[:4])
            case ("agents", int(), "pose" | "sensor", *_):
                result.add(path[:3])
            case ("agents", int(), "region", *_):
                result |= {path[:3], (*path[:2], "pose")}  # a pose may be right in the region that was meant
            case _:
                pass
    return result


def _without(data: dict[str, Any], drop: set[KeyPath]) -> dict[str, Any]:
    def copy(value: Any, path: KeyPath) -> Any:
        if isinstance(value, dict):
            return {key: copy(item, (*path, key)) for key, item in value.items() if (*path, key) not in drop}
        if isinstance(value, list):
            return [copy(item, (*path, i)) for i, item in enumerate(value)]
        return value

    result: dict[str, Any] = copy(data, ())
    return result


def _salvage(data: dict[str, Any]) -> _Parts:
    environment = data.get("environment")
    if not isinstance(environment, dict):
        environment = {}
    agents = data.get("agents")
    return _Parts(
        _valid(LandmarksSection, environment.get("landmarks")),
        _valid(RegionSection, environment.get("region")),
        _valid(SensorSection, data.get("sensor", {})),
        [
            _valid(AgentSection, {**agent, "name": "?"}) if isinstance(agent, dict) else None
            for agent in (agents if isinstance(agents, list) else [])
        ],
        _valid(CoverageOptions, data.get("coverage", {})),
        _valid(CommunicationSection, data.get("communication")),
        [],
        _valid(GeoreferenceSection, data.get("georeference")),
        _valid(FlightSection, data.get("flight")),
    )


def _valid(model: type[S], value: Any) -> S | None:
    try:
        return model.model_validate(value)
    except ValidationError:
        return None


def _agents(agents: list[AgentSection] | CountSection) -> list[AgentSection]:
    if isinstance(agents, CountSection):
        return [AgentSection(name=_numbered(i)) for i in range(agents.count)]
    return agents


class _Builder:
    """Builds each part that can be built; `report` tells what could not."""

    def __init__(self, report: Report, folder: Path) -> None:
        self._report = report
        self._folder = folder

    def mission(
        self, file: MissionFile | None, parts: _Parts, data: dict[str, Any], path: Path | None, seed: int | None
    ) -> Mission | None:
        sites = SiteBuilder(self._report, self._folder)
        regions = [((*_agent(i), "region"), agent.region) for i, agent in enumerate(parts.agents) if agent]
        georeference = sites.georeference(
            parts.georeference,
            parts.landmarks,
            [(("environment", "region"), parts.region), *regions],
            stated="georeference" in data,
        )
        landmarks = sites.landmarks(parts.landmarks, ("environment", "landmarks"))
        region = sites.region(parts.region, ("environment", "region"))
        sensor = self._sensor(parts.sensor, ("sensor",))
        if file is not None and seed is None:
            seed = file.seed
        agents = [
            self._agent_spec(_agent(i), i, agent, sites, sensor, region, landmarks, seed or 0)
            for i, agent in enumerate(parts.agents)
        ]
        names = self._names(data.get("agents"))
        coverage = self._coverage(parts.coverage, names, None if landmarks is None else len(landmarks))
        communication = self._communication(parts.communication, names)
        changes = self._changes(parts.changes, names, landmarks, sites, sensor, region, seed or 0)
        flight = build_flight(parts.flight, names, self._report, folder=self._folder)
        if (
            file is None
            or seed is None
            or flight is None
            or landmarks is None
            or region is None
            or sensor is None
            or coverage is None
            or self._report.mistakes
        ):
            return None
        mission = Mission(
            schema_version=file.schema_version,
            name=file.name,
            seed=seed,
            landmarks=landmarks,
            region=region,
            sensor=sensor,
            agents=draw_poses(
                [agent for agent in agents if agent is not None], seed=seed, spacing=flight.start_spacing
            ),
            coverage=coverage,
            communication=communication,
            changes=tuple(changes),
            flight=flight,
            separation=flight.separation(len(agents)),
            georeference=georeference,
            source=data,
            path=path,
        )
        check_room(mission, self._report)
        check_starts(mission, self._report)
        return mission

    def _sensor(self, section: SensorSection | None, path: KeyPath) -> SensorSpec | None:
        if section is None:
            return None
        options = dict(section.options or {})
        model = section.model
        if model in BUILT_IN_MODELS:
            if section.options is not None:
                self._report.add((*path, "options"), f"expected no options, the model {model!r} is built in")
            return SensorSpec(model, {"optimal_distance": section.optimal_distance_m or 1.0})
        for name in options:
            if not name.isidentifier() or (name == "optimal_distance" and section.optimal_distance_m is not None):
                self._report.add((*path, "options", name), f"expected the name of another argument, got {name[:60]!r}")
        if section.optimal_distance_m is not None:
            options["optimal_distance"] = section.optimal_distance_m
        return self._own_model(model, options, (*path, "model"))

    def _own_model(self, model: str, options: Mapping[str, float], path: KeyPath) -> SensorSpec | None:
        module, colon, name = model.rpartition(":")
        known = f"{one_of(BUILT_IN_MODELS)}, or a class of your own as 'file.py:Class'"
        if not colon:
            near = nearest(model, BUILT_IN_MODELS)
            hint = f"did you mean {near!r}?" if near else ""
            if model.endswith(".py"):
                hint = f"name the class too: '{model[:60]}:Class'"
            self._report.add(path, f"expected {known}, got {model[:60]!r}", hint)
            return None
        if not name.isidentifier():
            self._report.add(path, f"expected the name of a class behind the colon, got {name[:60]!r}")
            return None
        if not module.endswith(".py"):
            if all(part.isidentifier() for part in module.split(".")):
                return SensorSpec(model, options)
            self._report.add(path, f"expected 'file.py:Class' or 'package.module:Class', got {model[:60]!r}")
            return None
        file = self._folder / module
        try:
            if file.is_file():
                return SensorSpec(f"{file.resolve()}:{name}", options)
        except (OSError, ValueError):  # a name that no file can have
            pass
        self._report.add(path, f"expected a Python file, found none at {str(file)[:200]!r}")
        return None

    def _agent_spec(
        self,
        path: KeyPath,
        index: int,
        section: AgentSection | None,
        sites: SiteBuilder,
        sensor: SensorSpec | None,
        region: Region | None,
        landmarks: Landmarks | None,
        seed: int,
    ) -> AgentSpec | None:
        if section is None:
            return None
        sensor_path: KeyPath = ("sensor",)
        if section.sensor is not None:
            sensor_path = (*path, "sensor")
            sensor = self._sensor(section.sensor, sensor_path)
        needs_normals = sensor is not None and sensor.model in ORIENTED_MODELS
        if needs_normals and landmarks is not None and landmarks.normals_W is None:
            self._report.add(
                (*sensor_path, "model"),
                "expected landmarks with normals for this model, environment.landmarks has none",
                "give normals_deg or normals, columns in the csv, or a curve",
            )
        if section.region is not None:
            region = sites.region(section.region, (*path, "region"))
        if region is None:
            return None
        pose = self._pose(section, region, path, index, seed)
        if sensor is None or pose is None:
            return None
        return AgentSpec(section.name, pose, sensor, region, drawn=section.pose is None)

    def _pose(self, section: AgentSection, region: Region, path: KeyPath, index: int, seed: int) -> Pose2 | None:
        if section.pose is None:
            x_min, x_max, y_min, y_max = region.bounds
            if region.shape.area < _THINNEST * (x_max - x_min) * (y_max - y_min):
                self._report.add(path, "expected a pose, its region is too thin to draw one in", "add pose:")
                return None
            return draw_pose(region, seed=seed, index=index)
        x, y = section.pose.x_m, section.pose.y_m
        if not region.contains(x, y):
            inside = region.project(x, y)
            away = math.dist((x, y), inside)
            self._report.add(
                (*path, "pose"),
                f"expected a position inside its region, ({x:g}, {y:g}) is {away:.3g} m outside",
                f"the nearest inside is ({inside[0]:g}, {inside[1]:g})",
            )
            return None
        return Pose2(x, y, math.radians(section.pose.yaw_deg))

    def _names(self, agents: Any) -> list[str]:
        """Check the names as they stand in the file, those of agents that are wrong otherwise too."""
        if isinstance(agents, dict):
            count = agents.get("count")
            return [_numbered(i) for i in range(count)] if type(count) is int and count <= MAX_AGENTS else []
        first: dict[str, int] = {}
        for i, agent in enumerate(agents if isinstance(agents, list) else []):
            name = agent.get("name") if isinstance(agent, dict) else None
            if not isinstance(name, str):
                continue
            if name in first:
                message = f"expected each name once, {name[:60]!r} is already agents[{first[name]}]"
                self._report.add((*_agent(i), "name"), message)
            first.setdefault(name, i)
        return list(first)

    def _changes(
        self,
        sections: list[ChangeSection],
        names: list[str],
        landmarks: Landmarks | None,
        sites: SiteBuilder,
        sensor: SensorSpec | None,
        region: Region | None,
        seed: int,
    ) -> list[ChangeSpec]:
        builder = ChangeBuilder(names, landmarks, self._report)
        changes = []
        for i, section in enumerate(sections):
            path: KeyPath = ("changes", i)
            changes.append(builder.build(section, path))
            if section.join is not None:
                self._agent_spec((*path, "join"), len(names), section.join, sites, sensor, region, landmarks, seed)
        return [change for change in changes if change is not None]

    def joining(self, mission: Mission, index: int, section: AgentSection) -> AgentSpec | None:
        """Build an agent that joins a mission."""
        sites = SiteBuilder(self._report, self._folder, origin=mission.georeference)
        parts = (sites, mission.sensor, mission.region, mission.landmarks, mission.seed)
        return self._agent_spec((), index, section, *parts)

    def _communication(self, section: CommunicationSection | None, names: list[str]) -> CommunicationSpec | None:
        if section is None:
            return None
        path: KeyPath = ("communication",)
        if (section.range_m is None) == (section.links is None):
            self._report.add(path, "expected exactly one of range_m and links")
            return None
        if section.links is None:
            return CommunicationSpec(range=section.range_m)
        for i, pair in enumerate(section.links):
            for k, name in enumerate(pair):
                self._check_name(name, names, (*path, "links", i, k))
            if pair[0] == pair[1]:
                self._report.add((*path, "links", i), f"expected two agents, got {pair[0][:60]!r} twice")
        return CommunicationSpec(links=tuple((pair[0], pair[1]) for pair in section.links))

    def _check_name(self, name: str, names: list[str], path: KeyPath) -> None:
        if names and name not in names:
            near = nearest(name, names)
            self._report.add(
                path,
                f"expected the name of an agent, got {name[:60]!r}",
                f"did you mean {near!r}?" if near else "",
            )

    def _coverage(
        self, options: CoverageOptions | None, names: list[str], landmarks: int | None
    ) -> CoverageSpec | None:
        if options is None:
            return None
        assignment: Assignment | dict[str, tuple[int, ...]]
        if isinstance(options.assignment, str):
            assignment = Assignment(options.assignment)
        else:
            self._check_assignment(options.assignment, names, landmarks)
            assignment = {name: tuple(indices) for name, indices in options.assignment.items()}
            assignment |= {name: () for name in names if name not in assignment}
        return CoverageSpec(options.sigma, Trade(options.trade), OptimizerName(options.optimizer), assignment)

    def _check_assignment(self, assignment: dict[str, list[int]], names: list[str], landmarks: int | None) -> None:
        path: KeyPath = ("coverage", "assignment")
        owner: dict[int, str] = {}
        for name, indices in assignment.items():
            self._check_name(name, names, (*path, name))
            for k, index in enumerate(indices):
                if landmarks is not None and index >= landmarks:
                    self._report.add((*path, name, k), f"expected a landmark from 0 to {landmarks - 1}, got {index}")
                elif index in owner:
                    self._report.add(
                        (*path, name, k), f"expected each landmark once, {index} belongs to {owner[index]!r} already"
                    )
                owner.setdefault(index, name)
        if landmarks is None:
            return
        missing = [k for k in range(landmarks) if k not in owner]
        if missing:
            shown = ", ".join(map(str, missing[:5])) + (", ..." if len(missing) > 5 else "")
            self._report.add(path, f"expected each landmark once, {len(missing):,} have no owner: {shown}")


def build_agent(mission: Mission, index: int, section: AgentSection, report: Report) -> AgentSpec | None:
    """Build an agent that joins a mission, or note every mistake in the report and return None."""
    folder = Path() if mission.path is None else mission.path.parent
    agent = _Builder(report, folder).joining(mission, index, section)
    return None if report.mistakes else agent


def _numbered(index: int) -> str:
    return f"agent-{index + 1}"


def _agent(index: int) -> KeyPath:
    return ("agents", index)
