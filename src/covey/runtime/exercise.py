"""Flies an exercise: each vehicle does its one task until the time is over."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from covey.flight.layout import P, V
from covey.flight.navigation import Navigator
from covey.flight.obstacles import Sphere
from covey.flight.trajectories import Circle as CircleTrajectory
from covey.flight.trajectories import Follow as FollowTrajectory
from covey.flight.trajectories import Hold, Trajectory
from covey.mission.exercise import Circle, Exercise, Follow, Goal
from covey.runtime.plan import software_versions
from covey.runtime.records.flight_document import events_document
from covey.runtime.result import Progress
from covey.runtime.watching.exercise_telling import ExerciseTeller
from covey.runtime.watching.feed import Watcher
from covey.runtime.world import build_simulator
from covey.vehicles.fleet import CONTROL_PERIOD, Arrival, Fleet, Kind
from covey.vehicles.flight_log import FlightLog

LOG_EVERY = 0.05
"""Seconds between two rows of an exercise's log."""

REPORT_EVERY = 0.5
"""Seconds of flight between two words on progress."""


@dataclass(frozen=True, eq=False)
class ExerciseResult:
    """An exercise that was flown.

    Parameters
    ----------
    exercise : Exercise
    log : FlightLog
        Everything over time.
    interrupted : bool
        Whether it ended before its time, by Ctrl-C.
    summary : mapping
        What is worth telling, ready for JSON: ``simulator``, ``duration_s``, ``wall_s``, ``real_time_factor``,
        ``min_separation_m`` (scaled, in the air; None for one vehicle), ``required_separation_m``,
        ``min_object_gap_m`` (from a vehicle's rotor tips to a moving object; None without one), ``collisions``,
        ``tracking_rms_m``, ``waypoints_reached``, ``waypoints_missed``, ``lost`` and ``events``.
    """

    exercise: Exercise
    log: FlightLog
    interrupted: bool
    summary: Mapping[str, Any]


def fly_exercise(
    exercise: Exercise,
    *,
    simulator: Kind | str = Kind.MUJOCO,
    seed: int | None = None,
    realtime: bool = False,
    on_progress: Callable[[Progress], None] | None = None,
    watch: Watcher | None = None,
) -> ExerciseResult:
    """Fly an exercise.

    Parameters
    ----------
    exercise : Exercise
    simulator : Kind or str
        ``mujoco``, ``reference``, or ``kinematic``, which follows every reference exactly.
    seed : int, optional
        Instead of the exercise's.
    realtime : bool
        Let it take as long as it would.
    on_progress : callable, optional
        Told twice a simulated second; its score is NaN.
    watch : Watcher, optional
        Called with all there is to see, when it happens: `covey.runtime.watching.feed`.

    Returns
    -------
    ExerciseResult
        After Ctrl-C (KeyboardInterrupt) what had happened by then.

    Notes
    -----
    Source: Sposato (2016), sections 2.3.2, 3.4.1 to 3.4.3.
    """
    if seed is not None:
        exercise = replace(exercise, seed=seed)
    flight = _Flight(exercise, Kind(simulator), realtime=realtime)
    teller = None if watch is None else ExerciseTeller(watch, exercise, flight.fleet, software_versions())
    interrupted = False
    try:
        flight.fly(on_progress, teller)
    except KeyboardInterrupt:
        interrupted = True
    finally:
        flight.fleet.simulator.close()
    if teller is not None:
        teller.end("interrupted" if interrupted else "settled")
    return ExerciseResult(exercise, flight.fleet.log(), interrupted, flight.summary())


