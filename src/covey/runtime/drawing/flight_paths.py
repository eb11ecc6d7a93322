"""The paths of a flight, from above and in three dimensions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.patches import Circle, Polygon
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from covey.flight.layout import P
from covey.flight.obstacles import Box, Obstacle, Sphere
from covey.geometry import Pose2
from covey.runtime.drawing.flight_drawing import MANY
from covey.runtime.drawing.map_drawing import FAINT, INK, MAP_BOX, Frame, draw_badges, draw_map, draw_poses
from covey.runtime.drawing.palette import colours, is_light, rgb
from covey.vehicles.flight_log import FlightLog

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from covey.mission import Mission
    from covey.runtime.result import Deployment

PALE = 0.62
"""How far the colours of cells are mixed with white, so that paths can be seen on them."""

DOTTED = 6
"""Up to so many vehicles have dots at equal times on their paths."""


def plan_frame(
    log: FlightLog,
    mission: Mission | None,
    *,
    box: tuple[float, float] = MAP_BOX,
    obstacles: Sequence[Obstacle] = (),
) -> Frame:
    """Choose the part of the plane that shows a flight and its mission, to be drawn in a box of this size, inches."""
    places = [log.state[:, :, P : P + 2].reshape(-1, 2), log.goal[:, :, :2].reshape(-1, 2)]
    places += [(log.objects[:, :, :2] + side * log.object_radii[:, None]).reshape(-1, 2) for side in (-1.0, 1.0)]
    places += [outline(obstacle)[0] for obstacle in obstacles]
    everything = np.concatenate(places)
    everything = everything[np.isfinite(everything).all(axis=1)]
    low, high = everything.min(axis=0), everything.max(axis=0)
    if mission is not None:
        corners = [Pose2(float(x), float(y), 0.0) for x, y in (low, high)]
        return Frame.around(mission, [*corners, *(agent.pose for agent in mission.agents)], box=box)
    margin = 0.08 * float((high - low).max()) or 1.0
    low, high = low - margin, high + margin
    scale = float(np.min(np.array(box) / (high - low)))
    short = np.maximum(0.0, 0.5 * np.array(box) / scale - (high - low)) / 2.0
    low, high = low - short, high + short
    width, height = (high - low) * scale
    return Frame((float(low[0]), float(high[0])), (float(low[1]), float(high[1])), float(width), float(height))


def draw_plan(
    ax: Axes, log: FlightLog, deployment: Deployment | None, frame: Frame, obstacles: Sequence[Obstacle] = ()
) -> str:
    """Draw the paths and obstacles seen from above, over the map of a deployment if there is one.

    Returns
    -------
    str
        What the dots on the paths mean, empty where there are none.
    """
    palette = colours(log.names)
    if deployment is not None:
        draw_map(ax, deployment.mission, deployment.poses, deployment.owner, frame=frame, palette=pale(palette))
    else:
        frame.apply(ax)
        ax.grid(True, color="#E4E4E4", linewidth=0.7)
        ax.set_axisbelow(True)
        ax.set_xlabel("x [m]")
        ax.set_ylabel("y [m]")
    width = 2.0 if len(log.names) <= 8 else 1.4 if len(log.names) <= 20 else 1.0
    interval = _interval(log)
    dots = _moments(log, interval) if len(log.names) <= DOTTED else np.empty(0, dtype=np.int64)
    for index, (name, colour) in enumerate(zip(log.names, palette, strict=True)):
        x, y = log.state[:, index, P], log.state[:, index, P + 1]
        edge = INK if is_light(colour) or deployment is not None else "white"
        ax.plot(x, y, color=edge, linewidth=width + 1.3, alpha=0.65, zorder=3.2, solid_capstyle="round")
        ax.plot(x, y, color=colour, linewidth=width, label=name, zorder=3.3, solid_capstyle="round")
        ax.plot(
            x[dots], y[dots], "o", color=colour, markersize=4.2, markeredgecolor=INK, markeredgewidth=0.6, zorder=3.4
        )
        ax.plot(x[:1], y[:1], "s", color="white", markersize=5.5, markeredgecolor=INK, markeredgewidth=1.0, zorder=3.5)
    draw_obstacles(ax, obstacles)
    _draw_objects(ax, log)
    if deployment is not None:
        # Once more on top, in full colour.
        numbers = [str(index + 1) for index in range(len(palette))]
        draw_poses(ax, deployment.poses, palette, numbers, radius=mark_radius(len(palette)))
    else:
        _number_ends(ax, log, palette, frame)
    return f"squares: starts; dots: every {interval:g} s" if len(dots) else "squares: starts"


def draw_obstacles(ax: Axes, obstacles: Sequence[Obstacle]) -> list[Polygon]:
    """Draw obstacles as seen from above."""
    style: dict[str, Any] = {"facecolor": (0.55, 0.55, 0.55, 0.55), "edgecolor": INK, "hatch": "////", "linewidth": 1.0}
    shapes = [Polygon(outline(obstacle)[0], closed=True, zorder=2.7, **style) for obstacle in obstacles]
    for shape in shapes:
        ax.add_patch(shape)
    return shapes


def outline(obstacle: Obstacle) -> tuple[NDArray[np.float64], float, float]:
    """Return an obstacle's outline seen from above, shape (k, 2), its bottom and its top, metres."""
    if isinstance(obstacle, Sphere):
        turn = np.linspace(0.0, 2.0 * np.pi, 48, endpoint=False)
        x, y, z = obstacle.center_W
        ring = np.column_stack([x + obstacle.radius * np.cos(turn), y + obstacle.radius * np.sin(turn)])
        return ring, z - obstacle.radius, z + obstacle.radius
    if isinstance(obstacle, Box):
        (x0, y0, z0), (x1, y1, z1) = obstacle.min_W, obstacle.max_W
        return np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]]), z0, z1
    return np.array(obstacle.polygon), obstacle.z_min, obstacle.z_max


