"""The thesis's figures and numbers of section 5.1, made anew."""

from __future__ import annotations

import base64
import csv
import html
import statistics
from collections.abc import Callable, Sequence
from pathlib import Path

from covey.errors import OutputError
from covey.mission import Mission, SensorSpec, Trade, parse_mission
from covey.runtime.records.output import check_target, staged
from covey.runtime.result import Deployment, Progress, Scores
from covey.sensing.registry import build_model

THESIS = Scores(21.39, 72.55, 79.89, 118.99)
"""What the thesis prints in section 5.1: one draw of the random assignment."""

MOMENTS = (
    ("5.3", "initial", "The environment at the start"),
    ("5.4", "after_first_optimization", "After each agent optimised its pose once"),
    ("5.5", "after_first_trade", "After the first trade"),
    ("5.6", "final", "At the end"),
)
"""Figure of the thesis, score and title."""

SCENE = """
schema_version: 1
name: thesis-5.1
seed: 0
environment:
  landmarks: {grid: {x_m: [-5, 5], y_m: [-5, 5], spacing_m: 0.5}}
  region: {box: {x_m: [-5, 5], y_m: [-5, 5]}}
sensor: {model: anisotropic, optimal_distance_m: 1.0}
agents:
  - {name: blue, pose: {x_m: 3.5, y_m: -2, yaw_deg: 0}}
  - {name: red, pose: {x_m: 3.5, y_m: 4.5, yaw_deg: 0}}
  - {name: green, pose: {x_m: 3.5, y_m: -4, yaw_deg: 0}}
  - {name: yellow, pose: {x_m: -5, y_m: 4, yaw_deg: 0}}
coverage: {sigma: 0.01, trade: thesis, optimizer: search, assignment: random}
"""

PAGE = "index.html"
NAMES = (
    *(f"figure-{figure}.{kind}" for figure in ("4.1", *(moment[0] for moment in MOMENTS)) for kind in ("png", "pdf")),
    "scores.csv",
    PAGE,
)
MARK = '<meta name="generator" content="covey reproduce">'


def thesis_mission() -> Mission:
    """Return the scene of section 5.1, with the thesis's own way of trading.

    Notes
    -----
    Source: Sposato (2016), section 5.1.  Deviation: V5 (where the landmarks lie).
    """
    return parse_mission(SCENE, source="thesis-5.1")


def reproduce_thesis(
    directory: str | Path,
    *,
    seeds: int = 40,
    overwrite: bool = False,
    on_progress: Callable[[Progress], None] | None = None,
) -> tuple[Deployment, ...]:
    """Plan the scene of section 5.1 for seeds 0, 1, ... and write Figures 4.1 and 5.3 to 5.6, a table and a page.

    Parameters
    ----------
    directory : str or Path
        Where to; it is made if need be.
    seeds : int
        How many random initial assignments; the figures show seed 0.
    overwrite : bool
        Replace an earlier reproduction there.
    on_progress : callable, optional
        Told after each mission.

    Returns
    -------
    tuple of Deployment
        One a seed; after Ctrl-C (KeyboardInterrupt) those that were planned by then, with what follows from them
        written.  If there is none it goes on, and nothing is written.

    Raises
    ------
    OutputError
        If something is there already, or it cannot be written.
    """
    from covey.runtime.plan import plan

    target = Path(directory)
    check_target(target, NAMES, _is_reproduction, overwrite=overwrite)
    mission = thesis_mission()
    deployments: list[Deployment] = []
    try:
        for seed in range(seeds):
            deployment = plan(mission, seed=seed, trade=Trade.THESIS)
            if deployment.status.value == "interrupted":
                raise KeyboardInterrupt
            deployments.append(deployment)
            if on_progress is not None:
                on_progress(Progress(f"seed {seed}", deployment.score.final, deployment.trades, 0, (seed + 1) / seeds))
    except KeyboardInterrupt:
        if not deployments:
            raise
    with staged(target, NAMES) as staging:
        _write_figures(deployments[0], staging)
        _write_scores(deployments, staging / "scores.csv")
        (staging / PAGE).write_text(_page(deployments, staging, asked=seeds), encoding="utf-8")
    return tuple(deployments)


def table_text(deployments: Sequence[Deployment]) -> str:
    """Return the table of scores, ours beside the thesis's, as text."""
    lines = [f"{'coverage score':<42}{'thesis':>8}{'mean':>9}{'smallest':>10}{'largest':>9}"]
    for _, name, title in MOMENTS:
        thesis, mean, low, high = _row(deployments, name)
        lines.append(f"{title:<42}{thesis:>8.2f}{mean:>9.2f}{low:>10.2f}{high:>9.2f}")
    return "\n".join(lines)


