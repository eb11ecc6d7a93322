"""When a run tells its watcher what: hooks where the state of a team or a flight changes."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import PurePath

import numpy as np
from numpy.typing import NDArray

from covey.flight.layout import OMEGA, QUAT, P, V
from covey.flight.obstacles import Box, Obstacle, Sphere
from covey.flight.rotation import yaw_of
from covey.geometry import Pose2, Region
from covey.mission import Mission
from covey.protocol import Lock, Node, Offer, TradeId
from covey.runtime.drawing.palette import colours
from covey.runtime.team import Team
from covey.runtime.watching.feed import (
    POSE,
    Activity,
    BoundFound,
    ChangeKind,
    Ended,
    Health,
    Motion,
    Note,
    ObstacleAppeared,
    Run,
    Scene,
    SceneAgent,
    SceneObstacle,
    TeamChange,
    TeamState,
    Trading,
    Update,
    Watcher,
    Weights,
)
from covey.runtime.watching.view import TeamView
from covey.sensing import VisibilityModel

KEYFRAME_EVERY = 256
KEYFRAME_SECONDS = 10.0
"""After so many updates of the committed state, or seconds of a flight, the whole of it is told again."""

MOTION_EVERY = 0.05
"""Seconds between two `Motion`s of a flight."""

LOOK_EVERY = 0.2
"""Seconds of a flight between two looks at what the agents are doing."""

HEALTH_EVERY = 1.0
"""Seconds between two `Health`s while nobody's activity changes."""

KINDS = {
    "optimization": ChangeKind.OPTIMIZATION,
    "trade": ChangeKind.TRADE,
    "proof": ChangeKind.PROOF,
    "abandoned": ChangeKind.ABANDONED,
    "lost": ChangeKind.DEATH,
    "adoption": ChangeKind.ADOPTION,
    "death": ChangeKind.DEATH,
    "return": ChangeKind.RETURN,
    "agreed": ChangeKind.ADOPTION,
    "added": ChangeKind.LANDMARKS,
    "removed": ChangeKind.LANDMARKS,
    "reweighted": ChangeKind.LANDMARKS,
    "joined": ChangeKind.JOINED,
    "left": ChangeKind.LEFT,
}
"""Events of the history as watchers know them."""

_TEXTS = {
    "optimization": "{who} found a better pose",
    "trade": "{who} trade: {moved} and their poses",
    "proof": "the proof found {who} a better pose",
    "abandoned": "{who} cannot reach its waypoint and holds another pose",
    "lost": "{who} does not fly any more",
    "adoption": "{who} adopts {moved}",
    "death": "{who} is dead",
    "return": "{who} is back",
    "agreed": "all agree on {moved} that several had adopted",
}


class Teller:
    """Tells a watcher what changes, once; it remembers what was told.

    Parameters
    ----------
    watch : Watcher
    scene : Scene
        Told with the first state.

    Attributes
    ----------
    view : TeamView
        What whoever watches knows by now.
    """

    def __init__(self, watch: Watcher, scene: Scene) -> None:
        self._watch = watch
        self.scene = scene
        self.view = TeamView()
        self._since_keyframe = 0
        self._keyframe_at = -math.inf

    def tell(self, item: Scene | Update) -> None:
        """Tell anything."""
        self.view.apply(item)
        self._watch(item)

    def state(self, state: TeamState) -> None:
        """Tell the whole committed state."""
        self._since_keyframe, self._keyframe_at = 0, state.time
        self.tell(state)

    def change(
        self,
        time: float,
        kind: ChangeKind,
        agents: Sequence[int],
        owner: NDArray[np.integer],
        poses: NDArray[np.float64],
        scores: NDArray[np.float64],
        text: str,
        score: float | None = None,
    ) -> None:
        """Tell how the committed state differs from what was told before; arrays as in `TeamState`.

        The team's score is the sum of its agents', if it is not given.
        """
        told = self.view
        landmarks = np.flatnonzero(owner != told.owner).astype(np.int32)
        posed = np.flatnonzero((poses != told.poses).any(axis=1))
        scored = np.flatnonzero(scores != told.scores)
        self.tell(
            TeamChange(
                time,
                kind,
                tuple(agents),
                landmarks,
                owner[landmarks].astype(np.int32),
                tuple(int(agent) for agent in posed),
                poses[posed].copy(),
                tuple(int(agent) for agent in scored),
                scores[scored].copy(),
                float(scores.sum()) if score is None else score,
                text,
            )
        )
        self.count(time)

    def count(self, time: float) -> None:
        """Tell the whole state if it is time to, after an update of it."""
        self._since_keyframe += 1
        if self._since_keyframe >= KEYFRAME_EVERY:
            self.state(self.view.state(time))


