"""Where the agents have been, for those who come late: bounded, and cheap for a thousand vehicles."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

PATH_POINTS = 500
"""Most points of a path."""

ALL_POINTS = 30_000
"""Most points of all paths: they go to each visitor that comes."""

FEWEST = 8
"""So many points a path may have however many agents there are."""

STEP = 0.01
"""Metres; who has moved less since its last point gets no new one."""


class PathKeeper:
    """Keeps the path of each agent; from one that is full every other point goes, and the next ones are further apart.

    Examples
    --------
    >>> keeper = PathKeeper()
    >>> keeper.make_room(2)
    >>> poses = np.zeros((2, 7))
    >>> for second in range(10_000):
    ...     poses[0, 0] = second
    ...     keeper.add(second, poses)
    >>> counts, x, points = keeper.paths()
    >>> bool(counts[0] <= PATH_POINTS), int(counts[1]), points[0].tolist()
    (True, 1, [0.0, 0.0, 0.0])
    """

    def __init__(self) -> None:
        self._counts = np.zeros(0, dtype=np.int64)
        self._x = np.zeros((0, 0))
        self._points = np.zeros((0, 0, 3), dtype=np.float32)
        self._last = np.zeros((0, 3))
        self._least = np.zeros(0)

    def make_room(self, m: int) -> None:
        """Be ready for m agents, those known and new ones after them."""
        known = len(self._counts)
        most = max(FEWEST, min(PATH_POINTS, ALL_POINTS // max(m, 1)))
        while (over := np.flatnonzero(self._counts > most)).size:
            self._thin(over)
        width = min(most, self._x.shape[1])
        x, points = np.zeros((m, most)), np.zeros((m, most, 3), dtype=np.float32)
        x[:known, :width], points[:known, :width] = self._x[:, :width], self._points[:, :width]
        self._x, self._points = x, points
        self._counts = np.concatenate([self._counts, np.zeros(m - known, dtype=np.int64)])
        self._last = np.concatenate([self._last, np.full((m - known, 3), np.nan)])
        self._least = np.concatenate([self._least, np.full(m - known, STEP)])

    def add(self, x: float, poses: NDArray[np.float64], agents: NDArray[np.int64] | None = None) -> None:
        """Note where these agents, or all, are at a place x of the time line; poses have a row for each of them."""
        whom = np.arange(len(self._counts)) if agents is None else agents
        places = poses[:, :3]
        # Who has no point yet has moved by NaN, which is not less.
        near = ((places - self._last[whom]) ** 2).sum(axis=1) < self._least[whom] ** 2
        rows = np.flatnonzero(np.isfinite(places).all(axis=1) & ~near)
        if not rows.size:
            return
        moved = whom[rows]
        if (full := moved[self._counts[moved] == self._x.shape[1]]).size:
            self._thin(full)
        at = self._counts[moved]
        self._x[moved, at], self._points[moved, at] = x, places[rows]
        self._last[moved] = places[rows]
        self._counts[moved] += 1

    def paths(self) -> tuple[NDArray[np.int32], NDArray[np.float64], NDArray[np.float32]]:
        """Return how many points each agent has, and x and place, metres, of these, agent after agent."""
        there = np.arange(self._x.shape[1]) < self._counts[:, None]
        return self._counts.astype(np.int32), self._x[there], self._points[there]

    def _thin(self, agents: NDArray[np.int64]) -> None:
        """Leave out every other point of these agents."""
        points = self._points[agents, ::2]
        half = points.shape[1]
        self._x[agents, :half], self._points[agents, :half] = self._x[agents, ::2], points
        counts = self._counts[agents] = (self._counts[agents] + 1) // 2
        steps = np.linalg.norm(np.diff(points, axis=1), axis=2)
        length = np.where(np.arange(1, half) < counts[:, None], steps, 0.0).sum(axis=1)
        self._least[agents] = np.maximum(STEP, 0.5 * length / counts)
