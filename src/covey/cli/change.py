"""``covey change``: change landmarks or agents of a team on the network."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from covey.cli.arguments import Seed, named_path
from covey.cli.interrupt import Interruption

if TYPE_CHECKING:
    from covey.mission import ChangeSpec
    from covey.runtime.network.observed_team import ObservedTeam

SOURCE = "covey change"
"""What errors say that a change comes from."""


def change(
    mission: Annotated[
        Path, typer.Argument(parser=named_path, metavar="MISSION", help="The file that the team's agents read.")
    ],
    connect: Annotated[
        list[str] | None, typer.Option(metavar="ENDPOINT", help="Where an agent listens; one is enough.")
    ] = None,
    add: Annotated[
        list[str] | None,
        typer.Option(metavar="X,Y", help="A landmark to be seen from now on, metres."),
    ] = None,
    remove: Annotated[
        list[int] | None, typer.Option(min=0, metavar="K", help="A landmark to be seen no more; may be repeated.")
    ] = None,
    reweight: Annotated[
        list[int] | None,
        typer.Option(min=0, metavar="K", help="A landmark that is worth --weight from now on; may be repeated."),
    ] = None,
    weight: Annotated[
        float | None, typer.Option(min=0.0, metavar="W", help="Of those that are added or re-weighted.")
    ] = None,
    normal: Annotated[
        float | None, typer.Option("--normal", metavar="DEG", help="Which way those face that are added, degrees.")
    ] = None,
    join: Annotated[
        Path | None,
        typer.Option(
            parser=named_path, metavar="FILE", help="An agent that takes part from now on, as a mission file has it."
        ),
    ] = None,
    leave: Annotated[str | None, typer.Option(metavar="NAME", help="The agent that takes part no more.")] = None,
    seed: Seed = None,
    network: Annotated[
        Path | None,
        typer.Option(parser=named_path, metavar="FILE", help="Endpoints, certificates, times: TOML."),
    ] = None,
    timeout: Annotated[
        float,
        typer.Option(min=0.1, metavar="SECONDS", help="How long to wait for agents, and then until all know."),
    ] = 10.0,
    json: Annotated[bool, typer.Option("--json", help="Print what was changed, and who knows, as JSON.")] = False,
) -> None:
    """Change what a running team is to see, or who takes part, and wait until all know.

    Give one kind of change a time; --add, --remove and --reweight may be repeated. What is added, and who joins, gets
    the next number. Start an agent that joins by `covey agent --name` and its name; who leaves hands its landmarks
    over and ends. In a network file {name} stands for operator here. One operator at a time: of two changes of the
    same at the same time one is lost, which is reported.

    Exit code: 0 all agents know, 2 bad input, nobody is heard, or not all know, 130 Ctrl-C.

    [bold]Examples[/bold]

      covey change scene.yaml --connect tcp/192.0.2.10:7447 --reweight 12 --reweight 13 --weight 5

      covey change scene.yaml --connect tcp/192.0.2.10:7447 --join green.yaml
    """
    from covey.errors import InputError
    from covey.mission import load_mission
    from covey.mission.changes_build import read_change
    from covey.runtime.airspace import check_processes
    from covey.runtime.network.network_file import NetworkPlan, load_network
    from covey.runtime.network.operator import change_team

    loaded = load_mission(mission, seed=seed)
    check_processes(loaded)
    plan = NetworkPlan() if network is None else load_network(network, loaded)
    plan = plan.for_name("operator").joined(connect=tuple(connect or ()))
    if not plan.options.connect and not plan.options.multicast:
        raise InputError("--connect: expected the endpoint of an agent, or a network file that has one; got none")
    wanted: dict[str, Any] = {}
    if add:
        wanted["add"] = {"points": [_point(text) for text in add]}
        wanted["add"] |= {} if weight is None else {"weight": weight}
        wanted["add"] |= {} if normal is None else {"normal_deg": normal}
    if remove:
        wanted["remove"] = list(remove)
    if reweight:
        if weight is None:
            raise InputError("--weight: expected what the landmarks are worth from now on, got none")
        wanted["reweight"] = {"landmarks": list(reweight), "weight": weight}
    if join is not None:
        wanted["join"] = _document(join)
    if leave is not None:
        wanted["leave"] = leave
    if len(wanted) != 1:
        given = ", ".join(f"--{kind}" for kind in wanted) or "none"
        raise InputError(f"expected exactly one of --add, --remove, --reweight, --join and --leave, got {given}")

    def build(team: ObservedTeam) -> ChangeSpec:
        names, gone = team.names, [team.names[agent] for agent in team.gone]
        return read_change(
            wanted,
            names=[name for name in names if name not in gone],
            gone=gone,
            landmarks=team.planner.landmarks,
            removed=[k for k, alive in enumerate(team.planner.alive.tolist()) if not alive],
            source=SOURCE,
        )

    with Interruption() as interruption:
        told = change_team(loaded, plan, build, timeout=timeout, check=interruption.check)
    if json:
        import dataclasses
        from json import dumps

        typer.echo(dumps(dataclasses.asdict(told)))
    else:
        typer.echo(f"{told.detail} {told.event}; known to {', '.join(told.agents)}")


def _point(text: str) -> list[float]:
    from covey.errors import InputError

    try:
        numbers = [float(part) for part in text.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) != 2 or not all(map(math.isfinite, numbers)):
        raise InputError(f"--add: expected X,Y in metres, got {text!r}")
    return numbers


def _document(path: Path) -> Any:
    from covey.environment.files import read_text
    from covey.errors import InputError, MissionError
    from covey.mission.document import FORMATS, parse

    text = read_text(path, limit=1_000_000)
    syntax = FORMATS.get(path.suffix.lower())
    if syntax is None:
        raise InputError(f"{path}: expected a file name ending in .yaml, .yml, .toml or .json, got {path.suffix!r}")
    document = parse(text, syntax, str(path))
    if document.mistakes:
        raise MissionError(tuple(document.mistakes))
    return document.data
