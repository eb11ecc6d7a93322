"""Closes the loop: observe, navigate, control, simulate; and tells who has arrived where."""

from __future__ import annotations

import enum
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from covey.flight.arrival import arrived, tumbling
from covey.flight.backstepping import control_all
from covey.flight.battery import Batteries
from covey.flight.disturbance import DisturbanceEstimate
from covey.flight.layout import COMMAND, ON_GROUND, QUAT, SIGNALS, P, V
from covey.flight.navigation import Navigator, Status
from covey.flight.obstacles import Obstacle
from covey.flight.parameters import VehicleParameters
from covey.flight.rotation import yaw_of
from covey.flight.separation import min_separation
from covey.flight.simulator import Simulator
from covey.flight.trajectories import Trajectory
from covey.vehicles.flight_log import FlightLog, FlightRecorder
from covey.vehicles.kinematic import KinematicSimulator

CONTROL_PERIOD = 0.01
"""Seconds between two commands, as the autopilots of the thesis take them."""

LATE = 0.05
"""In real time a flight makes up for delays of so many seconds; longer ones, such as planning, put off the rest."""

OUTSIDE = 0.15
"""References stay inside the fence; a vehicle whose centre is farther outside its region, metres, gets an event."""

TUMBLED_FOR = 0.5
"""A vehicle that has been upside down for so many seconds does not fly any more."""


class Kind(enum.Enum):
    """What the vehicles are."""

    MUJOCO = "mujoco"
    REFERENCE = "reference"
    KINEMATIC = "kinematic"


@dataclass(frozen=True)
class Arrival:
    """When a waypoint counts as reached.

    Parameters
    ----------
    position : float
        Largest distance, metres.
    yaw : float
        Largest error of yaw, radians.
    speed : float
        Largest speed, m/s.
    hold : float
        For how long, seconds.
    """

    position: float = 0.15
    yaw: float = math.radians(5.0)
    speed: float = 0.25
    hold: float = 0.2


