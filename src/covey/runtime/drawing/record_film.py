"""A film of what a run told: the map as landmarks change hands, the vehicles on it, and the score."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.patches import Polygon
from numpy.typing import NDArray

from covey.environment import Landmarks
from covey.environment.lattice import find_lattice
from covey.errors import OutputError, ResultError
from covey.runtime.drawing.film import DPI, FPS, GIF_DPI, GIF_FPS, Report, choose_speed, encode_film, find_ffmpeg
from covey.runtime.drawing.film_frames import HEIGHT, WIDTH, Pixels
from covey.runtime.drawing.flight_drawing import clip_text, new_page, place_axes, write_title
from covey.runtime.drawing.flight_paths import pale
from covey.runtime.drawing.map_drawing import INK, STYLE, scatter_loose
from covey.runtime.drawing.palette import rgb
from covey.runtime.watching.feed import (
    NOBODY,
    Activity,
    ChangeKind,
    Note,
    Run,
    Scene,
    TeamChange,
    TeamState,
    Trading,
    Update,
)
from covey.runtime.watching.view import TeamView

CHANGES_A_SECOND = 5.0
"""Of a plan, whose own time is that of a processor."""

WHITE, UNOWNED, GIVEN_UP = (1.0, 1.0, 1.0), (0.85, 0.85, 0.85), 0.0

LINES = 12
"""Lines of the log."""

NUMBERED = 20
"""Agents of larger teams are not numbered."""


def write_record_film(
    feed: Sequence[Scene | Update],
    target: Path,
    *,
    speed: float | None = None,
    on_progress: Report | None = None,
) -> None:
    """Make a film of a record, whole or not at all.

    Parameters
    ----------
    feed : sequence of Scene or Update
        As a run told it.
    target : Path
        An ``.mp4`` or a ``.gif``.
    speed : float, optional
        Seconds of a flight, or changes of a plan, a second; by default such that it lasts 26 s at most.
    on_progress : callable, optional
        Is told how much is done, from 0 to 1.

    Raises
    ------
    ResultError
        If the record holds no scene.
    OutputError
        If the file has another suffix, cannot be written, or needs an ffmpeg that is not there.
    """
    kind = target.suffix.lower()
    if kind not in (".mp4", ".gif"):
        raise OutputError(f"{target}: expected a name that ends in .mp4 or .gif")
    ffmpeg = find_ffmpeg() if kind == ".mp4" else None
    if kind == ".mp4" and ffmpeg is None:
        raise OutputError(f"{target}: an mp4 needs ffmpeg with H.264; install it, or covey[film], or name a .gif")
    fps, dpi = (FPS, DPI) if ffmpeg else (GIF_FPS, GIF_DPI)
    encode_film(RecordFrames(feed, fps=fps, dpi=dpi, speed=speed), target, ffmpeg, on_progress)


class RecordFrames:
    """Draws the pictures of a record.

    Parameters
    ----------
    feed : sequence of Scene or Update
    fps : int, keyword-only
        Pictures a second.
    dpi : float, keyword-only
    speed : float or None, keyword-only
        As for `write_record_film`.

    Attributes
    ----------
    times : array, shape (f,)
        The moment that each picture shows: seconds, or changes and offers of a plan.

    Raises
    ------
    ResultError
        If there is no scene.
    """

    def __init__(self, feed: Sequence[Scene | Update], *, fps: int, dpi: float, speed: float | None) -> None:
        scene = next((item for item in feed if isinstance(item, Scene)), None)
        if scene is None:
            raise ResultError("the record holds no scene: nothing can be shown of it")
        self._feed, self._clock = feed, clock_of(feed, scene.run)
        begin, end = float(self._clock[0]), float(self._clock[-1])
        planned = scene.run is Run.PLAN
        usual = max(CHANGES_A_SECOND, (end - begin) / 26.0) if planned else choose_speed(end - begin)
        self._speed = usual if speed is None else speed
        count = max(2, math.ceil((end - begin) / self._speed * fps - 1e-6) + 1)
        self.times: NDArray[np.float64] = np.minimum(begin + np.arange(count) * self._speed / fps, end)
        self._planned = planned
        with mpl.rc_context(STYLE):
            self._figure = new_page(WIDTH, HEIGHT)
            self._figure.set_dpi(dpi)
        self._palette = np.empty((0, 3))
        self.rewind()

    @property
    def size(self) -> tuple[int, int]:
        """Width and height, pixels."""
        width, height = self._figure.canvas.get_width_height()
        return int(width), int(height)

    def rewind(self) -> None:
        """Begin anew."""
        self._view, self._next, self._log = TeamView(), 0, list[str]()
        self._scores: list[tuple[float, float]] = []
        self._drawn: Scene | None = None

    def picture(self, index: int) -> Pixels:
        """Draw a picture; one after the other is fastest."""
        now = self.times[index]
        while self._next < len(self._feed) and self._clock[self._next] <= now + 1e-9:
            self._take(self._feed[self._next], float(self._clock[self._next]))
            self._next += 1
        scene = self._view.scene
        assert scene is not None, "the first picture shows what was told first"
        with mpl.rc_context(STYLE):
            if scene is not self._drawn:
                self._draw_page(scene)
            self._update(float(now))
            canvas: Any = self._figure.canvas
            canvas.restore_region(self._still)
            for artist in self._moving:
                self._figure.draw_artist(artist)
            return np.array(canvas.buffer_rgba())

    def _take(self, item: Scene | Update, clock: float) -> None:
        self._view.apply(item)
        if isinstance(item, TeamState | TeamChange):
            self._scores.append((clock, self._view.score))
        if isinstance(item, TeamChange | Note) and not (
            isinstance(item, TeamChange) and item.kind is ChangeKind.INITIAL
        ):
            when = "" if self._planned else f"{item.time:.1f} s  "
            self._log = [*self._log[-LINES + 1 :], clip_text(f"{when}{item.text}", 72)]

    # The page.

    def _draw_page(self, scene: Scene) -> None:
        """Draw what stands still, and make what moves."""
        figure = self._figure
        figure.clear()
        self._drawn = scene
        write_title(figure, scene.mission, f"{len(scene.agents)} agents, {len(scene.positions_W)} landmarks", left=0.6)
        self._palette = np.array([rgb(agent.colour) for agent in scene.agents]).reshape(-1, 3)
        shades = [rgb(colour) for colour in pale([agent.colour for agent in scene.agents])]
        self._shades = np.array([*shades, UNOWNED])
        ax = place_axes(figure, 0.6, 0.5, 6.6, 5.9, aspect="equal", xlabel="x [m]", ylabel="y [m]")
        self._moving: list[Artist] = []
        self._frame_map(ax, scene)
        self._paint = self._make_cells(ax, scene)
        for ring in scene.region:
            self._add(ax.plot(*np.vstack([ring, ring[:1]]).T, color=INK, linewidth=1.2)[0])
        self._obstacles = ax, len(scene.obstacles)
        for obstacle in scene.obstacles:
            self._add(_patch(ax, obstacle.outline))
        m = len(scene.agents)
        x = np.zeros(m)
        self._waypoints: Any = self._add(ax.scatter(x, x, s=26, facecolors="none", edgecolors=INK, linewidths=1.0))
        self._arrows: Any = self._add(
            ax.quiver(x, x, x + 1.0, x, scale=26.0, width=0.005, color=INK, zorder=4.0, pivot="tail")
        )
        self._agents: Any = self._add(ax.scatter(x, x, s=90, c=self._palette, edgecolors=INK, linewidths=1.2, zorder=5))
        self._numbers = [
            self._add(ax.text(0.0, 0.0, str(i + 1), fontsize=7, ha="center", va="center", color=_on(c), zorder=6))
            for i, c in enumerate(self._palette)
            if m <= NUMBERED
        ]
        self._make_chart(scene)
        self._text: Any = self._add(figure.text(0.6 / WIDTH, 1.0 - 0.72 / HEIGHT, "", fontsize=9, va="center"))
        self._lines: Any = self._add(
            figure.text(7.9 / WIDTH, 3.15 / HEIGHT, "", fontsize=8, va="top", color=INK, linespacing=1.45)
        )
        canvas: Any = figure.canvas
        canvas.draw()
        self._still = canvas.copy_from_bbox(figure.bbox)

    def _add(self, artist: Any) -> Any:
        artist.set_animated(True)
        self._moving.append(artist)
        return artist

    @staticmethod
    def _frame_map(ax: Axes, scene: Scene) -> None:
        corners = np.vstack([*scene.region, scene.positions_W[:, :2], *(agent.region[0] for agent in scene.agents)])
        low, high = corners.min(axis=0), corners.max(axis=0)
        margin = 0.04 * float((high - low).max()) + 1e-6
        ax.set(xlim=(low[0] - margin, high[0] + margin), ylim=(low[1] - margin, high[1] + margin))

    def _make_cells(self, ax: Axes, scene: Scene) -> Callable[[NDArray[np.float64]], None]:
        positions = scene.positions_W[:, :2]
        cell_size = scene.cell_size if scene.cell_size > 0.0 else None
        lattice = find_lattice(Landmarks(positions, cell_size=cell_size)) if len(positions) else None
        if lattice is None:
            diameter = min(9.0, max(2.0, 300.0 / math.sqrt(max(1, len(positions)))))
            dots = self._add(
                ax.scatter(positions[:, 0], positions[:, 1], s=diameter**2, linewidths=0.3, edgecolors=INK, zorder=0.5)
            )
            return lambda shades: dots.set_facecolor(shades)
        image = np.ones((*lattice.index.shape, 4))
        filled = lattice.index >= 0
        image[~filled, 3] = 0.0
        limits = ax.get_xlim(), ax.get_ylim()
        shown = self._add(ax.imshow(image, extent=lattice.extent, origin="lower", interpolation="nearest", zorder=0.5))
        ax.set(xlim=limits[0], ylim=limits[1])
        side = float(np.diff(ax.transData.transform([(0.0, 0.0), (lattice.cell_size, 0.0)])[:, 0])[0])
        loose = self._add(scatter_loose(ax, positions[lattice.loose], side * 72.0 / self._figure.dpi))

        def paint(shades: NDArray[np.float64]) -> None:
            image[filled, :3] = shades[lattice.index[filled]]
            shown.set_data(image)
            loose.set_facecolor(shades[lattice.loose])

        return paint

    def _make_chart(self, scene: Scene) -> None:
        ax = place_axes(self._figure, 8.3, 4.1, 4.1, 2.5)
        curve = np.array(score_curve(self._feed, self._clock))
        ax.step(*curve.T, where="post", color="#C8C8C8", linewidth=1.4)
        if math.isfinite(bound := _last_bound(self._feed)):
            ax.axhline(bound, color=INK, linewidth=1.0, linestyle="--")
        ax.set(xlim=(self._clock[0], max(self._clock[-1], self._clock[0] + 1e-3)), ylabel="score")
        ax.set_xlabel("changes and offers" if self._planned else "time [s]")
        ax.grid(True, color="#E4E4E4", linewidth=0.7)
        for side in ("top", "right"):
            ax.spines[side].set_visible(False)
        self._curve: Any = self._add(ax.step([], [], where="post", color=INK, linewidth=1.8)[0])

    def _update(self, now: float) -> None:
        """Let what moves show the state."""
        view, scene = self._view, self._drawn
        assert scene is not None
        shades = self._shades[np.where(view.owner == NOBODY, len(scene.agents), view.owner)]
        shades[view.trading] = WHITE
        shades[view.weights == GIVEN_UP] = UNOWNED
        self._paint(shades)
        ax, known = self._obstacles
        for obstacle in view.obstacles[known:]:
            self._add(_patch(ax, obstacle.outline))
        self._obstacles = ax, len(view.obstacles)
        poses = view.poses if view.motion is None else view.motion.poses
        yaw = headings(poses)
        gone = view.activity == Activity.GONE
        places = np.where(gone[:, None], np.nan, poses[:, :2])
        self._waypoints.set_offsets(np.where(gone[:, None], np.nan, view.poses[:, :2]))
        self._waypoints.set_visible(view.motion is not None)
        self._agents.set_offsets(places)
        self._agents.set_facecolors(np.where((view.activity == Activity.DEAD)[:, None], UNOWNED, self._palette))
        self._arrows.set_offsets(poses[:, :2])
        self._arrows.set_UVC(*(np.ma.array(part, mask=gone) for part in (np.cos(yaw), np.sin(yaw))))
        for number, pose, is_gone in zip(self._numbers, poses, gone, strict=bool(self._numbers)):
            number.set_position(pose[:2])
            number.set_visible(not is_gone)
        when = "" if self._planned else f"{now:.1f} s,  "
        speed = "" if self._planned or self._speed == 1.0 else f",  {self._speed:g} times as fast"
        self._text.set_text(f"{when}score {view.score:.2f},  trades: {view.trades}{speed}")
        self._lines.set_text("\n".join(reversed(self._log)))
        if self._scores:
            self._curve.set_data(*np.array([*self._scores, (now, self._scores[-1][1])]).T)


def clock_of(feed: Sequence[Scene | Update], run: Run) -> NDArray[np.float64]:
    """Return when each item of a feed is shown: its time, or for a plan how much there was to see before it."""
    if run is Run.PLAN:
        return np.cumsum([isinstance(item, TeamChange | Trading) for item in feed], dtype=np.float64)
    times = [-math.inf if isinstance(item, Scene) else item.time for item in feed]
    rising = np.maximum.accumulate(np.array(times))
    first = rising[np.isfinite(rising)]
    rising[~np.isfinite(rising)] = first[0] if len(first) else 0.0
    return rising


def score_curve(feed: Sequence[Scene | Update], clock: NDArray[np.float64]) -> list[tuple[float, float]]:
    """Return the team score over the clock of a feed."""
    curve = []
    for now, item in zip(clock, feed, strict=True):
        if isinstance(item, TeamState):
            curve.append((float(now), float(item.scores.sum())))
        elif isinstance(item, TeamChange):
            curve.append((float(now), item.score))
    return curve or [(float(clock[0]), 0.0)]


def headings(poses: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the yaw of rows of `covey.runtime.watching.feed.POSE` columns, radians."""
    w, x, y, z = poses[:, 3:].T
    return np.asarray(np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z)))


def _last_bound(feed: Sequence[Scene | Update]) -> float:
    bounds = [item.bound for item in feed if isinstance(item, TeamState) and math.isfinite(item.bound)]
    return bounds[-1] if bounds else math.nan


def _patch(ax: Axes, outline: NDArray[np.float64]) -> Artist:
    return ax.add_patch(Polygon(outline, facecolor="#BDBDBD", edgecolor=INK, hatch="///", linewidth=0.8, alpha=0.7))


def _on(colour: NDArray[np.float64]) -> str:
    """Return black or white, whichever reads on a colour."""
    return "white" if float(colour @ (0.2126, 0.7152, 0.0722)) < 0.45 else INK