def draw_space(ax: Any, log: FlightLog, obstacles: Sequence[Obstacle] = ()) -> None:
    """Draw the paths into three-dimensional axes, with their shadows on the ground, and the edges of obstacles."""
    palette = colours(log.names)
    path = log.state[:, :, P : P + 3]
    places = np.concatenate([path.reshape(-1, 3), log.objects.reshape(-1, 3)])
    low, high = np.nanmin(places, axis=0), np.nanmax(places, axis=0)
    low[2] = min(0.0, float(low[2]))
    middle, span = (low + high) / 2.0, np.maximum(1.08 * (high - low), 0.4 * float((high - low).max()) or 1.0)
    span[2] = max(float(high[2] - low[2]), 0.2 * float(span.max()))
    width = 1.8 if len(palette) <= 8 else 1.1
    for index, (name, colour) in enumerate(zip(log.names, palette, strict=True)):
        x, y, z = path[:, index].T
        ax.plot(x, y, np.full_like(z, low[2]), color="#BDBDBD", linewidth=0.8, zorder=1)
        ax.plot(x, y, z, color=colour, linewidth=width, label=name, zorder=3)
        ax.plot(x[:1], y[:1], z[:1], "s", color="white", markersize=4.5, markeredgecolor=INK, markeredgewidth=0.9)
        if len(palette) <= MANY:
            row = int(np.nanargmax(z)) if z[-1] < 0.5 * np.nanmax(z) else len(z) - 1
            ax.text(
                x[row], y[row], z[row], str(index + 1), fontsize=7.5, ha="center", va="center",
                color=INK if is_light(colour) else "white", zorder=10,
                bbox={"boxstyle": "circle,pad=0.22", "facecolor": colour, "edgecolor": INK, "linewidth": 0.7},
            )  # fmt: skip
    for index in range(log.objects.shape[1]):
        ax.plot(*log.objects[:, index].T, color=FAINT, linewidth=1.2, linestyle=":")
    for obstacle in obstacles:
        _draw_edges(ax, obstacle, float(low[2]), float(low[2] + span[2]))
    ax.set_xlim(middle[0] - span[0] / 2, middle[0] + span[0] / 2)
    ax.set_ylim(middle[1] - span[1] / 2, middle[1] + span[1] / 2)
    ax.set_zlim(low[2], low[2] + span[2])
    shape = span.copy()
    shape[2] = min(shape[2], 0.8 * float(shape[:2].max()))  # true to scale unless it would be a tower
    ax.set_box_aspect(tuple(shape), zoom=1.0 - 0.12 * float(shape[2] / shape[:2].max()))
    ax.view_init(elev=26.0, azim=-58.0)
    for axis, name in ((ax.xaxis, "x"), (ax.yaxis, "y"), (ax.zaxis, "z")):
        axis.set_pane_color((1.0, 1.0, 1.0, 0.0))
        axis.set_major_locator(MaxNLocator(nbins=5, steps=[1, 2, 5, 10]))
        axis._axinfo["grid"] |= {"color": "#DDDDDD", "linewidth": 0.6}
        axis.set_label_text(f"{name} [m]")


