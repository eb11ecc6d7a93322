"""``covey plan``: from a mission file to a deployment and its proof."""

from __future__ import annotations

import importlib
import threading
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from covey.cli.arguments import Seed, named_path
from covey.cli.interrupt import INTERRUPTED, Interruption
from covey.cli.view import Host, Open, Port, Speed, View, live

if TYPE_CHECKING:
    from covey.mission import Mission
    from covey.runtime.result import Deployment, Progress

CHANGES_A_SECOND = 10.0
"""With ``--view``, so that people can see what happens."""

VIOLATED = 1
"""Exit code for a deployment whose certificate does not hold."""


def plan(
    mission: Annotated[
        Path, typer.Argument(parser=named_path, metavar="MISSION", help="Mission file: YAML, TOML or JSON.")
    ],
    seed: Seed = None,
    out: Annotated[
        Path | None,
        typer.Option(
            parser=named_path,
            metavar="DIR",
            help="Where to write the result; by default a new directory in covey-out/.",
        ),
    ] = None,
    trade: Annotated[
        Literal["thesis", "pairwise"] | None, typer.Option(help="How two agents trade, instead of the mission's way.")
    ] = None,
    optimizer: Annotated[
        Literal["search", "exact", "differential-evolution"] | None,
        typer.Option(help="What looks for poses, instead of the mission's choice."),
    ] = None,
    bound: Annotated[bool, typer.Option("--bound", help="Prove what no deployment of this team can exceed.")] = False,
    baseline: Annotated[
        bool, typer.Option("--baseline", help="Also deploy greedily and by Lloyd's iteration, to compare.")
    ] = False,
    json: Annotated[bool, typer.Option("--json", help="Print the content of result.json, nothing else.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress and no summary.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace an earlier result in DIR, all its files.")] = False,
    view: View = False,
    port: Port = 0,
    host: Host = "127.0.0.1",
    open_page: Open = False,
    speed: Speed = None,
) -> None:
    """Plan a mission: who goes where and watches what, proved.

    The result directory gets result.json, agents.csv, deployment.png, deployment.pdf, the record of the run
    (record.mcap: see `covey info`) and, for missions on the map, deployment.geojson. Ctrl-C ends the planning early
    and keeps what is known by then.

    With --view a page in the browser shows it live, 10 changes a second, and lets you pause and step; it stays until
    Ctrl-C, or not at all where no terminal is.

    Exit code: 0 the deployment is proved, 1 its certificate does not hold, 2 bad input or the result cannot be
    written, 3 an optimiser failed, for example a bound for a sensor that is not built in, 130 Ctrl-C.

    [bold]Examples[/bold]

      covey plan scene.yaml

      covey plan scene.yaml --seed 3 --out results/3 --bound --baseline

      covey plan scene.yaml --trade thesis --json --quiet > result.json

      covey plan scene.yaml --view --open
    """
    from covey.errors import OutputError
    from covey.mission import OptimizerName, Trade, load_mission

    loaded = load_mission(mission, seed=seed)

    from covey.cli.recording import Recording
    from covey.runtime.records.record import check_result_target, default_directory, write_result

    target = default_directory(loaded.name, loaded.seed) if out is None else out
    check_result_target(target, overwrite=force)
    failure: OutputError | None = None
    with live(
        view, mission=loaded, host=host, port=port, open_page=open_page, speed=speed, usual=CHANGES_A_SECOND
    ) as shown:
        with Interruption() as interruption, Recording(target, quiet=quiet) as recording:
            # Half a second of imports that only the figures need, while the planner's compiled code runs.
            threading.Thread(target=_import_figures).start()
            deployment = _plan(
                loaded,
                interruption,
                quiet=quiet,
                trade=None if trade is None else Trade(trade),
                optimizer=None if optimizer is None else OptimizerName(optimizer),
                bound=bound,
                baseline=baseline,
                watch=shown.watch_with(recording.recorder),
                steering=shown.steering,
            )
            try:
                write_result(deployment, target, overwrite=force)
                recording.keep()
            except OutputError as error:  # what was found must not be lost with it
                failure = recording.lost(error)
        _show(deployment, target, json=json, quiet=quiet, written=failure is None)
        if failure is None and not interruption.noted:
            shown.stay()
    if failure is not None:
        raise failure
    certificate = deployment.certificate
    violated = certificate is not None and not certificate.holds
    if certificate is not None and violated:
        count = len(certificate.violations)
        typer.echo(f"covey: the certificate does not hold, violations: {count}; they are in {target}", err=True)
    if deployment.status.value == "interrupted":
        typer.echo(f"covey: interrupted; what was known by then is in {target}", err=True)
        raise typer.Exit(INTERRUPTED)
    if interruption.noted:
        asked = (("bound", bound, deployment.bound), ("baseline", baseline, deployment.baseline))
        missing = " and the ".join(name for name, wanted, found in asked if wanted and found is None)
        if missing:
            typer.echo(f"covey: interrupted; planning had settled and is in {target}, without the {missing}", err=True)
        raise typer.Exit(INTERRUPTED)
    if violated:
        raise typer.Exit(VIOLATED)


def _plan(mission: Mission, interruption: Interruption, *, quiet: bool, **options: Any) -> Deployment:
    from covey.cli.progress import ProgressLine
    from covey.runtime.first_use import compiling_beside

    with ProgressLine(quiet=quiet) as progress, compiling_beside():
        from covey.runtime.plan import plan as plan_mission

        def report(news: Progress) -> None:
            interruption.check()
            progress(news)

        return plan_mission(mission, on_progress=report, **options)


def _import_figures() -> None:
    for name in ("covey.runtime.drawing.figures", "matplotlib.backends.backend_pdf"):
        importlib.import_module(name)


def _show(deployment: Deployment, target: Path, *, json: bool, quiet: bool, written: bool) -> None:
    if json:
        from covey.runtime.records.record import result_text

        typer.echo(result_text(deployment, target), nl=False)
    elif not quiet:
        from covey.cli.summary import print_summary

        print_summary(deployment, target if written else None)
