"""Flies a mission: take off, trade and fly until nobody gains, come home and land."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace

from covey.coverage import agent_scores, team_visibility
from covey.errors import ArgumentError, InputError
from covey.flight.layout import P
from covey.flight.obstacles import Obstacle
from covey.geometry import Pose2, Region, wrap_angle
from covey.mission import Mission
from covey.runtime.airspace import check_starts, clear_region, cylinder, passable, without_disc
from covey.runtime.flight import Flight, Moment
from covey.runtime.leg import AT_REST, BELOW_GROUND, Leg
from covey.runtime.plan import PlanRun, separation_cost, software_versions
from covey.runtime.result import Deployment, FlightReport, PlanStatus, Progress
from covey.runtime.watching.feed import Run, Watcher
from covey.runtime.watching.steering import AddObstacle, Kill, Request, Steering
from covey.runtime.watching.telling import MOTION_EVERY, TeamTeller, describe
from covey.runtime.world import build_fleet, not_felt
from covey.vehicles.fleet import CONTROL_PERIOD, Fleet, Kind

SLOWEST, GRACE = 0.25, 20.0
"""A leg may take its length at this speed, m/s, and so many seconds more; then its waypoint counts as unreachable."""


def fly(
    mission: Mission,
    *,
    vehicles: Kind | str = Kind.MUJOCO,
    seed: int | None = None,
    realtime: bool = False,
    on_progress: Callable[[Progress], None] | None = None,
    watch: Watcher | None = None,
    steering: Steering | None = None,
) -> Flight:
    """Fly a mission: the vehicles take off, the agents trade and fly until no trade and no move helps, all land.

    Parameters
    ----------
    mission : Mission
    vehicles : Kind or str
        ``mujoco``, ``reference``, or ``kinematic``, which follows every reference exactly.
    seed : int, optional
        Instead of the mission's.
    realtime : bool
        Let the flight take as long as it would.
    on_progress : callable, optional
        Called with a `Progress` ten times a second at most.
    watch : Watcher, optional
        Called with all there is to see, when it happens: `covey.runtime.watching.feed`.
    steering : Steering, optional
        Lets others pause it, set its speed, let vehicles fail and put obstacles in their way.

    Returns
    -------
    Flight
        After Ctrl-C (KeyboardInterrupt) what had happened by then, with status INTERRUPTED.

    Raises
    ------
    InputError
        If vehicles start too close to each other or to an obstacle, a sensor model cannot be built, or the mission has
        changes.

    Notes
    -----
    Source: Sposato (2016), section 5.1.  Deviation: V6, V8.
    """
    kind = Kind(vehicles)
    if mission.changes:
        raise InputError(
            "changes: expected a mission without; only `covey plan` and `covey launch` act on them; "
            "leave the key out to fly it"
        )
    if seed is not None:
        mission = mission.with_seed(seed)
    check_starts(mission)
    sortie = _Sortie(mission, kind, realtime=realtime, on_progress=on_progress, watch=watch)
    if steering is not None:
        sortie.let_steer(steering)
    return sortie.fly()


class _Sortie:
    """One flight; the `Travel` of its team."""

    def __init__(
        self,
        mission: Mission,
        kind: Kind,
        *,
        realtime: bool,
        on_progress: Callable[[Progress], None] | None,
        watch: Watcher | None,
    ) -> None:
        self._planned = mission
        self._spec = spec = mission.flight
        self._began = time.monotonic()
        self.fleet: Fleet = build_fleet(mission, kind, realtime=realtime)
        self.altitudes = spec.altitudes(len(mission.agents))
        self.run = PlanRun(mission, on_progress, travel=self)
        self._homes = [agent.pose for agent in mission.agents]
        self._obstacles = list(spec.obstacles)
        self._appeared = [0.0] * len(self._obstacles)
        self._faults = list(spec.faults)
        self._deadlines: dict[int, float] = {}  # of the vehicles on their way
        self._held: dict[int, Pose2] = {}  # of those that cannot get there, until the team knows
        self._blind: set[int] = set()
        self._airborne: set[int] = set()
        self._settling = False
        self._reached = self._missed = 0
        self._leg = Leg.TAKE_OFF
        self._stage = "taking off"
        self._moments = [Moment(0.0, self.run.team.owner.copy(), tuple(self.run.team.poses))]
        self._changes = len(self.run.team.history)
        self.fleet.on_sample = self._scores
        self._air_s = 0.0  # of the wall's time: what went into flying, and how much of it while the team traded
        self._air_trading_s = 0.0
        self._flown = math.nan
        self._told_notes = 0
        self._motion_due = 0.0
        self._teller: TeamTeller | None = None
        if watch is not None:
            self._teller = self.run.teller = self._tell(watch)

    def fly(self) -> Flight:
        """Fly from take-off to landing."""
        deployment, flown = None, math.nan
        ignored = not_felt(self._spec, self.fleet.kind)
        if ignored:
            self._note("ignored", [], f"kinematic vehicles do not feel {ignored}: choose other vehicles to try that")
        try:
            self._take_off()
            self._settling = True
            before = self._air_s
            deployment = self.run.deployment()
            self._air_trading_s = self._air_s - before
            self._settling = False
            flown = self._scores()[1]
            if deployment.status is PlanStatus.SETTLED:
                self._come_home()
        except KeyboardInterrupt:
            self._settling = False
            deployment = deployment or self.run.interrupted()
        finally:
            self.fleet.simulator.close()
        for fault in self._faults:
            self._note("fault", [], f"a fault at {fault.at:g} s did not happen: the flight ended before")
        if self._teller is not None:
            self._tell_motion(self._teller)
            self.run.tell_end(deployment)
        report = self._report(flown)
        if deployment.status is PlanStatus.SETTLED:
            with suppress(KeyboardInterrupt):  # nothing of the flight is lost by it
                report = replace(report, separation_cost=self._separation_cost(deployment.score.final))
        return Flight(
            replace(deployment, flight=report, timing_s=self._timing(deployment)),
            self.fleet.log(),
            tuple(self._obstacles),
            tuple(self._appeared),
            tuple(self._moments),
        )

    def let_steer(self, steering: Steering) -> None:
        """From now on do what others ask for."""
        steering.measure(lambda: self.fleet.time, 0.1)
        steering.offer(Kill, AddObstacle)
        self.run.steering = steering

    # Travel

    def go_to(self, agent: int, pose: Pose2) -> None:
        """Send an agent's vehicle to a pose at its altitude."""
        if agent in self.fleet.lost:
            self._held[agent] = self._clipped(agent)
            return
        way = math.hypot(pose.x - self._pose(agent).x, pose.y - self._pose(agent).y)
        turn = abs(wrap_angle(pose.yaw - self.fleet.yaw(agent)))
        self._deadlines[agent] = self.fleet.time + GRACE + way / SLOWEST + turn
        self._send(agent, pose, self.altitudes[agent])

    def make_way(self, agent: int, pose: Pose2) -> None:
        """Let an agent's vehicle leave for a pose at its altitude; nobody waits for its arrival."""
        if agent not in self.fleet.lost:
            self._send(agent, pose, self.altitudes[agent])

    def under_way(self, agent: int) -> bool:
        """Whether an agent's vehicle has not arrived yet, or will not."""
        return agent in self._deadlines or agent in self._held

    def wait(self, agent: int) -> Pose2 | None:
        """Fly until an agent has arrived; return the pose it holds instead if it cannot."""
        while agent in self._deadlines:
            self._tick()
        held = self._held.pop(agent, None)
        if held is not None and agent not in self.fleet.lost:
            held = self.run.team.free(agent, held)
            self._send(agent, held, self.altitudes[agent])
        return held

    # What happens in the air

    def _tick(self) -> None:
        """Let one control period pass, and see to what happened in it."""
        began = time.monotonic()
        self.fleet.step()
        self._air_s += time.monotonic() - began
        now = self.fleet.time
        while self._faults and self._faults[0].at <= now:
            self._fail()
        if self.run.steering is not None:
            for request in self.run.steering.take():
                self._grant(request)
        for agent in list(self._deadlines):
            if self._leg is Leg.LANDING and self.fleet.on_ground(agent):
                self._touch_down(agent)
            elif self._leg is not Leg.LANDING and self.fleet.reached(agent):
                del self._deadlines[agent]
                self._reached += self._leg is Leg.WAYPOINT
                self._airborne.add(agent)
                self._note(self._leg.reached, [agent], f"{self._name(agent)} {self._leg.arrival}")
            elif agent not in self.fleet.lost and (self.fleet.blocked(agent) or now > self._deadlines[agent]):
                self._miss(agent)
        self._see_who_fell()
        if self._teller is not None and now >= self._motion_due:
            self._tell_motion(self._teller)
        self.run.report(self._stage)

    def _see_who_fell(self) -> None:
        for agent in range(self.fleet.n):
            if agent in self.fleet.lost and agent not in self._blind:
                self._blind.add(agent)
                self._deadlines.pop(agent, None)
                self._held[agent] = self._clipped(agent)
                self.run.blind(agent)
            elif self._settling and agent not in self.fleet.lost and self.fleet.on_ground(agent):
                self.fleet.lose(agent, "fell to the ground" if agent in self._airborne else "did not leave the ground")

    def _miss(self, agent: int) -> None:
        """Give a waypoint up (V8): its surroundings are not offered to the agent again."""
        del self._deadlines[agent]
        self._missed += self._leg is Leg.WAYPOINT
        self._note(self._leg.missed, [agent], f"{self._name(agent)} {self._leg.failure}")
        if self._leg is Leg.LANDING:
            return
        held = self._held[agent] = self._clipped(agent)
        if not self._settling:
            return
        abandoned = self.run.team.poses[agent]
        region = self._clear_region(agent, held)
        if region is not None:
            region = passable(region, 0.25 * self.fleet.parameters[agent].required_separation, near=held)
        if region is not None and region.contains(abandoned.x, abandoned.y):
            region = without_disc(
                region, abandoned.x, abandoned.y, 0.5 * self.fleet.parameters[agent].required_separation, near=held
            )
        if region is not None:
            self.run.restrict(agent, region)
            self._held[agent] = self._clipped(agent)

    def _fail(self) -> None:
        """Let the next fault happen."""
        fault = self._faults.pop(0)
        if fault.agent is not None and fault.rotor is not None:
            if self.fleet.kind is Kind.KINEMATIC:
                return
            self.fleet.simulator.fail_motor(fault.agent, fault.rotor)
            self._note("fault", [fault.agent], f"rotor {fault.rotor} of {self._name(fault.agent)} stops")
        elif fault.obstacle is not None:
            self._appear(fault.obstacle)

    def _appear(self, obstacle: Obstacle) -> None:
        self._obstacles.append(obstacle)
        self._appeared.append(self.fleet.time)
        self.fleet.add_obstacle(obstacle)
        if self._teller is not None:
            self._teller.appeared(obstacle)
        self._note("fault", [], "an obstacle appears")
        self._check_waypoints()

    def _grant(self, request: Request) -> None:
        """Do what a visitor asks for, or say why not."""
        match request.command:
            case Kill(agent):
                if not 0 <= agent < self.fleet.n or agent in self.fleet.lost:
                    request.refuse("agent: expected one that still flies")
                else:
                    self.fleet.lose(agent, "was switched off")
            case AddObstacle(x, y, radius, height):
                room = radius + self.fleet.required_separation
                if any(math.hypot(x - row[P], y - row[P + 1]) < room for row in self.fleet.state):
                    request.refuse(f"obstacle: expected {room:.2f} m between its centre and each vehicle")
                    return
                try:
                    self._appear(cylinder(x, y, radius, height))
                except ArgumentError as error:
                    request.refuse(str(error))

    def _check_waypoints(self) -> None:
        """Send those again whose waypoint an obstacle may have taken: they get there, or find that they cannot."""
        for agent, pose in enumerate(self.run.team.poses):
            if self._settling and agent not in self.fleet.lost and agent not in self._deadlines:
                clear = self._clear_region(agent, pose)
                if clear is None or not clear.contains(pose.x, pose.y):
                    self.go_to(agent, pose)

    def _clear_region(self, agent: int, near: Pose2) -> Region | None:
        """Return where an agent's vehicle may be at its altitude, obstacles and the room around them taken away."""
        clearance = 0.5 * self.fleet.parameters[agent].required_separation
        region = self.run.mission.agents[agent].region
        return clear_region(region, self._obstacles, self.altitudes[agent], clearance, near=near)

    # Begin and end

    def _take_off(self) -> None:
        """Rise from the starting positions, all at once: each above its own."""
        for agent, home in enumerate(self._homes):
            self._depart(agent, home, self.altitudes[agent])
        self._note("takeoff", list(range(self.fleet.n)), "take-off")
        while self._deadlines:
            self._tick()
        self._held = {agent: pose for agent, pose in self._held.items() if agent in self.fleet.lost}
        self._leg = Leg.WAYPOINT
        self._stage = "flying"

    def _come_home(self) -> None:
        """Fly back above the starting positions, then sink, all at once."""
        self._stage = "landing"
        if self._teller is not None:
            self._teller.note(self.fleet.time, "landing", range(self.fleet.n), "all fly home and land")
        self._leg = Leg.HOME
        for agent in self._flying():
            self._depart(agent, self._homes[agent], self.altitudes[agent])
        while self._deadlines:
            self._tick()
        self._leg = Leg.LANDING
        for agent in self._flying():
            self._depart(agent, self._held.get(agent, self._homes[agent]), -BELOW_GROUND)
        while self._deadlines:
            self._tick()
        self.fleet.run(lambda: False, AT_REST)

    def _flying(self) -> list[int]:
        return [agent for agent in range(self.fleet.n) if agent not in self.fleet.lost]

    def _touch_down(self, agent: int) -> None:
        """Stop the motors of a vehicle that touches the ground."""
        del self._deadlines[agent]
        self.fleet.stop_motors(agent)
        self._note(self._leg.reached, [agent], f"{self._name(agent)} {self._leg.arrival}")

    def _depart(self, agent: int, pose: Pose2, altitude: float) -> None:
        climb = abs(altitude - float(self.fleet.state[agent, P + 2]))
        way = math.hypot(pose.x - self._pose(agent).x, pose.y - self._pose(agent).y)
        self._deadlines[agent] = self.fleet.time + GRACE + (way + climb) / SLOWEST
        self._send(agent, pose, altitude)

    def _send(self, agent: int, pose: Pose2, altitude: float) -> None:
        self.fleet.go_to(agent, (pose.x, pose.y, altitude), pose.yaw)

    # What is known

    def _pose(self, agent: int) -> Pose2:
        x, y = (float(value) for value in self.fleet.state[agent, P : P + 2])
        return Pose2(x, y, self.fleet.yaw(agent))

    def _clipped(self, agent: int) -> Pose2:
        """Return where a vehicle is, or the nearest pose in its agent's region."""
        pose = self._pose(agent)
        x, y = self.run.mission.agents[agent].region.project(pose.x, pose.y)
        return Pose2(x, y, pose.yaw)

    def _name(self, agent: int) -> str:
        return self.run.mission.agents[agent].name

    def _note(self, kind: str, agents: list[int], text: str) -> None:
        self.fleet.recorder.note(self.fleet.time, kind, agents, text)

    def _scores(self) -> tuple[float, float]:
        """Return the committed score and the one from the true poses."""
        team, landmarks = self.run.team, self.run.mission.landmarks
        if len(team.history) > self._changes:
            for entry in team.history[self._changes :]:
                if entry.event == "trade":
                    agents = [self.fleet.recorder.names.index(name) for name in entry.agents]
                    self._note("trade", agents, f"{' and '.join(entry.agents)} trade: {entry.score:.2f}")
            self._changes = len(team.history)
            self._moments.append(Moment(self.fleet.time, team.owner.copy(), tuple(team.poses)))
        poses = [self._pose(agent) for agent in range(self.fleet.n)]
        seen = team_visibility(self.run.models, poses, landmarks)
        self._flown = float(agent_scores(seen, team.owner, landmarks.weights).sum())
        return team.score, self._flown

    def _tell(self, watch: Watcher) -> TeamTeller:
        fleet, run = self.fleet, self.run
        scene = describe(
            run.mission,
            run.models,
            run=Run.FLIGHT,
            software=software_versions(),
            body_radius=max(vehicle.body_radius for vehicle in fleet.parameters),
            required_separation=fleet.required_separation,
        )
        return TeamTeller(watch, run.team, scene, clock=lambda: fleet.time, altitudes=self.altitudes)

    def _tell_motion(self, teller: TeamTeller) -> None:
        """Tell what happened since the last time, and where everybody is."""
        fleet = self.fleet
        self._motion_due = fleet.time + MOTION_EVERY - 0.5 * CONTROL_PERIOD
        for event in fleet.recorder.events[self._told_notes :]:
            if event.kind != "trade":  # the team tells of those
                teller.note(
                    fleet.time, event.kind, [fleet.recorder.names.index(name) for name in event.vehicles], event.text
                )
        self._told_notes = len(fleet.recorder.events)
        teller.motion(
            fleet.state,
            objects_W=fleet.objects_W,
            score_flown=self._flown,
            separation=fleet.separation,
            battery=fleet.battery,
        )

    def _report(self, flown: float) -> FlightReport:
        fleet = self.fleet
        log = fleet.recorder
        return FlightReport(
            simulator=fleet.kind.value,
            vehicle=fleet.parameters[0].name,
            duration=fleet.time,
            wall=time.monotonic() - self._began,
            min_separation=fleet.min_separation,
            required_separation=fleet.required_separation,
            altitudes=self.altitudes,
            separation_cost=math.nan,
            max_outside_region=fleet.max_outside_region,
            collisions=len(fleet.simulator.collisions),
            tracking_rms=fleet.tracking_rms,
            waypoints_reached=self._reached,
            waypoints_missed=self._missed,
            score_flown=flown,
            lost=tuple(self._name(agent) for agent in sorted(fleet.lost)),
            events=tuple(log.events),
        )

    def _timing(self, deployment: Deployment) -> dict[str, float]:
        """Return what the wall's time went into, seconds: flying is told apart from the trading that it serves."""
        timing = {name: seconds for name, seconds in deployment.timing_s.items() if name != "total"}
        if "trading" in timing:
            timing["trading"] = max(0.0, timing["trading"] - self._air_trading_s)
        timing["flying"] = self._air_s
        return {**timing, "total": time.monotonic() - self._began}

    def _separation_cost(self, final: float) -> float:
        self.run.report("comparing", force=True)
        return separation_cost(self._planned, None if self._missed or self.fleet.lost else final)
