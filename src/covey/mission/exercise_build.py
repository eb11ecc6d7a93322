"""From an exercise file's plain data to an `Exercise`: what pydantic cannot check is checked here."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any, TypeVar

from pydantic import ValidationError

from covey.environment.json_text import KeyPath, describe
from covey.errors import ArgumentError, CoveyError
from covey.flight.obstacles import Obstacle, clearance, pack
from covey.flight.parameters import VehicleParameters, load_vehicle, vehicle_names
from covey.mission.exercise import (
    Circle,
    Exercise,
    ExerciseVehicle,
    Follow,
    Goal,
    MovingObject,
    Point,
    Task,
    navigation_options,
)
from covey.mission.exercise_schema import (
    TASKS,
    ExerciseFile,
    NavigationSection,
    ObjectSection,
    PlaceSection,
    VehicleSection,
)
from covey.mission.flight import NoiseSpec, WindSpec
from covey.mission.flight_build import build_obstacle
from covey.mission.flight_schema import ObstacleSection
from covey.mission.report import Report, nearest, one_of, wrong_version
from covey.mission.schema import SCHEMA_VERSIONS
from covey.mission.schema_base import Section

S = TypeVar("S", bound=Section)


@dataclass(frozen=True)
class _Parts:
    """The entries of lists that are right in themselves; None where a mistake is reported already."""

    vehicles: list[VehicleSection | None]
    objects: list[ObjectSection | None]
    obstacles: list[ObstacleSection | None]
    duration: float


def build(data: Any, report: Report, *, folder: Path, path: Path | None, seed: int | None) -> Exercise | None:
    """Build the exercise, or note every mistake in the report and return None."""
    if not isinstance(data, dict):
        report.add((), f"expected the keys of an exercise, got {describe(data)}")
        return None
    version = data.get("schema_version")
    if "schema_version" in data and (type(version) is not int or version not in SCHEMA_VERSIONS):
        report.add(("schema_version",), wrong_version(version))
        if type(version) is int:
            return None  # another version has other keys: more complaints would mislead
    _refuse_nulls(data, (), report)
    file: ExerciseFile | None = None
    try:
        file = ExerciseFile.model_validate(data)
    except ValidationError as error:
        report.add_pydantic(error.errors(include_url=False))
    parts = _salvage(data)
    obstacles = [build_obstacle(item, _at("obstacles", i), report) for i, item in enumerate(parts.obstacles) if item]
    solid = [obstacle for obstacle in obstacles if obstacle is not None]
    vehicles = _Team(data, parts, solid, report, folder).vehicles()
    objects = _objects(data, parts, report)
    navigation: dict[str, float] = {}
    if file is not None:
        navigation = _navigation(file.exercise.navigation)
        _check_gains(vehicles, navigation, report)
    if file is None or report.mistakes:
        return None
    section = file.exercise
    x, y, z = (*section.wind.steady_m_s, 0.0)[:3]
    noise = section.noise
    return Exercise(
        name=file.name,
        seed=file.seed if seed is None else seed,
        duration=section.duration_s,
        vehicles=vehicles,
        objects=objects,
        obstacles=tuple(solid),
        navigation=navigation,
        wind=WindSpec((x, y, z), section.wind.gust_m_s, section.wind.gust_time_s),
        noise=NoiseSpec(
            noise.position_m,
            noise.velocity_m_s,
            math.radians(noise.attitude_deg),
            math.radians(noise.rate_deg_s),
            noise.latency_s,
        ),
        arrival_position=section.arrival.position_m,
        arrival_yaw=math.radians(section.arrival.yaw_deg),
        source=data,
        path=path,
    )


def _refuse_nulls(value: Any, path: KeyPath, report: Report) -> None:
    if value is None:
        report.add(path, "expected a value, got nothing", "give it one or leave the key out")
    elif isinstance(value, dict):
        for key, item in value.items():
            _refuse_nulls(item, (*path, key), report)
    elif isinstance(value, list):
        for i, item in enumerate(value):
            _refuse_nulls(item, (*path, i), report)


def _salvage(data: Mapping[str, Any]) -> _Parts:
    section = _section(data)
    duration = section.get("duration_s")
    return _Parts(
        [_valid(VehicleSection, item) for item in _list(section, "vehicles")],
        [_valid(ObjectSection, item) for item in _list(section, "objects")],
        [_valid(ObstacleSection, item) for item in _list(section, "obstacles")],
        duration if isinstance(duration, int | float) and duration > 0 else math.inf,
    )


def _section(data: Mapping[str, Any]) -> dict[str, Any]:
    section = data.get("exercise")
    return section if isinstance(section, dict) else {}


def _list(section: Mapping[str, Any], key: str) -> list[Any]:
    value = section.get(key)
    return value if isinstance(value, list) else []


def _valid(model: type[S], value: Any) -> S | None:
    try:
        return model.model_validate(value)
    except ValidationError:
        return None


def _names(items: Sequence[Any], key: str, report: Report, taken: Mapping[str, str]) -> dict[str, int]:
    """Check the names as they stand in the file, those of entries that are wrong otherwise too."""
    first: dict[str, int] = {}
    for i, item in enumerate(items):
        name = item.get("name") if isinstance(item, dict) else None
        if not isinstance(name, str):
            continue
        place = f"{key}[{first[name]}]" if name in first else taken.get(name)
        if place:
            report.add((*_at(key, i), "name"), f"expected each name once, {name[:60]!r} is already {place}")
        first.setdefault(name, i)
    return first


class _Team:
    """Builds the vehicles and checks them one by one and against each other."""

    def __init__(
        self, data: Mapping[str, Any], parts: _Parts, obstacles: Sequence[Obstacle], report: Report, folder: Path
    ) -> None:
        self._sections = parts.vehicles
        self._obstacles = pack(obstacles)
        self._report = report
        self._names = _names(_list(_section(data), "vehicles"), "vehicles", report, {})
        self._models = [None if item is None else self._model(i, item, folder) for i, item in enumerate(parts.vehicles)]

    def vehicles(self) -> tuple[ExerciseVehicle, ...]:
        """Return the vehicles that are right; for the others there is a mistake in the report."""
        tasks = [None if item is None else self._task(i, item) for i, item in enumerate(self._sections)]
        self._check_cycles(tasks)
        self._check_distances(tasks)
        result = []
        for section, model, task in zip(self._sections, self._models, tasks, strict=True):
            if section is not None and model is not None:
                start = section.start
                result.append(ExerciseVehicle(section.name, model, _point(start), math.radians(start.yaw_deg), task))
        return tuple(result)

    def _model(self, index: int, section: VehicleSection, folder: Path) -> VehicleParameters | None:
        name, path = section.model, _at("vehicles", index, "model")
        own = name.endswith(".toml")
        if not own and name not in vehicle_names():
            near = nearest(name, vehicle_names())
            hint = f"did you mean {near!r}?" if near else ""
            message = f"expected {one_of(vehicle_names())}, or a file ending in .toml, got {name[:60]!r}"
            self._report.add(path, message, hint)
            return None
        try:
            return load_vehicle((folder / name).resolve() if own else name)
        except (CoveyError, OSError, ValueError) as error:
            self._report.add(path, str(error))
            return None

    def _task(self, index: int, section: VehicleSection) -> Task:
        given = [key for key in TASKS if getattr(section, key) is not None]
        if len(given) != 1:
            message = f"expected exactly one task of {', '.join(TASKS)}, got {', '.join(given) or 'none'}"
            self._report.add(_at("vehicles", index), message)
            return None
        self._check_room(index, "start", section.start)
        if section.hold is False:
            self._report.add(_at("vehicles", index, "hold"), "expected true, got false", "or another task")
        if section.goal is not None:
            self._check_flying((*_at("vehicles", index, "goal"), "z_m"), section.goal.z_m)
            self._check_room(index, "goal", section.goal)
            return Goal(_point(section.goal), math.radians(section.goal.yaw_deg), section.goal.direct)
        if section.circle is not None:
            circle = section.circle
            self._check_flying((*_at("vehicles", index, "circle"), "altitude_m"), circle.altitude_m)
            if circle.rate_rad_s == 0.0:
                self._report.add(
                    (*_at("vehicles", index, "circle"), "rate_rad_s"),
                    "expected a rate other than 0",
                    "negative is clockwise; to stay at a place, give a goal",
                )
            x, y = circle.center_m
            return Circle((x, y, circle.altitude_m), circle.radius_m, circle.rate_rad_s)
        if section.follow is not None:
            follow = section.follow
            leader = self._names.get(follow.leader)
            path = (*_at("vehicles", index, "follow"), "leader")
            if leader is None:
                near = nearest(follow.leader, [name for name in self._names if name != section.name])
                hint = f"did you mean {near!r}?" if near else ""
                self._report.add(path, f"expected the name of a vehicle, got {follow.leader[:60]!r}", hint)
                return None
            if follow.leader == section.name:
                self._report.add(path, "expected another vehicle, got its own name")
                return None
            x, y, z = follow.offset_m
            return Follow(leader, (x, y, z), follow.feed_forward)
        return None

    def _check_flying(self, path: KeyPath, height: float) -> None:
        if height == 0.0:
            self._report.add(path, "expected a height above 0, got the ground")

    def _check_room(self, index: int, key: str, place: PlaceSection) -> None:
        """Obstacles must leave room for the vehicle's body at its start and its goal."""
        model = self._models[index]
        if model is None or not len(self._obstacles.rows):
            return
        room = clearance(self._obstacles.rows, self._obstacles.edges, *_point(place))
        if room < model.body_radius:
            self._report.add(
                _at("vehicles", index, key),
                f"expected {model.body_radius:.2f} m to the nearest obstacle, its body's radius, got {room:.2f} m",
            )

    def _check_cycles(self, tasks: Sequence[Task]) -> None:
        called = {index: name for name, index in self._names.items()}
        for i, task in enumerate(tasks):
            seen = [i]
            while isinstance(task, Follow):
                if task.leader == i:
                    names = [called[k] for k in (*seen, i)]
                    if i == min(seen):
                        path = (*_at("vehicles", i, "follow"), "leader")
                        self._report.add(path, f"expected someone to lead in the end, got {' after '.join(names)}")
                    break
                if task.leader in seen:
                    break  # behind a ring that is reported at one of its own
                seen.append(task.leader)
                task = tasks[task.leader]

    def _check_distances(self, tasks: Sequence[Task]) -> None:
        """Starts, goals and places beside a leader must be as far apart as vehicles have to be."""
        for i, j in combinations(range(len(tasks)), 2):
            a, b = self._sections[i], self._sections[j]
            if a is None or b is None or self._models[i] is None or self._models[j] is None:
                continue
            self._check_distance(i, j, "start", _point(a.start), _point(b.start))
            first, second = tasks[i], tasks[j]
            if isinstance(first, Follow) and isinstance(second, Follow) and first.leader == second.leader:
                self._check_distance(i, j, "follow", first.offset_W, second.offset_W)
            if isinstance(second, Follow) and second.leader == i:
                self._check_distance(i, j, "follow", (0.0, 0.0, 0.0), second.offset_W)
            if isinstance(first, Follow) and first.leader == j:
                self._check_distance(j, i, "follow", (0.0, 0.0, 0.0), first.offset_W)
            ends = [
                task.p_W if isinstance(task, Goal) else _point(section.start)
                for task, section in ((first, a), (second, b))
                if isinstance(task, Goal) or section.hold
            ]
            if len(ends) == 2 and isinstance(second, Goal):
                self._check_distance(i, j, "goal", *ends)
            elif len(ends) == 2 and isinstance(first, Goal):
                self._check_distance(j, i, "goal", *reversed(ends))

    def _check_distance(self, other: int, index: int, key: str, p: Point, q: Point) -> None:
        a, b = self._models[other], self._models[index]
        section = self._sections[other]
        assert a is not None
        assert b is not None
        assert section is not None
        needed = a.body_radius + b.body_radius + max(a.margin, b.margin)
        ratio = max(a.vertical_ratio, b.vertical_ratio)
        apart = math.hypot(p[0] - q[0], p[1] - q[1], (p[2] - q[2]) / ratio)
        if apart < needed:
            hint = f"heights count 1/{ratio:g} of their difference" if p[2] != q[2] else ""
            where = "from its leader" if key == "follow" and not any(p) else f"from that of {section.name[:60]!r}"
            path = _at("vehicles", index, key)
            self._report.add(path, f"expected at least {needed:.3g} m {where}, got {apart:.3g} m", hint)


