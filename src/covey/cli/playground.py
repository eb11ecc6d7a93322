"""``covey playground``: a team to play with, or one that runs elsewhere to watch."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from covey.cli.arguments import Seed, named_path
from covey.cli.interrupt import Interruption
from covey.cli.view import FASTEST, Eyes, Host, Open, Port, eyes_of, serve_page

if TYPE_CHECKING:
    from covey.mission import Mission
    from covey.runtime.network.network_file import NetworkPlan
    from covey.runtime.result import Progress
    from covey.runtime.watching.feed import Watcher
    from covey.runtime.watching.steering import Steering

LISTEN = 0.05
"""How long to listen to the network at a time, seconds."""

SILENCE = 8.0
"""Seconds without a word from any agent after which it is said what may be wrong."""


def playground(
    mission: Annotated[
        Path, typer.Argument(parser=named_path, metavar="MISSION", help="Mission file: YAML, TOML or JSON.")
    ],
    seed: Seed = None,
    connect: Annotated[
        list[str] | None,
        typer.Option(metavar="ENDPOINT", help="Watch a team on the network: where an agent of it listens."),
    ] = None,
    network: Annotated[
        Path | None,
        typer.Option(parser=named_path, metavar="FILE", help="Watch a team on the network: certificates, times; TOML."),
    ] = None,
    port: Port = 0,
    host: Host = "127.0.0.1",
    open_page: Open = False,
    speed: Annotated[
        float, typer.Option(min=0.0, max=FASTEST, help="Seconds a second; 0 for as fast as possible.")
    ] = 1.0,
) -> None:
    """Play with a mission in the browser: let messages get lost, kill agents, let them come back, and watch.

    The team lives in this process, where a message takes a twentieth of a second, so that all can be seen. With
    --connect or --network nothing is started: the page shows the team that others have started, and cannot steer it.
    Nothing is written. It goes on until Ctrl-C.

    Exit code: 0, or 2 for bad input or no network.

    [bold]Examples[/bold]

      covey playground scene.yaml --open

      covey playground scene.yaml --connect tcp/192.0.2.10:7447
    """
    from covey.mission import load_mission

    loaded = load_mission(mission, seed=seed)

    from covey.runtime.airspace import check_processes
    from covey.runtime.live_team import check_playable
    from covey.runtime.watching.steering import Steering

    observes = bool(connect or network)
    plan: NetworkPlan | None = None
    if observes:
        from covey.runtime.network.network_file import OBSERVER, NetworkPlan, load_network

        check_processes(loaded)
        plan = NetworkPlan() if network is None else load_network(network, loaded)
        plan = plan.joined(connect=tuple(connect or ())).for_name(OBSERVER)
    else:
        check_playable(loaded)
    steering = None if observes else Steering(speed=speed)
    eyes = eyes_of(loaded)
    with (
        serve_page(host=host, port=port, open_page=open_page, steering=steering, seen_by=eyes) as server,
        Interruption() as interruption,
    ):
        typer.echo("covey: it goes on until you press Ctrl-C", err=True)
        if plan is not None:
            _observe(loaded, plan, server.watch, eyes, interruption)
        elif steering is not None:
            _play(loaded, server.watch, steering, interruption)


def _play(mission: Mission, watch: Watcher, steering: Steering, interruption: Interruption) -> None:
    from covey.runtime.live_team import LiveTeam

    def report(news: Progress) -> None:
        interruption.check()

    LiveTeam(mission, watch=watch, steering=steering).play(until=lambda: interruption.noted, on_progress=report)


def _observe(mission: Mission, plan: NetworkPlan, watch: Watcher, eyes: Eyes, interruption: Interruption) -> None:
    from covey.protocol import Event
    from covey.runtime.network.network_telling import NetworkTeller
    from covey.runtime.network.observer import Observer
    from covey.runtime.network.remote_agent import mission_codec
    from covey.transports.zenoh_observer import ZenohObserver

    with closing(ZenohObserver(mission_codec(mission), plan.options)) as access:
        observer = Observer(mission, access, times=plan.times, late=True)
        eyes.follow(observer.team.planner)
        teller = NetworkTeller(watch, observer, dead_after=plan.times.dead_after)
        over, wondering = False, True
        while not interruption.noted:
            news = observer.step(LISTEN)
            if wondering and (news or observer.time > SILENCE):
                wondering = False
                if not news:
                    typer.echo(
                        "covey: no agent of this mission is heard yet; expected agents with the same mission file and "
                        "--seed, one of which listens at the endpoint given",
                        err=True,
                    )
            if over and any(isinstance(item.content, Event) for item in news):
                over = False  # somebody has died, or came back
                teller.tell(teller.scene)
            if observer.over and not over:
                over = observer.settle()
                teller.end("settled", None)
            if not over:  # who falls silent after the end has left
                teller.update()