def draw_heatmap(sensor: SensorSpec, file: Path, *, overwrite: bool = False) -> None:
    """Draw the heat map of a visibility model into a PNG, PDF or SVG file.

    Raises
    ------
    OutputError
        If the file is there already, has another suffix, or cannot be written.
    """
    from covey.runtime.drawing import figures

    if file.suffix.lower() not in (".png", ".pdf", ".svg"):
        raise OutputError(f"{file}: expected a file name ending in .png, .pdf or .svg")
    if file.exists() and not overwrite:
        raise OutputError(f"{file}: is there already; choose another name, or replace it with --force")
    model = build_model(sensor.model, sensor.options)
    distance = sensor.options.get("optimal_distance", 1.0)
    figure = figures.heatmap_figure(model, half_width=3.0 * distance)
    partial = file.with_name(f".{file.name}.partial")
    try:
        try:
            figures.save_figure(figure, partial, kind=file.suffix.lower().lstrip("."))
            partial.replace(file)
        finally:
            partial.unlink(missing_ok=True)
    except OSError as error:
        raise OutputError(f"{file}: cannot be written: {error.strerror or error}") from error


def _write_figures(deployment: Deployment, staging: Path) -> None:
    from covey.runtime.drawing import figures

    for kind in ("png", "pdf"):
        draw_heatmap(deployment.mission.sensor, staging / f"figure-4.1.{kind}")
    snapshots = {snapshot.label: snapshot for snapshot in deployment.snapshots}
    for number, label, title in MOMENTS:
        figure = figures.snapshot_figure(deployment.mission, snapshots[label], title)
        for kind in ("png", "pdf"):
            figures.save_figure(figure, staging / f"figure-{number}.{kind}")


def _write_scores(deployments: Sequence[Deployment], file: Path) -> None:
    names = [name for _, name, _ in MOMENTS]
    with file.open("w", encoding="utf-8", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(["seed", *names, "trades"])
        writer.writerow(["thesis", *(getattr(THESIS, name) for name in names), ""])
        for item in deployments:
            writer.writerow([item.seed, *(getattr(item.score, name) for name in names), item.trades])


def _row(deployments: Sequence[Deployment], name: str) -> tuple[float, float, float, float]:
    values = [getattr(item.score, name) for item in deployments]
    return getattr(THESIS, name), statistics.fmean(values), min(values), max(values)


def _is_reproduction(directory: Path) -> bool:
    try:
        return MARK in (directory / PAGE).read_text(encoding="utf-8")
    except (OSError, ValueError):
        return False


def _figure(folder: Path, number: str, text: str) -> str:
    image = base64.b64encode((folder / f"figure-{number}.png").read_bytes()).decode("ascii")
    caption = html.escape(f"Figure {number}. {text}")
    return (
        f'<figure><a href="figure-{number}.pdf"><img src="data:image/png;base64,{image}" alt="{caption}"></a>'
        f"<figcaption>{caption}</figcaption></figure>"
    )


def _page(deployments: Sequence[Deployment], folder: Path, *, asked: int) -> str:
    """Return the page, which holds the figures of the folder itself."""
    first = deployments[0]
    early = f" The run was interrupted; {asked} were asked for." if len(deployments) < asked else ""
    rows = "\n".join(
        f"<tr><th>{html.escape(title)}</th><td>{thesis:.2f}</td><td>{mean:.2f}</td><td>{low:.2f} to {high:.2f}</td>"
        f"<td>{getattr(first.score, name):.2f}</td></tr>"
        for _, name, title in MOMENTS
        for thesis, mean, low, high in [_row(deployments, name)]
    )
    figures = "\n".join(
        _figure(
            folder, number, f"{title}: {getattr(first.score, name):.2f}; in the thesis {getattr(THESIS, name):.2f}."
        )
        for number, name, title in MOMENTS
    )
    heatmap = _figure(
        folder, "4.1", "Heat map of the visibility function. Lighter points are seen better by the agent."
    )
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
{MARK}
<title>Section 5.1 of the thesis, reproduced</title>
<style>
body {{ font: 16px/1.5 system-ui, sans-serif; color: #1a1a1a; max-width: 76rem; margin: 2rem auto; padding: 0 1rem; }}
h1 {{ font-size: 1.6rem; }}
h2 {{ font-size: 1.2rem; margin-top: 2rem; }}
p {{ max-width: 44rem; }}
table {{ border-collapse: collapse; font-variant-numeric: tabular-nums; }}
th, td {{ padding: 0.3rem 1rem; border-bottom: 1px solid #ddd; text-align: right; font-weight: normal; }}
thead th {{ border-bottom: 2px solid #888; color: #666; }}
th:first-child {{ text-align: left; padding-left: 0; }}
.figures {{ display: grid; grid-template-columns: repeat(auto-fit, minmax(20rem, 1fr)); gap: 1.5rem; }}
figure {{ margin: 0; }}
img {{ width: 100%; }}
figcaption {{ color: #666; font-size: 0.9rem; }}
</style>
</head>
<body>
<h1>Section 5.1 of the thesis, reproduced</h1>
<p>Four agents cover 400 landmarks on 10 m by 10 m. The initial assignment is random, so the thesis's scores are one
draw; ours are of {len(deployments)} seeds with the thesis's own way of trading, sigma {first.sigma:g}.{early}</p>
<table>
<thead><tr><th>coverage score</th><th>thesis</th><th>our mean</th><th>our range</th>
<th>seed {first.seed}, below</th></tr></thead>
<tbody>
{rows}
</tbody>
</table>
<h2>Figures</h2>
<div class="figures">
{heatmap}
{figures}
</div>
<p>Every score is in <a href="scores.csv">scores.csv</a>.</p>
</body>
</html>
"""
