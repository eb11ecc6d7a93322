"""The map of a deployment: region, landmarks coloured by owner, poses.

Colour is never the only cue: cells that are large enough carry their owner's number, otherwise it is written once on
each agent's landmarks.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
from matplotlib.collections import LineCollection, PathCollection, PolyCollection
from matplotlib.patches import PathPatch
from matplotlib.path import Path as Outline
from matplotlib.transforms import Affine2D, IdentityTransform
from numpy.typing import NDArray

from covey.environment import Landmarks
from covey.environment.lattice import Lattice, find_lattice
from covey.geometry import Pose2, Region
from covey.runtime.drawing.palette import colours, is_light, rgb

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from covey.mission import Mission

INK = "#1A1A1A"
FAINT = "#666666"
STYLE: Any = {
    "pdf.fonttype": 42,
    "font.family": "DejaVu Sans",
    "font.size": 9.0,
    "text.usetex": False,
    "text.parse_math": False,
    "axes.edgecolor": FAINT,
    "axes.facecolor": "white",
    "axes.labelcolor": INK,
    "axes.linewidth": 0.8,
    "axes.unicode_minus": False,
    "figure.facecolor": "white",
    "savefig.facecolor": "auto",
    "text.color": INK,
    "xtick.color": FAINT,
    "ytick.color": FAINT,
    "path.simplify": True,
}
"""Set on every figure, whatever the user's matplotlibrc says; names of missions and agents are never read as TeX.

One weight of one font, and ASCII without ligatures (fi) in the texts of our own: each further font or block of
characters would cost a PDF a tenth of a second.
"""

MANY_CELLS = 2500
"""From here on cells are drawn as an image: as single shapes they would make the PDF slow to show."""

MAP_BOX = (6.2, 5.6)
"""Largest size of the map, inches."""

BADGE_TURNS = (0, 35, -35, 70, -70, 105, -105)
"""Where an agent's number may be, in degrees from straight behind it; the first place with room is taken."""


def draw_map(
    ax: Axes,
    mission: Mission,
    poses: Sequence[Pose2],
    owner: NDArray[np.int64],
    *,
    frame: Frame | None = None,
    palette: Sequence[str] | None = None,
    radius: float | None = None,
    present: NDArray[np.bool_] | None = None,
) -> None:
    """Draw region, landmarks coloured by owner, and poses.

    Parameters
    ----------
    ax : matplotlib Axes
    mission : Mission
    poses : sequence of Pose2
        One an agent, frame W.
    owner : array of int64, shape (n,)
        Index of each landmark's owner, -1 for none.
    frame, palette : optional
        What part of the plane is shown at which scale, and the agents' colours; chosen here when absent.
    radius : float, optional
        Size of a pose's mark, points; by default what suits the number of agents.
    present : array of bool, shape (m,), optional
        Whose poses are drawn; by default everybody's.
    """
    palette = palette or colours([agent.name for agent in mission.agents])
    with mpl.rc_context(STYLE):
        if frame is None:
            box = ax.get_window_extent()
            inches = (box.width / ax.figure.dpi, box.height / ax.figure.dpi)
            frame = Frame.around(mission, poses, box=inches, stretch=False)
        frame.apply(ax)
        numbers = [str(index + 1) for index in range(len(poses))]
        numbered = _draw_landmarks(ax, mission.landmarks, owner, palette, numbers, frame)
        for index, agent in enumerate(mission.agents):
            if agent.region is not mission.region:
                _draw_region(ax, agent.region, palette[index], dashed=True)
        _draw_region(ax, mission.region, INK, cells=mission.landmarks.cell_size is not None)
        if radius is None:
            radius = 10.0 if len(poses) <= 8 else 8.0 if len(poses) <= 16 else 6.5 if len(poses) <= 32 else 5.0
        there = range(len(poses)) if present is None else np.flatnonzero(present).tolist()
        marks = np.empty((0, 2))
        if there:
            marks = draw_poses(
                ax, [poses[i] for i in there], [palette[i] for i in there], [numbers[i] for i in there], radius=radius
            )
        if not numbered:
            _number_partitions(ax, mission.landmarks, owner, poses, numbers, frame, marks, radius)
        east, north = ("x, east", "y, north") if mission.georeference is not None else ("x", "y")
        ax.set_xlabel(f"{east} [m]")
        ax.set_ylabel(f"{north} [m]")


