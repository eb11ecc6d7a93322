"""What went before, for those who come late: bounded, however long a run takes."""

from __future__ import annotations

from collections import Counter, deque

import numpy as np
from numpy.typing import NDArray

from covey.playground.messages import History, PastChange
from covey.playground.paths import PathKeeper
from covey.runtime.watching.feed import ChangeKind, Motion, Run, Scene, TeamChange, TeamState, Trading, Update

POINTS = 2000
"""Most points of a curve; beyond it every other one is left out."""

CHANGES = 200
"""So many changes are kept in words."""


class HistoryKeeper:
    """Keeps curves and paths, thinned out, the newest changes, and who has traded with whom.

    Examples
    --------
    >>> keeper = HistoryKeeper()
    >>> for second in range(100_000):
    ...     keeper.add_score(second, 0.5 * second)
    >>> history = keeper.history()
    >>> len(history.times) <= POINTS + 1, float(history.times[0]), float(history.times[-1])
    (True, 0.0, 99999.0)
    """

    def __init__(self) -> None:
        self._scene: Scene | None = None
        self._curve, self._curve_flown = _Curve(), _Curve()
        self._paths = PathKeeper()
        self._flies = False
        self._step, self._time = 0, 0.0
        self._changes: deque[PastChange] = deque(maxlen=CHANGES)
        self._traded: Counter[tuple[int, ...]] = Counter()

    def add(self, item: Scene | Update) -> None:
        """Take in what a run tells."""
        if isinstance(item, Scene):
            self._open(item)
            return
        self._time = max(self._time, item.time)
        self._step += isinstance(item, TeamChange | Trading)
        if isinstance(item, TeamChange):
            self._changes.append(PastChange(item.time, self._step, item.kind, item.agents, item.score, item.text))
            self.add_score(item.time, item.score)
            if item.kind is ChangeKind.TRADE:
                self._traded[tuple(sorted(item.agents))] += 1
            if not self._flies:
                self._paths.add(self._place, item.poses, np.array(item.posed, dtype=np.int64))
        elif isinstance(item, TeamState):
            self.add_score(item.time, float(item.scores.sum()))
        elif isinstance(item, Motion):
            self._flies = True
            self._paths.add(self._place, item.poses)
            if not np.isnan(item.score_flown):
                self._curve_flown.add(self._time, self._step, item.score_flown)

    def add_score(self, time: float, score: float) -> None:
        """Add a point to the curve."""
        self._curve.add(time, self._step, score)

    def history(self) -> History:
        """Return it as a message; the newest point of each curve is always there."""
        times, steps, scores = self._curve.rows()
        times_flown, _, scores_flown = self._curve_flown.rows()
        partners = np.array([(*pair, count) for pair, count in self._traded.items()], dtype=np.int32).reshape(-1, 3)
        return History(
            self._step,
            times,
            steps.astype(np.int32),
            scores,
            times_flown,
            scores_flown,
            *self._paths.paths(),
            changes=tuple(self._changes),
            partners=partners,
        )

    @property
    def _place(self) -> float:
        """Where on the page's time line the newest update is."""
        return self._step if self._scene is not None and self._scene.run is Run.PLAN else self._time

    def _open(self, scene: Scene) -> None:
        before, self._scene = self._scene, scene
        if before is None or before.mission != scene.mission or len(before.agents) > len(scene.agents):
            self._paths, self._flies = PathKeeper(), False
        self._paths.make_room(len(scene.agents))


class _Curve:
    """Rows of time, how many changes and offers there were, and score."""

    def __init__(self) -> None:
        self._points: list[tuple[float, int, float]] = []
        self._newest: tuple[float, int, float] | None = None
        self._stride, self._count = 1, 0

    def add(self, time: float, step: int, score: float) -> None:
        self._newest = (time, step, score)
        if self._count % self._stride == 0:
            self._points.append(self._newest)
            if len(self._points) > POINTS:
                del self._points[1::2]
                self._stride *= 2
        self._count += 1

    def rows(self) -> NDArray[np.float64]:
        """Return the three columns as rows; the newest point is always there."""
        points = list(self._points)
        if self._newest is not None and points[-1] != self._newest:
            points.append(self._newest)
        return np.array(points, dtype=np.float64).reshape(-1, 3).T.copy()
