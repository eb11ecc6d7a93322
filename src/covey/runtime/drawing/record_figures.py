"""Figures for a paper, drawn from a record: as wide as a column, in type that can be read there."""

from __future__ import annotations

import enum
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from covey.environment import GeoReference, Landmarks
from covey.errors import ArgumentError
from covey.geometry import Pose2, Region
from covey.mission import AgentSpec, CoverageSpec, Mission, SensorSpec
from covey.runtime.drawing.map_drawing import FAINT, INK, STYLE, Frame, draw_badges, draw_map
from covey.runtime.drawing.palette import is_light
from covey.runtime.records.mcap_reader import Record
from covey.runtime.watching.feed import POSE, Activity, ChangeKind, Motion, Note, Run, Scene, TeamChange, TeamState
from covey.runtime.watching.view import TeamView

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLUMN_MM = 88.0
"""Width of a column of most journals, millimetres."""

NARROWEST, WIDEST = 50.0, 400.0
"""Between these widths, millimetres, the figures can be read."""

_STYLE = {**STYLE, "font.size": 7.5, "axes.labelsize": 7.5, "xtick.labelsize": 7.0, "ytick.labelsize": 7.0,
          "legend.fontsize": 6.5, "axes.linewidth": 0.6, "xtick.major.width": 0.6, "ytick.major.width": 0.6,
          "xtick.major.size": 2.5, "ytick.major.size": 2.5, "lines.linewidth": 1.0}  # fmt: skip

_MARKS = {
    ChangeKind.OPTIMIZATION: ("better pose", "o", 2.0),
    ChangeKind.TRADE: ("trade", "s", 3.0),
    ChangeKind.PROOF: ("pose by the proof", "D", 3.5),
    ChangeKind.ABANDONED: ("waypoint given up", "v", 4.0),
    ChangeKind.ADOPTION: ("adoption", "P", 4.0),
    ChangeKind.DEATH: ("loss", "X", 4.5),
    ChangeKind.RETURN: ("return", "^", 4.0),
    ChangeKind.JOINED: ("joined", ">", 4.0),
    ChangeKind.LEFT: ("left", "<", 4.0),
    ChangeKind.LANDMARKS: ("landmarks changed", "h", 4.0),
}
"""How changes are marked on the score."""


class Kind(enum.Enum):
    """What a figure shows."""

    DEPLOYMENT = "deployment"
    """The map at the end, with the paths flown."""
    SCORE = "score"
    """The score over time, what changed it, and its bound."""
    SEPARATION = "separation"
    """The least distance between two vehicles over time."""
    TRACKING = "tracking"
    """How far each vehicle is from its waypoint over time."""
    TRADES = "trades"
    """Who traded with whom, and how many landmarks."""


@dataclass(frozen=True, eq=False)
class Story:
    """A record, read to its end.

    Parameters
    ----------
    view : TeamView
        The state at the end.
    scene : Scene
        The newest.
    initial : TeamState
        The first.
    changes : tuple of TeamChange
    motions : tuple of Motion
        Those since the newest scene.
    waypoints : array, shape (k, m, 7)
        Committed poses at the time of each motion.
    home : float
        When the vehicles left their waypoints for home, seconds; infinite if they did not.
    """

    view: TeamView
    scene: Scene
    initial: TeamState
    changes: tuple[TeamChange, ...]
    motions: tuple[Motion, ...]
    waypoints: NDArray[np.float64]
    home: float

    @classmethod
    def of(cls, record: Record) -> Story:
        """Read a record."""
        view, changes, motions, waypoints = TeamView(), list[TeamChange](), list[Motion](), list[NDArray[np.float64]]()
        initial: TeamState | None = None
        home = math.inf
        for item in record.items():
            view.apply(item)
            match item:
                case Scene():
                    motions, waypoints = [], []
                case TeamState():
                    initial = initial or item
                case TeamChange():
                    changes.append(item)
                case Note(kind="landing"):
                    home = min(home, item.time)
                case Motion():
                    motions.append(item)
                    waypoints.append(view.poses.copy())
                case _:
                    pass
        if view.scene is None or initial is None:
            raise ArgumentError(f"record: expected one with the state of a team, got {record.path}")
        goals = np.array(waypoints).reshape(len(motions), len(view.scene.agents), POSE)
        return cls(view, view.scene, initial, tuple(changes), tuple(motions), goals, home)

    @property
    def kinds(self) -> tuple[Kind, ...]:
        """What can be drawn of it."""
        flown = len(self.motions) > 1
        traded = any(change.kind is ChangeKind.TRADE for change in self.changes)
        separated = any(math.isfinite(motion.separation) for motion in self.motions)
        possible = {Kind.SEPARATION: flown and separated, Kind.TRACKING: flown, Kind.TRADES: traded}
        return tuple(kind for kind in Kind if possible.get(kind, True))


