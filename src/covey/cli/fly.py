"""``covey fly``: from a mission file to a flight in simulation."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from covey.cli.arguments import Seed, named_path
from covey.cli.interrupt import INTERRUPTED, Interruption
from covey.cli.view import Host, Open, Port, Speed, View, live

if TYPE_CHECKING:
    from covey.runtime.flight import Flight
    from covey.runtime.result import Progress

VIOLATED = 1
"""Exit code for a deployment whose certificate does not hold, or an exercise that did not do what it should."""


FAILED = 4
"""Exit code for a flight on which vehicles touched something or did not come back."""


def fly(
    mission: Annotated[
        Path,
        typer.Argument(parser=named_path, metavar="MISSION", help="Mission or exercise file: YAML, TOML or JSON."),
    ],
    vehicles: Annotated[
        Literal["mujoco", "reference", "kinematic"],
        typer.Option(help="What flies: MuJoCo's rigid bodies, our own equations, or points that follow exactly."),
    ] = "mujoco",
    seed: Seed = None,
    out: Annotated[
        Path | None,
        typer.Option(
            parser=named_path,
            metavar="DIR",
            help="Where to write the result; by default a new directory in covey-out/.",
        ),
    ] = None,
    realtime: Annotated[bool, typer.Option("--realtime", help="Let the flight take as long as it would.")] = False,
    film: Annotated[bool, typer.Option("--film", help="Also make a film of it: mp4, or gif without ffmpeg.")] = False,
    json: Annotated[bool, typer.Option("--json", help="Print the content of result.json, nothing else.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress and no summary.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace an earlier result in DIR, all its files.")] = False,
    view: View = False,
    port: Port = 0,
    host: Host = "127.0.0.1",
    open_page: Open = False,
    speed: Speed = None,
) -> None:
    """Fly a mission in simulation: take off, trade and fly until nobody gains, land.

    The result directory gets what `covey plan` writes, record.mcap with the flight, its log (flight.npz), figures
    (flight.png, flight.pdf) and, with --film, a film. Ctrl-C ends the flight early and keeps what is known by then;
    while the film is made it leaves the result without one.

    With --view a page in the browser shows it live, in real time, and lets you pause, put obstacles in the way and let
    vehicles fail; it stays until Ctrl-C, or not at all where no terminal is.

    An exercise file (a few vehicles with goals or trajectories, no landmarks) is flown as well.

    Exit code: 0 the deployment is proved, 1 its certificate does not hold, 2 bad input or the result cannot be
    written, 3 an optimiser or simulator failed, 4 vehicles were lost or touched something, 130 Ctrl-C.

    [bold]Examples[/bold]

      covey fly scene.yaml

      covey fly scene.yaml --vehicles reference --seed 3 --out results/3 --film
    """
    from covey.mission.exercise import is_exercise

    if is_exercise(mission):
        from covey.cli.exercise import fly_exercise_file

        if speed is not None:
            raise typer.BadParameter("an exercise is shown in real time", param_hint="--speed")
        fly_exercise_file(
            mission,
            vehicles=vehicles,
            seed=seed,
            out=out,
            realtime=realtime,
            film=film,
            json=json,
            quiet=quiet,
            force=force,
            view=view,
            host=host,
            port=port,
            open_page=open_page,
        )
        return

    from covey.errors import OutputError
    from covey.mission import load_mission

    loaded = load_mission(mission, seed=seed)

    from covey.cli.progress import ProgressLine
    from covey.cli.recording import Recording
    from covey.runtime.fly import fly as fly_mission
    from covey.runtime.records.record import check_result_target, default_directory, result_text
    from covey.runtime.records.sortie_record import film_flight, write_flight

    target = default_directory(f"{loaded.name}-flown", loaded.seed) if out is None else out
    check_result_target(target, overwrite=force)
    failure: OutputError | None = None
    filmed = False
    with live(view, mission=loaded, host=host, port=port, open_page=open_page, speed=speed, usual=1.0) as shown:
        with (
            Interruption() as interruption,
            Recording(target, quiet=quiet) as recording,
            ProgressLine(quiet=quiet) as progress,
        ):

            def report(news: Progress) -> None:
                interruption.check()
                progress(news)

            flight = fly_mission(
                loaded,
                vehicles=vehicles,
                realtime=realtime and not view,
                on_progress=report,
                watch=shown.watch_with(recording.recorder),
                steering=shown.steering,
            )
            try:
                write_flight(flight, target, overwrite=force)
                recording.keep()
                if film:
                    with suppress(KeyboardInterrupt):  # all else is there
                        filmed = film_flight(flight, target, on_progress=report) is not None
            except OutputError as error:  # what was found must not be lost with it
                failure = recording.lost(error)
        deployment = flight.deployment
        if json:
            typer.echo(result_text(deployment, target), nl=False)
        elif not quiet:
            from covey.cli.summary import print_summary

            print_summary(deployment, target if failure is None else None)
        if failure is None and not interruption.noted:
            shown.stay()
    if failure is not None:
        raise failure
    _leave(flight, target, interrupted=interruption.noted, without_film=film and not filmed)


def _leave(flight: Flight, target: Path, *, interrupted: bool, without_film: bool) -> None:
    deployment = flight.deployment
    certificate = deployment.certificate
    if deployment.status.value == "interrupted":
        typer.echo(f"covey: interrupted; what was known by then is in {target}", err=True)
        raise typer.Exit(INTERRUPTED)
    if interrupted:
        missing = ", without a film" if without_film else ""
        typer.echo(f"covey: interrupted; the flight was over and is in {target}{missing}", err=True)
        raise typer.Exit(INTERRUPTED)
    if certificate is not None and not certificate.holds:
        count = len(certificate.violations)
        typer.echo(f"covey: the certificate does not hold, violations: {count}; they are in {target}", err=True)
        raise typer.Exit(VIOLATED)
    report = deployment.flight
    if report is not None and (report.lost or report.collisions):
        lost = f"lost: {', '.join(report.lost)}" if report.lost else "nobody lost"
        typer.echo(f"covey: the flight failed, {lost}; collisions: {report.collisions}; see {target}", err=True)
        raise typer.Exit(FAILED)
