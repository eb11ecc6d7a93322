"""What is on the topics of a record besides covey's own types: the standard ones, which other tools draw and plot."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from covey.runtime.records import ros_types as ros
from covey.runtime.watching.feed import (
    NOBODY,
    BoundFound,
    Health,
    Motion,
    Note,
    ObstacleAppeared,
    Run,
    Scene,
    SceneObstacle,
    TeamChange,
    TeamState,
    Trading,
    Update,
)
from covey.runtime.watching.view import TeamView

FRAME = "map"
"""The name of frame W: REP 105."""

MANY = 5000
"""With more landmarks than these the cells are written with each `TeamState` only, not after every change."""

BATTERY_EVERY = 1.0
"""Seconds between two messages of a battery, at least."""

ODOMETRY_EVERY = 0.1
"""Seconds between two odometries of a vehicle, and two transforms; `Motion`s are written as often as they come."""

HOVER_EVERY, HOVERING = 1.0, 0.1
"""The same of a vehicle that hovers: with velocities, m/s, and body rates, rad/s, below this."""

GREY, WHITE, INK = "#bdbdbd", "#ffffff", "#1f2328"

Put: TypeAlias = Callable[[str, str, bytes, bool], None]
"""Takes topic, type, message, and whether who comes later wants the last message too."""


def topic_names(names: Sequence[str]) -> list[str]:
    """Return what agents are called in topics and frames, all different.

    Examples
    --------
    >>> topic_names(["blue", "north gate", "north-gate", "1"])
    ['blue', 'north_gate', 'north_gate_2', 'agent_1']
    """
    used: set[str] = set()
    result = []
    for name in names:
        clean = re.sub(r"[^A-Za-z0-9]+", "_", name).strip("_") or "agent"
        clean = f"agent_{clean}" if clean[0].isdigit() else clean
        number, tried = 2, clean
        while tried in used:
            tried, number = f"{clean}_{number}", number + 1
        used.add(tried)
        result.append(tried)
    return result


class StandardTopics:
    """Writes what follows from a feed in standard types.

    Parameters
    ----------
    put : Put
        Takes the messages.
    """

    def __init__(self, put: Put) -> None:
        self._put = put
        self._view = TeamView()
        self._names: list[str] = []
        self._odometry: list[ros.OdometryMessage] = []
        self._transforms = ros.TransformsMessage(FRAME, [])
        self._posed = np.empty((0, 7))
        self._hover_due = np.empty(0)
        self._flown = self._separation = math.nan
        self._odometry_due = self._batteries_due = -math.inf

    def write(self, item: Scene | Update, now: int) -> None:
        """Write what an item changes; `now` in nanoseconds."""
        self._view.apply(item)
        match item:
            case Motion():
                self._motion(item, now)
            case Scene():
                self._begin(item, now)
            case TeamState():
                self._poses(range(len(self._names)), now)
                self._agents(now)
                self._cells(now)
                self._offered(now)
                self._number("/covey/score", self._view.score)
            case TeamChange():
                self._poses(item.posed, now)
                if item.posed:
                    self._agents(now)
                if len(item.landmarks) and len(self._view.owner) <= MANY:
                    self._cells(now)
                self._number("/covey/score", item.score)
                self._say(now, ros.INFO, item.kind.value, item.text)
            case Trading():
                self._offered(now)
            case Health():
                self._batteries(item, now)
            case BoundFound():
                self._number("/covey/bound", item.bound, latched=True)
            case Note():
                bad = item.kind in ("missed", "lost", "collision", "fault")
                self._say(now, ros.WARN if bad else ros.INFO, item.kind, item.text)
            case ObstacleAppeared():
                self._obstacles(now)
            case _:
                pass

    def _begin(self, scene: Scene, now: int) -> None:
        self._names = topic_names([agent.name for agent in scene.agents])
        self._odometry = [ros.OdometryMessage(FRAME, name) for name in self._names]
        self._transforms = ros.TransformsMessage(FRAME, self._names)
        self._posed = np.full((len(self._names), 7), np.nan)
        self._hover_due = np.full(len(self._names), -math.inf)
        if self._view.obstacles:
            self._obstacles(now)
        size = scene.body_radius or 0.5 * _cell(scene)
        bodies = [
            ros.Marker(
                "bodies", index, ros.ARROW, frame=name, scale=(3.0 * size, size, size), colour=agent.colour,
                frame_locked=True,
            )
            for index, (name, agent) in enumerate(zip(self._names, scene.agents, strict=True))
        ]  # fmt: skip
        self._markers("/covey/vehicles", now, bodies)

    def _motion(self, motion: Motion, now: int) -> None:
        if motion.time < self._odometry_due:
            return
        self._odometry_due = motion.time + 0.9 * ODOMETRY_EVERY
        poses = motion.poses.tolist()
        self._put("/tf", ros.TRANSFORMS, self._transforms.pack(now, poses), False)
        velocities_B = into_body(motion.poses[:, 3:], motion.velocities_W)
        twists = np.concatenate([velocities_B, motion.rates_B], axis=1)
        hover = (np.abs(twists) < HOVERING).all(axis=1) & (motion.time < self._hover_due)
        self._hover_due[~hover] = motion.time + 0.9 * HOVER_EVERY
        for agent, twist in zip(np.flatnonzero(~hover).tolist(), twists[~hover].tolist(), strict=True):
            data = self._odometry[agent].pack(now, poses[agent], twist)
            self._put(f"/covey/{self._names[agent]}/odometry", ros.ODOMETRY, data, False)
        if motion.score_flown != self._flown and math.isfinite(motion.score_flown):
            self._flown = motion.score_flown
            self._number("/covey/score_flown", motion.score_flown)
        if motion.separation != self._separation and math.isfinite(motion.separation):
            self._separation = motion.separation
            self._number("/covey/separation", motion.separation)

    def _batteries(self, health: Health, now: int) -> None:
        if health.time < self._batteries_due:
            return
        self._batteries_due = health.time + 0.9 * BATTERY_EVERY
        for name, share in zip(self._names, health.battery.tolist(), strict=True):
            if math.isfinite(share):
                self._put(f"/covey/{name}/battery", ros.BATTERY, ros.battery_state(now, name, share), False)

    def _poses(self, agents: Sequence[int], now: int) -> None:
        """Write the waypoints that are new, and where agents are that do not fly."""
        poses = self._view.poses
        moved = [agent for agent in agents if not np.array_equal(poses[agent], self._posed[agent])]
        for agent in moved:
            message = ros.pose_stamped(now, FRAME, poses[agent].tolist())
            self._put(f"/covey/{self._names[agent]}/waypoint", ros.POSE_STAMPED, message, True)
            self._posed[agent] = poses[agent]
        scene = self._view.scene
        if moved and self._view.motion is None and scene is not None and scene.run is not Run.FLIGHT:
            self._put("/tf", ros.TRANSFORMS, self._transforms.pack(now, poses.tolist()), False)

    def _agents(self, now: int) -> None:
        """Draw the committed poses, with the agents' names."""
        scene, markers = self._scene, list[ros.Marker]()
        size = _cell(scene)
        for index, (agent, pose) in enumerate(zip(scene.agents, self._view.poses.tolist(), strict=True)):
            markers.append(
                ros.Marker(
                    "waypoints", index, ros.ARROW, frame=FRAME, pose=pose, scale=(2.0 * size, 0.4 * size, 0.4 * size),
                    colour=INK,
                )
            )  # fmt: skip
            above = [pose[0], pose[1], pose[2] + size, *pose[3:]]
            markers.append(
                ros.Marker(
                    "names", index, ros.TEXT_VIEW_FACING, frame=FRAME, pose=above, scale=(size, size, size),
                    colour=agent.colour, text=agent.name,
                )
            )  # fmt: skip
        self._markers("/covey/agents", now, markers)

    def _cells(self, now: int) -> None:
        """Draw the landmarks as cells in their owners' colours."""
        scene, owner, size = self._scene, self._view.owner, _cell(self._scene)
        markers = [ros.Marker("landmarks", 0, action=ros.DELETEALL, frame=FRAME)]
        for number in (NOBODY, *range(len(scene.agents))):
            points = scene.positions_W[(owner == number) & (self._view.weights > 0.0)]
            if len(points):
                colour = GREY if number == NOBODY else scene.agents[number].colour
                scale = (0.94 * size, 0.94 * size, 0.02 * size)
                markers.append(ros.Marker("landmarks", number, frame=FRAME, scale=scale, colour=colour, points=points))
        self._markers("/covey/landmarks", now, markers)

    def _offered(self, now: int) -> None:
        """Draw the landmarks white that are offered in a trade."""
        scene, size = self._scene, _cell(self._scene)
        markers = [ros.Marker("offered", 0, action=ros.DELETEALL, frame=FRAME)]
        if self._view.trading.any():
            points = scene.positions_W[self._view.trading]
            scale = (0.94 * size, 0.94 * size, 0.04 * size)
            markers.append(ros.Marker("offered", 0, frame=FRAME, scale=scale, colour=WHITE, points=points))
        self._markers("/covey/offered", now, markers)

    def _obstacles(self, now: int) -> None:
        markers = [
            ros.Marker(
                "obstacles", index, ros.LINE_LIST, frame=FRAME, scale=(0.03, 0.0, 0.0), colour=GREY,
                points=edges(obstacle),
            )
            for index, obstacle in enumerate(self._view.obstacles)
        ]  # fmt: skip
        self._markers("/covey/obstacles", now, markers)

    @property
    def _scene(self) -> Scene:
        assert self._view.scene is not None
        return self._view.scene

    def _markers(self, topic: str, now: int, markers: Sequence[ros.Marker]) -> None:
        self._put(topic, ros.MARKERS, ros.marker_array(now, markers), True)

    def _number(self, topic: str, value: float, *, latched: bool = False) -> None:
        self._put(topic, ros.FLOAT64, ros.float64(value), latched)

    def _say(self, now: int, level: int, name: str, text: str) -> None:
        self._put("/rosout", ros.LOG, ros.log_line(now, level, name, text), False)


