"""``covey heatmap``: what a visibility model looks like."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

LONGEST = 1e7
"""Optimal distance, metres; as in mission files."""


def heatmap(
    model: Annotated[
        str,
        typer.Option(metavar="MODEL", help="anisotropic, isotropic, oriented, or your own file.py:Class."),
    ] = "anisotropic",
    optimal_distance_m: Annotated[
        float | None, typer.Option(metavar="METRES", help="Distance from which a landmark is seen best.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="PNG, PDF or SVG; by default heatmap-MODEL.png.")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace FILE.")] = False,
) -> None:
    """Draw the heat map of a visibility model, as Figure 4.1 of the thesis.

    [bold]Examples[/bold]

      covey heatmap

      covey heatmap --model oriented --optimal-distance-m 2 --out oriented.pdf
    """
    from covey.mission import SensorSpec
    from covey.runtime.reproduce.mission import draw_heatmap

    if optimal_distance_m is not None and not 0.0 < optimal_distance_m <= LONGEST:
        raise typer.BadParameter(
            f"expected a number above 0 and at most {LONGEST:,.0f}, got {optimal_distance_m:g}",
            param_hint="'--optimal-distance-m'",
        )

    options = {} if optimal_distance_m is None else {"optimal_distance": optimal_distance_m}
    name = "".join(character if character.isalnum() else "-" for character in model.rpartition(":")[2])
    file = out or Path(f"heatmap-{name}.png")
    draw_heatmap(SensorSpec(model, options), file, overwrite=force)
    typer.echo(file)
