"""The pictures of a film: a page that stands still, and what moves on it drawn over a copy of its pixels.

Drawing the whole page anew for every picture would take a hundred times as long.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
from matplotlib.artist import Artist
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from numpy.typing import NDArray
from PIL import Image

from covey.flight.layout import P
from covey.geometry import Pose2
from covey.runtime.drawing.film_map import Ground, Tracks
from covey.runtime.drawing.flight_drawing import (
    EVENT_MARKS,
    clip_text,
    draw_altitude,
    draw_score,
    draw_separation,
    list_rows,
    list_vehicles,
    new_page,
    place_axes,
    style_time_axes,
    write_legend,
    yaws,
)
from covey.runtime.drawing.flight_paths import draw_obstacles, plan_frame
from covey.runtime.drawing.map_drawing import FAINT, INK, STYLE
from covey.runtime.drawing.palette import colours
from covey.vehicles.flight_log import TROUBLE, FlightLog

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from covey.flight.obstacles import Obstacle
    from covey.mission import Mission

WIDTH, HEIGHT = 12.8, 7.2
"""Size of a picture, inches; at 100 dots per inch 1280 x 720 pixels."""

LISTED = 18
"""Names of more vehicles are left out."""

Pixels = NDArray[np.uint8]
Scene = Callable[[float], Pixels | None]


class FilmFrames:
    """Draws the pictures of a film.

    Parameters
    ----------
    log : FlightLog
    times : array, shape (f,)
        The moment of each picture, seconds since the flight began, rising.
    mission : Mission or None
        For its map; without one the paths are shown on an empty plane.
    moments : sequence of (time, owner, poses)
        The owner of each landmark from a time on.
    obstacles : sequence of Obstacle
    appeared : sequence of float
        When each of them appeared, seconds; without, all are there from the start.
    dpi : float
        Dots per inch: the picture measures `WIDTH` x `HEIGHT` inches.
    speed : float
        How much faster than the flight the film is, to be written on it.
    scene : callable, optional
        Gives the picture of the scene at a time, shape (height, width, 3), or None to leave the last one.
    """

    def __init__(
        self,
        log: FlightLog,
        times: NDArray[np.float64],
        *,
        mission: Mission | None,
        moments: Sequence[tuple[float, NDArray[np.int64], Sequence[Pose2]]],
        obstacles: Sequence[Obstacle] = (),
        appeared: Sequence[float] = (),
        dpi: float,
        speed: float,
        scene: Scene | None,
    ) -> None:
        self.log, self.times, self.scene = log, times, scene
        self.palette = colours(log.names)
        self._places, self._yaw, self._goals, self._objects = _at(log, times)
        self._before = _rows_before(log, times)
        with mpl.rc_context(STYLE):
            self.figure = new_page(WIDTH, HEIGHT)
            self.canvas = _canvas(self.figure)
            self.figure.set_dpi(dpi)
            self._tail = max(1, int(np.searchsorted(times, times[0] + 4.0 * speed)))
            title = "Flight" if mission is None else clip_text(mission.name, 60)
            self.figure.text(0.55 / WIDTH, 1.0 - 0.3 / HEIGHT, title, fontsize=16, va="center")
            listed = 1 < len(log.names) <= LISTED
            top = HEIGHT - 0.6 - (0.21 * list_rows(len(log.names), WIDTH - 1.0) + 0.05 if listed else 0.0)
            if listed:
                strip = place_axes(self.figure, 0.55, top, WIDTH - 1.0, HEIGHT - 0.6 - top)
                strip.set(xlim=(0.0, WIDTH - 1.0), ylim=(0.0, HEIGHT - 0.6 - top))
                strip.set_axis_off()
                list_vehicles(strip, log.names, range(len(log.names)), self.palette)
            frame = plan_frame(log, mission, box=(6.5, top - 1.15), obstacles=obstacles)
            self._left = max(6.0, 0.65 + frame.width + 0.35)
            up = 1.05 + (top - 1.15 - frame.height) / 2.0
            self.map = place_axes(self.figure, 0.65, up, frame.width, frame.height)
            frame.apply(self.map)
            self.map.set_xlabel("x [m]")
            self.map.set_ylabel("y [m]")
            self._scale = frame.points_per_metre
            self._ground = Ground(self.map, mission, moments, self.palette, self._scale)
            shapes = draw_obstacles(self.map, obstacles)
            for shape in shapes:
                shape.set_animated(True)
                self._ground.artists.append(shape)
            self._appearing = list(zip(shapes, appeared or [-math.inf] * len(shapes), strict=True))
            self._tracks = Tracks(self.map, log, self.palette, self._scale)
            self._first = self._picture_of_scene(float(times[0]), None)
            self._side(top - 0.1)
            self._foot(speed)
            self.canvas.draw()
        self._page: Any = self.canvas.copy_from_bbox(self.figure.bbox)
        self._with_ground: Any = None

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of a picture, pixels."""
        width, height = self.canvas.get_width_height()
        return int(width), int(height)

    def picture(self, index: int) -> Pixels:
        """Draw picture `index`, shape (height, width, 4); it is good until the next one is drawn."""
        now = float(self.times[index])
        renderer = self.canvas.get_renderer()
        changed = self._ground.update(now, index, settled=index == len(self.times) - 1)
        for shape, since in self._appearing:
            if shape.get_visible() != (since <= now):
                shape.set_visible(since <= now)
                changed = True
        if self._update_texts(index, now) or changed or self._with_ground is None:
            self.canvas.restore_region(self._page)
            for artist in (*self._ground.artists, self._score, self._event):
                artist.draw(renderer)
            self._with_ground = self.canvas.copy_from_bbox(self.figure.bbox)
        else:
            self.canvas.restore_region(self._with_ground)
        first = max(0, index - self._tail)
        stride = max(1, (index - first) // 60)
        trail = self._places[first : index + 1][::-1][::stride][::-1]
        places, yaw, goals, objects = (
            values[index] for values in (self._places, self._yaw, self._goals, self._objects)
        )
        self._tracks.update(places, yaw, goals, objects, trail, now)
        for artist in self._tracks.artists:
            artist.draw(renderer)
        self._update_side(index, now)
        for artist in self._moving:
            artist.draw(renderer)
        pixels: Pixels = np.asarray(self.canvas.buffer_rgba())
        if self.scene is not None:
            pixels = pixels.copy()
            self._first = self._picture_of_scene(now, self._first)
            if self._first is not None:
                x, y = self._scene_at
                height, width = self._first.shape[:2]
                pixels[y : y + height, x : x + width, :3] = self._first
        return pixels

    def rewind(self) -> None:
        """Forget what was drawn, to begin again."""
        self._ground.rewind()
        self._with_ground = None

    def _side(self, top: float) -> None:
        """Charts over time, and above them the scene."""
        left, width, log = self._left, WIDTH - self._left - 0.3, self.log
        if self._first is not None:
            height = self._first.shape[0] / self.figure.dpi
            self._scene_at = (round(left * self.figure.dpi), round((HEIGHT - top - 0.1) * self.figure.dpi))
            top -= height + 0.25
        draw: list[tuple[float, Callable[[Axes], None]]] = []
        if not np.isnan(log.score_committed).all():
            draw.append((1.5, lambda ax: draw_score(ax, log)))
        if np.isfinite(log.separation).any() and (self._first is None or not draw):
            draw.append((1.1, lambda ax: draw_separation(ax, log)))
        if self._first is None or not draw:
            draw.append((1.1, lambda ax: draw_altitude(ax, log)))
        head, gap = 0.25, 0.36
        stretch = (top - 1.05 - head * 1 - gap * (len(draw) - 1)) / sum(height for height, _ in draw)
        axes, upper = [], top - head
        for height, _ in draw:
            axes.append(place_axes(self.figure, left + 0.45, upper - stretch * height, width - 0.45, stretch * height))
            upper -= stretch * height + gap
        style_time_axes(axes, log)
        self._moving: list[Artist] = []
        self._future: list[Rectangle] = []
        self._cursors = []
        for ax, (_, painter) in zip(axes, draw, strict=True):
            painter(ax)
            if "altitude" not in ax.get_ylabel():
                write_legend(ax)
            future = Rectangle((0.0, 0.0), 1.0, 1.0, facecolor="white", alpha=0.78, linewidth=0.0, zorder=5.0)
            future.set_transform(ax.get_xaxis_transform())
            ax.add_patch(future)
            cursor = ax.axvline(0.0, color=INK, linewidth=1.2, zorder=6.0)
            self._future.append(future)
            self._cursors.append(cursor)
            self._moving += [future, cursor]

    def _foot(self, speed: float) -> None:
        """Time, score, the last event, and how far the film is."""
        log = self.log
        bar = place_axes(self.figure, 0.55, 0.16, WIDTH - 0.85, 0.14)
        bar.set_axis_off()
        bar.set_xlim(float(log.time[0]), float(log.time[-1]))
        bar.set_ylim(0.0, 1.0)
        bar.add_patch(Rectangle((log.time[0], 0.3), log.time[-1] - log.time[0], 0.4, color="#DDDDDD", linewidth=0.0))
        self._bar = Rectangle((log.time[0], 0.3), 0.0, 0.4, color="#0072B2", linewidth=0.0, zorder=2.0)
        bar.add_patch(self._bar)
        for event in log.events:
            _, colour, _ = EVENT_MARKS.get(event.kind, ("", FAINT, ""))
            grave = event.kind in TROUBLE
            size = 3.0 if grave else 1.0
            bar.plot([event.time] * 2, [0.0, 1.0], color=colour, linewidth=size, zorder=2.5 if grave else 1.5)
        place: dict[str, Any] = {"va": "center"}
        y = 1.0 - 0.3 / HEIGHT
        self._clock = self.figure.text(1.0 - 1.25 / WIDTH, y, "", fontsize=16, ha="right", **place)
        self.figure.text(1.0 - 0.3 / WIDTH, y, f"x {speed:g}", fontsize=12, ha="right", color=FAINT, **place)
        self._score = self.figure.text(0.5, y, "", fontsize=13, ha="center", **place)
        self._event = self.figure.text(0.55 / WIDTH, 0.45 / HEIGHT, "", fontsize=11, ha="left", **place)
        self._linger = 2.5 * speed
        self._moving += [self._bar, self._clock]
        for artist in (*self._moving, self._score, self._event):
            artist.set_animated(True)

    def _update_side(self, index: int, now: float) -> None:
        log, end = self.log, float(self.log.time[-1])
        for future, cursor in zip(self._future, self._cursors, strict=True):
            future.set_x(now)
            future.set_width(end - now)
            cursor.set_xdata([now, now])
        self._bar.set_width(now - float(log.time[0]))
        self._clock.set_text(f"{now:.1f} s")

    def _update_texts(self, index: int, now: float) -> bool:
        """Write what rarely changes; whether it did."""
        committed = self.log.score_committed[self._before[index]]
        recent = [event for event in self.log.events if now - self._linger < event.time <= now]
        shown = ([event for event in recent if event.kind in TROUBLE] or recent)[-1:]
        texts = (
            f"score {committed:.2f}" if math.isfinite(committed) else "",
            f"{shown[0].time:.1f} s: {clip_text(shown[0].text, 110)}" if shown else "",
        )
        changed = texts != (self._score.get_text(), self._event.get_text())
        self._score.set_text(texts[0])
        self._event.set_text(texts[1])
        return changed

    def _picture_of_scene(self, now: float, last: Pixels | None) -> Pixels | None:
        """The scene at a time, as wide as its place on the page."""
        pixels = None if self.scene is None else self.scene(now)
        if pixels is None:
            return last
        width = round((WIDTH - self._left - 0.3) * self.figure.dpi)
        height = min(round(width * pixels.shape[0] / pixels.shape[1]), round(3.4 * self.figure.dpi))
        if last is not None:
            height, width = last.shape[:2]
        image = Image.fromarray(np.ascontiguousarray(pixels[:, :, :3]))
        return np.array(image.resize((width, height), Image.Resampling.BILINEAR, reducing_gap=2.0), dtype=np.uint8)


def _canvas(figure: Figure) -> Any:  # its types leave out most of what it can do
    return FigureCanvasAgg(figure)


def _at(log: FlightLog, times: NDArray[np.float64]) -> tuple[NDArray[np.float64], ...]:
    """Positions (f, n, 2), headings (f, n), waypoints (f, n, 2) and objects (f, m, 2) at times, between samples too."""
    before = _rows_before(log, times)
    after = np.minimum(before + 1, len(log.time) - 1)
    span = log.time[after] - log.time[before]
    share = np.where(span > 0.0, (times - log.time[before]) / np.where(span > 0.0, span, 1.0), 0.0).clip(0.0, 1.0)
    turned = np.unwrap(np.nan_to_num(yaws(log)), axis=0)

    def between(values: NDArray[np.float64]) -> NDArray[np.float64]:
        part = share.reshape(-1, *[1] * (values.ndim - 1))
        mixed: NDArray[np.float64] = (1.0 - part) * values[before] + part * values[after]
        return mixed

    return between(log.state[:, :, P : P + 2]), between(turned), log.goal[before, :, :2], between(log.objects[:, :, :2])


def _rows_before(log: FlightLog, times: NDArray[np.float64]) -> NDArray[np.int64]:
    """The last sample at or before each time."""
    rows = np.searchsorted(log.time, times + 1e-9, side="right") - 1
    return np.clip(rows, 0, len(log.time) - 1).astype(np.int64)