def record_figure(story: Story, kind: Kind, *, width_mm: float = COLUMN_MM) -> Figure:
    """Draw a figure; save it with `covey.runtime.drawing.figures.save_figure`.

    Parameters
    ----------
    story : Story
    kind : Kind
    width_mm : float
        Width of the figure, millimetres.

    Raises
    ------
    ArgumentError
        If the record does not have what the figure shows, or the width is not from 50 to 400.
    """
    if not NARROWEST <= width_mm <= WIDEST:
        raise ArgumentError(f"width_mm: expected from {NARROWEST:g} to {WIDEST:g}, got {width_mm:g}")
    if kind not in story.kinds:
        raise ArgumentError(
            f"kind: expected one of {', '.join(kind.value for kind in story.kinds)} for this record, got {kind.value}"
        )
    width = width_mm / 25.4
    with mpl.rc_context(_STYLE):
        if kind is Kind.DEPLOYMENT:
            return _map_figure(story, width)
        if kind is Kind.TRADES:
            return _trades_figure(story, width)
        figure, ax = _chart(width)
        draw = {Kind.SCORE: _draw_score, Kind.SEPARATION: _draw_separation, Kind.TRACKING: _draw_tracking}[kind]
        draw(ax, story)
    return figure


def _chart(width: float) -> tuple[Figure, Axes]:
    height = 0.62 * width
    figure = Figure(figsize=(width, height))
    FigureCanvasAgg(figure)
    left, bottom = 0.45, 0.36
    ax = figure.add_axes((left / width, bottom / height, 1.0 - (left + 0.08) / width, 1.0 - (bottom + 0.08) / height))
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)
    ax.grid(True, color="#E4E4E4", linewidth=0.5)
    ax.set_axisbelow(True)
    ax.xaxis.set_major_locator(MaxNLocator(nbins=6, steps=[1, 2, 5, 10]))
    ax.yaxis.set_major_locator(MaxNLocator(nbins=5))
    return figure, ax


def _map_figure(story: Story, width: float) -> Figure:
    mission, poses = mission_of(story.scene, story.view), _poses(story.view.poses)
    left, bottom, rest = 0.42, 0.36, 0.06
    frame = Frame.around(mission, poses, box=(width - left - rest, 1.4 * width))
    height = frame.height + bottom + rest
    figure = Figure(figsize=(width, height))
    FigureCanvasAgg(figure)
    across = (width - left - rest - frame.width) / 2.0
    ax = figure.add_axes(((left + across) / width, bottom / height, frame.width / width, frame.height / height))
    ax.xaxis.set_major_locator(MaxNLocator(nbins=6, steps=[1, 2, 5, 10]))
    ax.yaxis.set_major_locator(MaxNLocator(nbins=6, steps=[1, 2, 5, 10]))
    palette = [agent.colour for agent in story.scene.agents]
    draw_map(
        ax,
        mission,
        poses,
        story.view.owner.astype(np.int64),
        frame=frame,
        palette=palette,
        radius=7.0 if len(poses) <= 16 else 5.0,
        present=story.view.activity != Activity.GONE,
    )
    motions = _under_way(story)
    if motions:
        paths = np.array([motion.poses[:, :2] for motion in motions])
        for index, colour in enumerate(palette):
            edge = INK if is_light(colour) else "white"
            ax.plot(*paths[:, index].T, color=edge, linewidth=1.5, alpha=0.6, zorder=3.2)
            ax.plot(*paths[:, index].T, color=colour, linewidth=0.8, zorder=3.3)
    return figure