def _draw_edges(ax: Any, obstacle: Obstacle, bottom: float, top: float) -> None:
    """Draw an obstacle's edges, those of a ball being three circles, as far up and down as the axes go."""
    style = {"color": "#7A7A7A", "linewidth": 1.0, "zorder": 2}
    ring, low, high = outline(obstacle)
    closed = np.vstack([ring, ring[:1]])
    if isinstance(obstacle, Sphere):
        a, b = (closed - obstacle.center_W[:2]).T
        x, y, z = obstacle.center_W
        for u, v, w in ((a, b, 0.0 * a), (a, 0.0 * a, b), (0.0 * a, a, b)):
            ax.plot(x + u, y + v, z + w, **style)
        return
    low, high = max(low, bottom), min(high, top)
    for level in (low, high):
        ax.plot(*closed.T, np.full(len(closed), level), **style)
    for x, y in ring:
        ax.plot([x, x], [y, y], [low, high], **style)


def mark_radius(n: int) -> float:
    """Size of a camera's mark on the map of n agents, points."""
    return 10.0 if n <= 8 else 8.0 if n <= 16 else 6.5 if n <= 32 else 5.0


def pale(palette: Sequence[str]) -> list[str]:
    """Mix colours with white."""
    mixed = [PALE + (1.0 - PALE) * rgb(colour) for colour in palette]
    return ["#" + "".join(f"{round(float(value) * 255):02X}" for value in colour) for colour in mixed]


def _draw_objects(ax: Axes, log: FlightLog) -> None:
    for index, radius in enumerate(log.object_radii):
        x, y = log.objects[:, index, 0], log.objects[:, index, 1]
        ax.plot(x, y, color=FAINT, linewidth=1.2, linestyle=":", zorder=3.1)
        ax.add_patch(Circle((x[-1], y[-1]), radius, facecolor="#9A9A9A", edgecolor=INK, alpha=0.8, zorder=3.1))


def _number_ends(ax: Axes, log: FlightLog, palette: Sequence[str], frame: Frame) -> None:
    """Write each vehicle's number a little beyond the end of its path."""
    if len(palette) > MANY:
        return
    path = log.state[:, :, P : P + 2]
    shift = np.zeros((len(palette), 2))
    for index in range(len(palette)):
        far = path[-1, index] - path[:, index]
        away = np.flatnonzero(np.linalg.norm(far, axis=1) * frame.points_per_metre > 15.0)
        ahead = far[away[-1]] if len(away) else np.array([0.0, 1.0])
        shift[index] = 11.0 * ahead / np.linalg.norm(ahead)
    draw_badges(ax, path[-1], palette, [str(i + 1) for i in range(len(palette))], size=6.0, shift=shift)


def _interval(log: FlightLog) -> float:
    """Seconds between dots: a round number, about a dozen of them."""
    wanted = float(log.time[-1] - log.time[0]) / 12.0
    steps = [s * 10.0**e for e in range(-3, 5) for s in (1, 2, 5)]
    return next((step for step in steps if step >= wanted), wanted)


def _moments(log: FlightLog, interval: float) -> NDArray[np.int64]:
    times = np.arange(log.time[0] + interval, log.time[-1] + 1e-9, interval)
    rows: NDArray[np.int64] = np.clip(np.searchsorted(log.time, times - 1e-9), 0, len(log.time) - 1).astype(np.int64)
    return rows