@dataclass(frozen=True)
class Frame:
    """The part of the plane that a map shows, metres, and how large it is drawn, inches."""

    x: tuple[float, float]
    y: tuple[float, float]
    width: float
    height: float

    @classmethod
    def around(
        cls,
        mission: Mission,
        poses: Sequence[Pose2],
        *,
        box: tuple[float, float] = MAP_BOX,
        stretch: bool = True,
    ) -> Frame:
        """Show everything in a box of this size, inches; `stretch` keeps narrow scenes from shrinking to a line."""
        half = (mission.landmarks.cell_size or 0.0) / 2.0
        corners = [mission.region.exterior, np.array([pose.position_W for pose in poses]).reshape(-1, 2)]
        corners += [mission.landmarks.positions_W - half, mission.landmarks.positions_W + half]
        corners += [agent.region.exterior for agent in mission.agents if agent.region is not mission.region]
        everything = np.concatenate(corners)
        low, high = everything.min(axis=0), everything.max(axis=0)
        margin = 0.04 * float((high - low).max()) or 1.0
        low, high = low - margin, high + margin
        scale = float(np.min(np.array(box) / (high - low)))
        # A long and narrow scene gets more room across, or nothing could be read.
        least = np.minimum(np.array(box), 2.2) if stretch else np.array(box)
        short = np.maximum(0.0, least / scale - (high - low)) / 2.0
        low, high = low - short, high + short
        width, height = (high - low) * scale
        return cls((float(low[0]), float(high[0])), (float(low[1]), float(high[1])), float(width), float(height))

    @property
    def points_per_metre(self) -> float:
        """Scale of the map."""
        return 72.0 * self.width / (self.x[1] - self.x[0])

    def apply(self, ax: Axes) -> None:
        """Set the limits of axes."""
        ax.set_xlim(*self.x)
        ax.set_ylim(*self.y)
        ax.set_aspect("equal")


def _draw_landmarks(
    ax: Axes,
    landmarks: Landmarks,
    owner: NDArray[np.int64],
    palette: Sequence[str],
    numbers: Sequence[str],
    frame: Frame,
) -> bool:
    """Draw the landmarks and say whether each carries its owner's number."""
    table = np.array([rgb(colour) for colour in palette] + [[1.0, 1.0, 1.0]])
    shades = table[owner]
    lattice = find_lattice(landmarks)
    many = len(landmarks) > MANY_CELLS
    is_cell = np.ones(len(landmarks), dtype=np.bool_)
    if lattice is not None:
        is_cell[lattice.loose] = False
    positions = landmarks.positions_W[is_cell]
    if lattice is not None and many:
        _draw_image(ax, lattice, shades)
    elif landmarks.cell_size is not None:
        half = landmarks.cell_size / 2.0
        square = half * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
        corners = positions[:, None, :] + square
        width = 0.0 if many else 0.5
        cells = PolyCollection(list(corners), facecolors=shades[is_cell], edgecolors="white", linewidths=width)
        cells.set_rasterized(many)
        ax.add_collection(cells, autolim=False)
    else:
        _draw_dots(ax, landmarks, shades, many, frame)
    size = (landmarks.cell_size or 0.0) * frame.points_per_metre
    numbered = size >= 9.0 and not many
    if numbered:
        _number_cells(ax, positions, owner[is_cell], palette, numbers, size)
    if lattice is not None and len(lattice.loose):
        dots: Any = scatter_loose(ax, landmarks.positions_W[lattice.loose], size)
        dots.set_facecolor(shades[lattice.loose])
    return numbered