def _draw_score(ax: Axes, story: Story) -> None:
    start = story.initial
    scores = np.array([float(start.scores.sum()), *(change.score for change in story.changes)])
    if story.scene.run is Run.PLAN:
        times = np.arange(len(scores), dtype=np.float64)
        ax.set_xlabel("change")
    else:
        end = max(story.view.time, start.time)
        times = np.array([start.time, *(change.time for change in story.changes)])
        times, scores = np.append(times, end), np.append(scores, scores[-1])
        ax.set_xlabel("time [s]")
    ax.step(times, scores, where="post", color=INK, linewidth=1.0, label="committed", zorder=3)
    flown = [(motion.time, motion.score_flown) for motion in _under_way(story) if math.isfinite(motion.score_flown)]
    if flown:
        ax.plot(*np.array(flown).T, color="#0072B2", linewidth=0.8, label="as flown", zorder=2)
    for kind, (label, shape, size) in _MARKS.items():
        rows = [index for index, change in enumerate(story.changes, start=1) if change.kind is kind]
        if rows:
            ax.plot(
                times[rows], scores[rows], shape, color="#D55E00" if kind is ChangeKind.TRADE else INK,
                markersize=size, markeredgewidth=0.0, linestyle="none", label=label, zorder=4,
            )  # fmt: skip
    if math.isfinite(story.view.bound):
        ax.axhline(story.view.bound, color=FAINT, linestyle=(0, (4, 2)), linewidth=0.8, label="upper bound")
    ax.set_ylabel("coverage score")
    room: Literal["best", "lower right"] = (
        "best" if (np.diff(scores) < 0.0).any() else "lower right"
    )  # below a curve that only rises
    columns = 1 if len(ax.get_legend_handles_labels()[0]) <= 5 else 2
    ax.legend(loc=room, ncols=columns, frameon=True, framealpha=0.9, edgecolor="none", borderpad=0.3, handlelength=1.6)


def _draw_separation(ax: Axes, story: Story) -> None:
    known = [(motion.time, motion.separation) for motion in story.motions if math.isfinite(motion.separation)]
    times, apart = np.array(known).T
    # a line across a time in which fewer than two flew would tell of what was not
    gaps = np.flatnonzero(np.diff(times) > 1.0) + 1
    times, apart = np.insert(times, gaps, np.nan), np.insert(apart, gaps, np.nan)
    ax.plot(times, apart, color=INK, linewidth=0.9, label="least separation")
    needed = story.scene.required_separation
    ax.axhline(needed, color="#D55E00", linestyle=(0, (4, 2)), linewidth=0.9, label=f"required: {needed:.2f} m")
    ax.set_ylim(0.0, 1.22 * float(np.nanmax(apart)))
    ax.set_xlabel("time [s]")
    ax.set_ylabel("separation [m]")
    ax.legend(loc="upper right", frameon=True, framealpha=0.9, edgecolor="none", borderpad=0.3, handlelength=1.6)


def _draw_tracking(ax: Axes, story: Story) -> None:
    motions = _under_way(story)
    times = np.array([motion.time for motion in motions])
    away = np.array([motion.poses[:, :3] for motion in motions]) - story.waypoints[: len(motions), :, :3]
    distance = np.linalg.norm(away, axis=2)
    for index, agent in enumerate(story.scene.agents):
        ax.plot(times, distance[:, index], color=agent.colour, linewidth=0.8, label=agent.name)
    ax.set_ylim(0.0, 1.25 * float(distance.max()) or 1.0)
    ax.set_xlabel("time [s]")
    ax.set_ylabel("distance to waypoint [m]")
    if len(story.scene.agents) <= 8:
        ax.legend(
            loc="upper center", ncols=4, frameon=True, framealpha=0.9, edgecolor="none", borderpad=0.3,
            handlelength=1.2, columnspacing=1.0,
        )  # fmt: skip