class _Flight:
    """The fleet of an exercise and what happens to it."""

    def __init__(self, exercise: Exercise, kind: Kind, *, realtime: bool) -> None:
        self._exercise = exercise
        self._began = time.monotonic()
        vehicles = [vehicle.parameters for vehicle in exercise.vehicles]
        balls = [Sphere(item.path_W[0], item.radius) for item in exercise.objects]
        obstacles = [*exercise.obstacles, *balls]
        first = len(exercise.obstacles)
        simulator = build_simulator(
            kind,
            vehicles,
            np.array([vehicle.start_W for vehicle in exercise.vehicles]),
            np.array([vehicle.yaw for vehicle in exercise.vehicles]),
            obstacles=obstacles,
            wind=exercise.wind,
            noise=exercise.noise,
            seed=exercise.seed,
        )
        self.fleet = Fleet(
            simulator,
            [vehicle.name for vehicle in exercise.vehicles],
            navigator=Navigator(vehicles, obstacles, [exercise.options(i) for i in range(len(vehicles))]),
            kind=kind,
            arrival=Arrival(exercise.arrival_position, exercise.arrival_yaw),
            object_radii=[ball.radius for ball in balls],
            object_indices=range(first, first + len(balls)),
            log_every=LOG_EVERY,
            realtime=realtime,
        )
        self._gap = math.inf
        self._waiting: set[int] = set()
        self._reached: set[int] = set()
        self._set_tasks()

    def fly(self, on_progress: Callable[[Progress], None] | None, teller: ExerciseTeller | None) -> None:
        """Fly to the end of the exercise."""
        exercise, fleet = self._exercise, self.fleet
        steps = round(exercise.duration / CONTROL_PERIOD)
        every = round(REPORT_EVERY / CONTROL_PERIOD)
        for step in range(steps):
            if on_progress is not None and step % every == 0:
                on_progress(Progress("flying", math.nan, fraction=step / steps))
            for k, item in enumerate(exercise.objects):
                fleet.move_object(k, item.position(fleet.time))
            fleet.step()
            self._watch()
            if teller is not None:
                teller.update()

    def summary(self) -> dict[str, Any]:
        """Return the figures of the flight so far."""
        fleet = self.fleet
        wall = time.monotonic() - self._began
        return {
            "simulator": fleet.kind.value,
            "duration_s": round(fleet.time, 6),
            "wall_s": wall,
            "real_time_factor": fleet.time / wall if wall > 0.0 else None,
            "min_separation_m": _finite(fleet.min_separation),
            "required_separation_m": fleet.required_separation,
            "min_object_gap_m": _finite(self._gap),
            "collisions": len(fleet.simulator.collisions),
            "tracking_rms_m": fleet.tracking_rms,
            "waypoints_reached": len(self._reached),
            "waypoints_missed": len(self._waiting),
            "lost": [self._exercise.vehicles[i].name for i in sorted(fleet.lost)],
            "events": events_document(fleet.recorder.events),
        }

    def _set_tasks(self) -> None:
        for i, vehicle in enumerate(self._exercise.vehicles):
            task = vehicle.task
            if isinstance(task, Goal):
                self.fleet.go_to(i, task.p_W, task.yaw)
                self._waiting.add(i)
                if task.direct:
                    self.fleet.track(i, Hold(task.p_W, task.yaw))
            elif isinstance(task, Circle):
                self.fleet.track(i, CircleTrajectory(task.center_W, task.radius, -task.rate, vehicle.yaw))
            elif isinstance(task, Follow):
                self.fleet.track(i, self._follow(task, vehicle.yaw))
            else:
                self.fleet.go_to(i, vehicle.start_W, vehicle.yaw)

    def _follow(self, task: Follow, yaw: float) -> Trajectory:
        def leader() -> np.ndarray[Any, np.dtype[np.float64]]:
            # What is known of a leader is where it is and how fast, not how it means to go on.
            return self.fleet.state[task.leader, P : V + 3]

        return FollowTrajectory(leader, task.offset_W, yaw, derivatives=task.feed_forward)

    def _watch(self) -> None:
        fleet = self.fleet
        for i in sorted(self._waiting):
            if fleet.reached(i):
                self._waiting.remove(i)
                self._reached.add(i)
                name = self._exercise.vehicles[i].name
                fleet.recorder.note(fleet.time, "reached", [i], f"{name} reached its goal")
        for item in self._exercise.objects:
            centre = item.position(fleet.time - CONTROL_PERIOD)
            for i, vehicle in enumerate(self._exercise.vehicles):
                away = math.dist(fleet.state[i, P : P + 3], centre)
                self._gap = min(self._gap, away - item.radius - vehicle.parameters.body_radius)


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
