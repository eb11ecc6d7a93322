"""Parts of the figures of a flight: pages, panels over time, lists and marks."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullLocator
from numpy.typing import NDArray

from covey.errors import ArgumentError
from covey.flight.layout import QUAT, REF_P, P, V
from covey.runtime.drawing.figures import DPI
from covey.runtime.drawing.map_drawing import FAINT, INK, draw_badges
from covey.runtime.drawing.palette import OKABE_ITO, colours
from covey.vehicles.flight_log import ARRIVALS, FlightLog

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from covey.runtime.result import Deployment

MANY = 32
"""Lines of more vehicles carry no numbers: there is no room."""

BLUE, RED, GREEN, ORANGE = (OKABE_ITO[name] for name in ("blue", "red", "green", "orange"))
EVENT_MARKS = {
    "takeoff": ("^", GREEN, "take-off"),
    "reached": ("o", BLUE, "reached"),
    "trade": ("D", ORANGE, "trade"),
    "missed": ("s", RED, "missed"),
    "fault": ("P", RED, "fault"),
    "lost": ("X", RED, "lost"),
    "collision": ("*", RED, "collision"),
    "outside": ("d", RED, "outside its region"),
    "airborne": ("^", BLUE, "at its altitude"),
    "home": ("v", BLUE, "above its start"),
    "landed": ("v", GREEN, "landed"),
}
"""Marker, colour and label of each kind of event; others are grey."""

JUMP = 0.1
"""Metres that the separation may change between two rows beside what vehicles move."""

EVENT_ROW = 0.17
"""Height of a row of events, inches."""


def draw_score(ax: Axes, log: FlightLog, deployment: Deployment | None = None) -> None:
    """Draw the scores of a flight over time into axes, and marks of its events along their upper edge."""
    ax.step(log.time, log.score_committed, where="post", color=BLUE, linewidth=1.8, label="at committed poses")
    ax.plot(log.time, log.score_flown, color=RED, linewidth=1.2, linestyle="-", label="as flown")
    if deployment is not None:
        final = deployment.score.final
        ax.axhline(final, color=GREEN, linestyle=":", linewidth=1.6, label=f"at the end {final:.2f}")
        bound = deployment.bound
        if bound is not None and math.isfinite(bound.team_upper_bound):
            text = f"at most {bound.team_upper_bound:.2f}"
            ax.axhline(bound.team_upper_bound, color=INK, linestyle="--", linewidth=1.1, label=text)
    ax.set_ylabel("score of the team")


def draw_separation(ax: Axes, log: FlightLog) -> None:
    """Draw the separation of a flight over time into axes; far distances are cut off, they do not matter."""
    required = log.required_separation
    shown = np.where(np.isfinite(log.separation), log.separation, np.nan)
    gaps = _pair_changes(log)
    ax.plot(np.insert(log.time, gaps, log.time[gaps]), np.insert(shown, gaps, np.nan), color=BLUE, linewidth=1.6,
            label="closest two vehicles")  # fmt: skip
    text = f"required, {required:.2f} m"
    ax.axhline(required, color=RED, linewidth=1.4, linestyle="--", label=text)
    ax.axhspan(0.0, required, color=RED, alpha=0.08, linewidth=0.0, zorder=0.3)
    if np.isfinite(log.separation).any():
        least = int(np.nanargmin(shown))
        ax.plot(log.time[least], shown[least], "o", color=INK, markersize=4.5, label=f"least, {shown[least]:.2f} m")
    ax.set_ylim(0.0, max(1.5 * required, min(1.08 * peak(shown), 8.0 * required)))
    ax.set_ylabel("separation [m]")


def _pair_changes(log: FlightLog) -> NDArray[np.int64]:
    """Rows at which the separation has changed more than vehicles move: one of a close pair took off or landed."""
    speed = np.linalg.norm(log.state[:, :, V : V + 3], axis=2).max(axis=1)
    moved = 2.0 * np.maximum(speed[1:], speed[:-1]) * np.diff(log.time)
    apart = np.where(np.isfinite(log.separation), log.separation, np.nan)
    return np.flatnonzero(np.abs(np.diff(apart)) > 1.5 * moved + JUMP) + 1


def draw_altitude(ax: Axes, log: FlightLog) -> None:
    """Draw the altitude of every vehicle over time into axes."""
    chosen = list(range(len(log.names)))
    draw_lines(ax, log, chosen, log.state[:, :, P + 2])
    ax.set_ylim(bottom=min(0.0, float(np.nanmin(log.state[:, :, P + 2], initial=0.0))))
    ax.set_ylabel("altitude [m]")


def draw_errors(ax: Axes, log: FlightLog) -> None:
    """Draw the norm of every vehicle's position error over time into axes."""
    errors = log.state[:, :, P : P + 3] - log.reference[:, :, REF_P : REF_P + 3]
    draw_lines(ax, log, list(range(len(log.names))), np.linalg.norm(errors, axis=2))
    ax.set_ylim(bottom=0.0)
    ax.set_ylabel("position error [m]")


