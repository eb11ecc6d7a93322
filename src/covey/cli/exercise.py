"""Flies an exercise file for ``covey fly``."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from covey.cli.interrupt import INTERRUPTED, Interruption
from covey.cli.view import live

if TYPE_CHECKING:
    from covey.runtime.exercise import ExerciseResult
    from covey.runtime.result import Progress

MISSED = 1
"""Exit code for an exercise with a collision, a lost vehicle or a goal that was not reached."""


def fly_exercise_file(
    path: Path,
    *,
    vehicles: str,
    seed: int | None,
    out: Path | None,
    realtime: bool,
    film: bool,
    json: bool,
    quiet: bool,
    force: bool,
    view: bool,
    host: str,
    port: int,
    open_page: bool,
) -> None:
    """Fly the exercise of a file, write it into a directory, and say how it went; in real time if it is shown."""
    from covey.mission.exercise import load_exercise

    exercise = load_exercise(path, seed=seed)

    from covey.cli.progress import ProgressLine
    from covey.cli.recording import Recording
    from covey.errors import OutputError
    from covey.runtime.exercise import fly_exercise
    from covey.runtime.records.record import default_directory
    from covey.runtime.records.sortie_record import check_exercise_target, exercise_text, film_exercise, write_exercise

    target = default_directory(exercise.name, exercise.seed) if out is None else out
    check_exercise_target(target, overwrite=force)
    failure: OutputError | None = None
    with live(view, mission=None, host=host, port=port, open_page=open_page) as shown:
        with (
            Interruption() as interruption,
            Recording(target, quiet=quiet) as recording,
            ProgressLine(quiet=quiet) as progress,
        ):

            def report(news: Progress) -> None:
                interruption.check()
                progress(news)

            result = fly_exercise(
                exercise,
                simulator=vehicles,
                realtime=realtime or view,
                on_progress=report,
                watch=shown.watch_with(recording.recorder),
            )
            try:
                write_exercise(result, target, overwrite=force)
                recording.keep()
            except OutputError as error:  # what was flown must not be lost with it
                failure = recording.lost(error)
            filmed = False
            if film and failure is None:
                with suppress(KeyboardInterrupt):  # all else is there
                    filmed = film_exercise(result, target, on_progress=report) is not None
        if failure is not None:
            raise failure
        if json:
            typer.echo(exercise_text(result), nl=False)
        elif not quiet:
            _show(result, target)
        if not interruption.noted:
            shown.stay()
    if result.interrupted:
        typer.echo(f"covey: interrupted; what was known by then is in {target}", err=True)
        raise typer.Exit(INTERRUPTED)
    if interruption.noted:
        missing = ", without a film" if film and not filmed else ""
        typer.echo(f"covey: interrupted; the flight was over and is in {target}{missing}", err=True)
        raise typer.Exit(INTERRUPTED)
    if result.summary["collisions"] or result.summary["lost"] or result.summary["waypoints_missed"]:
        raise typer.Exit(MISSED)


def _show(result: ExerciseResult, target: Path) -> None:
    from covey.cli.summary import factor_text, length_text, printable
    from covey.runtime.records.record import FLIGHT_FILES, RECORD, RESULT

    summary = result.summary
    least = summary["min_separation_m"]
    apart = "one vehicle" if least is None else f"at least {least:.2f} m"
    head = f"{printable(result.exercise.name)}: {summary['duration_s']:.0f} s in {summary['simulator']}"
    lines = [
        f"{head}, {factor_text(summary['real_time_factor'])} real time",
        f"Apart     {apart}; collisions: {summary['collisions']}",
        f"Tracking  {length_text(summary['tracking_rms_m'])} rms",
        f"Goals     {summary['waypoints_reached']} reached, {summary['waypoints_missed']} missed",
    ]
    if summary["min_object_gap_m"] is not None:
        lines.append(f"Object    passes at {summary['min_object_gap_m']:.2f} m from the rotors")
    lines += [
        f"          {event['time_s']:.1f} s: {printable(event['text'])}"
        for event in summary["events"]
        if event["event"] != "reached"
    ]
    names = [name for name in (*FLIGHT_FILES, RECORD, RESULT) if (target / name).exists()]
    lines.append(f"Files     {target}: {', '.join(names)}")
    typer.echo("\n".join(lines))
