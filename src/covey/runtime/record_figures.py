"""Figures for a paper, drawn from a record: as wide as a column, in type that can be read there."""

from __future__ import annotations

import enum
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

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
from covey.runtime.feed import POSE, ChangeKind, Motion, Run, Scene, TeamChange, TeamState
from covey.runtime.map_drawing import FAINT, INK, STYLE, Frame, draw_badges, draw_map
from covey.runtime.mcap_reader import Record
from covey.runtime.palette import is_light
from covey.runtime.view import TeamView

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
    """

    view: TeamView
    scene: Scene
    initial: TeamState
    changes: tuple[TeamChange, ...]
    motions: tuple[Motion, ...]
    waypoints: NDArray[np.float64]

    @classmethod
    def of(cls, record: Record) -> Story:
        """Read a record."""
        view, changes, motions, waypoints = TeamView(), list[TeamChange](), list[Motion](), list[NDArray[np.float64]]()
        initial: TeamState | None = None
        for item in record.items():
            view.apply(item)
            match item:
                case Scene():
                    motions, waypoints = [], []
                case TeamState():
                    initial = initial or item
                case TeamChange():
                    changes.append(item)
                case Motion():
                    motions.append(item)
                    waypoints.append(view.poses.copy())
                case _:
                    pass
        if view.scene is None or initial is None:
            raise ArgumentError(f"record: expected one with the state of a team, got {record.path}")
        goals = np.array(waypoints).reshape(len(motions), len(view.scene.agents), POSE)
        return cls(view, view.scene, initial, tuple(changes), tuple(motions), goals)

    @property
    def kinds(self) -> tuple[Kind, ...]:
        """What can be drawn of it."""
        flown = len(self.motions) > 1
        traded = any(change.kind is ChangeKind.TRADE for change in self.changes)
        separated = any(math.isfinite(motion.separation) for motion in self.motions)
        possible = {Kind.SEPARATION: flown and separated, Kind.TRACKING: flown, Kind.TRADES: traded}
        return tuple(kind for kind in Kind if possible.get(kind, True))


def record_figure(story: Story, kind: Kind, *, width_mm: float = COLUMN_MM) -> Figure:
    """Draw a figure; save it with `covey.runtime.figures.save_figure`.

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
        if kind in (Kind.DEPLOYMENT, Kind.TRADES):
            return _map_figure(story, width, trades=kind is Kind.TRADES)
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


def _map_figure(story: Story, width: float, *, trades: bool) -> Figure:
    mission, poses = mission_of(story.scene, story.view), _poses(story.view.poses)
    left, bottom, rest = 0.42, 0.36, 0.06
    frame = Frame.around(mission, poses, box=(width - left - rest, 1.6 * width), stretch=False)
    height = frame.height + bottom + rest
    figure = Figure(figsize=(width, height))
    FigureCanvasAgg(figure)
    across = (width - left - rest - frame.width) / 2.0
    ax = figure.add_axes(((left + across) / width, bottom / height, frame.width / width, frame.height / height))
    ax.xaxis.set_major_locator(MaxNLocator(nbins=6, steps=[1, 2, 5, 10]))
    ax.yaxis.set_major_locator(MaxNLocator(nbins=6, steps=[1, 2, 5, 10]))
    palette = [agent.colour for agent in story.scene.agents]
    if trades:
        frame.apply(ax)
        ax.set_xlabel("x [m]")
        ax.set_ylabel("y [m]")
        _draw_trades(ax, story, palette)
        return figure
    draw_map(ax, mission, poses, story.view.owner.astype(np.int64), frame=frame, palette=palette)
    if len(story.motions) > 1:
        paths = np.array([motion.poses[:, :2] for motion in story.motions])
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
    flown = [(motion.time, motion.score_flown) for motion in story.motions if math.isfinite(motion.score_flown)]
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
    ax.legend(loc="lower right", frameon=True, framealpha=0.9, edgecolor="none", borderpad=0.3, handlelength=1.6)


def _draw_separation(ax: Axes, story: Story) -> None:
    known = [(motion.time, motion.separation) for motion in story.motions if math.isfinite(motion.separation)]
    times, apart = np.array(known).T
    # a line across a time in which fewer than two flew would tell of what was not
    gaps = np.flatnonzero(np.diff(times) > 1.0) + 1
    times, apart = np.insert(times, gaps, np.nan), np.insert(apart, gaps, np.nan)
    ax.plot(times, apart, color=INK, linewidth=0.9, label="least separation")
    needed = story.scene.required_separation
    ax.axhline(needed, color="#D55E00", linestyle=(0, (4, 2)), linewidth=0.9, label=f"required: {needed:.2f} m")
    ax.set_ylim(0.0, 1.08 * float(np.nanmax(apart)))
    ax.set_xlabel("time [s]")
    ax.set_ylabel("separation [m]")
    ax.legend(loc="upper right", frameon=True, framealpha=0.9, edgecolor="none", borderpad=0.3, handlelength=1.6)


def _draw_tracking(ax: Axes, story: Story) -> None:
    times = np.array([motion.time for motion in story.motions])
    away = np.array([motion.poses[:, :3] for motion in story.motions]) - story.waypoints[:, :, :3]
    distance = np.linalg.norm(away, axis=2)
    for index, agent in enumerate(story.scene.agents):
        ax.plot(times, distance[:, index], color=agent.colour, linewidth=0.8, label=agent.name)
    ax.set_ylim(bottom=0.0)
    ax.set_xlabel("time [s]")
    ax.set_ylabel("distance to waypoint [m]")
    if len(story.scene.agents) <= 8:
        ax.legend(
            loc="upper right", ncols=2, frameon=True, framealpha=0.9, edgecolor="none", borderpad=0.3,
            handlelength=1.2, columnspacing=1.0,
        )  # fmt: skip


def _draw_trades(ax: Axes, story: Story, palette: Sequence[str]) -> None:
    """Draw the trades between each two agents as a line, the wider the more, with the landmarks that went across."""
    moved, count = Counter[tuple[int, int]](), Counter[tuple[int, int]]()
    for change in story.changes:
        if change.kind is ChangeKind.TRADE:
            first, second = sorted(change.agents)
            moved[first, second] += len(change.landmarks)
            count[first, second] += 1
    places = story.view.poses[:, :2]
    for ring in story.scene.region:
        ax.plot(*np.vstack([ring, ring[:1]]).T, color=FAINT, linewidth=0.8)
    most = max(count.values())
    for pair, trades in sorted(count.items(), key=lambda item: item[1]):
        (x0, y0), (x1, y1) = places[list(pair)]
        ax.plot([x0, x1], [y0, y1], color="#8A8A8A", linewidth=0.8 + 3.2 * trades / most, alpha=0.75, zorder=2)
    if len(count) <= 24:
        for pair, trades in count.items():
            x, y = places[list(pair)].mean(axis=0)
            ax.text(
                x, y, f"{trades} ({moved[pair]})", ha="center", va="center", fontsize=6.0, zorder=3,
                bbox={"boxstyle": "round,pad=0.15", "facecolor": "white", "edgecolor": "none", "alpha": 0.85},
            )  # fmt: skip
        ax.text(
            0.02, 0.985, "trades (landmarks moved)", transform=ax.transAxes, ha="left", va="top", fontsize=6.5,
            color=FAINT,
        )  # fmt: skip
    size = 6.5 if len(palette) <= 16 else 5.0
    draw_badges(ax, places, palette, [str(index + 1) for index in range(len(palette))], size=size)


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
