"""``covey figures``: figures for a paper from the record of a run."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from covey.cli.arguments import named_path

FORMATS = ("pdf", "png", "svg")


def figures(
    record: Annotated[
        Path, typer.Argument(parser=named_path, metavar="RECORD", help="record.mcap, or the directory it is in.")
    ],
    out: Annotated[Path, typer.Option(parser=named_path, metavar="DIR", help="Where to write the figures.")],
    width_mm: Annotated[float, typer.Option(min=50.0, max=400.0, help="Width of a figure, millimetres.")] = 88.0,
    kind: Annotated[
        str | None,
        typer.Option(
            metavar="KIND,...",
            help="Which: deployment, score, separation, tracking, trades; by default all that the record has.",
        ),
    ] = None,
    format: Annotated[str, typer.Option(metavar="FORMAT,...", help="pdf, png, svg, separated by commas.")] = "pdf",
    force: Annotated[bool, typer.Option("--force", help="Replace figures in DIR.")] = False,
) -> None:
    """Draw figures for a paper: as wide as a column, with fonts that publishers take.

    deployment: the map at the end and the paths flown. score: over time, with what changed it and its bound.
    separation and tracking: of flights. trades: who traded with whom.

    Exit code: 0 drawn, 2 no record, or it does not have what a figure needs.

    [bold]Examples[/bold]

      covey figures covey-out/scene-7 --out figures

      covey figures covey-out/scene-flown-7 --out figures --width-mm 180 --kind score,separation --format pdf,png
    """
    from covey.errors import ArgumentError
    from covey.runtime.drawing.figures import save_figure
    from covey.runtime.drawing.record_figures import Kind, Story, record_figure
    from covey.runtime.records.mcap_reader import Record
    from covey.runtime.records.output import check_target, staged

    known = tuple(choice.value for choice in Kind)
    wanted = None if kind is None else [Kind(name) for name in _choices("--kind", kind, known)]
    formats = _choices("--format", format, FORMATS)
    names = [f"{choice}.{suffix}" for choice in known for suffix in FORMATS]
    check_target(out, names, lambda target: True, overwrite=force)
    with Record(record) as opened:
        story = Story.of(opened)
        problems = opened.problems
    for problem in problems:
        typer.echo(f"covey: {record}: {problem}", err=True)
    drawn = {}
    for choice in wanted or story.kinds:
        try:
            drawn[choice] = record_figure(story, choice, width_mm=width_mm)
        except ArgumentError as error:
            raise typer.BadParameter(str(error).removeprefix("kind: "), param_hint="--kind") from error
    made = [f"{choice.value}.{suffix}" for choice in drawn for suffix in formats]
    with staged(out, made) as staging:
        for choice, figure in drawn.items():
            for suffix in formats:
                save_figure(figure, staging / f"{choice.value}.{suffix}", dpi=300.0)
    typer.echo(f"{out}: {', '.join(made)}")


def _choices(option: str, text: str, known: tuple[str, ...]) -> list[str]:
    chosen = list(dict.fromkeys(part.strip() for part in text.split(",")))
    for name in chosen:
        if name not in known:
            raise typer.BadParameter(f"expected some of {', '.join(known)}, got {name!r}", param_hint=option)
    return chosen
