"""Figures of a flight: where the vehicles were, how well they tracked, how far apart they kept, what the team saw.

Like those of `covey.runtime.drawing.figures` they are made without pyplot and saved with `save_figure`.  Where vehicles
are told apart each has its colour and its number, which stands on its line, so that colour is never the only cue.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from covey.errors import ArgumentError
from covey.flight.layout import GRAVITY, OMEGA, REF_P, REF_V, SIG_V1, SIG_V2, SIG_V3, P, V
from covey.runtime.drawing.flight_drawing import (
    BLUE,
    EVENT_ROW,
    GREEN,
    MANY,
    RED,
    check_log,
    clip_text,
    draw_altitude,
    draw_errors,
    draw_events,
    draw_lines,
    draw_score,
    draw_separation,
    event_rows,
    list_rows,
    list_vehicles,
    new_page,
    peak,
    place_axes,
    scale_logarithmically,
    style_time_axes,
    tilts,
    under_way,
    write_legend,
    write_title,
)
from covey.runtime.drawing.flight_paths import draw_plan, draw_space, plan_frame
from covey.runtime.drawing.map_drawing import FAINT, INK, STYLE
from covey.runtime.drawing.palette import colours
from covey.vehicles.flight_log import FlightLog

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from covey.flight.obstacles import Obstacle
    from covey.runtime.result import Deployment

WIDTH = 6.9
"""Width of a panel over time, inches."""

COMPONENTS = (("x", BLUE, "-"), ("y", RED, "--"), ("z", GREEN, "-."))
"""Name, colour and line of each component of a vector."""


def position_figure(log: FlightLog, vehicle: int | str | None = None) -> Figure:
    """Draw x, y and z over time against the reference, as Figures 2.2, 2.6 and 3.1 of the thesis do.

    Parameters
    ----------
    log : FlightLog
    vehicle : int or str, optional
        Index or name of the vehicle; all of them when absent.

    Raises
    ------
    ArgumentError
        If the log is empty or has no such vehicle.
    """
    chosen = _chosen(log, vehicle)
    with mpl.rc_context(STYLE):
        figure, axes = _stack(log, chosen, "Position", [1.55, 1.55, 1.55])
        for axis, (ax, (name, _, _)) in enumerate(zip(axes, COMPONENTS, strict=True)):
            measured, wanted = log.state[:, chosen, P + axis], log.reference[:, chosen, REF_P + axis]
            if len(chosen) > 1:
                ax.plot(log.time, wanted, color=INK, linewidth=0.6, linestyle=(0, (3, 2)), zorder=1.8)
                draw_lines(ax, log, chosen, measured)
            else:
                goal = log.goal[:, chosen[0], axis]
                if not np.isnan(goal).all():
                    ax.plot(log.time, goal, color="#A0A0A0", linewidth=1.0, linestyle=":", label="waypoint")
                ax.plot(log.time, measured[:, 0], color=BLUE, linewidth=1.8, label="flown")
                ax.plot(log.time, wanted[:, 0], color=INK, linewidth=1.0, linestyle="--", label="reference")
            ax.set_ylabel(f"{name} [m]")
        if len(chosen) == 1:
            write_legend(axes[0])
        else:
            write_legend(axes[0], [Line2D([], [], color=INK, linewidth=0.8, linestyle="--", label="reference")])
    return figure


def error_figure(log: FlightLog, vehicle: int | str | None = None, which: str = "position") -> Figure:
    """Draw the error against the reference, as Figures 2.3, 2.4, 2.7 and 2.8 of the thesis do.

    Parameters
    ----------
    log : FlightLog
    vehicle : int or str, optional
        Of one vehicle the components and the norm are drawn; of all, when absent, the norms.
    which : str
        ``"position"``, p - p*, or ``"velocity"``, v - v*.

    Raises
    ------
    ArgumentError
        If the log is empty, has no such vehicle, or `which` is something else.
    """
    columns = {"position": (P, REF_P, "m"), "velocity": (V, REF_V, "m/s")}
    if which not in columns:
        raise ArgumentError(f"which: expected 'position' or 'velocity', got {which!r}")
    chosen = _chosen(log, vehicle)
    first, wanted, unit = columns[which]
    errors = log.state[:, chosen, first : first + 3] - log.reference[:, chosen, wanted : wanted + 3]
    norms = np.linalg.norm(errors, axis=2)
    with mpl.rc_context(STYLE):
        title = f"{which.capitalize()} error"
        if len(chosen) > 1:
            figure, (ax,) = _stack(log, chosen, title, [3.4], f"at most {peak(norms):.3g} {unit}")
            draw_lines(ax, log, chosen, norms)
            ax.set_ylim(bottom=0.0)
            ax.set_ylabel(f"norm of the error [{unit}]")
            return figure
        figure, (top, bottom) = _stack(log, chosen, title, [2.7, 1.7], f"at most {peak(norms):.3g} {unit}")
        for axis, (name, colour, style) in enumerate(COMPONENTS):
            top.plot(log.time, errors[:, 0, axis], color=colour, linestyle=style, linewidth=1.6, label=name)
        top.axhline(0.0, color=FAINT, linewidth=0.7, zorder=1.5)
        top.set_ylabel(f"error [{unit}]")
        bottom.plot(log.time, norms[:, 0], color=INK, linewidth=1.4, label="norm")
        scale_logarithmically(bottom, norms, span=1e6)
        bottom.set_ylabel(f"its norm [{unit}]")
        write_legend(top)
    return figure


def lyapunov_figure(log: FlightLog, vehicle: int | str | None = None) -> Figure:
    """Draw the Lyapunov functions of the controller, as Figures 2.5 and 2.9 of the thesis do.

    Parameters
    ----------
    log : FlightLog
    vehicle : int or str, optional
        Of one vehicle V1, V2 and V3 are drawn, shaded while it is under way to a waypoint; of all, when absent, V3.

    Raises
    ------
    ArgumentError
        If the log is empty or has no such vehicle.

    Notes
    -----
    Source: Sposato (2016), section 2.2 (V1), eqs. (2.8) (V2) and (2.18) (V3).
    """
    chosen = _chosen(log, vehicle)
    v3 = log.signals[:, chosen, SIG_V3]
    with mpl.rc_context(STYLE):
        if len(chosen) > 1:
            figure, (ax,) = _stack(log, chosen, "Lyapunov function V3", [3.4])
            low = scale_logarithmically(ax, v3, span=1e10)
            draw_lines(ax, log, chosen, np.where(v3 > low, v3, np.nan))
            ax.set_ylabel("V3")
            return figure
        index = chosen[0]
        figure, (top, bottom) = _stack(log, chosen, "Lyapunov functions", [2.5, 2.3])
        spans = under_way(log, index)
        for ax in (top, bottom):
            for column, label, colour, style, width in (
                (SIG_V1, "V1", GREEN, "-.", 1.3),
                (SIG_V2, "V2", RED, "--", 1.3),
                (SIG_V3, "V3", BLUE, "-", 1.9),
            ):
                values = log.signals[:, index, column]
                ax.plot(log.time, values, color=colour, linestyle=style, linewidth=width, label=label)
            for number, (begin, end) in enumerate(spans):
                label = "under way to a waypoint" if number == 0 else "_"
                ax.axvspan(begin, end, color="#E9EEF4", linewidth=0.0, zorder=0.2, label=label)
        top.set_ylim(bottom=0.0)
        top.set_ylabel("V")
        scale_logarithmically(bottom, v3, span=1e10)
        bottom.set_ylabel("V, logarithmic")
        write_legend(top)
    return figure


def speed_figure(log: FlightLog, vehicle: int | str | None = None) -> Figure:
    """Draw the speed over time, as Figure 3.2 of the thesis does; of a single vehicle the velocity's components too.

    Raises
    ------
    ArgumentError
        If the log is empty or has no such vehicle.
    """
    chosen = _chosen(log, vehicle)
    velocity = log.state[:, chosen, V : V + 3]
    speed = np.linalg.norm(velocity, axis=2)
    with mpl.rc_context(STYLE):
        figure, (ax,) = _stack(log, chosen, "Speed", [3.2], f"at most {peak(speed):.2f} m/s")
        if len(chosen) > 1:
            draw_lines(ax, log, chosen, speed)
            ax.set_ylim(bottom=0.0)
        else:
            for axis, (name, colour, style) in enumerate(COMPONENTS):
                ax.plot(log.time, velocity[:, 0, axis], color=colour, linestyle=style, linewidth=1.4, label=name)
            ax.plot(log.time, speed[:, 0], color=INK, linewidth=1.8, label="speed")
            write_legend(ax)
        ax.set_ylabel("speed [m/s]" if len(chosen) > 1 else "velocity [m/s]")
    return figure


def altitude_figure(log: FlightLog) -> Figure:
    """Draw the altitude of every vehicle over time.

    Raises
    ------
    ArgumentError
        If the log is empty.
    """
    chosen = _chosen(log, None)
    with mpl.rc_context(STYLE):
        figure, (ax,) = _stack(log, chosen, "Altitude", [3.4])
        draw_altitude(ax, log)
    return figure


def command_figure(log: FlightLog, vehicle: int | str | None = None) -> Figure:
    """Draw normalised thrust, tilt and body rate over time.

    Raises
    ------
    ArgumentError
        If the log is empty or has no such vehicle.
    """
    chosen = _chosen(log, vehicle)
    tilt = np.degrees(tilts(log)[:, chosen])
    rates = np.degrees(np.linalg.norm(log.state[:, chosen, OMEGA : OMEGA + 3], axis=2))
    with mpl.rc_context(STYLE):
        figure, axes = _stack(log, chosen, "Thrust and tilt", [1.8, 1.5, 1.5], f"tilt at most {peak(tilt):.1f}°")
        axes[0].axhline(GRAVITY, color=INK, linewidth=1.0, linestyle="--", zorder=1.5)
        for ax, values, label in (
            (axes[0], log.command[:, chosen, 0], "thrust [m/s²]"),
            (axes[1], tilt, "tilt [°]"),
            (axes[2], rates, "body rate [°/s]"),
        ):
            draw_lines(ax, log, chosen, values)
            ax.set_ylabel(label)
        for ax in axes[1:]:
            ax.set_ylim(bottom=0.0)
        write_legend(axes[0], [Line2D([], [], color=INK, linestyle="--", linewidth=1.0, label="hover: g")])
    return figure


def separation_figure(log: FlightLog) -> Figure:
    """Draw the least scaled distance between two vehicles in the air, and what it must not fall below.

    Raises
    ------
    ArgumentError
        If the log is empty, or fewer than two vehicles were ever in the air.
    """
    chosen = _chosen(log, None)
    if not np.isfinite(log.separation).any():
        raise ArgumentError("log: expected two vehicles in the air at some time, got at most one")
    with mpl.rc_context(STYLE):
        figure, (ax,) = _stack(log, chosen, "Separation", [3.0], _separation_text(log), listed=False)
        draw_separation(ax, log)
        write_legend(ax)
    return figure


def score_figure(log: FlightLog, deployment: Deployment | None = None) -> Figure:
    """Draw the team's score at the committed poses and at the flown ones, with the events of the flight.

    Parameters
    ----------
    log : FlightLog
    deployment : Deployment, optional
        Its score and its bound are drawn as lines.

    Raises
    ------
    ArgumentError
        If the log is empty or has no scores.
    """
    chosen = _chosen(log, None)
    if np.isnan(log.score_committed).all() and np.isnan(log.score_flown).all():
        raise ArgumentError("log: expected scores, got a flight without a mission")
    with mpl.rc_context(STYLE):
        heights = [3.2] + [EVENT_ROW * len(event_rows(log))] * bool(log.events)
        figure, axes = _stack(log, chosen, "Score", heights, listed=False)
        draw_score(axes[0], log, deployment)
        write_legend(axes[0])
        if log.events:
            draw_events(axes[1], log)
    return figure


def paths_figure(log: FlightLog, deployment: Deployment | None = None, *, obstacles: Sequence[Obstacle] = ()) -> Figure:
    """Draw the paths from above and in three dimensions, as Figures 3.3 and 3.4 of the thesis do.

    Parameters
    ----------
    log : FlightLog
    deployment : Deployment, optional
        The paths from above are drawn over its map.
    obstacles : sequence of Obstacle

    Raises
    ------
    ArgumentError
        If the log is empty.
    """
    chosen = _chosen(log, None)
    with mpl.rc_context(STYLE):
        frame = plan_frame(log, None if deployment is None else deployment.mission, box=(5.6, 5.2), obstacles=obstacles)
        height = max(frame.height, 4.2)
        strip = _strip(chosen, frame.width + 6.0)
        figure = new_page(0.75 + frame.width + 6.2, 0.55 + height + 0.75 + strip)
        ax = place_axes(figure, 0.75, 0.55 + (height - frame.height) / 2.0, frame.width, frame.height)
        dots = draw_plan(ax, log, deployment, frame, obstacles)
        space = place_axes(figure, 0.75 + frame.width + 0.2, 0.1, 5.6, height + 0.5, projection="3d")
        draw_space(space, log, obstacles)
        _list(figure, log, chosen, frame.width + 6.0)
        _write_head(figure, log, chosen, "Paths", dots)
    return figure


def flight_overview(
    log: FlightLog, deployment: Deployment | None = None, *, obstacles: Sequence[Obstacle] = ()
) -> Figure:
    """Draw one page on a flight: the paths on the map, and over time the score, separation, altitude and error.

    Parameters
    ----------
    log : FlightLog
    deployment : Deployment, optional
        The paths are drawn over its map, and its score is drawn to compare with.
    obstacles : sequence of Obstacle

    Raises
    ------
    ArgumentError
        If the log is empty.
    """
    chosen = _chosen(log, None)
    panels: list[tuple[float, Callable[[Axes], None]]] = []
    if not np.isnan(log.score_committed).all():
        panels.append((1.35, lambda ax: draw_score(ax, log, deployment)))
    if log.events:
        panels.append((EVENT_ROW * len(event_rows(log)), lambda ax: draw_events(ax, log)))
    if np.isfinite(log.separation).any():
        panels.append((1.0, lambda ax: draw_separation(ax, log)))
    panels += [(1.0, lambda ax: draw_altitude(ax, log)), (1.0, lambda ax: draw_errors(ax, log))]
    with mpl.rc_context(STYLE):
        frame = plan_frame(log, None if deployment is None else deployment.mission, obstacles=obstacles)
        gap, right, left = 0.3, 6.2, 0.75 + frame.width + 0.95
        fixed = gap * (len(panels) - 1) + 0.25
        body = max(frame.height, sum(height for height, _ in panels) + fixed)
        stretch = (body - fixed) / sum(height for height, _ in panels)
        across = frame.width if list_rows(len(chosen), frame.width) <= 3 else frame.width + 7.1
        strip = _strip(chosen, across)
        figure = new_page(left + right + 0.25, 0.55 + body + 0.75 + strip)
        ax = place_axes(figure, 0.75, 0.55 + body - frame.height, frame.width, frame.height)
        dots = draw_plan(ax, log, deployment, frame, obstacles)
        axes, upper = [], 0.55 + body - 0.25
        for height, _ in panels:
            axes.append(place_axes(figure, left, upper - stretch * height, right, stretch * height))
            upper -= stretch * height + gap
        style_time_axes(axes, log)
        for ax, (_, draw) in zip(axes, panels, strict=True):
            draw(ax)
        for ax in axes:
            if "score" in ax.get_ylabel() or "separation" in ax.get_ylabel():
                write_legend(ax)
        _list(figure, log, chosen, across)
        mission = "" if deployment is None else f" of {clip_text(deployment.mission.name, 50)}"
        _write_head(figure, log, chosen, f"Flight{mission}", f"{log.time[-1] - log.time[0]:.1f} s", dots)
    return figure


def flight_figures(
    log: FlightLog, deployment: Deployment | None = None, *, obstacles: Sequence[Obstacle] = ()
) -> dict[str, Figure]:
    """Draw all figures that make sense for a flight.

    Parameters
    ----------
    log : FlightLog
    deployment : Deployment, optional
        The mission's plan, for the map and for lines to compare the score with.
    obstacles : sequence of Obstacle

    Returns
    -------
    dict of str to Figure
        By name, ``overview`` first.

    Raises
    ------
    ArgumentError
        If the log is empty.
    """
    only = 0 if len(log.names) == 1 else None
    figures = {
        "overview": flight_overview(log, deployment, obstacles=obstacles),
        "paths": paths_figure(log, deployment, obstacles=obstacles),
    }
    if not np.isnan(log.score_committed).all():
        figures["score"] = score_figure(log, deployment)
    if np.isfinite(log.separation).any():
        figures["separation"] = separation_figure(log)
    figures |= {
        "position": position_figure(log, only),
        "position-error": error_figure(log, only, "position"),
        "velocity-error": error_figure(log, only, "velocity"),
        "lyapunov": lyapunov_figure(log, only),
        "altitude": altitude_figure(log),
        "speed": speed_figure(log, only),
        "commands": command_figure(log, only),
    }
    return figures


def _stack(
    log: FlightLog,
    chosen: Sequence[int],
    title: str,
    heights: Sequence[float],
    note: str = "",
    *,
    listed: bool = True,
) -> tuple[Figure, list[Axes]]:
    """Panels over time above each other, below a title, the list of vehicles and room for a legend."""
    strip = _strip(chosen, WIDTH) if listed else 0.0
    gap, head = 0.16, 0.9 + strip
    height = 0.5 + sum(heights) + gap * (len(heights) - 1) + head
    figure = new_page(0.75 + WIDTH + 0.2, height)
    axes, upper = [], height - head
    for panel in heights:
        axes.append(place_axes(figure, 0.75, upper - panel, WIDTH, panel))
        upper -= panel + gap
    style_time_axes(axes, log)
    if listed:
        _list(figure, log, chosen, WIDTH)
    _write_head(figure, log, chosen, title, note)
    return figure, axes


def _strip(chosen: Sequence[int], width: float) -> float:
    """Height of the list of vehicles, inches; none for one vehicle, which the title names, or for very many."""
    return 0.21 * list_rows(len(chosen), width) + 0.06 if 1 < len(chosen) <= MANY else 0.0


def _list(figure: Figure, log: FlightLog, chosen: Sequence[int], width: float) -> None:
    strip = _strip(chosen, width)
    if strip:
        ax = place_axes(figure, 0.75, figure.get_figheight() - 0.66 - strip, width, strip)
        ax.set(xlim=(0.0, width), ylim=(0.0, strip))
        ax.set_axis_off()
        palette = colours(log.names)
        list_vehicles(ax, [log.names[i] for i in chosen], chosen, [palette[i] for i in chosen])


def _write_head(figure: Figure, log: FlightLog, chosen: Sequence[int], title: str, *notes: str) -> None:
    who = clip_text(log.names[chosen[0]], 40) if len(chosen) == 1 else f"{len(chosen)} vehicles"
    models = " and ".join(sorted({log.models[i] for i in chosen}))
    parts = [f"{who} ({clip_text(models, 40)})", f"{log.simulator} simulator", *notes]
    write_title(figure, title, ",  ".join(part for part in parts if part))


def _separation_text(log: FlightLog) -> str:
    finite = log.separation[np.isfinite(log.separation)]
    return f"at least {finite.min():.2f} m ({log.required_separation:.2f} m required)" if len(finite) else ""


def _chosen(log: FlightLog, vehicle: int | str | None) -> list[int]:
    check_log(log)
    if vehicle is None:
        return list(range(len(log.names)))
    if isinstance(vehicle, str) and vehicle in log.names:
        return [log.names.index(vehicle)]
    if not isinstance(vehicle, str) and 0 <= vehicle < len(log.names):
        return [int(vehicle)]
    known = ", ".join(log.names)
    raise ArgumentError(f"vehicle: expected an index below {len(log.names)} or one of {known}, got {vehicle!r}")
