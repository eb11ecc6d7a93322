"""Takes in what a run tells and hands it to the visitors: each message is encoded once for all of them."""

from __future__ import annotations

import threading
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from covey.playground.client import Visitor
from covey.playground.history import HistoryKeeper
from covey.playground.messages import Message, Steered, encode
from covey.runtime.watching.feed import Health, Motion, ObstacleAppeared, Scene, SceneObstacle, Update
from covey.runtime.watching.view import TeamView

MOST = 200
"""Changes between two frames; with more everybody is told the whole state instead."""

REST = 3
"""The whole state is told in every third frame at most."""


@dataclass(frozen=True, eq=False)
class _Snapshot:
    """All that a visitor needs who comes now."""

    number: int
    scene: Scene
    state: tuple[Message, ...]
    obstacles: tuple[SceneObstacle, ...]
    time: float


class Broadcast:
    """A watcher of a run.  The run's thread calls it and never waits for a visitor; all else is the event loop's.

    What it keeps is bounded: the state of the team, a thinned history, and what happened since the last frame.

    Attributes
    ----------
    visitors : set of Visitor
    """

    def __init__(self) -> None:
        self.visitors: set[Visitor] = set()
        self._lock = threading.Lock()
        self._view = TeamView()
        self._history = HistoryKeeper()
        self._scenes = 0
        self._pending: list[Update] = []
        self._motion: Motion | None = None
        self._health: Health | None = None
        self._piled_up = False
        self._frames = 0
        self._encoded_scene = (0, "")
        self._steered: Steered | None = None

    def whereabouts(self, agent: int) -> tuple[Scene | None, NDArray[np.float64] | None]:
        """Return the newest scene, and an agent's committed pose in it (`runtime.watching.feed.POSE`), if any."""
        with self._lock:
            known = 0 <= agent < len(self._view.poses)
            return self._view.scene, np.array(self._view.poses[agent]) if known else None

    def __call__(self, item: Scene | Update) -> None:
        """Take in what a run tells."""
        with self._lock:
            self._view.apply(item)
            self._history.add(item)
            if isinstance(item, Scene):
                self._scenes += 1
                self._motion = self._health = None
                self._pile_up()
                return
            if isinstance(item, Motion):
                self._motion = item
            elif isinstance(item, Health):
                self._health = item
            elif not self._piled_up:
                self._pending.append(item)
                if len(self._pending) > MOST:
                    self._pile_up()

    def _pile_up(self) -> None:
        self._piled_up = True
        self._pending = []

    def pass_on(self, steered: Steered) -> None:
        """Tell every visitor what happened since the last time, and how the run is steered."""
        self._frames += 1
        with self._lock:
            pending, self._pending = self._pending, []
            motion, self._motion = self._motion, None
            health, self._health = self._health, None
            if self._piled_up:
                self._piled_up = False
                for visitor in self.visitors:
                    visitor.fall_behind()
            late = self._late()
            snapshot = self._snapshot() if late else None
        changed, self._steered = steered != self._steered, steered
        if any(not visitor.behind for visitor in self.visitors):
            appeared = sum(isinstance(item, ObstacleAppeared) for item in pending)
            changes = [encode(item) for item in (*pending, *([steered] if changed else ()))]
            moved, well = ("" if item is None else encode(item) for item in (motion, health))
            for visitor in self.visitors:
                if not visitor.behind:
                    visitor.obstacles += appeared
                    visitor.tell(changes, moved, well)
        if snapshot is not None:
            self._bring_up_to_date(late, snapshot, steered)

    def _late(self) -> list[Visitor]:
        """Return who is to be told the whole state now."""
        if self._frames % REST != 0 or self._view.scene is None:
            return []
        return [visitor for visitor in self.visitors if visitor.behind and visitor.idle]

    def _snapshot(self) -> _Snapshot:
        view = self._view
        assert view.scene is not None
        parts = (view.state(), self._history.history(), view.motion, view.health, view.ended)
        state = tuple(part for part in parts if part is not None)
        return _Snapshot(self._scenes, view.scene, state, view.obstacles, view.time)

    def _bring_up_to_date(self, late: list[Visitor], snapshot: _Snapshot, steered: Steered) -> None:
        state = [encode(item) for item in (*snapshot.state, steered)]
        for visitor in late:
            scene = []
            if visitor.scene != snapshot.number:
                visitor.scene, visitor.obstacles = snapshot.number, len(snapshot.scene.obstacles)
                if self._encoded_scene[0] != snapshot.number:
                    self._encoded_scene = snapshot.number, encode(snapshot.scene)
                scene = [self._encoded_scene[1]]
            missed = snapshot.obstacles[visitor.obstacles :]
            visitor.obstacles = len(snapshot.obstacles)
            visitor.restart([*scene, *state, *(encode(ObstacleAppeared(snapshot.time, item)) for item in missed)])
