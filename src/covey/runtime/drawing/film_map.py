"""What a film shows on its map: the landmarks as they change hands, and the vehicles."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.collections import LineCollection, PathCollection
from matplotlib.patches import Circle, PathPatch
from matplotlib.path import Path as Outline
from matplotlib.textpath import TextPath
from matplotlib.transforms import IdentityTransform
from numpy.typing import NDArray

from covey.environment.lattice import find_lattice
from covey.geometry import Pose2
from covey.runtime.drawing.flight_paths import mark_radius, pale
from covey.runtime.drawing.map_drawing import INK, draw_badges, draw_poses, scatter_loose
from covey.runtime.drawing.palette import rgb
from covey.vehicles.flight_log import FlightLog

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from covey.environment import Landmarks
    from covey.mission import Mission

CHUNKS = 12
"""Pieces of a path that fade one by one."""


class Ground:
    """Landmarks in their owners' colours, and regions; what changes hands fades in from white."""

    FADE = 8.0
    """Pictures that this takes."""

    def __init__(
        self,
        ax: Axes,
        mission: Mission | None,
        moments: Sequence[tuple[float, NDArray[np.int64], Sequence[Pose2]]],
        palette: Sequence[str],
        scale: float,
    ) -> None:
        self.artists: list[Artist] = []
        self._mission = mission
        self._moments = sorted(moments, key=lambda moment: moment[0])
        self._shown = -1
        if mission is None:
            ax.grid(True, color="#E4E4E4", linewidth=0.7)
            ax.set_axisbelow(True)
            return
        landmarks = mission.landmarks
        self._shades = np.array([rgb(colour) for colour in pale(palette)] + [[0.93, 0.93, 0.93]])
        self._changed = np.full(len(landmarks), -math.inf)
        self._owner = np.full(len(landmarks), -1, dtype=np.int64)
        self._paint = self._make_cells(ax, landmarks, scale)
        self._numbers = self._make_numbers(ax, landmarks, palette, scale)
        for region, colour, width in [(mission.region, INK, 1.3)] + [
            (agent.region, palette[i], 1.5)
            for i, agent in enumerate(mission.agents)
            if agent.region is not mission.region
        ]:
            rings = [Outline(np.vstack([ring, ring[:1]]), closed=True) for ring in [region.exterior, *region.holes]]
            outline = Outline.make_compound_path(*rings)
            self.artists.append(ax.add_patch(PathPatch(outline, fill=False, edgecolor=colour, linewidth=width)))
        for artist in self.artists:
            artist.set_animated(True)

    def update(self, now: float, index: int, *, settled: bool = False) -> bool:
        """Show the state at a time, in picture `index`, `settled` without fading; whether anything looks different."""
        if self._mission is None:
            return False
        due = sum(moment[0] <= now + 1e-9 for moment in self._moments) - 1
        if due != self._shown and due >= 0:
            owner = np.asarray(self._moments[due][1])
            if self._shown >= 0:
                self._changed[owner != self._owner] = index
            self._owner, self._shown = owner, due
            for number, (marks, positions) in enumerate(self._numbers):
                marks.set_data(*positions[owner == number].T)
        elif not settled and index - self._changed.max(initial=-math.inf) > self.FADE + 1.0:
            return False
        shown = math.inf if settled else float(index)
        fade = np.clip((shown - self._changed) / self.FADE, 0.0, 1.0)[:, None]
        self._paint(fade * self._shades[self._owner] + (1.0 - fade))
        return True

    def rewind(self) -> None:
        """Forget what was shown."""
        if self._mission is not None:
            self._shown = -1
            self._changed[:] = -math.inf

    def _make_cells(self, ax: Axes, landmarks: Landmarks, scale: float) -> Callable[[NDArray[np.float64]], None]:
        lattice = find_lattice(landmarks)
        if lattice is None:
            area = float(np.ptp(ax.get_xlim()) * np.ptp(ax.get_ylim()))
            diameter = min(9.0, max(2.0, 0.5 * math.sqrt(area / max(1, len(landmarks))) * scale))
            x, y = landmarks.positions_W.T
            dots: Any = ax.scatter(x, y, s=diameter**2, linewidths=0.4 if diameter > 4.0 else 0.0, edgecolors=INK)
            self.artists.append(dots)
            return lambda shades: dots.set_facecolor(shades)
        image = np.zeros((*lattice.index.shape, 4), dtype=np.uint8)
        filled = lattice.index >= 0
        image[filled, 3] = 255
        limits = ax.get_xlim(), ax.get_ylim()
        shown = ax.imshow(image, extent=lattice.extent, origin="lower", interpolation="nearest", zorder=0.5)
        ax.set(xlim=limits[0], ylim=limits[1])
        self.artists.append(shown)
        if lattice.cell_size * scale > 5.0:
            x_min, x_max, y_min, y_max = lattice.extent
            rows, columns = lattice.index.shape
            lines = [[(x, y_min), (x, y_max)] for x in np.linspace(x_min, x_max, columns + 1)]
            lines += [[(x_min, y), (x_max, y)] for y in np.linspace(y_min, y_max, rows + 1)]
            self.artists.append(ax.add_collection(LineCollection(lines, colors="white", linewidths=0.6), autolim=False))
        loose: Any = scatter_loose(ax, landmarks.positions_W[lattice.loose], lattice.cell_size * scale)
        self.artists.append(loose)

        def paint(shades: NDArray[np.float64]) -> None:
            image[filled, :3] = np.rint(255.0 * shades[lattice.index[filled]])
            shown.set_data(image)
            loose.set_facecolor(shades[lattice.loose])

        return paint

    def _make_numbers(self, ax: Axes, landmarks: Landmarks, palette: Sequence[str], scale: float) -> list[Any]:
        """Each owner's number in its cells, where these are large enough."""
        size = (landmarks.cell_size or 0.0) * scale
        if size < 9.0:
            return []
        lattice = find_lattice(landmarks)
        positions = landmarks.positions_W.copy()
        positions[[] if lattice is None else lattice.loose] = math.nan
        numbers = []
        for index in range(len(palette)):
            text = TextPath((0.0, 0.0), str(index + 1), size=10.0)
            box = text.get_extents()
            glyphs = Outline(text.vertices - [(box.x0 + box.x1) / 2.0, (box.y0 + box.y1) / 2.0], text.codes)
            height = min(8.0, 0.4 * size) * max(box.width, box.height) / 7.0
            marks: Any = ax.plot([], [], linestyle="none", marker=glyphs, markersize=height, zorder=1.0)[0]
            marks.set(color=INK, alpha=0.6, markeredgewidth=0.0)
            self.artists.append(marks)
            numbers.append((marks, positions))
        return numbers