def scatter_loose(ax: Axes, positions: NDArray[np.float64], size: float) -> PathCollection:
    """Draw landmarks that are no cells of their lattice, whose cells have this size, points."""
    diameter = min(9.0, max(4.0, 0.5 * size))
    x, y = positions.T
    return ax.scatter(x, y, s=diameter**2, linewidths=0.7, edgecolors=INK, zorder=1.2)


def _draw_image(ax: Axes, lattice: Lattice, shades: NDArray[np.float64]) -> None:
    image = np.zeros((*lattice.index.shape, 4))
    filled = lattice.index >= 0
    image[filled, :3] = shades[lattice.index[filled]]
    image[filled, 3] = 1.0
    limits = ax.get_xlim(), ax.get_ylim()
    ax.imshow(image, extent=lattice.extent, origin="lower", interpolation="nearest", zorder=0.5)
    ax.set_xlim(limits[0])
    ax.set_ylim(limits[1])


def _draw_dots(ax: Axes, landmarks: Landmarks, shades: NDArray[np.float64], many: bool, frame: Frame) -> None:
    area = (frame.x[1] - frame.x[0]) * (frame.y[1] - frame.y[0])
    diameter = 0.5 * math.sqrt(area / len(landmarks)) * frame.points_per_metre
    diameter = min(9.0, max(1.5, diameter))
    normals = landmarks.normals_W
    if normals is not None:
        tips = landmarks.positions_W + normals * diameter * 1.3 / frame.points_per_metre
        ticks = LineCollection(list(np.stack([landmarks.positions_W, tips], axis=1)), colors=FAINT, linewidths=0.9)
        ticks.set_rasterized(many)
        ax.add_collection(ticks, autolim=False)
    edge = 0.0 if diameter < 4.0 else 0.4
    dots = _marks([Outline.unit_circle()], [diameter / 2.0], landmarks.positions_W, ax)
    dots.set(facecolors=shades, edgecolors=INK, linewidths=edge)
    dots.set_rasterized(many)
    ax.add_collection(dots, autolim=False)


def _number_cells(
    ax: Axes,
    positions: NDArray[np.float64],
    owner: NDArray[np.int64],
    palette: Sequence[str],
    numbers: Sequence[str],
    size: float,
) -> None:
    """Write the owner's number into each cell; as outlines, since hundreds of texts would be slow."""
    for index, (number, colour) in enumerate(zip(numbers, palette, strict=True)):
        own = positions[owner == index]
        if len(own):
            marks = _marks([_glyphs(number)], [min(8.0, 0.45 * size)], own, ax)
            marks.set(facecolors=INK if is_light(colour) else "white", linewidths=0.0, alpha=0.75)
            ax.add_collection(marks, autolim=False)


def _number_partitions(
    ax: Axes,
    landmarks: Landmarks,
    owner: NDArray[np.int64],
    poses: Sequence[Pose2],
    numbers: Sequence[str],
    frame: Frame,
    marks: NDArray[np.float64],
    radius: float,
) -> None:
    """Write each agent's number once, near the middle of its landmarks and clear of what is drawn at `marks`, points.

    Where the agent itself is there its own number does.
    """
    size = 11.0 if len(numbers) <= 16 else 8.0
    lift = 0.0 if landmarks.cell_size is not None else 1.3 * size / frame.points_per_metre
    normals = landmarks.normals_W
    up = np.tile([0.0, 1.0], (len(owner), 1)) if normals is None else -normals
    for index, (number, pose) in enumerate(zip(numbers, poses, strict=True)):
        own = landmarks.positions_W[owner == index]
        if not len(own):
            continue
        away = np.linalg.norm(own - own.mean(axis=0), axis=1)
        middle = own[np.argmin(away)]
        if np.linalg.norm(middle - pose.position_W) * frame.points_per_metre < 3.0 * radius:
            continue
        places = own + lift * up[owner == index]
        room = np.linalg.norm(_points(ax, places)[:, None, :] - marks, axis=2).min(axis=1)
        middle = places[np.argmin(np.where(room < radius + 0.8 * size, away + away.max(), away))]
        halo, text = (_marks([_glyphs(number)], [size], middle[None, :], ax) for _ in range(2))
        halo.set(facecolors="white", edgecolors="white", linewidths=2.5, zorder=3.0)
        text.set(facecolors=INK, linewidths=0.0, zorder=3.1)
        ax.add_collection(halo, autolim=False)
        ax.add_collection(text, autolim=False)


