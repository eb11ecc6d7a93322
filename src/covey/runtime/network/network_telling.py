"""Tells a watcher of a team on the network, as an `Observer` hears it."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from covey.flight.arrival import arrived
from covey.flight.layout import OBSERVATION, OMEGA, QUAT, P, V
from covey.flight.parameters import load_vehicle
from covey.protocol import AgentBuried, Heartbeat, LandmarksAdopted, OfferStands, Sender, TradeCommitted
from covey.runtime.network.observer import Heard, Observer
from covey.runtime.plan import software_versions
from covey.runtime.watching.feed import (
    NOBODY,
    Activity,
    Ended,
    Health,
    Motion,
    Run,
    Scene,
    TeamState,
    Trading,
    Watcher,
    Weights,
)
from covey.runtime.watching.telling import HEALTH_EVERY, KINDS, Teller, change_text, describe, planar, pose_rows
from covey.transports.telemetry import Telemetry

REPORTED_EVERY = 0.1
"""Seconds between two `Motion`s, at least: as often as an agent reports."""

SILENT = 0.5
"""Part of the time until an agent counts as dead after which it is suspect."""


class NetworkTeller(Teller):
    """Tells of a team that an observer watches.

    Parameters
    ----------
    watch : Watcher
    observer : Observer
        It calls `hear`; call `update` as well when nothing is heard, so that silence is seen.
    dead_after : float
        Seconds of silence after which an agent counts as dead.
    """

    def __init__(self, watch: Watcher, observer: Observer, *, dead_after: float) -> None:
        team = observer.team
        self._observer = observer
        self._flies = False  # whether any vehicle has been heard of
        super().__init__(watch, self._describe())
        self._dead_after = dead_after
        self._heard = np.empty(0)
        self._quiescent = np.empty(0, dtype=np.bool_)
        self._reported = np.empty(0)  # when each vehicle was heard of last; NaN: never
        self._vehicles = np.empty((0, OBSERVATION))
        self._battery = np.empty(0)
        self._altitudes = np.empty(0)
        self._lives = np.empty(0, dtype=np.int64)
        self._has_moved = False
        self._told_fresh = np.empty(0, dtype=np.bool_)  # whose vehicles told their places when that was told last
        self._motion_due = -math.inf
        self._newest = 0.0  # when anything was heard last
        self._is_ending = False
        self._catalogue = team.planner.catalogue
        self._entries = len(team.history)
        self._moved: dict[str, deque[int]] = {"trade": deque(), "adoption": deque()}  # landmarks, by event
        self._offers: dict[int, OfferStands] = {}  # by server
        self._healthy_at = -math.inf
        self._begin()
        observer.subscribe(self.hear)

    def _describe(self) -> Scene:
        team = self._observer.team
        mission = replace(
            team.first_mission, landmarks=team.planner.landmarks, agents=tuple(team.planner.agents), changes=()
        )
        vehicle = load_vehicle(mission.flight.vehicle) if self._flies else None
        return describe(
            mission,
            team.planner.models,
            run=Run.NETWORK,
            software=software_versions(),
            body_radius=0.0 if vehicle is None else vehicle.body_radius,
            required_separation=0.0 if vehicle is None else vehicle.required_separation,
        )

    def _begin(self) -> None:
        """Tell the scene, at the start and when it changes, and the state."""
        self._names = self._observer.team.names
        more = len(self._names) - len(self._heard)
        self._heard = np.append(self._heard, np.full(more, np.nan))
        self._quiescent = np.append(self._quiescent, np.zeros(more, dtype=np.bool_))
        self._reported = np.append(self._reported, np.full(more, np.nan))
        self._vehicles = np.append(self._vehicles, np.full((more, OBSERVATION), np.nan), axis=0)
        self._battery = np.append(self._battery, np.full(more, np.nan))
        self._lives = np.append(self._lives, np.full(more, -1))
        self._told_fresh = np.append(self._told_fresh, np.zeros(more, dtype=np.bool_))
        count, flight = len(self._names), self._observer.team.first_mission.flight
        self._altitudes = np.array(flight.altitudes(count)) if self._flies else np.zeros(count)
        self.tell(self.scene)
        self.state(self._state())

    def _look_for_changes(self) -> None:
        """Tell of landmarks and agents that are others, if there are any."""
        planner = self._observer.team.planner
        if planner.catalogue is self._catalogue:
            return
        self._catalogue = planner.catalogue
        if len(planner.agents) > len(self._names) or len(planner.landmarks) > len(self.view.weights):
            self.scene = self._describe()
            self._begin()
        else:
            changed = np.flatnonzero(planner.weights != self.view.weights)
            if len(changed):
                self.tell(Weights(self._observer.time, changed.astype(np.int32), planner.weights[changed].copy()))

    def hear(self, item: Heard) -> None:
        """Take in what the observer heard."""
        self._newest = item.time
        if isinstance(item.content, Telemetry):
            self._look_for_changes()
            self._take_report(item.time, item.content)
            return
        if isinstance(item.content, Heartbeat):
            agent = item.content.sender.agent
            if agent >= len(self._heard):
                return  # of whom nothing is known yet
            self._note_life(item.content.sender)
            self._heard[agent] = item.time
            self._quiescent[agent] = item.content.quiescent
        elif isinstance(item.content, OfferStands):
            self._tell_trading(item.time, item.content)
        elif isinstance(item.content, AgentBuried):
            self._close(item.time, item.content.dead)
        elif isinstance(item.content, TradeCommitted):
            self._moved["trade"].append(item.content.moved)
        elif isinstance(item.content, LandmarksAdopted):
            self._moved["adoption"].append(len(item.content.records.indices))
        self._tell_history(as_heard=True)
        self._tell_health()

    def _take_report(self, time: float, telemetry: Telemetry) -> None:
        """Note where a vehicle is; `update` tells the rest."""
        agent = telemetry.sender.agent
        if agent >= len(self._reported) or telemetry.sender.incarnation < self._lives[agent]:
            return  # of whom nothing is known yet, or who is no more
        self._note_life(telemetry.sender)
        self._reported[agent] = time
        self._vehicles[agent] = telemetry.state
        self._battery[agent] = telemetry.battery
        self._has_moved = True
        if not self._flies:  # from now on there are obstacles, and waypoints are at their altitudes
            self._flies = True
            self.scene = self._describe()
            self._begin()
        self._tell_motion()

    def _note_life(self, sender: Sender) -> None:
        """Forget the vehicle of an agent's life that is over: the next may have none."""
        agent = sender.agent
        if sender.incarnation > self._lives[agent]:
            self._lives[agent] = sender.incarnation
            self._has_moved |= not np.isnan(self._reported[agent])
            self._reported[agent] = self._battery[agent] = np.nan
            self._vehicles[agent] = np.nan

    @property
    def _now(self) -> float:
        """The moment for which the state is told: at the end that of the last word, for who leaves is not silent."""
        return self._newest if self._is_ending else self._observer.time

    def _tell_motion(self, *, at_once: bool = False) -> None:
        """Tell where the vehicles are, if that is news; who has none, or does not tell, is at its committed pose."""
        now, fresh = self._observer.time, self._fresh()
        is_news = self._has_moved or not np.array_equal(fresh, self._told_fresh)
        if not is_news or (now < self._motion_due and not at_once):
            return
        self._has_moved, self._told_fresh, self._motion_due = False, fresh, now + REPORTED_EVERY
        known = ~np.isnan(self._reported)
        poses = self._poses()
        poses[known] = np.hstack([self._vehicles[known, P : P + 3], self._vehicles[known, QUAT : QUAT + 4]])
        velocities, rates = self._vehicles[:, V : V + 3].copy(), self._vehicles[:, OMEGA : OMEGA + 3].copy()
        velocities[~fresh] = rates[~fresh] = np.nan
        # of no moment are all positions known, and a separation between those of different moments would be none
        self.tell(Motion(now, poses, velocities, rates, np.empty((0, 3)), self._score_flown(poses), math.nan))

    def _fresh(self) -> NDArray[np.bool_]:
        """Return whose vehicles are known to be where they were reported, shape (m,)."""
        return np.asarray(self._now - self._reported <= SILENT * self._dead_after)

    def _score_flown(self, poses: NDArray[np.float64]) -> float:
        """Return the team's score from where the vehicles are; NaN while one of those that watch does not tell."""
        team = self._observer.team
        watching = [agent for agent in np.unique(team.owner).tolist() if agent != NOBODY and agent not in team.dead]
        if not self._fresh()[watching].all():
            return math.nan
        return sum(team.score_from(agent, planar(poses[agent])) for agent in watching)

    def _tell_trading(self, time: float, offer: OfferStands) -> None:
        """Tell that landmarks are being traded, or are so no more."""
        if not self._observer.team.knows(offer):
            return
        standing = self._offers.get(offer.server)
        if standing is not None and (offer.stands or offer.trade == standing.trade):
            self._close(time, offer.server)  # of an agent in a new life nobody says that its old offer is closed
        if offer.stands:
            self._offers[offer.server] = offer
            self.tell(self._trading(time, offer, stands=True))

    def _close(self, time: float, server: int) -> None:
        offer = self._offers.pop(server, None)
        if offer is not None:
            self.tell(self._trading(time, offer, stands=False))

    @staticmethod
    def _trading(time: float, offer: OfferStands, *, stands: bool) -> Trading:
        give, want = offer.give.astype(np.int32), offer.want.astype(np.int32)
        return Trading(time, offer.client, offer.server, give, want, stands)

    def update(self) -> None:
        """Tell what is new, also when nothing was heard."""
        team = self._observer.team
        self._tell_history(as_heard=False)
        if not np.array_equal(team.owner, self.view.owner) or not np.array_equal(self._poses(), self.view.poses):
            self.state(self._state())  # what the team agreed on is not quite what events told
        self._tell_motion()
        self._tell_health()

    def _tell_history(self, *, as_heard: bool) -> None:
        """Tell new entries of the history; what is heard together is in it before any of it is heard here."""
        now, team = self._observer.time, self._observer.team
        self._look_for_changes()
        while self._entries < len(team.history):
            entry = team.history[self._entries]
            counts = self._moved.get(entry.event)
            if as_heard and counts is not None and not counts:
                return
            self._entries += 1
            if entry.event in KINDS:
                agents = tuple(self._names.index(name) for name in entry.agents)
                if entry.detail:
                    text = f"{entry.detail} {entry.event}; score {entry.score:.2f}"
                else:
                    text = change_text(entry.event, entry.agents, counts.popleft() if counts else 0, entry.score)
                self.change(
                    now, KINDS[entry.event], agents, team.owner, self._poses(), self._scores(), text, entry.score
                )
        for counts in self._moved.values():
            counts.clear()

    def _tell_health(self) -> None:
        now, activity = self._observer.time, self._activity()
        if now - self._healthy_at >= HEALTH_EVERY or not np.array_equal(activity, self.view.activity):
            self._healthy_at = now
            unknown = np.full(len(self._names), np.nan)
            self.tell(Health(now, activity, self._battery.copy(), unknown, self._heard.copy()))

    def end(self, status: str, holds: bool | None) -> None:
        """Tell the last state, and that the mission is over."""
        self._is_ending = True
        self.update()
        self._tell_motion(at_once=True)
        for server in list(self._offers):
            self._close(self._observer.time, server)
        self.state(self._state())
        self._is_ending = False
        self.tell(Ended(self._observer.time, status, holds, float(self._scores().sum())))

    def _activity(self) -> NDArray[np.uint8]:
        silence = self._now - self._heard
        activity = np.where(self._quiescent, Activity.QUIESCENT, Activity.IDLE).astype(np.uint8)
        activity[self._under_way()] = Activity.FLYING
        activity[silence > SILENT * self._dead_after] = Activity.SUSPECT
        activity[silence > self._dead_after] = Activity.DEAD
        activity[list(self._observer.team.dead)] = Activity.DEAD
        activity[np.isnan(self._heard)] = Activity.GONE
        activity[list(self._observer.team.gone)] = Activity.GONE
        return activity

    def _under_way(self) -> NDArray[np.bool_]:
        """Return whose vehicles are known to be elsewhere than at their waypoints, shape (m,)."""
        if not self._flies:
            return np.zeros(len(self._names), dtype=np.bool_)
        flight, rows = self._observer.team.first_mission.flight, self._vehicles
        poses = self._observer.team.poses
        goals = [(pose.x, pose.y, z, pose.yaw) for pose, z in zip(poses, rows[:, P + 2].tolist(), strict=True)]
        there = np.zeros(len(rows), dtype=np.bool_)
        arrived(rows, np.array(goals), flight.arrival_position, flight.arrival_yaw, math.inf, there)
        return self._fresh() & ~self._quiescent & ~there

    def _poses(self) -> NDArray[np.float64]:
        return pose_rows(self._observer.team.poses, self._altitudes)

    def _scores(self) -> NDArray[np.float64]:
        scores = self._observer.team.scores.copy()
        scores[list(self._observer.team.dead)] = 0.0
        return scores

    def _state(self) -> TeamState:
        team = self._observer.team
        return TeamState(
            self._observer.time,
            team.owner.astype(np.int32),
            self._poses(),
            self._scores(),
            team.planner.weights.copy(),
            self._activity(),
            np.empty(0, dtype=np.int32),
            team.trades,
            self.view.bound,
        )