def _trades_figure(story: Story, width: float) -> Figure:
    """Draw the agents in a circle and the trades between each two as a line, the wider the more landmarks moved."""
    moved, count = Counter[tuple[int, int]](), Counter[tuple[int, int]]()
    for change in story.changes:
        if change.kind is ChangeKind.TRADE:
            first, second = sorted(change.agents)
            moved[first, second] += len(change.landmarks)
            count[first, second] += 1
    agents = story.scene.agents
    figure = Figure(figsize=(width, 0.8 * width))
    FigureCanvasAgg(figure)
    ax = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    ax.set(xlim=(-1.5, 1.5), ylim=(-1.2, 1.2), aspect="equal")
    ax.axis("off")
    # the first lies a little off the top, so that names have room on both sides
    angles = 0.5 * np.pi - 2.0 * np.pi * (np.arange(len(agents)) + 0.5) / len(agents)
    places = np.column_stack([np.cos(angles), np.sin(angles)])
    most = max(moved.values())
    for (first, second), landmarks in sorted(moved.items(), key=lambda item: item[1]):
        (x0, y0), (x1, y1) = places[first], places[second]
        ax.plot([x0, x1], [y0, y1], color="#8A8A8A", linewidth=0.7 + 4.3 * landmarks / most, alpha=0.75, zorder=2)
        if len(moved) <= 24:  # away from the middle, where lines cross
            ax.text(
                0.64 * x0 + 0.36 * x1, 0.64 * y0 + 0.36 * y1, f"{count[first, second]} ({landmarks})", ha="center",
                va="center", fontsize=6.0, zorder=3,
                bbox={"boxstyle": "round,pad=0.15", "facecolor": "white", "edgecolor": "none", "alpha": 0.85},
            )  # fmt: skip
    for agent, (x, y) in zip(agents, places, strict=True):
        side = "left" if x > 0.0 else "right"
        ax.text(1.12 * x, 1.12 * y, agent.name[:18], ha=side, va="center", fontsize=6.5, zorder=3)
    ax.text(0.01, 0.99, "trades (landmarks moved)", transform=ax.transAxes, va="top", fontsize=6.5, color=FAINT)
    numbers = [str(index + 1) for index in range(len(agents))]
    size = 6.5 if len(agents) <= 16 else 4.5
    draw_badges(ax, places, [agent.colour for agent in agents], numbers, size=size)
    return figure


def _under_way(story: Story) -> list[Motion]:
    """Return the motions before the vehicles went home."""
    return [motion for motion in story.motions if motion.time <= story.home]


def mission_of(scene: Scene, view: TeamView) -> Mission:
    """Return as much of the mission as a scene tells, the agents at the poses of a view."""
    region = Region(scene.region[0], scene.region[1:])
    sensor = SensorSpec(scene.agents[0].sensor, {}) if scene.agents else SensorSpec()
    agents = []
    for agent, pose in zip(scene.agents, _poses(view.poses), strict=True):
        own = region if _same(agent.region, scene.region) else Region(agent.region[0], agent.region[1:])
        agents.append(AgentSpec(agent.name, pose, SensorSpec(agent.sensor, {}), own))
    normals = scene.normals_W
    return Mission(
        schema_version=1,
        name=scene.mission,
        seed=scene.seed,
        landmarks=Landmarks(
            scene.positions_W[:, :2],
            view.weights,
            None if normals is None else normals[:, :2],
            scene.cell_size if math.isfinite(scene.cell_size) else None,
        ),
        region=region,
        sensor=sensor,
        agents=tuple(agents),
        coverage=CoverageSpec(sigma=scene.sigma),
        georeference=None if scene.origin_lonlat_deg is None else GeoReference(*scene.origin_lonlat_deg),
    )


def _poses(rows: NDArray[np.float64]) -> list[Pose2]:
    """Return the planar part of poses, the camera's heading being that of its x axis."""
    w, x, y, z = rows[:, 3:].T
    yaws = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return [Pose2(float(row[0]), float(row[1]), float(yaw)) for row, yaw in zip(rows, yaws, strict=True)]


def _same(first: Sequence[NDArray[np.float64]], second: Sequence[NDArray[np.float64]]) -> bool:
    return len(first) == len(second) and all(np.array_equal(a, b) for a, b in zip(first, second, strict=True))