class Fleet:
    """The vehicles of one simulator.

    Parameters
    ----------
    simulator : Simulator
    names : sequence of str
        What to call the vehicles.
    navigator : Navigator, keyword-only
    kind : Kind, keyword-only
    arrival : Arrival, keyword-only
    object_indices : sequence of int, keyword-only
        Which obstacles of simulator and navigator move; `move_object` moves them.
    log_every : float, keyword-only
        Seconds between two rows of the log.
    realtime : bool, keyword-only
        Never run ahead of the clock on the wall.

    Notes
    -----
    A vehicle stands with its motors off until `go_to` or `track` gives it something to do.
    """

    def __init__(
        self,
        simulator: Simulator,
        names: Sequence[str],
        *,
        navigator: Navigator,
        kind: Kind,
        arrival: Arrival | None = None,
        object_radii: Sequence[float] = (),
        object_indices: Sequence[int] = (),
        log_every: float = 0.05,
        realtime: bool = False,
    ) -> None:
        self.simulator = simulator
        self.navigator = navigator
        self.kind = kind
        self.n = n = len(names)
        self.lost: set[int] = set()
        self.on_sample: Callable[[], tuple[float, float]] | None = None
        """Returns the committed and the flown score for a row of the log."""
        self.separation = self.min_separation = math.inf
        """Least scaled distance between two vehicles in the air, metres: now, and so far."""
        self.max_outside_region = 0.0
        """How far a vehicle in the air has been outside its region, metres."""
        parameters = simulator.parameters
        self.required_separation = max(vehicle.required_separation for vehicle in parameters)
        self.vertical_ratio = max(vehicle.vertical_ratio for vehicle in parameters)
        self.recorder = FlightRecorder(
            names,
            [vehicle.name for vehicle in parameters],
            kind.value,
            required_separation=self.required_separation,
            vertical_ratio=self.vertical_ratio,
            object_radii=object_radii,
        )
        self._arrival = arrival or Arrival()
        self._rows = np.array([vehicle.row() for vehicle in parameters])
        self._disturbance = DisturbanceEstimate(parameters)
        self._batteries = Batteries(parameters)
        self._objects = tuple(object_indices)
        self._object_positions = np.zeros((len(self._objects), 3))
        self._every = max(1, round(log_every / CONTROL_PERIOD))
        self._count = 0
        self._realtime = realtime
        self._due = -math.inf  # when the last control period was over on the wall's clock
        self._goals = np.full((n, 4), np.nan)
        self._tracks: list[Trajectory | None] = [None] * n
        self._powered = np.zeros(n, dtype=np.bool_)
        self._since = np.full(n, np.nan)  # since when a vehicle has been at its goal
        self._tumbling = np.zeros(n)
        self._outside = np.zeros(n, dtype=np.bool_)  # who is farther outside its region than OUTSIDE
        self._flags = np.zeros(n, dtype=np.bool_)
        self._collisions = 0
        self._squares = 0.0
        self._squares_of = 0
        self._commands = np.zeros((n, COMMAND))
        self._signals = np.zeros((n, SIGNALS))
        self.state = simulator.state

    @property
    def time(self) -> float:
        """Seconds since the flight began."""
        return self._count * CONTROL_PERIOD

    @property
    def parameters(self) -> tuple[VehicleParameters, ...]:
        """The vehicles."""
        return self.simulator.parameters

    @property
    def battery(self) -> NDArray[np.float64]:
        """Share that is left of each vehicle's battery, shape (n,); NaN where unknown, as without rotors."""
        return np.full(self.n, np.nan) if self.kind is Kind.KINEMATIC else self._batteries.shares.copy()

    @property
    def tracking_rms(self) -> float:
        """Root mean square of the true distance from the reference over all flying vehicles so far, metres."""
        return math.sqrt(self._squares / self._squares_of) if self._squares_of else 0.0

    # What a vehicle is to do.

    def go_to(self, vehicle: int, p_W: Sequence[float], yaw: float) -> None:
        """Send a vehicle to a waypoint, metres and radians in frame W."""
        self._start(vehicle)
        self._tracks[vehicle] = None
        self._goals[vehicle, :3] = p_W
        self._goals[vehicle, 3] = yaw
        self._since[vehicle] = np.nan
        self.navigator.set_goal(vehicle, np.asarray(p_W, dtype=np.float64), yaw)

    def track(self, vehicle: int, trajectory: Trajectory) -> None:
        """Have a vehicle track a trajectory, whatever is in its way."""
        self._start(vehicle)
        self._tracks[vehicle] = trajectory

    def stop_motors(self, vehicle: int) -> None:
        """Switch a vehicle off, after landing or for good."""
        self._powered[vehicle] = False
        self._tracks[vehicle] = None
        self._goals[vehicle] = np.nan
        self.navigator.deactivate(vehicle)

    def _start(self, vehicle: int) -> None:
        if not self._powered[vehicle]:
            self._powered[vehicle] = True
            self.navigator.reset(vehicle, self.state[vehicle, P : P + 3], yaw_of(self.state[vehicle, QUAT : QUAT + 4]))

    def add_obstacle(self, obstacle: Obstacle) -> None:
        """Put an obstacle into the world, known to everybody."""
        self.simulator.add_obstacle(obstacle)
        self.navigator.add_obstacle(obstacle)

    def move_object(self, index: int, position_W: Sequence[float]) -> None:
        """Put a moving object somewhere."""
        self._object_positions[index] = position_W
        self.simulator.move_obstacle(self._objects[index], position_W)
        self.navigator.move_obstacle(self._objects[index], position_W)

    # Where a vehicle is.

    def reached(self, vehicle: int) -> bool:
        """Whether a vehicle has been at its waypoint for long enough."""
        return bool(self.time - self._since[vehicle] >= self._arrival.hold - 0.5 * CONTROL_PERIOD)

    def blocked(self, vehicle: int) -> bool:
        """Whether a vehicle cannot get to its waypoint: navigation gave up, or it does not fly any more."""
        return vehicle in self.lost or self.navigator.status(vehicle) is Status.BLOCKED

    def on_ground(self, vehicle: int) -> bool:
        """Whether a vehicle stands or lies on the ground."""
        return bool(self.simulator.grounded[vehicle])

    def yaw(self, vehicle: int) -> float:
        """True yaw of a vehicle, radians."""
        return yaw_of(self.state[vehicle, QUAT : QUAT + 4])

    # Time.

    def step(self) -> None:
        """Let one control period pass."""
        observed = self.simulator.observe()
        references = self.navigator.step(observed[:, P : P + 3], observed[:, V : V + 3], CONTROL_PERIOD)
        for i, trajectory in enumerate(self._tracks):
            if trajectory is not None:
                references[i] = trajectory(self.time)
        # the references of a trajectory may not be such as a vehicle can follow, which is no disturbance
        steered = np.array([track is None for track in self._tracks])
        airborne = self._powered & steered & (observed[:, P + 2] > ON_GROUND)
        self._disturbance.update(observed, references, airborne, CONTROL_PERIOD)
        leaning = self._disturbance.compensate(references)
        control_all(observed, leaning, self._rows, self._commands, self._signals)
        self._commands[~self._powered] = 0.0
        if isinstance(self.simulator, KinematicSimulator):
            self.simulator.follow(references, self._powered, CONTROL_PERIOD)
        else:
            self.simulator.step(self._commands, CONTROL_PERIOD)
        self.state = self.simulator.state
        self._batteries.drain(self.state, CONTROL_PERIOD)
        self._count += 1
        self._watch(references)
        if self._realtime:
            ahead = self._due + CONTROL_PERIOD - time.monotonic()
            if ahead > 0.0:
                time.sleep(ahead)
            self._due = max(self._due + CONTROL_PERIOD, time.monotonic() - LATE)

    def run(self, until: Callable[[], bool], timeout: float) -> bool:
        """Let time pass until something holds; False when it does not within so many seconds."""
        end = self.time + timeout
        while not until():
            if self.time >= end:
                return False
            self.step()
        return True

    @property
    def objects_W(self) -> NDArray[np.float64]:
        """Centres of the moving objects, metres, shape (j, 3)."""
        return self._object_positions

    def log(self) -> FlightLog:
        """Return what has been recorded so far."""
        return self.recorder.log()

    def _watch(self, references: NDArray[np.float64]) -> None:
        now, state = self.time, self.state
        flying = self._powered & (state[:, P + 2] > ON_GROUND)
        separation = min_separation(state[flying, P : P + 3], self.vertical_ratio) if flying.sum() > 1 else math.inf
        self.separation = separation
        self.min_separation = min(self.min_separation, separation)
        self._watch_vehicles(now)
        self._watch_fences(now, flying)
        errors = state[flying, P : P + 3] - references[flying, :3]
        self._squares += float((errors * errors).sum())
        self._squares_of += len(errors)
        collisions = self.simulator.collisions
        for collision in collisions[self._collisions :]:
            others = [collision.vehicle] if collision.other is None else [collision.vehicle, collision.other]
            what = "an obstacle" if collision.other is None else self.recorder.names[collision.other]
            text = f"{self.recorder.names[collision.vehicle]} touched {what}"
            self.recorder.note(now, "collision", others, text)
        self._collisions = len(collisions)
        if self._count % self._every == 0:
            committed, flown = (math.nan, math.nan) if self.on_sample is None else self.on_sample()
            self.recorder.add(
                now,
                state,
                references,
                self._commands,
                self._signals,
                self._goals,
                separation,
                objects=self._object_positions,
                score_committed=committed,
                score_flown=flown,
            )

    def _watch_vehicles(self, now: float) -> None:
        """Note since when each vehicle has been at its goal, and give up those that have tipped over for good."""
        limits = self._arrival
        arrived(self.state, self._goals, limits.position, limits.yaw, limits.speed, self._flags)
        self._since = np.where(self._flags, np.fmin(self._since, now), np.nan)
        tumbling(self.state, self._flags)
        self._tumbling = np.where(self._flags & self._powered, self._tumbling + CONTROL_PERIOD, 0.0)
        if self._tumbling.max() > TUMBLED_FOR:
            for i in np.flatnonzero(self._tumbling > TUMBLED_FOR):
                self.lose(int(i), "tumbles")

    def _watch_fences(self, now: float, flying: NDArray[np.bool_]) -> None:
        """Note how far outside their regions vehicles are, and tell of those that are too far."""
        beyond = np.where(flying, -self.navigator.fences.rooms(self.state[:, P : P + 3]), -math.inf)
        worst = float(beyond.max())
        if worst <= 0.0:
            self._outside[:] = False
            return
        self.max_outside_region = max(self.max_outside_region, worst)
        outside = beyond > np.where(self._outside, 0.0, OUTSIDE)
        for i in np.flatnonzero(outside & ~self._outside):
            text = f"{self.recorder.names[i]} is more than {100.0 * OUTSIDE:.0f} cm outside its region"
            self.recorder.note(now, "outside", [int(i)], text)
        self._outside = outside

    def lose(self, vehicle: int, why: str) -> None:
        """Give a vehicle up: its motors stop, and the others fly around where it lies."""
        self.lost.add(vehicle)
        self.recorder.note(self.time, "lost", [vehicle], f"{self.recorder.names[vehicle]} {why}")
        self.stop_motors(vehicle)
