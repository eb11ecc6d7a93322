"""``covey fly``: from a mission file to a flight in simulation."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from covey.cli.interrupt import INTERRUPTED, Interruption
from covey.cli.paths import named_path
from covey.cli.view import Host, Open, Port, Speed, View, live

if TYPE_CHECKING:
    from covey.runtime.fly import Flight
    from covey.runtime.result import Progress

VIOLATED = 1
"""Exit code for a deployment whose certificate does not hold, or an exercise that did not do what it should."""


def fly(
    mission: Annotated[
        Path,
        typer.Argument(parser=named_path, metavar="MISSION", help="Mission or exercise file: YAML, TOML or JSON."),
    ],
    vehicles: Annotated[
        Literal["mujoco", "reference", "kinematic"],
        typer.Option(help="What flies: MuJoCo's rigid bodies, our own equations, or points that follow exactly."),
    ] = "mujoco",
    seed: Annotated[int | None, typer.Option(min=0, help="Seed of all randomness, instead of the mission's.")] = None,
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
    force: Annotated[bool, typer.Option("--force", help="Replace an earlier result in DIR.")] = False,
    view: View = False,
    port: Port = 0,
    host: Host = "127.0.0.1",
    open_page: Open = False,
    speed: Speed = None,
) -> None:
    """Fly a mission in simulation: take off, trade and fly until nobody gains, land.

    The result directory gets what `covey plan` writes, record.mcap with the flight, its log (flight.npz), figures
    (flight.png, flight.pdf) and, with --film, a film. Ctrl-C ends the flight early and keeps what is known by then.

    With --view a page in the browser shows it live, in real time, and lets you pause, put obstacles in the way and let
    vehicles fail; it stays until Ctrl-C, or not at all where no terminal is.

    An exercise file (a few vehicles with goals or trajectories, no landmarks) is flown as well.

    Exit code: 0 the deployment is proved, 1 its certificate does not hold, 2 bad input or the result cannot be
    written, 3 an optimiser or simulator failed, 130 Ctrl-C.

    [bold]Examples[/bold]

      covey fly scene.yaml

      covey fly scene.yaml --vehicles reference --seed 3 --out results/3 --film
    """
    from covey.mission.exercise import is_exercise

    if is_exercise(mission):
        from covey.cli.exercise import fly_exercise_file

        if view:
            raise typer.BadParameter("an exercise has no landmarks to show; it takes a mission", param_hint="--view")
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
        )
        return

    from covey.errors import OutputError
    from covey.mission import load_mission

    loaded = load_mission(mission, seed=seed)

    from covey.cli.progress import ProgressLine
    from covey.cli.recording import Recording
    from covey.runtime.fly import fly as fly_mission
    from covey.runtime.record import check_result_target, default_directory, result_text
    from covey.runtime.sortie_record import write_flight

    target = default_directory(f"{loaded.name}-flown", loaded.seed) if out is None else out
    check_result_target(target, overwrite=force)
    failure: OutputError | None = None
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
                write_flight(flight, target, overwrite=force, film=film, on_progress=progress)
                recording.keep()
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
    _leave(flight, target)


def _leave(flight: Flight, target: Path) -> None:
    deployment = flight.deployment
    certificate = deployment.certificate
    if deployment.status.value == "interrupted":
        typer.echo(f"covey: interrupted; what was known by then is in {target}", err=True)
        raise typer.Exit(INTERRUPTED)
    if certificate is not None and not certificate.holds:
        count = len(certificate.violations)
        typer.echo(f"covey: the certificate does not hold, violations: {count}; they are in {target}", err=True)
        raise typer.Exit(VIOLATED)