class Tracks:
    """Vehicles with their fading paths and waypoints, and moving objects."""

    def __init__(self, ax: Axes, log: FlightLog, palette: Sequence[str], scale: float) -> None:
        n = len(palette)
        self._radius, self._scale, self._log = mark_radius(n), scale, log
        self._rgb = np.array([rgb(colour) for colour in palette])
        self._objects: list[Any] = [
            ax.add_patch(Circle((0.0, 0.0), radius, facecolor="#8C8C8C", edgecolor=INK, alpha=0.85, zorder=2.0))
            for radius in log.object_radii
        ]
        width = 2.4 if n <= 8 else 1.7
        self._ways = LineCollection([], colors=INK, linewidths=0.9, linestyles=(0, (2.0, 3.0)), alpha=0.7)
        self._trails: Any = LineCollection([], capstyle="butt", linewidths=np.repeat([width + 1.4, width], CHUNKS * n))
        for lines in (self._ways, self._trails):
            ax.add_collection(lines, autolim=False)
        size = (0.9 * self._radius) ** 2
        self._goals = ax.scatter(np.zeros(n), np.zeros(n), s=size, marker="o", facecolors=palette, edgecolors="white")
        self._goals.set(linewidths=1.2, alpha=0.95)
        self._dots = ax.scatter(np.zeros(n), np.zeros(n), s=0.12 * size, color=INK)
        self._marks = _Marks(ax, palette, self._radius)
        (self._lost,) = ax.plot([], [], "X", color="#D55E00", markersize=1.7 * self._radius, markeredgecolor="white")
        self.artists: list[Artist] = [
            *self._objects, self._ways, self._goals, self._dots, self._trails, self._marks.collection, self._lost,
        ]  # fmt: skip
        for artist in self.artists:
            artist.set_animated(True)

    def update(
        self,
        positions: NDArray[np.float64],
        yaw: NDArray[np.float64],
        goals: NDArray[np.float64],
        objects: NDArray[np.float64],
        trail: NDArray[np.float64],
        now: float,
    ) -> None:
        """Show the state at a time; `trail` has shape (m, n, 2), oldest first."""
        for circle, place in zip(self._objects, objects, strict=True):
            circle.set_center((float(place[0]), float(place[1])))
        far = np.linalg.norm(goals - positions, axis=1) * self._scale > 0.8 * self._radius
        self._ways.set_segments(list(np.stack([positions[far], goals[far]], axis=1)))
        for marks in (self._goals, self._dots):
            marks.set_offsets(np.where(far[:, None], goals, np.nan))
        self._show_trails(trail)
        self._marks.update(positions, yaw, 1.8 * self._radius / self._scale)
        gone = {
            name for event in self._log.events if event.kind == "lost" and event.time <= now for name in event.vehicles
        }
        lost = [i for i, name in enumerate(self._log.names) if name in gone]
        self._lost.set_data(*positions[lost].T)

    def _show_trails(self, trail: NDArray[np.float64]) -> None:
        """Draw each path in pieces that fade, twice: dark and wide, then in colour."""
        m, n = trail.shape[:2]
        cuts = np.linspace(0, m - 1, CHUNKS + 1).round().astype(np.int64)
        pieces = [trail[a : max(a, b) + 1, i] for a, b in itertools.pairwise(cuts) for i in range(n)]
        fading = np.repeat(((np.arange(CHUNKS) + 1.0) / CHUNKS) ** 0.8, n)
        dark = np.column_stack([np.full((len(fading), 3), 0.1), 0.45 * fading])
        bright = np.column_stack([np.tile(self._rgb, (CHUNKS, 1)), fading])
        self._trails.set_segments(pieces + pieces)
        self._trails.set_color(np.concatenate([dark, bright]))


