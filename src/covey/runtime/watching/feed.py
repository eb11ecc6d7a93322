"""What there is to see of a mission while it runs: one description for recording, the Playground and replay.

A run tells its watchers first a `Scene` and a `TeamState`, then `Update`s in the order of their time, at last `Ended`.
When landmarks or agents are added, a new `Scene` and `TeamState` follow in the middle, with those added at the end of
their lists.  Whoever has seen the scene and everything since knows all there is to draw; `TeamView` in
`covey.runtime.watching.view` adds it up.  Indices are those of `Scene.agents` and
`Scene.positions_W`; poses are rows of seven numbers, so that three-dimensional ones fit as well.
"""

from __future__ import annotations

import enum
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

POSE = 7
"""Columns of a pose: x, y, z in frame W, metres, then quat_wxyz, which takes the body's frame B into W."""

NOBODY = -1
"""The owner of a landmark that nobody watches."""


NO_TRADE = "none"
"""In the place of the rule of trade: the run is an exercise, whose vehicles have tasks and no landmarks."""


class Run(enum.Enum):
    """What kind of run is told of; it says what `time` means."""

    PLAN = "plan"
    """Seconds on the in-process bus: milliseconds apart, and only their order matters."""
    FLIGHT = "flight"
    """Simulated seconds since the flight began."""
    NETWORK = "network"
    """Seconds since the observer came, or since a team began that lives in real time in one process."""


class Activity(enum.IntEnum):
    """What an agent is doing."""

    IDLE = 0
    """It has partners left to ask."""
    ASKING = 1
    """Client of a trade."""
    OFFERING = 2
    """Server of a trade."""
    FLYING = 3
    """On its way to its waypoint."""
    QUIESCENT = 4
    """Nothing left to do."""
    SUSPECT = 5
    """Not heard for a while, or its connection is lost."""
    DEAD = 6
    """Declared dead, killed, or its vehicle does not fly any more."""
    GONE = 7
    """It has left the mission, or has not joined yet."""


class ChangeKind(enum.Enum):
    """Why the committed state of a team changed."""

    INITIAL = "initial"
    OPTIMIZATION = "optimization"
    TRADE = "trade"
    PROOF = "proof"
    ABANDONED = "abandoned"
    ADOPTION = "adoption"
    DEATH = "death"
    RETURN = "return"
    JOINED = "joined"
    LEFT = "left"
    LANDMARKS = "landmarks"
    """Landmarks were added, removed or weighted anew."""


@dataclass(frozen=True, eq=False, slots=True)
class SceneAgent:
    """One agent, as far as it does not change.

    Parameters
    ----------
    name : str
    colour : str
        ``#rrggbb``, one that people with any colour vision can tell apart.
    region : tuple of array, shape (k, 2)
        Where its position may be, frame W, metres: the outline, then the holes.
    sensor : str
        Name of its visibility model.
    optimal_distance : float
        Metres; NaN for a model that has none.
    """

    name: str
    colour: str
    region: tuple[NDArray[np.float64], ...]
    sensor: str
    optimal_distance: float


@dataclass(frozen=True, eq=False, slots=True)
class SceneObstacle:
    """Something that no vehicle may touch: a prism, or a sphere.

    Parameters
    ----------
    outline : array, shape (k, 2)
        Frame W, metres; a sphere's is the circle around it, drawn with 32 corners.
    z_min, z_max : float
        Metres.
    radius : float
        Of a sphere; 0 for a prism.
    """

    outline: NDArray[np.float64]
    z_min: float
    z_max: float
    radius: float = 0.0


@dataclass(frozen=True, eq=False, slots=True)
class Scene:
    """What does not change during a run, and how everything is at its start.

    Parameters
    ----------
    run : Run
    mission : str
        Name of the mission.
    seed : int
    sigma : float
    trade : str
        The rule of trade, or `NO_TRADE`.
    agents : tuple of SceneAgent
    positions_W : array, shape (n, 3)
        The landmarks, metres; z is 0 for those on the ground.
    weights : array, shape (n,)
    normals_W : array, shape (n, 3), or None
        Outward unit normals.
    cell_size : float
        Side of the square that a landmark stands for, metres; NaN where there is none.
    region : tuple of array, shape (k, 2)
        Omega: the outline, then the holes, frame W, metres.
    obstacles : tuple of SceneObstacle
    body_radius : float
        Of a vehicle, metres; 0 where nothing flies.
    required_separation : float
        Metres; 0 where nothing flies.
    origin_lonlat_deg : tuple of float, or None
        Where on earth the origin of W is, WGS84.
    source : mapping
        The mission file as plain data.
    software : mapping of str to str
        Versions.
    """

    run: Run
    mission: str
    seed: int
    sigma: float
    trade: str
    agents: tuple[SceneAgent, ...]
    positions_W: NDArray[np.float64]
    weights: NDArray[np.float64]
    normals_W: NDArray[np.float64] | None
    cell_size: float
    region: tuple[NDArray[np.float64], ...]
    obstacles: tuple[SceneObstacle, ...] = ()
    body_radius: float = 0.0
    required_separation: float = 0.0
    origin_lonlat_deg: tuple[float, float] | None = None
    source: Mapping[str, object] = field(default_factory=dict)
    software: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, eq=False, slots=True)
