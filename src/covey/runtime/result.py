"""What planning a mission gives: the deployment, how it came about, and its evidence."""

from __future__ import annotations

import base64
import enum
import html
import io
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from covey.coverage.certificate import Certificate, TeamBound
from covey.geometry import Pose2

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from covey.mission import Mission, OptimizerName, Trade
    from covey.vehicles.flight_log import FlightEvent


class PlanStatus(enum.Enum):
    """How planning ended."""

    SETTLED = "settled"
    """Every agent is quiescent: nobody wants another trade or pose."""
    INTERRUPTED = "interrupted"
    """Stopped by the user; this is what was known by then."""


@dataclass(frozen=True)
class Progress:
    """A word on how planning goes, for progress lines.

    Parameters
    ----------
    stage : str
        What is being done, for example ``trading``.
    score : float
        Team score so far.
    trades, messages : int
        How many so far.
    fraction : float or None
        How much of the stage is done, from 0 to 1, where that can be told.
    """

    stage: str
    score: float
    trades: int = 0
    messages: int = 0
    fraction: float | None = None


@dataclass(frozen=True, eq=False)
class AgentResult:
    """One agent of a deployment.

    Parameters
    ----------
    name : str
    pose : Pose2
        Frame W.
    score : float
        Sum over its landmarks of weight times visibility, eq. (4.4).
    landmarks : array of int64, shape (k,)
        Indices of the landmarks it owns, ascending.
    """

    name: str
    pose: Pose2
    score: float
    landmarks: NDArray[np.int64]


@dataclass(frozen=True)
class Scores:
    """Team scores, eq. (4.5), at the four moments of which the thesis tells; NaN for one that was not reached."""

    initial: float
    after_first_optimization: float
    after_first_trade: float
    final: float


@dataclass(frozen=True)
class HistoryEntry:
    """One change of the team's state.

    Parameters
    ----------
    event : str
        ``initial``, ``optimization``, ``trade`` or ``proof`` (the proof of a pose found a better one); where an
        operator changed the mission ``added``, ``removed``, ``reweighted``, ``joined`` or ``left``, and ``adoption``
        (an agent took landmarks over that had no owner).
    agents : tuple of str
        The agents that it concerned.
    score : float
        Team score after it.
    detail : str
        More on it, in words: which landmarks an operator changed.
    """

    event: str
    agents: tuple[str, ...]
    score: float
    detail: str = ""


@dataclass(frozen=True)
class FlightReport:
    """How a mission was flown; lengths in metres, times in seconds.

    Parameters
    ----------
    simulator : str
        ``mujoco``, ``reference`` or ``kinematic``.
    vehicle : str
    duration : float
        From take-off to landing, simulated.
    wall : float
        The same on the wall's clock, trading and proofs included.
    min_separation, required_separation : float
        Least scaled distance between two vehicles in the air (infinite for one vehicle), and what it must not fall
        below.
    altitudes : tuple of float
        One an agent.
    separation_cost : float
        What keeping apart cost in score: what `plan` reaches with the same seed if agents that share a layer may come
        as close as they like, less what it reaches as it is.  Both are local optima, so luck may make it negative.
        0 where nobody shares a layer; NaN if it was not computed.
    max_outside_region : float
        How far a vehicle in the air has been outside its agent's region, 0 if never.
    collisions : int
    tracking_rms : float
        Root mean square of the distance from the reference.
    waypoints_reached, waypoints_missed : int
    score_flown : float
        Team score from the true poses when the mission had settled.
    lost : tuple of str
        Agents whose vehicle did not come back.
    events : tuple of FlightEvent
    """

    simulator: str
    vehicle: str
    duration: float
    wall: float
    min_separation: float
    required_separation: float
    altitudes: tuple[float, ...]
    separation_cost: float
    max_outside_region: float
    collisions: int
    tracking_rms: float
    waypoints_reached: int
    waypoints_missed: int
    score_flown: float
    lost: tuple[str, ...]
    events: tuple[FlightEvent, ...]

    @property
    def real_time_factor(self) -> float:
        """How much faster than real time it was simulated."""
        return self.duration / self.wall if self.wall > 0.0 else math.inf


@dataclass(frozen=True)
class Baseline:
    """Team scores without any trading: greedy placement, and Lloyd's iteration with local refinement after it."""

    greedy: float
    greedy_lloyd: float


@dataclass(frozen=True, eq=False)
class Snapshot:
    """The state of the team at one of the four moments of `Scores`.

    Parameters
    ----------
    label : str
        ``initial``, ``after_first_optimization``, ``after_first_trade`` or ``final``.
    poses : tuple of Pose2
        One an agent.
    owner : array of int64, shape (n,)
        Index of each landmark's owner.
    score : float
        Team score.
    """

    label: str
    poses: tuple[Pose2, ...]
    owner: NDArray[np.int64]
    score: float


