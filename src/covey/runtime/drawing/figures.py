"""Figures: deployments with their score over time, moments of a mission, heat maps of visibility models.

Figures are made without pyplot, so that no window system and no global state is touched.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from covey.environment import Landmarks
from covey.geometry import Pose2
from covey.runtime.drawing.map_drawing import FAINT, INK, STYLE, Frame, draw_badges, draw_map, draw_poses
from covey.runtime.drawing.palette import colours

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from covey.mission import Mission
    from covey.runtime.result import Deployment, Snapshot
    from covey.sensing.base import VisibilityModel

DPI = 130
PANEL_WIDTH = 4.3
MOMENT_MARKS = (
    ("after_first_optimization", "after optimising once", "o"),
    ("after_first_trade", "after one trade", "s"),
)


def deployment_figure(deployment: Deployment) -> Figure:
    """Draw a deployment's map, beside it the score over time and the list of agents.

    Parameters
    ----------
    deployment : Deployment

    Returns
    -------
    matplotlib Figure
        Its first axes are the map.  Save it with `save_figure`.
    """
    mission = deployment.mission
    palette = colours([agent.name for agent in deployment.agents])
    with mpl.rc_context(STYLE):
        frame = Frame.around(mission, deployment.poses)
        height = max(frame.height, 4.4)
        width = 0.7 + frame.width + 0.85 + PANEL_WIDTH + 0.25
        figure = _figure(width, height + 1.35)
        ax = _axes(figure, 0.7, 0.55 + height - frame.height, frame.width, frame.height)
        draw_map(ax, mission, deployment.poses, deployment.owner, frame=frame, palette=palette)
        _write_title(figure, _clip(mission.name, 60), _subtitle(deployment))

        listed = len(deployment.agents) <= 16
        rows = math.ceil(len(deployment.agents) / 2) if listed else 0
        list_height = 0.5 + 0.2 * rows if listed else 0.0
        left = 0.7 + frame.width + 0.85
        chart = _axes(
            figure, left, 0.55 + list_height + 0.25 * listed, PANEL_WIDTH, height - list_height - 0.25 * listed
        )
        _draw_scores(chart, deployment)
        if listed:
            _list_agents(figure, deployment, palette, left, 0.2, list_height)
    return figure


def snapshot_figure(mission: Mission, snapshot: Snapshot, title: str) -> Figure:
    """Draw the team at one moment, as Figures 5.3 to 5.6 of the thesis do."""
    with mpl.rc_context(STYLE):
        frame = Frame.around(mission, snapshot.poses)
        figure = _figure(0.7 + frame.width + 0.25, 0.55 + frame.height + 0.8)
        ax = _axes(figure, 0.7, 0.55, frame.width, frame.height)
        draw_map(ax, mission, snapshot.poses, snapshot.owner, frame=frame)
        _write_title(figure, title, f"coverage score {snapshot.score:.2f}")
    return figure


def heatmap_figure(model: VisibilityModel, *, half_width: float = 3.0, pixels: int = 401) -> Figure:
    """Draw a visibility model as the thesis's Figure 4.1 does: an agent at the origin, lighter points are seen better.

    Parameters
    ----------
    model : VisibilityModel
        A model of oriented landmarks is shown for landmarks that face the agent.
    half_width : float
        The figure shows x and y up to this far from the agent, metres.
    pixels : int
        Points a side.
    """
    line = np.linspace(-half_width, half_width, pixels)
    points = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    distance = np.linalg.norm(points, axis=1, keepdims=True)
    facing = np.where(distance > 0.0, -points / np.where(distance > 0.0, distance, 1.0), [1.0, 0.0])
    landmarks = Landmarks(points, normals_W=facing)
    values = model.visibility(np.zeros((1, 3)), landmarks)[0].reshape(pixels, pixels)
    with mpl.rc_context(STYLE):
        figure = _figure(6.6, 6.0)
        ax = _axes(figure, 0.7, 0.55, 4.7, 4.7)
        image = ax.imshow(
            values,
            origin="lower",
            extent=(-half_width, half_width, -half_width, half_width),
            cmap="gray",
            vmin=0.0,
            interpolation="nearest",
        )
        draw_poses(ax, [Pose2(0.0, 0.0, 0.0)], ["#E69F00"], [""], radius=10.0)
        ax.set_xlabel("x, the way the camera points [m]")
        ax.set_ylabel("y [m]")
        bar = figure.colorbar(image, cax=_axes(figure, 5.6, 0.55, 0.2, 4.7))
        bar.set_label("visibility")
        facing_text = "; landmarks face the agent" if model.needs_normals else ""
        _write_title(
            figure, f"Visibility model {_clip(model.name, 40)}", f"lighter points are seen better{facing_text}"
        )
    return figure


def save_figure(figure: Figure, file: str | Path | IO[bytes], *, kind: str | None = None, dpi: float = DPI) -> None:
    """Save a figure, by default as what the file's suffix says; the same figure gives the same bytes."""
    kind = kind or Path(str(file)).suffix.lstrip(".").lower()
    options: dict[str, Any] = {}
    if kind == "pdf":
        options = {"metadata": {"CreationDate": None, "Creator": "covey"}}
    elif kind == "png":  # packed less tightly it is written in half the time and hardly larger
        words = {"Software": "covey", "Description": "\n".join(text.get_text() for text in figure.texts)}
        options = {"metadata": words, "pil_kwargs": {"compress_level": 3}}
    elif kind == "svg":
        options = {"metadata": {"Date": None, "Creator": "covey"}}
    with mpl.rc_context({**STYLE, "svg.hashsalt": "covey"}):
        figure.savefig(file, format=kind, dpi=dpi, **options)