def _draw_region(ax: Axes, region: Region, colour: str, *, dashed: bool = False, cells: bool = False) -> None:
    def closed(rings: Sequence[NDArray[np.float64]]) -> Outline:
        return Outline.make_compound_path(*(Outline(np.vstack([ring, ring[:1]]), closed=True) for ring in rings))

    style = (0, (5, 2.5)) if dashed else "solid"
    outline = closed([region.exterior, *region.holes])
    if dashed:  # a dark line under the agent's colour, to be seen on cells of the same colour
        ax.add_patch(PathPatch(outline, fill=False, edgecolor=INK, linewidth=2.6, zorder=2.4))
    width = 1.6 if dashed else 1.2
    ax.add_patch(PathPatch(outline, fill=False, edgecolor=colour, linewidth=width, linestyle=style, zorder=2.5))
    if region.holes and not dashed:
        # Over cells, which would hide it, and under dots, which it would hide.
        order, shade = (2.4, FAINT) if cells else (0.4, "#C8C8C8")
        holes = closed(region.holes)
        ax.add_patch(PathPatch(holes, facecolor="none", edgecolor=shade, linewidth=0.0, hatch="////", zorder=order))


def draw_poses(
    ax: Axes, poses: Sequence[Pose2], palette: Sequence[str], numbers: Sequence[str], *, radius: float
) -> NDArray[np.float64]:
    """Draw each pose as the thesis does: a black dot between two round arrows, and a line the way the camera points.

    Returns the centres of what was drawn, cameras and numbers, shape (2m, 2), in points.
    """
    positions = np.array([pose.position_W for pose in poses])
    turns = [Affine2D().rotate(pose.yaw) for pose in poses]

    def add(shape: Outline, order: float, **style: Any) -> None:
        marks = _marks([shape.transformed(turn) for turn in turns], [radius], positions, ax)
        marks.set(zorder=order, clip_on=False, **style)
        ax.add_collection(marks, autolim=False)

    upper = Outline.arc(40.0, 165.0)
    arcs = Outline.make_compound_path(upper, upper.transformed(Affine2D().scale(1.0, -1.0)))
    tips = Outline.make_compound_path(_tip(40.0, 1.0), _tip(40.0, -1.0))
    line = Outline([[0.0, 0.0], [2.0, 0.0]])
    dot = Outline.circle(radius=0.36)
    thin = max(1.0, 0.17 * radius)
    add(arcs, 4.0, facecolors="none", edgecolors="white", linewidths=thin + 2.2, capstyle="round")
    add(tips, 4.0, facecolors="white", edgecolors="white", linewidths=2.2)
    add(line, 4.0, facecolors="none", edgecolors="white", linewidths=thin + 2.6, capstyle="round")
    add(dot, 4.0, facecolors="white", edgecolors="white", linewidths=2.2)
    add(arcs, 4.1, facecolors="none", edgecolors="black", linewidths=thin)
    add(tips, 4.1, facecolors="black", linewidths=0.0)
    add(line, 4.1, facecolors="none", edgecolors="black", linewidths=thin + 0.4, capstyle="round")
    add(dot, 4.2, facecolors="black", linewidths=0.0)
    size = max(5.5, 0.85 * radius)
    centres = _points(ax, positions)
    shift = _badge_shifts(centres, poses, radius, size)
    draw_badges(ax, positions, palette, numbers, size=size, shift=shift)
    return np.concatenate([centres, centres + shift])


