"""A progress line on stderr: live on a terminal, a plain line now and then otherwise."""

from __future__ import annotations

import math
import sys
import time
from types import TracebackType
from typing import TYPE_CHECKING, TextIO

if TYPE_CHECKING:
    from rich.progress import Progress as Bars
    from rich.progress import TaskID

    from covey.runtime.result import Progress

LIVE_INTERVAL = 0.05
"""Seconds between updates of a live line."""

PLAIN_INTERVAL = 5.0
"""Seconds between plain lines of the same stage."""


class ProgressLine:
    """Shows how planning goes; use it as a context and pass it as ``on_progress``.

    Parameters
    ----------
    quiet : bool
        Show nothing.
    stream : text file, optional
        Where to; stderr by default.
    """

    def __init__(self, *, quiet: bool = False, stream: TextIO | None = None) -> None:
        self._quiet = quiet
        self._stream = stream or sys.stderr
        self._bars: Bars | None = None
        self._task: TaskID | None = None
        self._stage = ""
        self._next = 0.0

    def __enter__(self) -> ProgressLine:
        if not self._quiet and self._stream.isatty():
            from rich.console import Console
            from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

            self._bars = Progress(
                SpinnerColumn(),
                TextColumn("{task.description}", markup=False),
                BarColumn(bar_width=24),
                TimeElapsedColumn(),
                console=Console(file=self._stream),
                transient=True,
            )
            self._bars.start()
            self._task = self._bars.add_task("starting", total=None)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if self._bars is not None:
            self._bars.stop()
            self._bars = None

    def __call__(self, progress: Progress) -> None:
        """Show the news, unless the last are too fresh."""
        now = time.monotonic()
        if self._quiet or (progress.stage == self._stage and now < self._next):
            return
        self._stage = progress.stage
        text = _line(progress)
        if self._bars is not None and self._task is not None:
            self._next = now + LIVE_INTERVAL
            total = None if progress.fraction is None else 1.0
            self._bars.update(self._task, description=text, total=total, completed=progress.fraction or 0.0)
        else:
            self._next = now + PLAIN_INTERVAL
            done = "" if progress.fraction is None else f", {100.0 * progress.fraction:.0f} %"
            print(f"covey: {text}{done}", file=self._stream, flush=True)


def _line(progress: Progress) -> str:
    what = "at most" if progress.stage == "bounding" else "score"
    known = math.isfinite(progress.score)  # an exercise has none
    parts = [f"{progress.stage}: {what} {progress.score:.2f}" if known else progress.stage]
    if progress.trades:
        parts.append(f"{progress.trades} trade{'s' * (progress.trades != 1)}")
    if progress.messages:
        parts.append(f"{progress.messages} messages")
    return ", ".join(parts)