def event_rows(log: FlightLog) -> list[str]:
    """Kinds of events that a flight had, in the order in which `draw_events` lists them from above."""
    kinds = list(dict.fromkeys(event.kind for event in log.events))
    return [kind for kind in EVENT_MARKS if kind in kinds] + [kind for kind in kinds if kind not in EVENT_MARKS]


def draw_events(ax: Axes, log: FlightLog) -> None:
    """Draw the events of a flight over time into axes, a row for each kind."""
    rows = event_rows(log)
    for row, kind in enumerate(rows):
        marker, colour, _ = EVENT_MARKS.get(kind, ("d", FAINT, kind))
        times = [event.time for event in log.events if event.kind == kind]
        ax.plot(times, [row] * len(times), marker, color=colour, markersize=6.5 if marker == "*" else 4.5,
                markeredgecolor="white", markeredgewidth=0.4, clip_on=False, zorder=3.0, label=kind)  # fmt: skip
    ax.set_ylim(len(rows) - 0.4, -0.6)
    labels = [EVENT_MARKS[kind][2] if kind in EVENT_MARKS else clip_text(kind, 16) for kind in rows]
    ax.set_yticks(range(len(rows)), labels, fontsize=8.0)
    ax.tick_params(axis="y", length=0)


def tilts(log: FlightLog) -> NDArray[np.float64]:
    """Angle between the body's z axis and the vertical, shape (k, n), radians."""
    x, y = log.state[:, :, QUAT + 1], log.state[:, :, QUAT + 2]
    angle: NDArray[np.float64] = np.arccos(np.clip(1.0 - 2.0 * (x * x + y * y), -1.0, 1.0))
    return angle


def yaws(log: FlightLog) -> NDArray[np.float64]:
    """Heading of the body's x axis, shape (k, n), radians."""
    w, x, y, z = (log.state[:, :, QUAT + i] for i in range(4))
    angle: NDArray[np.float64] = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    return angle


def check_log(log: FlightLog) -> None:
    """Check that there is something to draw.

    Raises
    ------
    ArgumentError
        If the log has fewer than two moments or no vehicle.
    """
    if len(log.time) < 2 or not log.names:
        got = f"{len(log.time)} moments of {len(log.names)} vehicles"
        raise ArgumentError(f"log: expected two moments of one vehicle or more, got {got}; record a flight first")


def clip_text(text: str, length: int) -> str:
    """Make text fit a line: no control characters, no glyphs that the font lacks, at most `length` characters."""
    from matplotlib.font_manager import findfont, get_font

    font = get_font(findfont("DejaVu Sans"))
    shown = "".join(
        character if character.isprintable() and (character.isascii() or font.get_char_index(ord(character))) else "?"
        for character in text
    )
    return shown if len(shown) <= length else f"{shown[: length - 1]}…"