def _points(ax: Axes, positions: NDArray[np.float64]) -> NDArray[np.float64]:
    """Where positions, metres, lie on the page, points."""
    places: NDArray[np.float64] = ax.transData.transform(positions) * 72.0 / ax.figure.dpi
    return places


def _badge_shifts(
    centres: NDArray[np.float64], poses: Sequence[Pose2], radius: float, size: float
) -> NDArray[np.float64]:
    """Place each number behind its camera, or where it hides neither another camera nor number: (m, 2), points."""
    shifts = np.zeros((len(poses), 2))
    for index, pose in enumerate(poses):
        others = np.delete(centres, index, axis=0)
        placed = centres[:index] + shifts[:index]
        best = -math.inf
        for turn in BADGE_TURNS:
            angle = pose.yaw + math.pi + math.radians(turn)
            shift = 1.8 * radius * np.array([math.cos(angle), math.sin(angle)])
            place = centres[index] + shift
            room = min(
                float(np.linalg.norm(others - place, axis=1).min(initial=math.inf)) - radius - size,
                float(np.linalg.norm(placed - place, axis=1).min(initial=math.inf)) - 2.0 * size,
            )
            if room > best + 0.5:
                best, shifts[index] = room, shift
            if best >= 0.0:
                break
    return shifts


def draw_badges(
    ax: Axes,
    positions: NDArray[np.float64],
    palette: Sequence[str],
    numbers: Sequence[str],
    *,
    size: float,
    shift: NDArray[np.float64] | None = None,
) -> None:
    """Draw numbers on discs of the agents' colours at positions in data units, moved by `shift`, (n, 2) in points."""
    for index, (number, colour) in enumerate(zip(numbers, palette, strict=True)):
        if not number:
            continue
        move = np.zeros(2) if shift is None else shift[index]
        place = positions[index][None, :]
        disc = _marks([Outline.circle(tuple(move / size), 0.9 if len(number) == 1 else 1.0)], [size], place, ax)
        text = _marks([_glyphs(number).transformed(Affine2D().translate(*(move / size)))], [size], place, ax)
        disc.set(facecolors=colour, edgecolors=INK, linewidths=0.8, zorder=4.3, clip_on=False)
        text.set(facecolors=INK if is_light(colour) else "white", linewidths=0.0, zorder=4.3, clip_on=False)
        ax.add_collection(disc, autolim=False)
        ax.add_collection(text, autolim=False)


def _tip(degrees: float, side: float) -> Outline:
    """Arrow head at the front end of a round arrow, pointing on along the circle."""
    angle = math.radians(degrees)
    place = np.array([math.cos(angle), math.sin(angle)])
    ahead = np.array([math.sin(angle), -math.cos(angle)])
    corners = np.array([place + 0.62 * ahead, place + 0.36 * place, place - 0.36 * place, place + 0.62 * ahead])
    corners[:, 1] *= side
    return Outline(corners, closed=True)


def _marks(
    shapes: Sequence[Outline], sizes: Sequence[float], positions: NDArray[np.float64], ax: Axes
) -> PathCollection:
    """Shapes of a size in points at positions in metres."""
    marks = PathCollection(
        shapes, sizes=[size * size for size in sizes], offsets=positions, offset_transform=ax.transData
    )
    marks.set_transform(IdentityTransform())
    return marks


def _glyphs(text: str) -> Outline:
    """Outline of a text of height one, about its middle."""
    from matplotlib.textpath import TextPath

    path = TextPath((0.0, 0.0), text, size=100.0)
    box = path.get_extents()
    shift = Affine2D().translate(-(box.x0 + box.x1) / 2.0, -(box.y0 + box.y1) / 2.0).scale(0.01)
    return path.transformed(shift)
