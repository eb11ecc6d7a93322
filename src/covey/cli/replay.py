"""``covey replay``: a record in the browser, as one file, or as a film."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from covey.cli.arguments import named_path
from covey.cli.interrupt import Interruption
from covey.cli.view import FASTEST, Host, Open, Port, serve_page, wait_until

if TYPE_CHECKING:
    from covey.runtime.watching.feed import Scene, Update


def replay(
    record: Annotated[
        Path,
        typer.Argument(parser=named_path, metavar="RECORD", help="A record.mcap, or a result directory that has one."),
    ],
    html: Annotated[
        Path | None,
        typer.Option(parser=named_path, metavar="FILE", help="Write page and record as one file that plays offline."),
    ] = None,
    video: Annotated[
        Path | None, typer.Option(parser=named_path, metavar="FILE", help="Make a film of it: .mp4 or .gif.")
    ] = None,
    speed: Annotated[
        float | None,
        typer.Option(
            min=0.01, max=FASTEST, help="How many times as fast; of a plan's film, changes and offers a second."
        ),
    ] = None,
    port: Port = 0,
    host: Host = "127.0.0.1",
    open_page: Open = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace FILE.")] = False,
) -> None:
    """Replay a record: scrub through it, step, jump from trade to trade.

    Serves the page until Ctrl-C; with --html or --video it writes the file instead. A record that was cut off is
    played up to the cut.

    Exit code: 0, or 2 for a record that cannot be read or a file that cannot be written.

    [bold]Examples[/bold]

      covey replay covey-out/scene-7 --open

      covey replay record.mcap --html flight.html

      covey replay record.mcap --video flight.mp4 --speed 4
    """
    from covey.errors import OutputError
    from covey.runtime.records.mcap_reader import Record

    for target in (html, video):
        if target is not None and target.is_dir():
            raise OutputError(f"{target}: expected a file to write, got a directory; choose another name")
        if target is not None and os.path.lexists(target) and not force:
            raise OutputError(f"{target}: is there already; choose another name, or replace it with --force")
    with Record(record) as opened:
        told = list(opened.items())
        for problem in opened.problems:  # all are known when all was read
            typer.echo(f"covey: {problem}", err=True)
    if html is not None:
        _write_html(told, html)
    if video is not None:
        _write_video(told, video, speed=speed, quiet=quiet)
    if html is None and video is None:
        from covey.playground.offline import feed_bytes

        with (
            Interruption() as interruption,
            serve_page(host=host, port=port, open_page=open_page, record=feed_bytes(told), speed=speed or 1.0),
        ):
            typer.echo("covey: the page stays until you press Ctrl-C", err=True)
            wait_until(lambda: interruption.noted)


def _write_html(told: Sequence[Scene | Update], target: Path) -> None:
    from covey.playground.offline import feed_bytes, offline_page
    from covey.runtime.records.output import staged

    page = offline_page(feed_bytes(told))
    with staged(target.parent, [target.name]) as folder:
        (folder / target.name).write_text(page, encoding="utf-8")
    typer.echo(f"covey: wrote {target}, {target.stat().st_size / 1e6:.1f} MB", err=True)


def _write_video(told: Sequence[Scene | Update], target: Path, *, speed: float | None, quiet: bool) -> None:
    from covey.cli.progress import ProgressLine
    from covey.runtime.drawing.record_film import write_record_film
    from covey.runtime.result import Progress

    with Interruption() as interruption, ProgressLine(quiet=quiet) as progress:

        def report(done: float) -> None:
            interruption.check()
            progress(Progress("filming", float("nan"), fraction=done))

        write_record_film(told, target, speed=speed, on_progress=report)
    typer.echo(f"covey: wrote {target}, {target.stat().st_size / 1e6:.1f} MB", err=True)