class _Marks:
    """All poses and numbers as one collection: drawn once by `draw_poses`, then moved and turned for each picture."""

    def __init__(self, ax: Axes, palette: Sequence[str], radius: float) -> None:
        n = len(palette)
        before = len(ax.collections)
        draw_poses(ax, [Pose2(0.0, 0.0, 0.0)], palette[:1], [""], radius=radius)
        camera: list[Any] = list(ax.collections[before:])
        draw_badges(ax, np.zeros((n, 2)), palette, [str(i + 1) for i in range(n)], size=max(5.5, 0.85 * radius))
        badges: list[Any] = list(ax.collections[before + len(camera) :])
        self._shapes = [part.get_paths()[0] for part in camera]
        self._labels = [part.get_paths()[0] for part in badges]
        # Vehicle by vehicle, so that one that covers another covers all of it.
        parts = [part for i in range(n) for part in (*camera, *badges[2 * i : 2 * i + 2])]
        for part in (*camera, *badges):
            part.remove()

        def every(pick: Callable[[Any], NDArray[np.float64]]) -> NDArray[np.float64]:
            return np.array([pick(part)[0] if len(pick(part)) else np.zeros(4) for part in parts])

        self.collection: Any = PathCollection(
            [part.get_paths()[0] for part in parts],
            sizes=[float(part.get_sizes()[0]) for part in parts],
            facecolors=every(lambda part: part.get_facecolor()),
            edgecolors=every(lambda part: part.get_edgecolor()),
            linewidths=[float(part.get_linewidths()[0]) for part in parts],
            capstyle="round",
            offsets=np.zeros((len(parts), 2)),
            offset_transform=ax.transData,
        )
        self.collection.set(transform=IdentityTransform(), clip_on=False)
        ax.add_collection(self.collection, autolim=False)

    def update(self, positions: NDArray[np.float64], yaw: NDArray[np.float64], behind: float) -> None:
        """Move to poses; the numbers are so many metres behind."""
        cosine, sine = np.cos(yaw), np.sin(yaw)
        ahead = np.stack([cosine, sine], axis=1)
        turns = np.stack([ahead, np.stack([-sine, cosine], axis=1)], axis=1)
        paths: list[Outline] = []
        for i, turn in enumerate(turns):
            paths += [Outline(shape.vertices @ turn, shape.codes) for shape in self._shapes]
            paths += self._labels[2 * i : 2 * i + 2]
        k = len(self._shapes)
        places = np.repeat(positions[:, None, :], k + 2, axis=1)
        places[:, k:] -= behind * ahead[:, None, :]
        self.collection.set_paths(paths)
        self.collection.set_offsets(places.reshape(-1, 2))
