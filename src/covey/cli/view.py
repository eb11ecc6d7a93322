"""``--view``: the Playground beside a run."""

from __future__ import annotations

import math
import os
import sys
import time
import webbrowser
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, TypeAlias

import typer

from covey.cli.interrupt import Interruption
from covey.errors import InputError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from covey.mission import Mission
    from covey.playground.server import PlaygroundServer, SeenBy
    from covey.runtime.agent import TeamPlanner
    from covey.runtime.watching.feed import Scene, Update, Watcher
    from covey.runtime.watching.steering import Steering
    from covey.sensing import VisibilityModel

FASTEST = 1e6
"""Largest --speed; 0 stands for as fast as possible."""

View: TypeAlias = Annotated[
    bool, typer.Option("--view", help="Show it live in the browser: the Playground.", rich_help_panel="Playground")
]
Port: TypeAlias = Annotated[
    int, typer.Option(min=0, max=65535, help="Port of the page; 0 for a free one.", rich_help_panel="Playground")
]
Host: TypeAlias = Annotated[str, typer.Option(help="Address that the page is served at.", rich_help_panel="Playground")]
Open: TypeAlias = Annotated[
    bool, typer.Option("--open", help="Open the page in the browser.", rich_help_panel="Playground")
]
Speed: TypeAlias = Annotated[
    float | None,
    typer.Option(
        min=0.0,
        max=FASTEST,
        help="How fast: changes a second of a plan, seconds a second of a flight; 0 for as fast as possible.",
        rich_help_panel="Playground",
    ),
]

LOOPBACK = {"127.0.0.1", "localhost", "::1"}

OPENING = 10.0
"""Seconds that a run waits for a browser that was asked to open."""


@dataclass(frozen=True)
class Live:
    """What a run needs to be seen and steered; nothing of it without ``--view``."""

    watch: Watcher | None = None
    steering: Steering | None = None
    eyes: Eyes | None = None

    def watch_with(self, recorder: Watcher) -> Watcher:
        """Return a watcher that tells the recorder first, and then the page."""
        watch = self.watch
        if watch is None:
            return recorder

        def both(item: Scene | Update) -> None:
            recorder(item)
            watch(item)

        return both

    def stay(self) -> None:
        """Keep the page up until Ctrl-C, where somebody is there to press it."""
        if self.watch is None or not sys.stdin.isatty() or os.environ.get("CI"):
            return
        typer.echo("covey: the page stays until you press Ctrl-C", err=True)
        with Interruption() as interruption:
            wait_until(lambda: interruption.noted)


@contextmanager
def live(
    view: bool,
    *,
    mission: Mission | None,
    host: str,
    port: int,
    open_page: bool,
    speed: float | None = None,
    usual: float | None = None,
    steering: Steering | None = None,
) -> Iterator[Live]:
    """Serve the Playground beside a run, if it is asked for.

    Parameters
    ----------
    view : bool
        Whether it is.
    mission : Mission or None
        None for an exercise, in which nobody sees anything.
    host, port, open_page, speed
        The options.
    usual : float or None
        The speed, if it is not said; see `covey.runtime.watching.steering.SetSpeed`.  None for a run that nobody can
        steer.
    steering : Steering or None
        Instead, of a run whose speed nobody can set.

    Raises
    ------
    NetworkError
        If the port is taken.
    InputError
        If one of the other options is given without ``--view``.
    """
    if not view:
        if port or open_page or speed is not None or host != "127.0.0.1":
            raise InputError("--port, --host, --open and --speed belong to the page: expected --view with them")
        yield Live()
        return

    from covey.runtime.watching.steering import Steering

    if usual is not None:
        steering = Steering(speed=usual if speed is None else speed)
    eyes = None if mission is None else eyes_of(mission)
    with serve_page(host=host, port=port, open_page=open_page, steering=steering, seen_by=eyes) as server:
        yield Live(server.watch, steering, eyes)


@contextmanager
def serve_page(
    *,
    host: str,
    port: int,
    open_page: bool,
    steering: Steering | None = None,
    seen_by: SeenBy | None = None,
    record: bytes | None = None,
    speed: float = 1.0,
) -> Iterator[PlaygroundServer]:
    """Serve the Playground meanwhile, and print where.

    Raises
    ------
    NetworkError
        If the port is taken.
    """
    from covey.playground.server import PlaygroundServer

    with PlaygroundServer(
        host=host, port=port, steering=steering, seen_by=seen_by, record=record, speed=speed
    ) as server:
        typer.echo(f"covey: watch at {server.url}", err=True)
        if host not in LOOPBACK:
            typer.echo(
                f"covey: whoever reaches {host} can watch, and steer with the token, which travels unencrypted",
                err=True,
            )
        if open_page:
            if webbrowser.open(server.url):
                wait_until(lambda: bool(server.visitors), OPENING)
            else:
                typer.echo("covey: no browser can be opened from here; open the address yourself", err=True)
        yield server


def wait_until(happened: Callable[[], bool], seconds: float = math.inf) -> None:
    """Wait until something has happened, or so many seconds at most."""
    end = time.monotonic() + seconds
    while not happened() and time.monotonic() < end:
        time.sleep(0.05)


class Eyes:
    """Knows how well an agent sees each landmark of a scene from a pose, for heat maps.

    Parameters
    ----------
    models : mapping of str to VisibilityModel
        Each agent's sensor, by name.
    """

    def __init__(self, models: Mapping[str, VisibilityModel]) -> None:
        self._models = models
        self._planner: TeamPlanner | None = None

    def follow(self, planner: TeamPlanner) -> None:
        """From now on use the sensors that a planner knows, which learns of agents that join."""
        self._planner = planner

    def __call__(self, scene: Scene, agent: int, pose: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return, shape (n,), how well an agent sees each landmark from a pose (`covey.runtime.watching.feed.POSE`)."""
        import numpy as np

        from covey.environment import Landmarks

        planner = self._planner
        model = self._models[scene.agents[agent].name] if planner is None else planner.models[agent]
        x, y, _, w, _, _, z = (float(value) for value in pose)
        normals = None if scene.normals_W is None else scene.normals_W[:, :2]
        landmarks = Landmarks(scene.positions_W[:, :2], scene.weights, normals)
        return np.asarray(model.visibility(np.array([[x, y, 2.0 * math.atan2(z, w)]]), landmarks)[0])


def eyes_of(mission: Mission) -> Eyes:
    """Return what the agents of a mission see with, those that join among them."""
    from covey.mission import agent_text, read_agent
    from covey.runtime.agent import build_models

    joining = (agent_text(change.join) for change in mission.changes if change.join is not None)
    everybody = (
        *mission.agents,
        *(read_agent(mission, n, text) for n, text in enumerate(joining, len(mission.agents))),
    )
    models = build_models(replace(mission, agents=everybody))
    return Eyes({agent.name: model for agent, model in zip(everybody, models, strict=True)})
