"""``covey reproduce``: the thesis's figures and numbers, made anew."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from covey.cli.interrupt import INTERRUPTED, Interruption
from covey.cli.paths import named_path

if TYPE_CHECKING:
    from covey.runtime.result import Progress


def reproduce(
    what: Annotated[Literal["thesis-5.1"], typer.Argument(metavar="WHAT", help="What to reproduce: thesis-5.1.")],
    out: Annotated[
        Path | None,
        typer.Option(parser=named_path, metavar="DIR", help="Where to; by default a new directory in covey-out/."),
    ] = None,
    seeds: Annotated[int, typer.Option(min=1, help="How many random initial assignments.")] = 40,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress and no table.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace an earlier reproduction in DIR.")] = False,
) -> None:
    """Make Figures 4.1 and 5.3 to 5.6 of the thesis, and a table of its scores beside ours.

    [bold]Examples[/bold]

      covey reproduce thesis-5.1

      covey reproduce thesis-5.1 --seeds 5 --out reproduction
    """
    from covey.cli.progress import ProgressLine
    from covey.runtime.record import default_directory
    from covey.runtime.reproduce import reproduce_thesis, table_text

    target = default_directory(f"reproduce-{what}", seeds) if out is None else out
    with Interruption() as interruption, ProgressLine(quiet=quiet) as progress:

        def report(news: Progress) -> None:
            interruption.check()
            progress(news)

        try:
            missions = reproduce_thesis(target, seeds=seeds, overwrite=force, on_progress=report)
        except KeyboardInterrupt:
            typer.echo("covey: interrupted; nothing was written", err=True)
            raise typer.Exit(INTERRUPTED) from None
    if not quiet:
        typer.echo(table_text(missions))
        typer.echo(f"The page is {target / 'index.html'}")
