"""Tells a watcher of an exercise, which has vehicles and tasks but no landmarks."""

from __future__ import annotations

import math

import numpy as np

from covey.flight.layout import OMEGA, QUAT, P, V
from covey.mission.exercise import Exercise, ExerciseVehicle, Goal
from covey.runtime.drawing.palette import colours
from covey.runtime.watching.feed import (
    NO_TRADE,
    Activity,
    Ended,
    Health,
    Motion,
    Note,
    Run,
    Scene,
    SceneAgent,
    TeamState,
    Watcher,
)
from covey.runtime.watching.telling import HEALTH_EVERY, MOTION_EVERY, Teller, scene_obstacle
from covey.vehicles.fleet import CONTROL_PERIOD, Fleet

MARGIN = 2.0
"""Metres around all that stands and flies at the start: a region for the map, which keeps nobody in."""


class ExerciseTeller(Teller):
    """Tells where the vehicles of an exercise are; call `update` after each step of the fleet.

    Parameters
    ----------
    watch : Watcher
    exercise : Exercise
    fleet : Fleet
    software : mapping of str to str
        Versions.
    """

    def __init__(self, watch: Watcher, exercise: Exercise, fleet: Fleet, software: dict[str, str]) -> None:
        super().__init__(watch, describe_exercise(exercise, fleet, software))
        self._fleet = fleet
        self._told = 0
        self._due = self._health_due = 0.0
        self.tell(self.scene)
        m = fleet.n
        poses = np.array([_waypoint(vehicle) for vehicle in exercise.vehicles])
        none = np.empty(0, dtype=np.int32)
        activity = np.full(m, Activity.FLYING, dtype=np.uint8)
        self.state(TeamState(0.0, none, poses, np.zeros(m), np.empty(0), activity, none, 0, math.nan))
        self.update()

    def update(self) -> None:
        """Tell what happened since the last time, and, when it is time to, where everybody is."""
        fleet = self._fleet
        for event in fleet.recorder.events[self._told :]:
            who = tuple(fleet.recorder.names.index(name) for name in event.vehicles)
            self.tell(Note(fleet.time, event.kind, who, event.text))
        if len(fleet.recorder.events) > self._told or fleet.time >= self._health_due:
            self._told = len(fleet.recorder.events)
            self._tell_health()
        if fleet.time >= self._due:
            self._due = fleet.time + MOTION_EVERY - 0.5 * CONTROL_PERIOD
            state = fleet.state
            poses = np.concatenate([state[:, P : P + 3], state[:, QUAT : QUAT + 4]], axis=1)
            velocities, rates = state[:, V : V + 3].copy(), state[:, OMEGA : OMEGA + 3].copy()
            objects = fleet.objects_W.copy()
            self.tell(Motion(fleet.time, poses, velocities, rates, objects, math.nan, fleet.separation))

    def end(self, status: str) -> None:
        """Tell the last of it, and that the exercise is over."""
        self._due = 0.0
        self.update()
        self.state(self.view.state(self._fleet.time))
        self.tell(Ended(self._fleet.time, status, None, 0.0))

    def _tell_health(self) -> None:
        fleet = self._fleet
        activity = np.full(fleet.n, Activity.FLYING, dtype=np.uint8)
        activity[sorted(fleet.lost)] = Activity.DEAD
        self._health_due = fleet.time + HEALTH_EVERY
        unknown = np.full(fleet.n, np.nan)
        self.tell(Health(fleet.time, activity, fleet.battery, unknown, np.full(fleet.n, fleet.time)))


def _waypoint(vehicle: ExerciseVehicle) -> list[float]:
    """Return where a vehicle is to go, or where it starts if it has another task, as a row of `POSE` columns."""
    task = vehicle.task
    (x, y, z), yaw = (task.p_W, task.yaw) if isinstance(task, Goal) else (vehicle.start_W, vehicle.yaw)
    return [x, y, z, math.cos(0.5 * yaw), 0.0, 0.0, math.sin(0.5 * yaw)]


def describe_exercise(exercise: Exercise, fleet: Fleet, software: dict[str, str]) -> Scene:
    """Return the scene of an exercise: without landmarks, in a region that is only as large as what there is to see."""
    obstacles = tuple(scene_obstacle(obstacle) for obstacle in exercise.obstacles)
    starts = np.array([vehicle.start_W[:2] for vehicle in exercise.vehicles])
    paths = [np.array(item.path_W)[:, :2] for item in exercise.objects]
    goals = np.array([_waypoint(vehicle)[:2] for vehicle in exercise.vehicles])
    seen = np.concatenate([starts, goals, *(obstacle.outline for obstacle in obstacles), *paths])
    (x0, y0), (x1, y1) = seen.min(axis=0) - MARGIN, seen.max(axis=0) + MARGIN
    region = (np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]]),)
    palette = colours([vehicle.name for vehicle in exercise.vehicles])
    return Scene(
        run=Run.FLIGHT,
        mission=exercise.name,
        seed=exercise.seed,
        sigma=0.0,
        trade=NO_TRADE,
        agents=tuple(
            SceneAgent(vehicle.name, colour, region, "none", math.nan)
            for vehicle, colour in zip(exercise.vehicles, palette, strict=True)
        ),
        positions_W=np.empty((0, 3)),
        weights=np.empty(0),
        normals_W=None,
        cell_size=math.nan,
        region=region,
        obstacles=obstacles,
        body_radius=max(vehicle.parameters.body_radius for vehicle in exercise.vehicles),
        required_separation=fleet.required_separation,
        source=exercise.source,
        software=software,
    )