class TeamTeller(Teller):
    """Tells of a team on the in-process bus; the team calls `changed` and `acted`.

    Parameters
    ----------
    watch : Watcher
    team : Team
    scene : Scene
    clock : callable, optional
        Returns the time to tell, seconds; that of the bus by default.
    altitudes : sequence of float, optional
        Of the agents' waypoints, metres; on the ground by default.
    """

    def __init__(
        self,
        watch: Watcher,
        team: Team,
        scene: Scene,
        *,
        clock: Callable[[], float] | None = None,
        altitudes: Sequence[float] | None = None,
    ) -> None:
        super().__init__(watch, scene)
        m = len(scene.agents)
        self._team = team
        self._clock = clock or (lambda: team.bus.now)
        self._altitudes = np.zeros(m) if altitudes is None else np.array(altitudes, dtype=np.float64)
        self._offers: dict[int, Offer] = {}  # by server
        self._closed: dict[int, TradeId] = {}
        self._dead: set[int] = set()
        self._gone: set[int] = set()
        self._activity = np.full(m, Activity.IDLE, dtype=np.uint8)
        self._heard = np.full(m, np.nan)
        self._battery = np.full(m, np.nan)
        self._acts = 0  # since the last Health
        self._healthy_at = self._look_at = -math.inf
        team.onlooker = self
        self.begin(scene)

    def begin(self, scene: Scene) -> None:
        """Tell the scene, at the start and when it changes, and the state."""
        self.scene = scene
        self._names = [agent.name for agent in scene.agents]
        new = len(self._names) - len(self._activity)
        if new > 0:
            self._altitudes = np.append(self._altitudes, np.zeros(new))
            self._activity = np.append(self._activity, np.full(new, Activity.IDLE, dtype=np.uint8))
            self._heard = np.append(self._heard, np.full(new, np.nan))
            self._battery = np.append(self._battery, np.full(new, np.nan))
        self.tell(scene)
        self.state(self._state())

    # What the team calls.

    def changed(self, event: str, agents: tuple[int, ...]) -> None:
        """Tell that the committed state changed."""
        now, kind = self._clock(), KINDS[event]
        if kind is ChangeKind.DEATH:
            self._dead.update(agents)
            self._activity[list(agents)] = Activity.DEAD
            for agent in agents:
                self._close(agent)
        elif kind is ChangeKind.RETURN:
            self._dead.difference_update(agents)
        moved = int((self._team.owner != self.view.owner).sum())
        who = agents[:1] if kind is ChangeKind.ADOPTION else agents  # the others only lose what they had adopted too
        text = change_text(event, [self._names[agent] for agent in who], moved, self._team.score)
        self.change(now, kind, agents, self._team.owner, self._poses(), self._team.scores, text)
        if kind is ChangeKind.TRADE:
            self._close(agents[1])
        if kind is ChangeKind.DEATH:
            self._tell_health()

    def acted(self, agent: int) -> None:
        """Look at an agent that has just done something."""
        node = self._team.nodes[agent]
        offer = node.offer
        standing = self._offers.get(agent)
        if standing is not None and (offer is None or offer.trade != standing.trade):
            self._close(agent)
        if offer is not None and agent not in self._offers and self._closed.get(agent) != offer.trade:
            self._offers[agent] = offer
            self._tell_trading(agent, offer, stands=True)
        self._heard[agent] = now = self._clock()
        self._activity[agent] = self._activity_of(node)
        self._acts += 1
        if self._acts < max(1, len(self._names) // 4):
            return
        if now - self._healthy_at >= HEALTH_EVERY or self._is_health_news():
            self._tell_health()

    def reshaped(self, event: str, agents: tuple[int, ...], landmarks: NDArray[np.int64], detail: str) -> None:
        """Tell that landmarks or agents were changed from outside."""
        team, kind = self._team, KINDS[event]
        if event in ("added", "joined"):
            mission, planner = team.mission, team.planner
            self.begin(describe(mission, planner.models, run=self.scene.run, software=self.scene.software))
        elif event == "left":
            self._gone.update(agents)
            self._activity[list(agents)] = Activity.GONE
            for agent in agents:
                self._close(agent)
            self._tell_health()
        else:
            self.weighted(landmarks, team.planner.weights[landmarks])
        text = f"{detail} {event}; score {team.score:.2f}"
        self.change(self._clock(), kind, agents, team.owner, self._poses(), team.scores, text)

    # What runs call.

    def motion(
        self,
        state: NDArray[np.float64],
        *,
        objects_W: NDArray[np.float64],
        score_flown: float,
        separation: float,
        battery: NDArray[np.float64],
    ) -> None:
        """Tell where vehicles are, `state` having columns as in `covey.flight.layout`, and how they are."""
        now = self._clock()
        self._battery = battery
        poses = np.concatenate([state[:, P : P + 3], state[:, QUAT : QUAT + 4]], axis=1)
        velocities, rates = state[:, V : V + 3].copy(), state[:, OMEGA : OMEGA + 3].copy()
        self.tell(Motion(now, poses, velocities, rates, objects_W.copy(), score_flown, separation))
        if now < self._look_at:
            return
        self._look_at = now + LOOK_EVERY - 0.5 * MOTION_EVERY
        self._look()
        if self._is_health_news() or now - self._healthy_at >= HEALTH_EVERY:
            self._tell_health()
        if now - self._keyframe_at >= KEYFRAME_SECONDS:
            self.state(self.view.state(now))

    def note(self, time: float, kind: str, agents: Sequence[int], text: str) -> None:
        """Tell of something that changes nothing."""
        self.tell(Note(time, kind, tuple(agents), text))

    def appeared(self, obstacle: Obstacle) -> None:
        """Tell of an obstacle that was not there before."""
        self.tell(ObstacleAppeared(self._clock(), scene_obstacle(obstacle)))

    def weighted(self, landmarks: NDArray[np.integer], weights: NDArray[np.float64]) -> None:
        """Tell that landmarks are worth something else; `reshaped` tells what follows."""
        now = self._clock()
        self.tell(Weights(now, landmarks.astype(np.int32), np.array(weights, dtype=np.float64)))
        self.count(now)

    def bound(self, bound: float) -> None:
        """Tell what no deployment can exceed."""
        self.tell(BoundFound(self._clock(), bound))

    def end(self, status: str, holds: bool | None) -> None:
        """Tell the last state, and that the run is over."""
        self._look()
        if self._is_health_news():
            self._tell_health()
        self.state(self._state())
        self.tell(Ended(self._clock(), status, holds, self._team.score))

    def _close(self, server: int) -> None:
        offer = self._offers.pop(server, None)
        if offer is not None:
            self._closed[server] = offer.trade
            self._tell_trading(server, offer, stands=False)

    def _tell_trading(self, server: int, offer: Offer, *, stands: bool) -> None:
        give, want = offer.give.astype(np.int32), offer.want.astype(np.int32)
        now = self._clock()
        self.tell(Trading(now, offer.trade.client, server, give, want, stands))
        self.count(now)

    def _look(self) -> None:
        for agent, node in enumerate(self._team.nodes):
            self._activity[agent] = self._activity_of(node)

    def _activity_of(self, node: Node) -> Activity:
        if node.agent in self._dead:
            return Activity.DEAD
        if node.agent in self._gone:
            return Activity.GONE
        if self._team.travel.under_way(node.agent):
            return Activity.FLYING
        if node.lock is Lock.SERVER_PREPARED:
            return Activity.OFFERING
        if node.lock is not Lock.IDLE:
            return Activity.ASKING
        return Activity.QUIESCENT if node.quiescent else Activity.IDLE

    def _is_health_news(self) -> bool:
        health = self.view.health
        return health is None or not np.array_equal(health.activity, self._activity)

    def _tell_health(self) -> None:
        self._acts = 0
        self._healthy_at = now = self._clock()
        link = np.full(len(self._names), 1.0 - self._team.bus.loss)
        self.tell(Health(now, self._activity.copy(), self._battery.copy(), link, self._heard.copy()))

    def _poses(self) -> NDArray[np.float64]:
        return pose_rows(self._team.poses, self._altitudes)

    def _state(self) -> TeamState:
        offered = [landmarks for offer in self._offers.values() for landmarks in (offer.give, offer.want)]
        return TeamState(
            self._clock(),
            self._team.owner.astype(np.int32),
            self._poses(),
            self._team.scores.copy(),
            self._team.planner.weights.copy(),
            self._activity.copy(),
            np.unique(np.concatenate(offered)).astype(np.int32) if offered else np.empty(0, dtype=np.int32),
            self._team.trades,
            self.view.bound,
        )


def describe(
    mission: Mission,
    models: Sequence[VisibilityModel],
    *,
    run: Run,
    software: Mapping[str, str],
    body_radius: float = 0.0,
    required_separation: float = 0.0,
) -> Scene:
    """Return the scene of a mission: `models` are the agents' sensors, and obstacles count where something flies."""
    landmarks, geo = mission.landmarks, mission.georeference
    palette = colours([agent.name for agent in mission.agents])
    flat = np.zeros((len(landmarks), 1))
    normals = landmarks.normals_W
    return Scene(
        run=run,
        mission=mission.name,
        seed=mission.seed,
        sigma=mission.coverage.sigma,
        trade=mission.coverage.trade.value,
        agents=tuple(
            SceneAgent(
                agent.name,
                colour,
                rings(agent.region),
                PurePath(agent.sensor.model).name,  # where a user keeps a file is nobody else's business
                float(getattr(model, "optimal_distance", math.nan)),
            )
            for agent, model, colour in zip(mission.agents, models, palette, strict=True)
        ),
        positions_W=np.hstack([landmarks.positions_W, flat]),
        weights=landmarks.weights.copy(),
        normals_W=None if normals is None else np.hstack([normals, flat]),
        cell_size=math.nan if landmarks.cell_size is None else landmarks.cell_size,
        region=rings(mission.region),
        obstacles=tuple(scene_obstacle(obstacle) for obstacle in mission.flight.obstacles) if body_radius else (),
        body_radius=body_radius,
        required_separation=required_separation,
        origin_lonlat_deg=None if geo is None else (geo.lon_deg, geo.lat_deg),
        source=mission.source,
        software=software,
    )


def rings(region: Region) -> tuple[NDArray[np.float64], ...]:
    """Return a region as `SceneAgent.region`."""
    return (region.exterior.copy(), *(hole.copy() for hole in region.holes))


def scene_obstacle(obstacle: Obstacle) -> SceneObstacle:
    """Return an obstacle as watchers see it."""
    if isinstance(obstacle, Sphere):
        turn = np.linspace(0.0, 2.0 * np.pi, 32, endpoint=False)
        x, y, z = obstacle.center_W
        ring = np.column_stack([x + obstacle.radius * np.cos(turn), y + obstacle.radius * np.sin(turn)])
        return SceneObstacle(ring, z - obstacle.radius, z + obstacle.radius, obstacle.radius)
    if isinstance(obstacle, Box):
        (x0, y0, z0), (x1, y1, z1) = obstacle.min_W, obstacle.max_W
        return SceneObstacle(np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]]), z0, z1)
    return SceneObstacle(np.array(obstacle.polygon, dtype=np.float64), obstacle.z_min, obstacle.z_max)


def pose_rows(poses: Sequence[Pose2], altitudes: Sequence[float] | NDArray[np.float64]) -> NDArray[np.float64]:
    """Return planar poses at altitudes, metres, as rows of `covey.runtime.watching.feed.POSE` columns, shape (m, 7)."""
    rows = np.zeros((len(poses), POSE))
    for row, pose, z in zip(rows, poses, altitudes, strict=True):
        row[:] = (pose.x, pose.y, z, math.cos(0.5 * pose.yaw), 0.0, 0.0, math.sin(0.5 * pose.yaw))
    return rows


def planar(row: NDArray[np.float64]) -> Pose2:
    """Return the planar part of a row of `covey.runtime.watching.feed.POSE` columns, its heading that of the x axis."""
    return Pose2(float(row[0]), float(row[1]), yaw_of(row[3:]))


def change_text(event: str, names: Sequence[str], moved: int, score: float) -> str:
    """Return what happened, for people: an event of the history, whom it concerns, how many landmarks changed hands."""
    landmarks = f"{moved} landmark{'s' * (moved != 1)}"
    return f"{_TEXTS[event].format(who=' and '.join(names), moved=landmarks)}; score {score:.2f}"
