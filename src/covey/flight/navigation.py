"""References that lead vehicles to their goals, apart from each other and from obstacles."""

from __future__ import annotations

import enum
import itertools
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from covey.errors import ArgumentError
from covey.flight import reference_motion as motion
from covey.flight.fence import Fences
from covey.flight.layout import REF_YAW, REFERENCE
from covey.flight.navigation_options import NavigationOptions
from covey.flight.obstacles import Obstacle, Sphere, pack, place_sphere
from covey.flight.parameters import VehicleParameters
from covey.flight.route import Router
from covey.flight.separation import sort_into_cells
from covey.geometry import Region

FORGET = 0.3
"""Seconds after which an obstacle that is not moved any more counts as standing still."""

SLOW = 0.3
"""Vehicles slower than this, m/s, are gone around in an escape; others are expected to clear the way."""


OCCUPIED = 3
"""A goal at which one stall after the other finds somebody hover is given up after so many."""

__all__ = ["NavigationOptions", "Navigator", "Status"]


class Status(enum.Enum):
    """What has become of a vehicle's goal."""

    INACTIVE = "inactive"
    FLYING = "flying"
    ARRIVED_REFERENCE = "arrived"
    BLOCKED = "blocked"


class Navigator:
    """References for a team: each vehicle to its goal, apart from the others and from obstacles.

    Parameters
    ----------
    parameters : sequence of VehicleParameters
        One a vehicle.
    obstacles : sequence of Obstacle
    options : NavigationOptions, or a sequence of them, optional
        For all, or one a vehicle; by default `NavigationOptions.for_vehicle`.
    regions : sequence of Region or None, keyword-only
        Where each vehicle's centre has to stay, at any altitude: border and holes are its fence.  Anywhere by default.

    Notes
    -----
    Source: Sposato (2016), chapter 3.  Deviation: P1 to P5.

    A vehicle is inactive (on the ground, or lost) until `reset`; others keep clear of where it is measured.

    Examples
    --------
    >>> import numpy as np
    >>> from covey.flight.parameters import load_vehicle
    >>> navigator = Navigator([load_vehicle("iris")])
    >>> navigator.reset(0, (0, 0, 1), 0.0)
    >>> navigator.set_goal(0, (3, 0, 1), np.pi / 2)
    >>> p, v = np.array([[0.0, 0, 1]]), np.zeros((1, 3))
    >>> for _ in range(1000):
    ...     reference = navigator.step(p, v, 0.01)
    ...     p, v = reference[:, 0:3], reference[:, 3:6]
    >>> navigator.status(0).name, np.round(p[0], 2) + 0.0
    ('ARRIVED_REFERENCE', array([3., 0., 1.]))
    """

    def __init__(
        self,
        parameters: Sequence[VehicleParameters],
        obstacles: Sequence[Obstacle] = (),
        options: NavigationOptions | Sequence[NavigationOptions] | None = None,
        *,
        regions: Sequence[Region | None] | None = None,
    ) -> None:
        n = len(parameters)
        if options is None:
            options = [NavigationOptions.for_vehicle(vehicle) for vehicle in parameters]
        elif isinstance(options, NavigationOptions):
            options = [options] * n
        if len(options) != n or n == 0:
            raise ArgumentError(f"options: expected one for each of {n} vehicles (at least one), got {len(options)}")
        if regions is not None and len(regions) != n:
            raise ArgumentError(f"regions: expected one for each of {n} vehicles, got {len(regions)}")
        self.options = tuple(options)
        self.fences = Fences([None] * n if regions is None else regions)
        self._team = motion.Team(
            modes=np.full(n, motion.INACTIVE),
            options=np.array([choice.row() for choice in options]),
            virtual=np.zeros((n, motion.VIRTUAL)),
            goals=np.zeros((n, 4)),
            routes=np.zeros((n, motion.CORNERS, 3)),
            cursors=np.tile([0, 1], (n, 1)),
            progress=np.zeros((n, motion.PROGRESS)),
        )
        self._room = motion.make_room(n)
        widest = max(choice.separation for choice in options)
        self._reach = max(
            choice.threshold
            + widest
            - choice.separation
            + choice.tracking_reset
            + choice.filter_time * choice.max_speed
            for choice in options
        )
        self._positions = np.zeros((n, 3))
        self._velocities = np.zeros((n, 3))
        self._references = np.zeros((n, REFERENCE))
        self._escapes = np.zeros(n, dtype=np.int64)
        self._occupied = np.zeros(n, dtype=np.int64)
        self._closest = np.zeros(n)
        self._time = 0.0
        self._moved: dict[int, float] = {}
        self._set_obstacles(list(obstacles), np.zeros((len(obstacles), 3)))

    def __len__(self) -> int:
        return len(self.options)

    def reset(self, i: int, p_W: Sequence[float] | NDArray[np.float64], yaw: float) -> None:
        """Start or restart a vehicle's reference, at rest: it flies, and holds there."""
        point = _point("p_W", p_W)
        if not math.isfinite(yaw):
            raise ArgumentError(f"yaw: expected a finite angle (rad), got {yaw!r}")
        self._team.virtual[i] = 0.0
        self._team.virtual[i, 0:3] = point
        self._team.virtual[i, 9] = yaw
        self._positions[i] = point
        self._references[i] = 0.0
        self._references[i, :3] = point
        self._references[i, REF_YAW] = yaw
        self._team.modes[i] = motion.FLYING
        self._assign(i, point, yaw, point[np.newaxis])

    def deactivate(self, i: int) -> None:
        """Tell that a vehicle does not fly (any more): others keep clear of where it is measured."""
        self._team.modes[i] = motion.INACTIVE

    def set_goal(self, i: int, p_W: Sequence[float] | NDArray[np.float64], yaw: float) -> None:
        """Send a vehicle that flies to a pose, frame W, metres and rad; BLOCKED at once if obstacles leave no way."""
        goal = _point("p_W", p_W)
        if not math.isfinite(yaw):
            raise ArgumentError(f"yaw: expected a finite angle (rad), got {yaw!r}")
        if self._team.modes[i] == motion.INACTIVE:
            raise ArgumentError(f"i: expected a vehicle that flies, got {i}; reset it first")
        self._team.modes[i] = motion.FLYING
        route = self._plan(i, goal, self._blockers(i, parked=True))
        if route is None:
            route = self._plan(i, goal, None)
        if route is None:
            self._team.goals[i] = *goal, yaw
            self._block(i)
        else:
            self._assign(i, goal, yaw, route)

    def hold(self, i: int) -> None:
        """Let a vehicle stop where it can, and stay there."""
        point = self._stopping_point(i)
        self._assign(i, point, self._team.virtual[i, 9], point[np.newaxis])
        self._team.modes[i] = motion.FLYING

    def status(self, i: int) -> Status:
        """What has become of a vehicle's goal."""
        mode = self._team.modes[i]
        if mode == motion.FLYING:
            _, best, *_ = self._team.progress[i]
            off = np.linalg.norm(self._references[i, :3] - self._team.goals[i, :3])
            # once there, being pushed a little does not count
            arrived = best == 0.0 and off < motion.NEAR * self.options[i].arrival
            return Status.ARRIVED_REFERENCE if arrived else Status.FLYING
        return Status.BLOCKED if mode == motion.BLOCKED else Status.INACTIVE

    def stalled(self, i: int) -> bool:
        """Whether a vehicle has given its goal up, and holds where it is."""
        return self.status(i) is Status.BLOCKED

    def route(self, i: int) -> NDArray[np.float64]:
        """Corners that are still ahead of a vehicle, the last where it is to stay: shape (k, 3), frame W, metres."""
        begin, end = self._team.cursors[i]
        corners: NDArray[np.float64] = self._team.routes[i, begin:end].copy()
        return corners

    def add_obstacle(self, obstacle: Obstacle) -> int:
        """Put up an obstacle; routes that it blocks are planned anew.  Returns its index."""
        self._set_obstacles([*self._obstacles, obstacle], np.vstack([self._scene.drift, np.zeros(3)]))
        self._replan()
        return len(self._obstacles) - 1

    def move_obstacle(self, index: int, position_W: Sequence[float] | NDArray[np.float64]) -> None:
        """Put the centre of a spherical obstacle elsewhere; vehicles make way at the speed it is seen to have."""
        obstacle = self._obstacles[index]
        if not isinstance(obstacle, Sphere):
            raise ArgumentError(f"index: expected a sphere, which can move, got {obstacle!r}")
        point = _point("position_W", position_W)
        elapsed = self._time - self._moved.get(index, -math.inf)
        shift = point - np.asarray(obstacle.center_W)
        self._scene.drift[index] = shift / elapsed if 0.0 < elapsed < FORGET else 0.0
        self._moved[index] = self._time
        moved = Sphere((float(point[0]), float(point[1]), float(point[2])), obstacle.radius)
        self._obstacles[index] = moved
        place_sphere(self._scene.rows[index], moved)

    def step(
        self, positions_W: NDArray[np.float64], velocities_W: NDArray[np.float64], dt: float
    ) -> NDArray[np.float64]:
        """Move all references by one control period.

        Parameters
        ----------
        positions_W, velocities_W : arrays, shape (n, 3)
            As measured, frame W, m and m/s.
        dt : float
            Control period, s.

        Returns
        -------
        array, shape (n, REFERENCE)
            Columns as in `covey.flight.layout`.  An inactive vehicle's is where it is measured, at rest.
        """
        self._observe(positions_W, velocities_W, dt)
        stalled = self._advance(0, len(self), dt)
        if stalled:
            for i in range(len(self)):
                self._check_progress(i)
        return self._references.copy()

    def step_one(
        self, i: int, positions_W: NDArray[np.float64], velocities_W: NDArray[np.float64], dt: float
    ) -> NDArray[np.float64]:
        """Move the reference of vehicle i alone, as if each vehicle computed its own; shapes as in `step`.

        Returns
        -------
        array, shape (REFERENCE,)
        """
        self._observe(positions_W, velocities_W, dt)
        self._advance(i, i + 1, dt)
        self._check_progress(i)
        reference: NDArray[np.float64] = self._references[i].copy()
        return reference

    def _advance(self, first: int, last: int, dt: float) -> int:
        room = self._room
        columns, lines = sort_into_cells(self._positions, float(self._reach), room.frame, room.starts, room.order)
        measured = self._positions, self._velocities
        return motion.advance(
            first, last, columns, lines, *measured, self._team, self._scene, room, float(dt), self._references
        )

    def _observe(self, positions_W: NDArray[np.float64], velocities_W: NDArray[np.float64], dt: float) -> None:
        for name, target, values in (
            ("positions_W", self._positions, positions_W),
            ("velocities_W", self._velocities, velocities_W),
        ):
            if np.shape(values) != target.shape or not np.isfinite(values).all():
                raise ArgumentError(f"{name}: expected finite numbers of shape {target.shape}, got {np.shape(values)}")
            target[:] = values
        if not 0.0 < dt <= 0.1:
            raise ArgumentError(f"dt: expected seconds above zero, at most 0.1, got {dt!r}")
        self._time += dt
        for index, moved in list(self._moved.items()):
            if self._time - moved > FORGET:
                self._scene.drift[index] = 0.0
                del self._moved[index]
                self._replan()

    def _set_obstacles(self, obstacles: list[Obstacle], drift: NDArray[np.float64]) -> None:
        self._obstacles = obstacles
        packed = pack(obstacles)
        self._scene = motion.Scene(packed.rows, packed.edges, drift, self.fences.edges, self.fences.spans)
        self._routers = [
            Router(packed, floor=choice.floor, ceiling=choice.ceiling, fence=self.fences[i])
            for i, choice in enumerate(self.options)
        ]

    def _plan(
        self, i: int, goal: NDArray[np.float64], blockers: NDArray[np.float64] | None
    ) -> NDArray[np.float64] | None:
        return self._routers[i].route(self._team.virtual[i, 0:3], goal, self.options[i].keep_off, blockers)

    def _blockers(self, i: int, *, parked: bool) -> NDArray[np.float64]:
        """Others to go around: those that do not fly, or all but the fast ones."""
        modes, own = self._team.modes, self.options[i]
        table = []
        for j in range(len(self)):
            inactive = modes[j] == motion.INACTIVE
            if j == i or not (inactive if parked else np.linalg.norm(self._velocities[j]) < SLOW):
                continue
            if np.linalg.norm(self._positions[j] - self._positions[i]) > 20.0 and len(self) > 100:
                continue
            keep = 0.5 * (own.separation + self.options[j].separation) * 1.01
            ratio = 1.0 if inactive else max(own.vertical_ratio, self.options[j].vertical_ratio)
            table.append([*self._positions[j], keep, ratio])
        return np.array(table, dtype=np.float64).reshape(len(table), 5)

    def _assign(self, i: int, goal: NDArray[np.float64], yaw: float, route: NDArray[np.float64]) -> None:
        """Give a vehicle a new goal and the way there."""
        self._team.goals[i] = *goal, yaw
        self._escapes[i] = 0
        self._occupied[i] = 0
        self._closest[i] = np.linalg.norm(goal - self._team.virtual[i, 0:3])
        self._follow(i, route)

    def _follow(self, i: int, route: NDArray[np.float64]) -> None:
        if len(route) > motion.CORNERS:
            route = np.vstack([route[: motion.CORNERS - 1], route[-1:]])
        self._team.routes[i, : len(route)] = route
        self._team.cursors[i] = 0, len(route)
        legs = np.diff(np.vstack([self._team.virtual[i, 0:3], route]), axis=0)
        left = float(np.linalg.norm(legs, axis=1).sum())
        # Patience differs between vehicles and tries, so that two that are in each other's way do not try at once.
        patience = self.options[i].stall_time * (1.0 + 0.125 * ((i + 3 * self._escapes[i]) % 8))
        spare = 1.0 if self._escapes[i] < 3 else 0.0
        self._team.progress[i] = left, left, 0.0, patience, spare

    def _replan(self) -> None:
        """Plan anew where obstacles have come into the way; where none is left, the stall that follows decides."""
        for i in range(len(self)):
            if self._team.modes[i] != motion.FLYING:
                continue
            corners = np.vstack([self._team.virtual[i, 0:3], self.route(i)])
            keep, router = self.options[i].keep_off, self._routers[i]
            if all(router.line_is_free(a, b, keep) for a, b in itertools.pairwise(corners)):
                continue
            route = self._plan(i, self._team.goals[i, :3], None)
            if route is not None:
                self._follow(i, route)

    def _check_progress(self, i: int) -> None:
        """Let a vehicle that has made no progress try another way, and give up after too many."""
        progress = self._team.progress[i]
        if self._team.modes[i] != motion.FLYING or progress[motion.SINCE] <= progress[motion.PATIENCE]:
            return
        goal = self._team.goals[i, :3]
        left = float(np.linalg.norm(goal - self._team.virtual[i, 0:3]))
        if left < self._closest[i] - 0.5:
            self._closest[i] = left
            self._escapes[i] = 0
        self._escapes[i] += 1
        own, router = self.options[i], self._routers[i]
        blockers = self._blockers(i, parked=False)
        no_room = router.room(goal, own.keep_off, self._blockers(i, parked=True)) < 0.0
        self._occupied[i] = self._occupied[i] + 1 if router.room(goal, own.keep_off, blockers) < 0.0 else 0
        if no_room or self._occupied[i] >= OCCUPIED or self._escapes[i] > own.escapes:
            self._block(i)
            return
        padded = blockers.copy()
        padded[:, 3] *= 1.1 if self._escapes[i] % 2 else 1.0
        route = self._plan(i, goal, padded)
        if route is None or len(route) == 1:
            route = self._sidestep(i, goal, blockers)
        self._follow(i, route)

    def _sidestep(self, i: int, goal: NDArray[np.float64], blockers: NDArray[np.float64]) -> NDArray[np.float64]:
        """Choose a way by a point beside, above or behind, a different one each time."""
        own, router, here = self.options[i], self._routers[i], self._team.virtual[i, 0:3]
        ahead = (goal - here) * np.array([1.0, 1.0, 0.0])
        length = np.linalg.norm(ahead)
        ahead = ahead / length if length > 1e-6 else np.array([1.0, 0.0, 0.0])
        left, up = np.array([-ahead[1], ahead[0], 0.0]), np.array([0.0, 0.0, own.vertical_ratio])
        ways = [left, -left, up, left - ahead, -left - ahead, -ahead, -up]
        turn = i + int(self._escapes[i])
        reach = (1.0 + 0.5 * (turn % 3)) * own.separation
        for k in range(len(ways)):
            point = here + reach * ways[(turn + k) % len(ways)]
            point[2] = min(max(point[2], min(own.floor, here[2])), max(own.ceiling, here[2]))
            if np.linalg.norm(point - here) > 0.5 * reach and router.room(point, own.keep_off, blockers) > 0.0:
                onward = router.route(point, goal, own.keep_off)
                if onward is not None:
                    return np.vstack([point, onward])
        onward = self._plan(i, goal, None)
        return goal[np.newaxis] if onward is None else onward

    def _stopping_point(self, i: int) -> NDArray[np.float64]:
        """Where a vehicle comes to rest if it brakes now, or where it is, if that would be too close to something."""
        own, state = self.options[i], self._team.virtual[i]
        here, velocity = state[0:3].copy(), state[3:6]
        there = here + velocity * (np.linalg.norm(velocity) / (2.0 * own.brake_acceleration))
        free = self._routers[i].line_is_free(here, there, own.keep_off)
        point: NDArray[np.float64] = there if free else here
        return point

    def _block(self, i: int) -> None:
        self._team.modes[i] = motion.BLOCKED
        self._team.goals[i, 3] = self._team.virtual[i, 9]
        self._follow(i, self._stopping_point(i)[np.newaxis])


def _point(name: str, values: Sequence[float] | NDArray[np.float64]) -> NDArray[np.float64]:
    point = np.array(values, dtype=np.float64)
    if point.shape != (3,) or not np.isfinite(point).all():
        raise ArgumentError(f"{name}: expected three finite numbers (metres), got {values!r}")
    return point