def _objects(data: Mapping[str, Any], parts: _Parts, report: Report) -> tuple[MovingObject, ...]:
    section = _section(data)
    taken = {
        item["name"]: f"vehicles[{i}]"
        for i, item in enumerate(_list(section, "vehicles"))
        if isinstance(item, dict) and isinstance(item.get("name"), str)
    }
    _names(_list(section, "objects"), "objects", report, taken)
    result = []
    for i, item in enumerate(parts.objects):
        if item is None:
            continue
        if item.start_s >= parts.duration:
            message = f"expected a time before the end at {parts.duration:g} s, got {item.start_s:g}"
            report.add(_at("objects", i, "start_s"), message)
        path: list[Point] = [(x, y, z) for x, y, z in item.path_m]
        if all(point == path[0] for point in path):
            report.add(_at("objects", i, "path_m"), "expected a path of some length, got one point", "use obstacles")
        result.append(MovingObject(item.name, item.radius_m, tuple(path), item.speed_m_s, item.start_s))
    return tuple(result)


def _navigation(section: NavigationSection) -> dict[str, float]:
    values = {
        "k_wp": section.k_wp,
        "k_v": section.k_v,
        "k_rep": section.k_rep,
        "threshold": section.threshold_m,
        "max_speed": section.max_speed_m_s,
    }
    return {key: value for key, value in values.items() if value is not None}


def _check_gains(vehicles: Sequence[ExerciseVehicle], given: Mapping[str, float], report: Report) -> None:
    """The gains must be able to keep the vehicles apart (P4)."""
    for vehicle in vehicles:
        try:
            navigation_options(vehicle.parameters, given, alone=len(vehicles) == 1)
        except ArgumentError as error:
            report.add(("exercise", "navigation"), f"for {vehicle.parameters.name}: {error}")


def _point(place: PlaceSection) -> Point:
    return place.x_m, place.y_m, place.z_m


def _at(key: str, index: int, *rest: str) -> KeyPath:
    return ("exercise", key, index, *rest)
