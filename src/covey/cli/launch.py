"""``covey launch``: every agent of a mission as a process of its own, on this machine."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from covey.cli.arguments import Seed, named_path
from covey.cli.interrupt import INTERRUPTED, Interruption
from covey.cli.view import Host, Open, Port, View, live

if TYPE_CHECKING:
    from covey.mission import Mission
    from covey.runtime.network.launch import Blow, LaunchReport
    from covey.runtime.network.observer import Observer
    from covey.runtime.result import Deployment

VIOLATED = 1
"""Exit code for a mission that did not settle, or whose certificate does not hold."""


def launch(
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
    vehicles: Annotated[
        Literal["none", "kinematic", "reference", "mujoco"],
        typer.Option(
            help="What flies: nothing, which is at each waypoint at once, or simulated vehicles in real time."
        ),
    ] = "none",
    restart: Annotated[bool, typer.Option("--restart", help="Start an agent again that died.")] = False,
    kill: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME@SECONDS", help="Kill an agent's process, so long after all were there."),
    ] = None,
    timeout: Annotated[
        float | None, typer.Option(min=0.0, metavar="SECONDS", help="End after so long, over or not.")
    ] = None,
    state: Annotated[
        Path | None,
        typer.Option(parser=named_path, metavar="DIR", help="Where agents keep what a restart begins with."),
    ] = None,
    network: Annotated[
        Path | None,
        typer.Option(parser=named_path, metavar="FILE", help="Certificates, access list, times: TOML."),
    ] = None,
    observe: Annotated[
        bool, typer.Option("--observe", help="Start nothing; watch agents that others have started.")
    ] = False,
    connect: Annotated[
        list[str] | None, typer.Option(metavar="ENDPOINT", help="With --observe: where an agent listens.")
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print the content of result.json, nothing else.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress and no summary.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace an earlier result in DIR, all its files.")] = False,
    view: View = False,
    port: Port = 0,
    host: Host = "127.0.0.1",
    open_page: Open = False,
) -> None:
    """Run a mission with every agent in a process of its own, joined by a network on this machine.

    An observer, which never takes part, waits until the mission is over, proves the deployment and writes what
    `covey plan` writes, and launch.json: who died and how, what was dropped from strangers, how long it took. Ctrl-C
    is passed on to the agents, and what is known by then is kept. With --view a page in the browser shows it live.

    Exit code: 0 the deployment is proved, 1 it is not, or the mission did not settle, 2 bad input, no network
    or the result cannot be written, 3 an optimiser failed, 130 Ctrl-C.

    [bold]Examples[/bold]

      covey launch scene.yaml --out launched

      covey launch scene.yaml --kill red@2 --restart

      covey launch scene.yaml --observe --connect tcp/192.0.2.10:7447
    """
    from covey.errors import ArgumentError, InputError, OutputError
    from covey.mission import load_mission
    from covey.runtime.airspace import check_processes

    loaded = load_mission(mission, seed=seed)
    check_processes(loaded)

    from covey.cli.progress import ProgressLine
    from covey.cli.recording import Recording
    from covey.runtime.network import launch as launching
    from covey.runtime.network.network_file import NetworkPlan, load_network
    from covey.runtime.network.network_telling import NetworkTeller
    from covey.runtime.records.record import check_result_target, default_directory, write_result
    from covey.runtime.result import Progress
    from covey.runtime.watching.steering import Steering

    plan = NetworkPlan() if network is None else load_network(network, loaded)
    if connect and not observe:
        raise InputError("--connect: expected --observe with it; a launched team finds its own endpoints")
    if observe and (kill or restart):
        raise InputError("--observe: expected neither --kill nor --restart with it; an observer changes nothing")
    if observe:
        if not (connect or plan.options.connect or plan.options.multicast):
            raise InputError("--observe: expected --connect with it, or a network file that says where agents are")
        try:
            plan = plan.joined(connect=tuple(connect or ()))
        except ArgumentError as error:
            raise InputError(str(error)) from None
    blows = tuple(_kill(text, loaded) for text in kill or ())
    target = default_directory(f"{loaded.name}-launched", loaded.seed) if out is None else out
    check_result_target(target, overwrite=force)
    failure: OutputError | None = None
    steering = None if observe else Steering(paced=False)
    with live(view, mission=loaded, host=host, port=port, open_page=open_page, steering=steering) as shown:
        with (
            Interruption() as interruption,
            Recording(target, quiet=quiet) as recording,
            ProgressLine(quiet=quiet) as progress,
        ):
            tellers: list[NetworkTeller] = []

            def begin(observer: Observer) -> None:
                watch = shown.watch_with(recording.recorder)
                if shown.eyes is not None:
                    shown.eyes.follow(observer.team.planner)
                tellers.append(NetworkTeller(watch, observer, dead_after=plan.times.dead_after))

            def report(news: Progress) -> None:
                interruption.check()
                for teller in tellers:
                    teller.update()
                progress(news)

            limit = math.inf if timeout is None else timeout
            if observe:
                deployment, outcome = launching.watch(
                    loaded, plan, timeout=limit, on_progress=report, on_observer=begin
                )
            else:
                options = launching.LaunchOptions(
                    network=plan,
                    network_file=network,
                    state=state,
                    vehicles=vehicles,
                    restart=restart,
                    blows=blows,
                    timeout=limit,
                )
                deployment, outcome = launching.launch(
                    loaded, mission, options, on_progress=report, on_observer=begin, steering=shown.steering
                )
            for teller in tellers:
                teller.end(
                    deployment.status.value, None if deployment.certificate is None else deployment.certificate.holds
                )
            try:
                write_result(
                    deployment,
                    target,
                    overwrite=force,
                    more=lambda folder: (folder / "launch.json").write_text(outcome.to_json(), encoding="utf-8"),
                )
                recording.keep()
            except OutputError as error:  # what was found must not be lost with it
                failure = recording.lost(error)
        if json:
            from covey.runtime.records.record import result_text

            typer.echo(result_text(deployment, target), nl=False)
        elif not quiet:
            from covey.cli.summary import print_summary

            print_summary(deployment, target if failure is None else None)
        if failure is None and not interruption.noted:
            shown.stay()
    _tell(outcome, observe=observe, quiet=quiet or json)
    if failure is not None:
        raise failure
    _leave(deployment, target, interrupted=interruption.noted)


def _kill(text: str, mission: Mission) -> Blow:
    from covey.errors import InputError
    from covey.runtime.network.launch import Blow

    name, _, when = text.rpartition("@")
    names = [agent.name for agent in mission.agents]
    try:
        after = float(when)
    except ValueError:
        after = math.nan
    if name not in names or not 0.0 <= after < math.inf:
        raise InputError(f"--kill: expected NAME@SECONDS with an agent of {', '.join(names)}, got {text!r}")
    return Blow(names.index(name), after)


def _tell(outcome: LaunchReport, *, observe: bool, quiet: bool) -> None:
    """Say who died, and what came from strangers."""
    for one in outcome.exits:
        if one.wanted and one.code in (0, INTERRUPTED):
            continue
        wish = ", as asked" if one.wanted else ""
        typer.echo(f"covey: {one.name} died after {one.time:.1f} s: {one.cause}{wish}", err=True)
        if not one.wanted:
            for line in one.stderr[-5:]:
                typer.echo(f"covey:   {line}", err=True)
    if outcome.strangers:
        counts = ", ".join(f"{count} {cause}" for cause, count in outcome.strangers.items())
        typer.echo(f"covey: dropped from the network: {counts}", err=True)
    if outcome.refused:
        counts = ", ".join(f"{count} ({why})" for why, count in outcome.refused.items())
        typer.echo(f"covey: connections refused: {counts}", err=True)
    if not quiet:
        if outcome.start_s is None or outcome.settle_s is None:
            hint = "; do they have this mission file and seed?" if observe and not outcome.settled else ""
            typer.echo(f"covey: not all agents were heard{hint}", err=True)
            return
        unowned = f"; no landmark without an owner for longer than {outcome.longest_unowned:.1f} s"
        killed = outcome.died or any(one.wanted and one.code < 0 for one in outcome.exits)
        end = "through" if outcome.settled else "ended"
        typer.echo(
            f"covey: all agents were there after {outcome.start_s:.1f} s, and {end} {outcome.settle_s:.1f} s later"
            f"{unowned if killed and outcome.settled else ''}",
            err=True,
        )


def _leave(deployment: Deployment, target: Path, *, interrupted: bool) -> None:
    certificate = deployment.certificate
    if interrupted:
        typer.echo(f"covey: interrupted; what was known by then is in {target}", err=True)
        raise typer.Exit(INTERRUPTED)
    if certificate is None:
        typer.echo(f"covey: the mission did not settle; what was known by then is in {target}", err=True)
        raise typer.Exit(VIOLATED)
    if not certificate.holds:
        count = len(certificate.violations)
        typer.echo(f"covey: the certificate does not hold, violations: {count}; they are in {target}", err=True)
        raise typer.Exit(VIOLATED)
