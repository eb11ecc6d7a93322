"""Ctrl-C: at once where nothing can be lost, and otherwise where nothing is half done."""

from __future__ import annotations

import os
import signal
from types import FrameType, TracebackType

INTERRUPTED = 130
"""Exit code after Ctrl-C."""


def leave_at_once(number: int, frame: FrameType | None) -> None:
    """End the process: the handler of Ctrl-C while there is nothing to keep."""
    os._exit(INTERRUPTED)


class Interruption:
    """While this context is open Ctrl-C is only noted, and `check` raises KeyboardInterrupt for it.

    An exception out of nowhere could leave half a trade behind, or an import that others wait for.  A second Ctrl-C
    ends the process, whatever it is doing.

    Attributes
    ----------
    noted : bool
        Whether Ctrl-C was pressed.
    """

    def __init__(self) -> None:
        self.noted = False

    def __enter__(self) -> Interruption:
        self._before = signal.signal(signal.SIGINT, self._note)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        signal.signal(signal.SIGINT, self._before)

    def check(self) -> None:
        """Raise KeyboardInterrupt if Ctrl-C was pressed."""
        if self.noted:
            raise KeyboardInterrupt

    def _note(self, number: int, frame: FrameType | None) -> None:
        self.noted = True
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        os.write(2, b"\ncovey: stopping; press Ctrl-C again to quit at once\n")