def into_body(quat_wxyz: NDArray[np.float64], vectors_W: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return vectors of frame W, shape (m, 3), in the frames B of bodies with these attitudes, shape (m, 4)."""
    w, x, y, z = (quat_wxyz * (1.0, -1.0, -1.0, -1.0)).T
    u, v, t = vectors_W.T
    a, b, c = 2.0 * (y * t - z * v), 2.0 * (z * u - x * t), 2.0 * (x * v - y * u)
    return np.column_stack([u + w * a + y * c - z * b, v + w * b + z * a - x * c, t + w * c + x * b - y * a])


def edges(obstacle: SceneObstacle) -> NDArray[np.float64]:
    """Return the edges of an obstacle, seen as a prism, as pairs of points, shape (2 k, 3)."""
    ring = obstacle.outline
    low, high = (np.column_stack([ring, np.full(len(ring), z)]) for z in (obstacle.z_min, obstacle.z_max))
    pairs = [(corners, np.roll(corners, -1, axis=0)) for corners in (low, high)] + [(low, high)]
    return np.concatenate([np.stack(pair, axis=1).reshape(-1, 3) for pair in pairs])


def _cell(scene: Scene) -> float:
    """Side of a landmark's cell, metres; where it has none, what looks well."""
    if math.isfinite(scene.cell_size):
        return scene.cell_size
    extent = np.ptp(scene.region[0], axis=0)
    return 0.02 * float(extent.max())