def list_vehicles(ax: Axes, names: Sequence[str], numbers: Sequence[int], palette: Sequence[str]) -> None:
    """Write numbered names, row by row, into axes without frame whose limits are their size in inches."""
    across = max(1, int(ax.get_xlim()[1] / 1.35))
    top = ax.get_ylim()[1]
    places = np.array([[0.09 + 1.35 * (i % across), top - 0.12 - 0.21 * (i // across)] for i in range(len(names))])
    draw_badges(ax, places, palette, [str(number + 1) for number in numbers], size=6.0)
    for name, (x, y) in zip(names, places, strict=True):
        ax.text(x + 0.13, y, clip_text(name, 14), va="center", fontsize=8.0)


def list_rows(count: int, width: float) -> int:
    """How many rows `list_vehicles` needs in so many inches."""
    return math.ceil(count / max(1, int(width / 1.35)))


def new_page(width: float, height: float) -> Figure:
    """Make a figure of a size in inches."""
    figure = Figure(figsize=(width, height), dpi=DPI)
    FigureCanvasAgg(figure)
    return figure


def place_axes(figure: Figure, left: float, bottom: float, width: float, height: float, **options: Any) -> Axes:
    """Add axes at a place given in inches from the figure's lower left corner."""
    across, up = figure.get_figwidth(), figure.get_figheight()
    return figure.add_axes((left / across, bottom / up, width / across, height / up), **options)


def write_title(figure: Figure, title: str, subtitle: str, left: float = 0.75) -> None:
    """Write a title and a line below it along the figure's upper edge."""
    width, height = figure.get_figwidth(), figure.get_figheight()
    figure.text(left / width, 1.0 - 0.24 / height, title, fontsize=13, va="center")
    figure.text(left / width, 1.0 - 0.48 / height, subtitle, fontsize=9, color=FAINT, va="center")


def style_time_axes(axes: Sequence[Axes], log: FlightLog) -> None:
    """Let axes above each other share the time of a flight."""
    begin, end = float(log.time[0]), float(log.time[-1])
    for ax in axes:
        ax.set_xlim(begin, end if end > begin else begin + 1.0)
        ax.grid(True, color="#E4E4E4", linewidth=0.7)
        ax.set_axisbelow(True)
        ax.yaxis.set_major_locator(MaxNLocator(nbins=5, steps=[1, 2, 2.5, 5, 10]))
        for side in ("top", "right"):
            ax.spines[side].set_visible(False)
        ax.tick_params(labelbottom=ax is axes[-1])
    axes[-1].set_xlabel("time [s]")


def draw_lines(ax: Axes, log: FlightLog, chosen: Sequence[int], values: NDArray[np.float64]) -> None:
    """Draw a line a vehicle; several carry their numbers, each at a time of its own so that they never overlap."""
    palette = colours(log.names)
    width = 1.6 if len(chosen) <= 4 else 1.2 if len(chosen) <= 12 else 0.9
    for column, index in enumerate(chosen):
        ax.plot(log.time, values[:, column], color=palette[index], linewidth=width, label=log.names[index])
    if not 1 < len(chosen) <= MANY:
        return
    shares = (np.arange(len(chosen)) + 0.5) / len(chosen)
    moments = log.time[0] + shares * (log.time[-1] - log.time[0])
    places, numbers = np.zeros((len(chosen), 2)), [""] * len(chosen)
    for column, index in enumerate(chosen):
        drawn = np.flatnonzero(np.isfinite(values[:, column]))
        if len(drawn):
            row = drawn[np.argmin(np.abs(log.time[drawn] - moments[column]))]
            places[column], numbers[column] = (log.time[row], values[row, column]), str(index + 1)
    size = 5.0 if len(chosen) <= 16 else 4.0
    draw_badges(ax, places, [palette[i] for i in chosen], numbers, size=size)


def scale_logarithmically(ax: Axes, values: NDArray[np.float64], *, span: float) -> float:
    """Scale y logarithmically, downwards to the largest value over `span` at most, and return that lower limit.

    Where nothing is above zero, as for a vehicle that follows exactly, the scale stays linear and the limit is 0.
    """
    positive = values[np.isfinite(values) & (values > 0.0)]
    if not len(positive):
        return 0.0
    top = float(positive.max())
    low = max(float(positive.min()), top / span)
    ax.set_yscale("log")
    ax.set_ylim(low / 2.0, 2.0 * top)
    decades = math.ceil(math.log10(4.0 * top / low))
    ax.yaxis.set_major_locator(LogLocator(10.0 ** max(1, decades // 5)))
    ax.yaxis.set_minor_locator(NullLocator())
    ax.yaxis.set_major_formatter(FuncFormatter(_decimal))
    return low / 2.0


def _decimal(value: float, _: Any) -> str:
    return f"{value:g}" if 1e-3 < value < 1e4 else f"{value:.0e}".replace("e-0", "e-")


def write_legend(ax: Axes, handles: Sequence[Any] | None = None, columns: int = 6) -> None:
    """Write a legend above axes, where it hides nothing."""
    handles = list(handles) if handles is not None else ax.get_legend_handles_labels()[0]
    ax.legend(
        handles=handles,
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0),
        bbox_transform=ax.transAxes,
        borderaxespad=0.25,
        borderpad=0.1,
        ncols=columns,
        frameon=False,
        fontsize=8.5,
        handlelength=1.8,
        columnspacing=1.2,
        labelspacing=0.25,
    )


def under_way(log: FlightLog, index: int) -> list[tuple[float, float]]:
    """When a vehicle was on its way: from each new waypoint to the moment it was reached, or the next one."""
    goal = np.nan_to_num(log.goal[:, index], nan=math.inf)
    changes = np.flatnonzero((goal[1:] != goal[:-1]).any(axis=1)) + 1
    starts = [0, *changes.tolist()]
    ends = [*changes.tolist(), len(log.time) - 1]
    reached = [e.time for e in log.events if e.kind in ARRIVALS and log.names[index] in e.vehicles]
    if not reached and len(starts) < 3:
        return []  # a single waypoint throughout: shading everything would tell nothing
    spans = []
    for start, end in zip(starts, ends, strict=True):
        if np.isinf(goal[start]).any():
            continue
        begin, limit = float(log.time[start]), float(log.time[end])
        spans.append((begin, min((t for t in reached if begin < t <= limit), default=limit)))
    return spans


def peak(values: NDArray[np.float64]) -> float:
    """Return the largest finite value, 0 where there is none."""
    finite = values[np.isfinite(values)]
    return float(finite.max()) if len(finite) else 0.0