class TeamState:
    """The whole committed state: the first update, and now and then, so that one can begin to read anywhere.

    Parameters
    ----------
    time : float
        Seconds; see `Run`.
    owner : array of int32, shape (n,)
        Index of each landmark's owner, or `NOBODY`.
    poses : array, shape (m, 7)
        Committed poses, the waypoints; see `POSE`.
    scores : array, shape (m,)
        Score of each agent, eq. (4.4).
    weights : array, shape (n,)
        Of the landmarks; 0 for one that was removed.
    activity : array of uint8, shape (m,)
        `Activity` of each agent.
    trading : array of int32, shape (k,)
        Landmarks that are offered in a trade at this moment.
    trades : int
        How many so far.
    bound : float
        Upper bound on the score of any deployment; NaN where unknown.
    """

    time: float
    owner: NDArray[np.int32]
    poses: NDArray[np.float64]
    scores: NDArray[np.float64]
    weights: NDArray[np.float64]
    activity: NDArray[np.uint8]
    trading: NDArray[np.int32]
    trades: int
    bound: float


@dataclass(frozen=True, eq=False, slots=True)
class TeamChange:
    """The committed state changed; what is not named stayed as it was.

    Parameters
    ----------
    time : float
    kind : ChangeKind
    agents : tuple of int
        Whom it concerns: of a trade, client and server.
    landmarks : array of int32, shape (k,)
        Those with another owner than before.
    owner : array of int32, shape (k,)
        Their new owners.
    posed : tuple of int
        The agents with another committed pose than before.
    poses : array, shape (len(posed), 7)
    scored : tuple of int
        The agents with another score than before.
    scores : array, shape (len(scored),)
    score : float
        Team score after it.
    text : str
        What happened, for people.
    """

    time: float
    kind: ChangeKind
    agents: tuple[int, ...]
    landmarks: NDArray[np.int32]
    owner: NDArray[np.int32]
    posed: tuple[int, ...]
    poses: NDArray[np.float64]
    scored: tuple[int, ...]
    scores: NDArray[np.float64]
    score: float
    text: str


@dataclass(frozen=True, eq=False, slots=True)
class Trading:
    """A server made an offer, or the trade was committed or dropped: these landmarks are white meanwhile.

    Parameters
    ----------
    time : float
    client, server : int
    give, want : array of int32, shape (k,)
        Landmarks that would go to the client, and to the server.
    open : bool
        Whether the offer stands from now on.
    """

    time: float
    client: int
    server: int
    give: NDArray[np.int32]
    want: NDArray[np.int32]
    open: bool


@dataclass(frozen=True, eq=False, slots=True)
class Weights:
    """Landmarks are worth something else from now on.

    Parameters
    ----------
    time : float
    landmarks : array of int32, shape (k,)
    weights : array, shape (k,)
        0 for those that were removed.
    """

    time: float
    landmarks: NDArray[np.int32]
    weights: NDArray[np.float64]


@dataclass(frozen=True, eq=False, slots=True)
class Motion:
    """Where the vehicles are.

    Parameters
    ----------
    time : float
    poses : array, shape (m, 7)
        True poses; see `POSE`.  On a network: the last known one of a vehicle that is silent, the committed one of an
        agent that tells of no vehicle.
    velocities_W : array, shape (m, 3)
        m/s; NaN where unknown.
    rates_B : array, shape (m, 3)
        Body rates, rad/s; NaN where unknown.
    objects_W : array, shape (j, 3)
        Centres of moving objects, metres.
    score_flown : float
        Team score from the true poses; NaN where unknown.
    separation : float
        Least scaled distance between two vehicles in the air, metres; infinite where fewer than two fly,
        NaN where unknown.
    """

    time: float
    poses: NDArray[np.float64]
    velocities_W: NDArray[np.float64]
    rates_B: NDArray[np.float64]
    objects_W: NDArray[np.float64]
    score_flown: float
    separation: float


@dataclass(frozen=True, eq=False, slots=True)
class Health:
    """How the agents are.

    Parameters
    ----------
    time : float
    activity : array of uint8, shape (m,)
        `Activity` of each agent.
    battery : array, shape (m,)
        From 0 to 1; NaN where unknown.
    link : array, shape (m,)
        Share of what was sent to it that arrived, from 0 to 1; NaN where unknown.
    heard : array, shape (m,)
        When it was last heard, seconds on the clock of `time`; NaN for never.
    """

    time: float
    activity: NDArray[np.uint8]
    battery: NDArray[np.float64]
    link: NDArray[np.float64]
    heard: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Note:
    """Something worth telling that changes no owner and no committed pose.

    Parameters
    ----------
    time : float
    kind : str
        One word, for example ``takeoff``, ``reached``, ``missed``, ``collision``, ``fault``.
    agents : tuple of int
    text : str
    """

    time: float
    kind: str
    agents: tuple[int, ...]
    text: str


@dataclass(frozen=True, eq=False, slots=True)
class ObstacleAppeared:
    """There is an obstacle from now on."""

    time: float
    obstacle: SceneObstacle


@dataclass(frozen=True, slots=True)
class BoundFound:
    """No deployment of this team can score more than `bound`."""

    time: float
    bound: float


@dataclass(frozen=True, slots=True)
class Ended:
    """The run is over.

    Parameters
    ----------
    time : float
    status : str
        ``settled`` or ``interrupted``.
    holds : bool or None
        Whether the certificate holds; None where there is none.
    score : float
    """

    time: float
    status: str
    holds: bool | None
    score: float


Update: TypeAlias = (
    TeamState | TeamChange | Trading | Weights | Motion | Health | Note | ObstacleAppeared | BoundFound | Ended
)
"""Anything that is told after the scene."""

Watcher: TypeAlias = Callable[[Scene | Update], object]
"""Whoever wants to know; it must return soon, and what it raises ends the run."""
