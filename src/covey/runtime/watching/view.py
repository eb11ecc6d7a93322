"""Adds up what a run tells: the state of the team at a moment."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from covey.errors import ArgumentError
from covey.runtime.watching.feed import (
    NOBODY,
    POSE,
    BoundFound,
    ChangeKind,
    Ended,
    Health,
    Motion,
    ObstacleAppeared,
    Scene,
    SceneObstacle,
    TeamChange,
    TeamState,
    Trading,
    Update,
    Weights,
)


class TeamView:
    """The state after all that was told so far.

    Attributes
    ----------
    scene : Scene or None
        The newest; None before the first.
    time : float
        Of the newest update, seconds.
    motion, health : Motion, Health or None
        The newest since the scene.
    obstacles : tuple of SceneObstacle
        Those of the scene, and those that appeared.
    ended : Ended or None
    owner, poses, scores, weights, activity : array
        As in `TeamState`, to be read only.
    trading : array of bool, shape (n,)
        Which landmarks are offered in a trade.
    trades : int
    bound : float
        NaN where unknown.
    """

    def __init__(self) -> None:
        self.scene: Scene | None = None
        self.time = 0.0
        self.motion: Motion | None = None
        self.health: Health | None = None
        self.obstacles: tuple[SceneObstacle, ...] = ()
        self.ended: Ended | None = None
        self.trades = 0
        self.bound = math.nan
        self.owner = np.empty(0, dtype=np.int32)
        self.poses = np.empty((0, POSE))
        self.scores = np.empty(0)
        self.weights = np.empty(0)
        self.activity = np.empty(0, dtype=np.uint8)
        self.trading = np.empty(0, dtype=np.bool_)

    @property
    def score(self) -> float:
        """Team score at the committed poses, eq. (4.5)."""
        return float(self.scores.sum())

    def apply(self, item: Scene | Update) -> None:
        """Take the next thing in that was told.

        Raises
        ------
        ArgumentError
            If an update comes before any scene, or does not fit it.
        """
        if isinstance(item, Scene):
            self._begin(item)
            return
        if self.scene is None:
            raise ArgumentError(f"item: expected a Scene first, got {type(item).__name__}")
        try:
            self._update(item)
        except (IndexError, ValueError) as error:
            raise ArgumentError(f"item: expected a {type(item).__name__} that fits its Scene: {error}") from error
        self.time = item.time

    def state(self, time: float | None = None) -> TeamState:
        """Return all of it, as of a time; by default that of the newest update."""
        return TeamState(
            self.time if time is None else time,
            self.owner.copy(),
            self.poses.copy(),
            self.scores.copy(),
            self.weights.copy(),
            self.activity.copy(),
            np.flatnonzero(self.trading).astype(np.int32),
            self.trades,
            self.bound,
        )

    def _begin(self, scene: Scene) -> None:
        n, m = len(scene.positions_W), len(scene.agents)
        self.scene = scene
        self.obstacles = scene.obstacles
        self.motion = self.health = self.ended = None
        self.owner = np.full(n, NOBODY, dtype=np.int32)
        self.poses = np.zeros((m, POSE))
        self.poses[:, 3] = 1.0
        self.scores = np.zeros(m)
        self.weights = np.array(scene.weights, dtype=np.float64)
        self.activity = np.zeros(m, dtype=np.uint8)
        self.trading = np.zeros(n, dtype=np.bool_)

    def _update(self, item: Update) -> None:
        match item:
            case TeamState():
                self._replace(item)
            case TeamChange():
                self.owner[item.landmarks] = item.owner
                self.poses[list(item.posed)] = item.poses
                self.scores[list(item.scored)] = item.scores
                self.trades += item.kind is ChangeKind.TRADE
            case Trading():
                self.trading[item.give] = item.open
                self.trading[item.want] = item.open
            case Weights():
                self.weights[item.landmarks] = item.weights
            case Motion():
                self.motion = item
            case Health():
                self.activity[:] = item.activity
                self.health = item
            case ObstacleAppeared():
                self.obstacles = (*self.obstacles, item.obstacle)
            case BoundFound():
                self.bound = item.bound
            case Ended():
                self.ended = item
            case _:
                pass  # a note changes nothing

    def _replace(self, state: TeamState) -> None:
        for mine, given in (
            (self.owner, state.owner),
            (self.poses, state.poses),
            (self.scores, state.scores),
            (self.weights, state.weights),
            (self.activity, state.activity),
        ):
            _fill(mine, given)
        self.trading[:] = False
        self.trading[state.trading] = True
        self.trades, self.bound = state.trades, state.bound


def _fill(target: NDArray[np.generic], source: NDArray[np.generic]) -> None:
    if target.shape != source.shape:
        raise ValueError(f"an array of shape {source.shape}, expected {target.shape}")
    target[...] = source
