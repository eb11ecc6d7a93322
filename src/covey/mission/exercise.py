"""Exercises: flights without landmarks, a few vehicles with one task each, and perhaps a moving object.

Those of chapters 2 and 3 of the thesis are in ``examples/exercises``.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from covey.environment.files import read_text
from covey.environment.json_text import as_mistake
from covey.errors import ArgumentError, InputError, MissionError, Mistake
from covey.flight.navigation_options import NavigationOptions
from covey.flight.obstacles import Obstacle
from covey.flight.parameters import VehicleParameters
from covey.flight.reference_motion import ADVANCE as STALL_ADVANCE
from covey.flight.separation import safe_speed
from covey.mission.flight import NoiseSpec, WindSpec
from covey.mission.load import MAX_BYTES, MAX_MISTAKES, holds_exercise

Point = tuple[float, float, float]

_KEY = re.compile(r"^\W*exercise\W*[:=\].]", re.MULTILINE)


@dataclass(frozen=True)
class Goal:
    """Go to a waypoint.

    Parameters
    ----------
    p_W : tuple of 3 floats
        Metres.
    yaw : float
        Radians.
    direct : bool
        The controller gets it as its reference at once, without navigation.
    """

    p_W: Point
    yaw: float = 0.0
    direct: bool = False


@dataclass(frozen=True)
class Circle:
    """Fly a circle: centre plus radius (cos rate t, sin rate t), frame W, metres and rad/s."""

    center_W: Point
    radius: float
    rate: float


@dataclass(frozen=True)
class Follow:
    """Go where vehicle number `leader` goes, `offset_W` (metres) beside it."""

    leader: int
    offset_W: Point
    feed_forward: bool = False


Task = Goal | Circle | Follow | None
"""None: stay at the start."""


@dataclass(frozen=True, eq=False)
class ExerciseVehicle:
    """One vehicle of an exercise.

    Parameters
    ----------
    name : str
    parameters : VehicleParameters
    start_W : tuple of 3 floats
        Where it is when the exercise begins, metres; on the ground when its height is zero.
    yaw : float
        Its heading then, radians.
    task : Task
    """

    name: str
    parameters: VehicleParameters
    start_W: Point
    yaw: float
    task: Task


@dataclass(frozen=True)
class MovingObject:
    """A ball that moves along a path of straight lines and stays at its end.

    Parameters
    ----------
    name : str
    radius : float
        Metres.
    path_W : tuple of points
        Corners, metres.
    speed : float
        m/s.
    start : float
        When it sets off, seconds.
    """

    name: str
    radius: float
    path_W: tuple[Point, ...]
    speed: float
    start: float = 0.0

    def position(self, time: float) -> Point:
        """Where its centre is at a time, frame W, metres.

        Examples
        --------
        >>> ball = MovingObject("ball", 0.1, ((0.0, 0.0, 1.0), (2.0, 0.0, 1.0), (2.0, 3.0, 1.0)), speed=0.5, start=1.0)
        >>> ball.position(0.0), ball.position(3.0), ball.position(7.0), ball.position(99.0)
        ((0.0, 0.0, 1.0), (1.0, 0.0, 1.0), (2.0, 1.0, 1.0), (2.0, 3.0, 1.0))
        """
        left = max(0.0, time - self.start) * self.speed
        for a, b in zip(self.path_W, self.path_W[1:], strict=False):
            length = sum((y - x) ** 2 for x, y in zip(a, b, strict=True)) ** 0.5
            if left < length:
                x, y, z = (x + (y - x) * left / length for x, y in zip(a, b, strict=True))
                return x, y, z
            left -= length
        return self.path_W[-1]


@dataclass(frozen=True, eq=False)
class Exercise:
    """A flight without landmarks, in SI units.

    Parameters
    ----------
    name : str
    seed : int
        Root of all randomness: gusts and errors of measurement.
    duration : float
        Seconds.
    vehicles : tuple of ExerciseVehicle
    objects : tuple of MovingObject
    obstacles : tuple of Obstacle
    navigation : mapping
        What the file says on the potential field: any of ``k_wp``, ``k_v``, ``k_rep``, ``threshold``, ``max_speed``.
    wind : WindSpec
    noise : NoiseSpec
    arrival_position, arrival_yaw : float
        When a goal counts as reached: metres, radians.
    source : mapping
        The file as plain data.
    path : Path or None
        The file.
    """

    name: str
    seed: int
    duration: float
    vehicles: tuple[ExerciseVehicle, ...]
    objects: tuple[MovingObject, ...]
    obstacles: tuple[Obstacle, ...]
    navigation: Mapping[str, float]
    wind: WindSpec
    noise: NoiseSpec
    arrival_position: float
    arrival_yaw: float
    source: Mapping[str, Any] = field(default_factory=dict, repr=False)
    path: Path | None = None

    def options(self, vehicle: int) -> NavigationOptions:
        """Return the gains and limits by which a vehicle navigates."""
        own = self.vehicles[vehicle]
        options = navigation_options(own.parameters, self.navigation, alone=len(self.vehicles) == 1)
        # A place to stay at is never given up, however long something is in the way.
        return replace(options, stall_time=10.0 * self.duration) if own.task is None else options


def navigation_options(
    vehicle: VehicleParameters, given: Mapping[str, float], *, alone: bool = False
) -> NavigationOptions:
    """Complete the options that a file gives: what it leaves out follows from the vehicle and from the others.

    Parameters
    ----------
    vehicle : VehicleParameters
    given : mapping
        Any of ``k_wp``, ``k_v``, ``k_rep``, ``threshold`` and ``max_speed``.
    alone : bool
        Whether there is no other vehicle, which the threshold is for: obstacles repel from a distance of their own.

    Raises
    ------
    ArgumentError
        If two such vehicles would not stay apart.

    Notes
    -----
    Deviation: P4.  Without a speed in the file vehicles fly as fast as the field alone can stop them in time.

    Examples
    --------
    >>> from covey.flight.parameters import load_vehicle
    >>> options = navigation_options(load_vehicle("iris"), {"k_wp": 1, "k_v": 5, "k_rep": 2, "threshold": 1.5})
    >>> print(f"{options.max_speed:.2f} m/s")
    0.29 m/s
    """
    chosen = dict(given)
    usual = NavigationOptions.for_vehicle(vehicle)
    if alone:
        chosen["threshold"] = usual.threshold
    k_rep, threshold = chosen.get("k_rep", usual.k_rep), chosen.get("threshold", usual.threshold)
    if threshold <= usual.separation:
        raise ArgumentError(
            f"threshold: expected more than the required separation of {usual.separation:g} m, got {threshold:g}"
        )
    if "max_speed" not in chosen and ("k_rep" in chosen or "threshold" in chosen):
        stopped = 0.5 * safe_speed(k_rep, threshold, usual.separation)
        chosen["max_speed"] = min(usual.max_speed, 0.999 * stopped)
    # The last stretch is covered ever more slowly; it must count as arrived before it counts as a stall.
    slope = chosen.get("k_wp", usual.k_wp) / chosen.get("k_v", usual.k_v)
    slowest = STALL_ADVANCE / (1.0 - math.exp(-slope * usual.stall_time))
    return NavigationOptions.for_vehicle(vehicle, arrival=max(usual.arrival, 1.2 * slowest), **chosen)


def load_exercise(path: str | Path, *, seed: int | None = None) -> Exercise:
    """Read an exercise file.

    Parameters
    ----------
    path : str or Path
        YAML (``.yaml``, ``.yml`` or no ending), TOML (``.toml``) or JSON (``.json``).
    seed : int, optional
        Instead of the file's seed.

    Raises
    ------
    MissionError
        With every mistake in the file, in order, each with its line and key.
    """
    from covey.mission.document import FORMATS

    path = Path(path)
    try:
        text = read_text(path, limit=MAX_BYTES)
    except InputError as error:
        raise MissionError((as_mistake(error, str(path)),)) from None
    syntax = FORMATS.get(path.suffix.lower())
    if syntax is None:
        message = f"expected a file name ending in .yaml, .yml, .json or .toml, got {path.suffix!r}"
        raise MissionError((Mistake(str(path), None, None, "", message),))
    return _exercise(text, syntax, source=str(path), folder=path.parent, path=path, seed=seed)


def parse_exercise(
    text: str,
    *,
    format: str = "yaml",
    source: str = "<text>",
    folder: str | Path = ".",
    seed: int | None = None,
) -> Exercise:
    """Read an exercise from a text; parameters as of `covey.mission.parse_mission`.

    Raises
    ------
    MissionError
        With every mistake, in order.
    ArgumentError
        If the format is not "yaml", "toml" or "json".

    Examples
    --------
    >>> exercise = parse_exercise('''
    ... schema_version: 1
    ... name: up
    ... exercise:
    ...   duration_s: 10
    ...   vehicles:
    ...     - {name: a, start: {x_m: 0, y_m: 0, z_m: 1}, goal: {x_m: 1, y_m: 3, z_m: 2, yaw_deg: 90}}
    ... ''')
    >>> exercise.vehicles[0].task
    Goal(p_W=(1.0, 3.0, 2.0), yaw=1.5707963267948966, direct=False)
    """
    if format not in ("yaml", "toml", "json"):
        raise ArgumentError(f"format: expected 'yaml', 'toml' or 'json', got {format!r}")
    return _exercise(text, format, source=source, folder=Path(folder), path=None, seed=seed)


def is_exercise(path: str | Path) -> bool:
    """Whether a file is an exercise and no mission: it has ``exercise`` at its top.

    A file that cannot be read is none, and one with mistakes of syntax is judged by its look, so that whatever reads it
    next can name the mistake.
    """
    from covey.mission.document import FORMATS, parse

    path = Path(path)
    try:
        text = read_text(path, limit=MAX_BYTES)
    except InputError:
        return False
    if "exercise" not in text:
        return False
    data = parse(text, FORMATS.get(path.suffix.lower(), "yaml"), str(path)).data
    return holds_exercise(data) or (data is None and _KEY.search(text) is not None)


def exercise_schema() -> dict[str, Any]:
    """Return the JSON Schema (2020-12) of the exercise file, each key described.

    Examples
    --------
    >>> sorted(exercise_schema()["required"])
    ['exercise', 'name', 'schema_version']
    """
    from covey.mission.exercise_schema import json_schema

    return json_schema()


def _exercise(text: str, syntax: str, *, source: str, folder: Path, path: Path | None, seed: int | None) -> Exercise:
    from covey.mission.document import parse
    from covey.mission.exercise_build import build
    from covey.mission.exercise_schema import ExerciseFile
    from covey.mission.report import Report

    if seed is not None and not 0 <= seed < 2**63:
        raise ArgumentError(f"seed: expected an integer from 0 to 2^63 - 1, got {seed}")
    document = parse(text, syntax, source)
    report = Report(source, document, ExerciseFile)
    exercise = None
    if document.data is not None or not document.mistakes:
        exercise = build(document.data, report, folder=folder, path=path, seed=seed)
    if exercise is None or report.mistakes:
        mistakes = report.in_order()
        rest = len(mistakes) - MAX_MISTAKES
        if rest > 0:
            mistakes = [*mistakes[:MAX_MISTAKES], Mistake(source, None, None, "", f"and {rest:,} more mistakes")]
        raise MissionError(tuple(mistakes))
    return exercise
