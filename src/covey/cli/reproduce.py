"""``covey reproduce``: the thesis's figures and numbers, made anew."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from covey.cli.arguments import named_path
from covey.cli.interrupt import INTERRUPTED, Interruption

if TYPE_CHECKING:
    from covey.runtime.result import Progress


def reproduce(
    what: Annotated[
        Literal["thesis-5.1", "thesis-flight"],
        typer.Argument(metavar="WHAT", help="What to reproduce: thesis-5.1, or thesis-flight (chapters 2 and 3)."),
    ],
    out: Annotated[
        Path | None,
        typer.Option(parser=named_path, metavar="DIR", help="Where to; by default a new directory in covey-out/."),
    ] = None,
    seeds: Annotated[int, typer.Option(min=1, help="How many random initial assignments (thesis-5.1).")] = 40,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress and no table.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace an earlier reproduction in DIR.")] = False,
) -> None:
    """Make figures of the thesis anew, beside what it says of them.

    thesis-5.1: Figures 4.1 and 5.3 to 5.6, and a table of its scores beside ours.

    thesis-flight: Figures 2.2 to 2.9 and 3.1 to 3.4, and the tests of sections 2.3.2, 3.4.2 and 3.4.3, as one page.

    Ctrl-C keeps what is finished: the seeds that were planned, the scenes that were flown.

    [bold]Examples[/bold]

      covey reproduce thesis-5.1

      covey reproduce thesis-5.1 --seeds 5 --out reproduction

      covey reproduce thesis-flight
    """
    from covey.cli.progress import ProgressLine
    from covey.runtime.records.record import default_directory

    number = seeds if what == "thesis-5.1" else 1
    target = default_directory(f"reproduce-{what}", number) if out is None else out
    with Interruption() as interruption, ProgressLine(quiet=quiet) as progress:

        def report(news: Progress) -> None:
            interruption.check()
            progress(news)

        try:
            if what == "thesis-5.1":
                from covey.runtime.reproduce.mission import reproduce_thesis, table_text

                text = table_text(reproduce_thesis(target, seeds=seeds, overwrite=force, on_progress=report))
            else:
                from covey.runtime.reproduce.flights import findings_text, reproduce_flight

                text = findings_text(reproduce_flight(target, overwrite=force, on_progress=report))
        except KeyboardInterrupt:
            typer.echo("covey: interrupted; nothing was written", err=True)
            raise typer.Exit(INTERRUPTED) from None
    if not quiet:
        typer.echo(text)
        typer.echo(f"The page is {target / 'index.html'}")
    if interruption.noted:
        typer.echo(f"covey: interrupted; what was finished by then is in {target}", err=True)
        raise typer.Exit(INTERRUPTED)