@dataclass(frozen=True, eq=False)
class Deployment:
    """Where the agents of a mission go and what each watches, with the evidence that it is good.

    Parameters
    ----------
    mission : Mission
    seed : int
        The seed it was planned with.
    sigma : float
        Tolerance of Definition 3.
    trade : Trade
    optimizer : OptimizerName
    status : PlanStatus
    score : Scores
    history : tuple of HistoryEntry
        Every change in order; the scores fall only where an operator changed the mission, or a waypoint was given up.
    trades, pose_optimizations : int
        How many trades were completed and how many pose problems were solved.
    agents : tuple of AgentResult
        In the order of the mission.
    certificate : Certificate, optional
        Definition 3, checked; absent when planning was interrupted.
    bound : TeamBound, optional
        What no deployment of this team can exceed, when asked for.
    baseline : Baseline, optional
        What simpler methods reach, when asked for.
    flight : FlightReport, optional
        How it was flown, if it was.
    timing_s : mapping of str to float
        Seconds spent on each stage.
    software : mapping of str to str
        Versions that took part.
    snapshots : tuple of Snapshot
        The team's state at the four moments of `score`; they are not kept in result files.

    Notes
    -----
    Source: Sposato (2016), section 4.2.  Notebooks show a deployment by its figure.
    """

    mission: Mission
    seed: int
    sigma: float
    trade: Trade
    optimizer: OptimizerName
    status: PlanStatus
    score: Scores
    history: tuple[HistoryEntry, ...]
    trades: int
    pose_optimizations: int
    agents: tuple[AgentResult, ...]
    certificate: Certificate | None = None
    bound: TeamBound | None = None
    baseline: Baseline | None = None
    flight: FlightReport | None = None
    timing_s: Mapping[str, float] = field(default_factory=dict)
    software: Mapping[str, str] = field(default_factory=dict)
    snapshots: tuple[Snapshot, ...] = ()

    @cached_property
    def owner(self) -> NDArray[np.int64]:
        """Index of the agent that owns each landmark, shape (n,); -1 where nobody does."""
        owner = np.full(len(self.mission.landmarks), -1, dtype=np.int64)
        for index, agent in enumerate(self.agents):
            owner[agent.landmarks] = index
        return owner

    @property
    def poses(self) -> tuple[Pose2, ...]:
        """The agents' poses, frame W, in the order of the mission."""
        return tuple(agent.pose for agent in self.agents)

    def plot(self, ax: Axes | None = None) -> Axes:
        """Draw the deployment.

        Parameters
        ----------
        ax : matplotlib Axes, optional
            Where to draw the map alone; without it a figure is made that also shows the score over time.

        Returns
        -------
        matplotlib Axes
            The axes of the map; ``.figure.savefig(...)`` saves the whole figure.
        """
        from covey.runtime.drawing import figures, map_drawing

        if ax is None:
            return figures.deployment_figure(self).axes[0]
        map_drawing.draw_map(ax, self.mission, self.poses, self.owner)
        return ax

    def to_dict(self) -> dict[str, Any]:
        """Return the content of ``result.json`` as plain data."""
        from covey.runtime.records import document

        return document.to_document(self)

    def save(self, directory: str | Path, *, overwrite: bool = False) -> Path:
        """Write ``result.json``, ``agents.csv``, the figures and, for geographic missions, ``deployment.geojson``.

        Parameters
        ----------
        directory : str or Path
            Where to; it is made if need be.
        overwrite : bool
            Replace an earlier result of covey there.  Other files in the directory stay as they are.

        Returns
        -------
        Path
            The directory.

        Raises
        ------
        OutputError
            If something is there already, or it cannot be written.  Nothing is left half-written.
        """
        from covey.runtime.records import record

        return record.write_result(self, directory, overwrite=overwrite)

    def _repr_png_(self) -> bytes:
        from covey.runtime.drawing import figures

        buffer = io.BytesIO()
        figures.save_figure(figures.deployment_figure(self), buffer, kind="png")
        return buffer.getvalue()

    def _repr_html_(self) -> str:
        image = base64.b64encode(self._repr_png_()).decode("ascii")
        rows = "".join(
            f"<tr><td>{number}</td><td>{html.escape(agent.name)}</td><td>{agent.pose.x:.3f}</td><td>{agent.pose.y:.3f}</td>"
            f"<td>{math.degrees(agent.pose.yaw):.1f}</td><td>{len(agent.landmarks)}</td><td>{agent.score:.2f}</td></tr>"
            for number, agent in enumerate(self.agents, start=1)
        )
        heads = "".join(f"<th>{head}</th>" for head in ("", "agent", "x [m]", "y [m]", "yaw [°]", "landmarks", "score"))
        return (
            f'<img src="data:image/png;base64,{image}" style="max-width: 100%" alt="{html.escape(repr(self))}">'
            f"<table><thead><tr>{heads}</tr></thead><tbody>{rows}</tbody></table>"
        )

    def __repr__(self) -> str:
        return (
            f"Deployment({self.mission.name!r}, {len(self.agents)} agents, {len(self.mission.landmarks)} landmarks, "
            f"score {self.score.initial:.2f} to {self.score.final:.2f}, {self.status.value})"
        )
