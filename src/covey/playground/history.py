"""What went before, for those who come late: bounded, however long a run takes."""

from __future__ import annotations

from collections import Counter, deque

import numpy as np

from covey.playground.messages import History, PastChange
from covey.runtime.watching.feed import ChangeKind, Scene, TeamChange, TeamState, Trading, Update

POINTS = 2000
"""Most points of the score curve; beyond it every other one is left out."""

CHANGES = 200
"""So many changes are kept in words."""


class HistoryKeeper:
    """Keeps the score curve, thinned out, the newest changes, and who has traded with whom.

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
        self._curve: list[tuple[float, int, float]] = []
        self._newest: tuple[float, int, float] | None = None
        self._stride, self._count = 1, 0
        self._step = 0
        self._changes: deque[PastChange] = deque(maxlen=CHANGES)
        self._traded: Counter[tuple[int, ...]] = Counter()

    def add(self, item: Scene | Update) -> None:
        """Take in what a run tells."""
        self._step += isinstance(item, TeamChange | Trading)
        if isinstance(item, TeamChange):
            self._changes.append(PastChange(item.time, self._step, item.kind, item.agents, item.score, item.text))
            self.add_score(item.time, item.score)
            if item.kind is ChangeKind.TRADE:
                self._traded[tuple(sorted(item.agents))] += 1
        elif isinstance(item, TeamState):
            self.add_score(item.time, float(item.scores.sum()))

    def add_score(self, time: float, score: float) -> None:
        """Add a point to the curve."""
        self._newest = (time, self._step, score)
        if self._count % self._stride == 0:
            self._curve.append(self._newest)
            if len(self._curve) > POINTS:
                del self._curve[1::2]
                self._stride *= 2
        self._count += 1

    def history(self) -> History:
        """Return it as a message; the newest point is always there."""
        curve = list(self._curve)
        if self._newest is not None and curve[-1] != self._newest:
            curve.append(self._newest)
        times, steps, scores = np.array(curve, dtype=np.float64).reshape(-1, 3).T.copy()
        partners = np.array([(*pair, count) for pair, count in self._traded.items()], dtype=np.int32).reshape(-1, 3)
        return History(self._step, times, steps.astype(np.int32), scores, tuple(self._changes), partners)
