"""The simulated vehicle of an agent in a process of its own, in real time."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from covey.flight.layout import OBSERVATION, OMEGA, P, V
from covey.geometry import Pose2, wrap_angle
from covey.mission import Mission
from covey.runtime.fly import GRACE, SLOWEST
from covey.runtime.network.remote_vehicle import Leg
from covey.runtime.world import build_fleet
from covey.vehicles.fleet import CONTROL_PERIOD, Kind

AT_A_TIME = 20
"""Control periods that are simulated in a row before the agent looks at its messages again."""

BEHIND = 1.0
"""A simulation that is further behind the clock than this, seconds, goes on slower than real time."""

NEVER = 1e9
"""Seconds between two rows of a log that nobody reads."""


class SimulatedVehicle:
    """One vehicle in a simulator of its own, already in the air at its agent's altitude.

    Parameters
    ----------
    mission : Mission
    agent : int
    kind : Kind
    pose : Pose2
        Where it begins.
    now : float
        Seconds.

    Notes
    -----
    It sees the mission's obstacles and no other vehicle: agents in processes of their own keep apart by their altitudes
    alone.  Faults of the mission do not happen.
    """

    def __init__(self, mission: Mission, agent: int, kind: Kind, pose: Pose2, now: float) -> None:
        specification = mission.agents[agent]
        self._region = specification.region
        self._altitude = mission.flight.altitudes(len(mission.agents))[agent]
        alone = replace(mission, agents=(replace(specification, pose=pose),))
        self._fleet = fleet = build_fleet(alone, kind, log_every=NEVER)
        half = 0.5 * pose.yaw
        fleet.simulator.set_state(
            0, (pose.x, pose.y, self._altitude), quat_wxyz=(math.cos(half), 0.0, 0.0, math.sin(half))
        )
        fleet.state = fleet.simulator.state
        self._resting = False
        self._deadline = math.inf
        self._began = now
        self._send(pose)

    @property
    def pose(self) -> Pose2:
        """Where it is, frame W."""
        x, y = (float(value) for value in self._fleet.state[0, P : P + 2])
        return Pose2(x, y, wrap_angle(self._fleet.yaw(0)))

    @property
    def state(self) -> NDArray[np.float64]:
        """How it moves, shape (13,), columns of an observation in `covey.flight.layout`."""
        state = self._fleet.state[0, :OBSERVATION].copy()
        if self._resting:
            state[V : V + 3] = state[OMEGA : OMEGA + 3] = 0.0
        return state

    @property
    def battery(self) -> float:
        """Share that is left of its battery, which was full at the start; NaN where unknown."""
        return float(self._fleet.battery[0])

    def go_to(self, now: float, pose: Pose2) -> None:
        """Fly to a waypoint at the agent's altitude."""
        here = self.pose
        if self._resting:
            self._began = now - self._fleet.time
        way = math.hypot(pose.x - here.x, pose.y - here.y)
        turn = abs(wrap_angle(pose.yaw - here.yaw))
        self._deadline = self._fleet.time + GRACE + way / SLOWEST + turn
        self._send(pose)

    def advance(self, now: float) -> Leg:
        """Simulate up to now."""
        fleet = self._fleet
        self._began = max(self._began, now - fleet.time - BEHIND)
        for _ in range(AT_A_TIME):
            if self._resting or fleet.time >= now - self._began:
                break
            fleet.step()
        if fleet.reached(0):
            self._resting = fleet.kind is Kind.KINEMATIC  # nothing moves it any more
            return Leg.ARRIVED
        stuck = fleet.blocked(0) or fleet.time > self._deadline
        return Leg.STUCK if stuck else Leg.UNDER_WAY

    def hold(self) -> Pose2:
        """Stay at the nearest pose in the agent's region."""
        here = self.pose
        x, y = self._region.project(here.x, here.y)
        held = Pose2(float(x), float(y), here.yaw)
        self._deadline = math.inf
        self._send(held)
        return held

    def due(self, now: float) -> float | None:
        """Return when the next control period begins."""
        return None if self._resting else max(now, self._began + self._fleet.time + CONTROL_PERIOD)

    def _send(self, pose: Pose2) -> None:
        self._resting = False
        self._fleet.go_to(0, (pose.x, pose.y, self._altitude), pose.yaw)