def save_pages(figures: Sequence[Figure], file: str | Path) -> None:
    """Save figures as the pages of one PDF file; the same figures give the same bytes."""
    from matplotlib.backends.backend_pdf import PdfPages

    with mpl.rc_context(STYLE), PdfPages(file, metadata={"CreationDate": None, "Creator": "covey"}) as pages:
        for figure in figures:
            pages.savefig(figure)


def _draw_scores(ax: Axes, deployment: Deployment) -> None:
    scores = np.array([entry.score for entry in deployment.history] or [deployment.score.final])
    steps = np.arange(len(scores))
    last = max(1, len(scores) - 1)
    ax.set_xlim(-0.02 * last, 1.02 * last)
    ax.step(
        steps, scores, where="post", color="#0072B2", linewidth=1.8, label=f"team score, {deployment.score.final:.2f}"
    )
    for name, label, marker in MOMENT_MARKS:
        value = getattr(deployment.score, name)
        reached = np.flatnonzero(scores >= value - 1e-9)
        if len(reached) and len(scores) > 1:
            text = f"{label}, {value:.2f}"
            ax.plot([reached[0]], [value], marker, color="#D55E00", markersize=6, label=text, zorder=3)
    if deployment.bound is not None and math.isfinite(deployment.bound.team_upper_bound):
        bound = deployment.bound
        text = f"no deployment exceeds {bound.team_upper_bound:.2f} (gap {100.0 * bound.gap:.2f} %)"
        ax.axhline(bound.team_upper_bound, color=INK, linestyle="--", linewidth=1.2, label=text)
    if deployment.baseline is not None:
        text = f"greedy, then Lloyd, {deployment.baseline.greedy_lloyd:.2f}"
        ax.axhline(deployment.baseline.greedy_lloyd, color="#009E73", linestyle=":", linewidth=1.8, label=text)
    ax.xaxis.set_major_locator(MaxNLocator(integer=True, nbins=8, steps=[1, 2, 5, 10]))
    ax.grid(True, color="#E4E4E4", linewidth=0.7)
    ax.set_axisbelow(True)
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)
    ax.set_xlabel("changes of pose or partition")
    ax.set_ylabel("coverage score of the team")
    ax.legend(loc="lower right", frameon=True, framealpha=0.9, edgecolor="none", fontsize=8.5)


def _list_agents(
    figure: Figure, deployment: Deployment, palette: Sequence[str], left: float, bottom: float, height: float
) -> None:
    ax = _axes(figure, left, bottom, PANEL_WIDTH, height)
    ax.set_axis_off()
    ax.set_xlim(0.0, PANEL_WIDTH)
    ax.set_ylim(0.0, height)
    rows = math.ceil(len(deployment.agents) / 2)
    places = np.array(
        [
            [(index // rows) * PANEL_WIDTH / 2.0 + 0.1, height - 0.35 - 0.2 * (index % rows)]
            for index in range(len(deployment.agents))
        ]
    )
    numbers = [str(index + 1) for index in range(len(deployment.agents))]
    draw_badges(ax, places, palette, numbers, size=7.0)
    ax.text(0.0, height - 0.1, "Each agent's score, and on how many landmarks", va="center", fontsize=8.5)
    for agent, (x, y) in zip(deployment.agents, places, strict=True):
        ax.text(x + 0.2, y, _clip(agent.name, 12), va="center", fontsize=8.5)
        ax.text(
            x + PANEL_WIDTH / 2.0 - 0.25,
            y,
            f"{agent.score:.2f} on {len(agent.landmarks)}",
            ha="right",
            va="center",
            fontsize=8.5,
            color=FAINT,
        )


def _subtitle(deployment: Deployment) -> str:
    score, certificate = deployment.score, deployment.certificate
    parts = [
        f"score {score.initial:.2f} to {score.final:.2f}",
        _count(len(deployment.agents), "agent"),
        _count(len(deployment.mission.landmarks), "landmark"),
        f"{_count(deployment.trades, 'trade')} ({deployment.trade.value})",
        f"seed {deployment.seed}",
    ]
    if certificate is not None:
        verdict = "proved" if certificate.holds else "not proved"
        parts.append(f"{verdict} (sigma {certificate.sigma:g})")
    elif deployment.status.value != "settled":
        parts.append(deployment.status.value)
    return ",  ".join(parts)


def _count(number: int, noun: str) -> str:
    return f"{number:,} {noun}{'' if number == 1 else 's'}"


def _clip(text: str, length: int) -> str:
    """Make text fit a line: no control characters, no glyphs that the font lacks, at most `length` characters."""
    shown = "".join(character if character.isprintable() and _has_glyph(character) else "?" for character in text)
    return shown if len(shown) <= length else f"{shown[: length - 1]}…"


def _has_glyph(character: str) -> bool:
    from matplotlib.font_manager import findfont, get_font

    return character.isascii() or bool(get_font(findfont("DejaVu Sans")).get_char_index(ord(character)))


def _write_title(figure: Figure, title: str, subtitle: str) -> None:
    height = figure.get_figheight()
    width = figure.get_figwidth()
    figure.text(0.7 / width, 1.0 - 0.27 / height, title, fontsize=14, va="center")
    figure.text(0.7 / width, 1.0 - 0.53 / height, subtitle, fontsize=9, color=FAINT, va="center")


def _figure(width: float, height: float) -> Figure:
    figure = Figure(figsize=(width, height), dpi=DPI)
    FigureCanvasAgg(figure)
    return figure


def _axes(figure: Figure, left: float, bottom: float, width: float, height: float) -> Axes:
    """Axes at a place given in inches from the figure's lower left corner."""
    total_width, total_height = figure.get_figwidth(), figure.get_figheight()
    return figure.add_axes((left / total_width, bottom / total_height, width / total_width, height / total_height))
