"""``covey agent``: one agent of a mission as a process."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Literal

import typer

from covey.cli.arguments import named_path
from covey.cli.interrupt import INTERRUPTED

UNSETTLED = 1
"""Exit code of an agent that left before the mission was over."""

SUPERSEDED = 4
"""Exit code of an agent that was started again elsewhere."""


def agent(
    mission: Annotated[
        Path, typer.Option("--mission", parser=named_path, metavar="FILE", help="Mission file: YAML, TOML or JSON.")
    ],
    name: Annotated[
        str, typer.Option("--name", metavar="NAME", help="Which agent this is, of the mission or of those that join.")
    ],
    seed: Annotated[
        int | None, typer.Option(min=0, help="Seed of all randomness; the same for the whole team.")
    ] = None,
    listen: Annotated[
        list[str] | None,
        typer.Option(metavar="ENDPOINT", help="Where others reach it, tcp/ADDRESS:PORT; by default from here only."),
    ] = None,
    connect: Annotated[
        list[str] | None, typer.Option(metavar="ENDPOINT", help="Where another listens; one is enough.")
    ] = None,
    router: Annotated[
        str | None, typer.Option(metavar="ENDPOINT", help="Talk through a router instead of to the others directly.")
    ] = None,
    network: Annotated[
        Path | None,
        typer.Option(parser=named_path, metavar="FILE", help="Endpoints, certificates, access list, times: TOML."),
    ] = None,
    state: Annotated[
        Path | None,
        typer.Option(parser=named_path, metavar="DIR", help="Where to keep what a restart begins with."),
    ] = None,
    vehicles: Annotated[
        Literal["none", "kinematic", "reference", "mujoco"],
        typer.Option(
            help="What flies: nothing, which is at each waypoint at once, or a simulated vehicle in real time."
        ),
    ] = "none",
    wait: Annotated[
        float, typer.Option(min=0.0, metavar="SECONDS", help="How long to wait for the others at the start.")
    ] = 60.0,
    timeout: Annotated[
        float | None, typer.Option(min=0.0, metavar="SECONDS", help="Leave after so long, over or not.")
    ] = None,
    attached: Annotated[
        bool, typer.Option("--attached", help="Stay when the mission is over, and leave when standard input closes.")
    ] = False,
    json: Annotated[bool, typer.Option("--json", help="Print a report of this agent as JSON at the end.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Say nothing but what is wrong.")] = False,
) -> None:
    """Run one agent of a mission: planner, controller and vehicle in one process.

    Every process of the team reads the same mission file with the same seed. The agent begins when all others are
    there, or have begun, or the wait is over, and leaves when the mission is over. With --state it remembers what it
    knew when it is started again. An agent that is not in the mission file joins if `covey change --join` has let it:
    the others know the rest.

    Exit code: 0 the mission is over, 1 it left before, 2 bad input or no network, 3 an optimiser failed, 4 another
    process took its place, 130 Ctrl-C.

    [bold]Examples[/bold]

      covey agent --mission scene.yaml --name blue --listen tcp/192.0.2.10:7447 --state state

      covey agent --mission scene.yaml --name red --listen tcp/192.0.2.11:7447 --connect tcp/192.0.2.10:7447
    """
    from covey.errors import ArgumentError, InputError
    from covey.mission import load_mission
    from covey.runtime.airspace import check_processes
    from covey.runtime.network.agent_process import AgentSettings, Ending, run_agent
    from covey.runtime.network.network_file import NetworkPlan, load_network

    loaded = load_mission(mission, seed=seed)
    check_processes(loaded)
    plan = NetworkPlan() if network is None else load_network(network, loaded)
    try:
        plan = plan.for_name(name).joined(
            listen=tuple(listen) if listen else None, connect=tuple(connect or ()), router=router
        )
    except ArgumentError as error:
        raise InputError(str(error)) from None
    settings = AgentSettings(
        name=name,
        network=plan,
        state=state,
        vehicles=vehicles,
        patience=wait,
        timeout=math.inf if timeout is None else timeout,
        attached=attached,
    )

    def say(text: str) -> None:
        typer.echo(f"covey: {name}: {text}", err=True)

    report = run_agent(loaded, settings, say=say, talkative=not quiet)
    if json:
        typer.echo(report.to_json())
    if report.ending is Ending.INTERRUPTED:
        raise typer.Exit(INTERRUPTED)
    if report.ending is Ending.SUPERSEDED:
        raise typer.Exit(SUPERSEDED)
    if not report.over and report.ending not in (Ending.RELEASED, Ending.LEFT):
        raise typer.Exit(UNSETTLED)
