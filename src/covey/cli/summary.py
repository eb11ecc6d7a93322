"""What a deployment looks like in a terminal: a small map, a table of the agents, and how good it is."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from rich import box
from rich.console import Console, Group, RenderableType
from rich.table import Table
from rich.text import Text

from covey.coverage import TeamBound
from covey.coverage.certificate import Certificate
from covey.environment.lattice import find_lattice
from covey.runtime.drawing.palette import colours
from covey.runtime.records.record import FILES
from covey.runtime.result import Baseline, Deployment, FlightReport
from covey.vehicles.flight_log import TROUBLE

if TYPE_CHECKING:
    from typing import TextIO

MAP_PIXELS = (44, 44)
"""Largest width and height of the map, in characters and half characters."""

LISTED = 16
"""How many agents the table shows."""

MARKS = "123456789abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ"
ARROWS = "→↗↑↖←↙↓↘"
ASCII_ARROWS = ">/^\\</v\\"


def print_summary(deployment: Deployment, directory: Path | None, *, stream: TextIO | None = None) -> None:
    """Print a deployment for people to read.

    Parameters
    ----------
    deployment : Deployment
    directory : Path or None
        Where its files are, if they were written.
    stream : text file, optional
        Where to; stdout by default.  Colours and characters beyond ASCII are used where the stream can show them.
    """
    console = Console(file=stream or sys.stdout, highlight=False)
    plain = not (console.encoding or "").lower().startswith("utf")
    picture = _map(deployment, colour=console.color_system is not None and not console.no_color, plain=plain)
    table = _agents(deployment, plain=plain)
    console.print(Text(_headline(deployment), style="bold"), soft_wrap=True)
    if console.width >= 44 + 60:
        side_by_side = Table.grid(padding=(0, 3))
        side_by_side.add_row(picture, table)
        console.print(side_by_side)
    else:
        console.print(Group(picture, table))
    for label, text in _facts(deployment, directory, arrow="->" if plain else "→"):
        console.print(Text.assemble((f"{label:<10}", "bold"), text), soft_wrap=True)


def certificate_line(certificate: Certificate) -> str:
    """Say in a line what a certificate says."""
    if certificate.holds:
        return (
            f"holds for sigma = {certificate.sigma:g}: one owner a landmark, poses within "
            f"{certificate.worst_pose_gap:.2g} of the best, no trade gains more than {certificate.worst_trade_gain:.2g}"
            f"{_among_linked(certificate)}"
        )
    return f"VIOLATED for sigma = {certificate.sigma:g}: {_count(len(certificate.violations), 'violation')}"


def _among_linked(certificate: Certificate) -> str:
    links = certificate.links
    if links is None:
        return ""
    return f" among linked agents ({links.linked} of {_count(links.pairs, 'pair')}; the others were not compared)"


def link_lines(certificate: Certificate) -> list[str]:
    """Say who cannot trade with whom, not even through others."""
    links = certificate.links
    if links is None or links.connected:
        return []
    groups = [f"{printable(', '.join(group[:4]))}{', ...' if len(group) > 4 else ''}" for group in links.groups[:5]]
    more = "; ..." if len(links.groups) > 5 else ""
    return [f"not connected: {len(links.groups)} groups that cannot trade with each other: {'; '.join(groups)}{more}"]


def bound_line(bound: TeamBound) -> str:
    """Say in a line what a team bound says."""
    return f"no deployment of this team exceeds {bound.team_upper_bound:.2f}; gap {100.0 * bound.gap:.2f} %"


def printable(text: str) -> str:
    """Return text without characters that would steer a terminal."""
    return "".join(character if character.isprintable() else "?" for character in text)


def _headline(deployment: Deployment) -> str:
    mission = deployment.mission
    return (
        f"{printable(mission.name)}: {_count(len(deployment.agents), 'agent')}, "
        f"{_count(len(mission.landmarks), 'landmark')}, seed {deployment.seed}, "
        f"trade {deployment.trade.value}, optimizer {deployment.optimizer.value}"
    )


def _count(number: int, noun: str) -> str:
    return f"{number:,} {noun}{'' if number == 1 else 's'}"


def _facts(deployment: Deployment, directory: Path | None, *, arrow: str) -> list[tuple[str, str]]:
    score, trades = deployment.score, deployment.trades
    steps = [
        (score.initial, "start"),
        (score.after_first_optimization, "first optimisation"),
        (score.after_first_trade, "first trade"),
        (score.final, "end"),
    ]
    path = f" {arrow} ".join(f"{value:.2f} ({name})" for value, name in steps if math.isfinite(value))
    facts = [("Score", path)]
    facts.append(
        ("Trading", f"{_count(trades, 'trade')}, {_count(deployment.pose_optimizations, 'pose optimisation')}")
    )
    if deployment.mission.separation is not None:
        facts.append(("Layers", str(deployment.mission.separation)))
    if deployment.certificate is not None:
        facts.append(("Proof", certificate_line(deployment.certificate)))
        facts += [("", line) for line in link_lines(deployment.certificate)]
        facts += [("", f"{item.kind}: {printable(item.message)}") for item in deployment.certificate.violations[:5]]
    else:
        facts.append(("Proof", f"none: {deployment.status.value}"))
    if deployment.flight is not None:
        facts += _flight_facts(deployment.flight)
    if deployment.bound is not None:
        facts.append(("Bound", bound_line(deployment.bound)))
    if deployment.baseline is not None:
        facts.append(("Baseline", _baseline_line(deployment.baseline, score.final)))
    if deployment.timing_s:
        facts.append(("Time", ", ".join(f"{name} {seconds:.2f} s" for name, seconds in deployment.timing_s.items())))
    if directory is not None:
        facts.append(("Files", f"{directory}: {', '.join(name for name in FILES if (directory / name).exists())}"))
    return facts


def _flight_facts(flight: FlightReport) -> list[tuple[str, str]]:
    """Say how a mission was flown, and what went wrong."""
    how = (
        f"{flight.duration:.0f} s in {flight.simulator} with {flight.vehicle}, {factor_text(flight.real_time_factor)} "
        f"real time; tracking {length_text(flight.tracking_rms)} rms"
    )
    if math.isfinite(flight.score_flown):
        how += f"; score as flown {flight.score_flown:.2f}"
    least = f"at least {flight.min_separation:.2f} m, {flight.required_separation:.2f} m required"
    apart = least if math.isfinite(flight.min_separation) else "never two vehicles in the air"
    apart += f"; {_count(flight.collisions, 'collision')}"
    if flight.max_outside_region > 0.005:
        apart += f"; up to {length_text(flight.max_outside_region)} outside a region"
    if math.isfinite(flight.separation_cost):
        apart += f"; keeping apart cost {flight.separation_cost:.2f} in score"
    waypoints = f"{flight.waypoints_reached} reached, {flight.waypoints_missed} missed"
    facts = [("Flight", how), ("Apart", apart), ("Waypoints", waypoints)]
    worth = [event for event in flight.events if event.kind in TROUBLE]
    facts += [("", f"{event.time:.1f} s: {printable(event.text)}") for event in worth[:8]]
    if len(worth) > 8:
        facts.append(("", f"and {len(worth) - 8} more, see result.json"))
    return facts


def length_text(metres: float) -> str:
    """Write a length in a unit that suits it.

    Examples
    --------
    >>> length_text(0.0123), length_text(1750.6)
    ('1.2 cm', '1751 m')
    """
    return f"{100.0 * metres:.1f} cm" if metres < 1.0 else f"{metres:.4g} m"


def factor_text(factor: float) -> str:
    """Write how much faster than real time something was.

    Examples
    --------
    >>> factor_text(27.6), factor_text(0.43)
    ('28 times', '0.4 times')
    """
    return f"{factor:.0f} times" if factor >= 2.0 else f"{factor:.1g} times"


def _baseline_line(baseline: Baseline, final: float) -> str:
    better = final - baseline.greedy_lloyd
    verdict = f"{abs(better):.2f} {'better' if better >= 0.0 else 'worse'}" if abs(better) >= 0.005 else "as good"
    return f"greedy {baseline.greedy:.2f}, then Lloyd {baseline.greedy_lloyd:.2f}; this is {verdict}"


def _agents(deployment: Deployment, *, plain: bool) -> RenderableType:
    table = Table(box=box.ASCII if plain else box.SIMPLE_HEAD, pad_edge=False)
    degrees = "deg" if plain else "°"
    table.add_column("")
    table.add_column("agent", max_width=24, no_wrap=True)
    for head in ("x [m]", "y [m]", f"yaw [{degrees}]", "landmarks", "score"):
        table.add_column(Text(head), justify="right", no_wrap=True)
    palette = colours([agent.name for agent in deployment.agents])
    arrows = ASCII_ARROWS if plain else ARROWS
    lost = () if deployment.flight is None else deployment.flight.lost
    for number, (agent, colour) in enumerate(zip(deployment.agents, palette, strict=True), start=1):
        if number > LISTED:
            break
        yaw = math.degrees(agent.pose.yaw)
        table.add_row(
            Text.assemble(("# " if plain else "■ ", colour), str(number)),
            Text(printable(agent.name), style="strike" if agent.name in lost else ""),
            f"{agent.pose.x:.3f}",
            f"{agent.pose.y:.3f}",
            f"{arrows[round(yaw / 45.0) % 8]} {yaw:6.1f}",
            str(len(agent.landmarks)),
            f"{agent.score:.2f}",
        )
    more = len(deployment.agents) - LISTED
    return table if more <= 0 else Group(table, Text(f"and {more} more, see agents.csv", style="dim"))


def _map(deployment: Deployment, *, colour: bool, plain: bool) -> Text:
    """Draw the owners, two rows of pixels a line of characters; without colour by their marks, one row a line."""
    pixels, (x0, y0, size) = _pixels(deployment)
    palette = colours([agent.name for agent in deployment.agents])
    agents = {}
    for index, pose in enumerate(deployment.poses):
        column = int((pose.x - x0) / size)
        agents[len(pixels) // 2 - 1 - int((pose.y - y0) / size) // 2, column] = index
    half_blocks = colour and not plain
    text = Text(no_wrap=True)
    for line in range(len(pixels) // 2):
        upper, lower = pixels[len(pixels) - 1 - 2 * line], pixels[len(pixels) - 2 - 2 * line]
        column = 0
        while column < len(upper):
            agent = agents.get((line, column))
            if agent is not None and half_blocks:
                number = str(agent + 1)[: len(upper) - column]
                text.append(number, style="bold black on white")
                column += len(number)
                continue
            if agent is not None:
                yaw = math.degrees(deployment.poses[agent].yaw)
                text.append((ASCII_ARROWS if plain else ARROWS)[round(yaw / 45.0) % 8])
            elif half_blocks:
                text.append(*_half_blocks(int(upper[column]), int(lower[column]), palette))
            else:
                owner = int(lower[column]) if lower[column] >= 0 else int(upper[column])
                text.append(" " if owner < 0 else MARKS[owner % len(MARKS)])
            column += 1
        text.append("\n")
    text.rstrip()
    return text


def _half_blocks(upper: int, lower: int, palette: tuple[str, ...]) -> tuple[str, str]:
    if upper < 0 and lower < 0:
        return " ", ""
    if lower < 0:
        return "▀", palette[upper]
    if upper < 0:
        return "▄", palette[lower]
    return "▀", f"{palette[upper]} on {palette[lower]}"


def _pixels(deployment: Deployment) -> tuple[NDArray[np.int64], tuple[float, float, float]]:
    """Owner of each pixel (-1: none) in an even number of rows, upwards; x and y of the first corner, and the size."""
    landmarks = deployment.mission.landmarks
    lattice = find_lattice(landmarks)
    half = (landmarks.cell_size or 0.0) / 2.0
    poses = np.array([pose.position_W for pose in deployment.poses])
    corners = np.concatenate([landmarks.positions_W - half, landmarks.positions_W + half, poses])
    low, high = corners.min(axis=0), corners.max(axis=0)
    size = float(np.max((high - low) / MAP_PIXELS)) or 1.0
    if lattice is None:  # pixels about as far apart as the landmarks
        size = max(size, 0.8 * math.sqrt(float(np.prod(high - low)) / len(landmarks)))
    if lattice is not None:
        # Whole pixels a cell, or whole cells a pixel, so that straight borders look straight.
        ratio = lattice.cell_size / size
        size = lattice.cell_size / math.floor(ratio) if ratio >= 1.0 else lattice.cell_size * math.ceil(1.0 / ratio)
        corner = np.array([lattice.x_min, lattice.y_min])
        low = corner - size * np.ceil((corner - low) / size - 1e-9)
    # A position on the upper edge needs a pixel too, unless only cells end there.
    ends = np.maximum(np.ceil((high - low) / size - 1e-9), np.floor((poses.max(axis=0) - low) / size) + 1.0)
    if lattice is None:
        ends = np.floor((high - low) / size) + 1.0
    columns, rows = (int(count) for count in ends)
    rows += rows % 2
    if lattice is None:
        owner = np.full((rows, columns), -1, dtype=np.int64)
        j, i = ((landmarks.positions_W - low) / size).astype(np.int64).T
        owner[i, j] = deployment.owner
    else:
        x, y = np.meshgrid(low[0] + size * (np.arange(columns) + 0.5), low[1] + size * (np.arange(rows) + 0.5))
        index = lattice.at(x, y)
        owner = np.where(index >= 0, deployment.owner[index], -1)
        j, i = ((landmarks.positions_W[lattice.loose] - low) / size).astype(np.int64).T
        owner[i, j] = deployment.owner[lattice.loose]
    return owner, (float(low[0]), float(low[1]), size)
