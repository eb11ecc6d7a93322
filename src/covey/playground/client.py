"""What one visitor has still to be told."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Sequence

BACKLOG = 1_000_000
"""Characters that may wait for a visitor; with more it is told the whole state instead."""


class Visitor:
    """What waits for one visitor: bounded, whatever the visitor does.  Only the server's event loop may touch it.

    Parameters
    ----------
    may_steer : bool
        Whether it has shown the token.

    Attributes
    ----------
    behind : bool
        Whether it needs the whole state: at first, and after changes piled up.
    idle : bool
        Whether all that it was told has been sent.
    scene : int
        Number of the scene that it knows; 0 for none.
    obstacles : int
        How many obstacles it knows of that scene.
    """

    def __init__(self, *, may_steer: bool) -> None:
        self.may_steer = may_steer
        self.behind = True
        self.idle = False
        self.scene = 0
        self.obstacles = 0
        self._changes: list[str] = []
        self._size = 0
        self._motion = ""
        self._health = ""
        self._answers: deque[str] = deque(maxlen=20)
        self._news = asyncio.Event()

    @property
    def backlog(self) -> int:
        """Characters of changes that wait."""
        return self._size

    def restart(self, texts: Sequence[str]) -> None:
        """Tell the whole state, as encoded messages."""
        self.behind = False
        self._changes, self._size = list(texts), 0
        self._motion = self._health = ""
        self._news.set()

    def tell(self, changes: Sequence[str], motion: str, health: str) -> None:
        """Add encoded messages: all changes, and the newest motion and health, which replace those that wait."""
        if self.behind or not (changes or motion or health):
            return
        self._motion = motion or self._motion
        self._health = health or self._health
        self._changes += changes
        self._size += sum(map(len, changes))
        if self._size > BACKLOG:
            self.fall_behind()
        self._news.set()

    def answer(self, text: str) -> None:
        """Add an encoded answer to what this visitor asked."""
        self._answers.append(text)
        self._news.set()

    def fall_behind(self) -> None:
        """Forget what waits; the visitor gets the whole state instead."""
        self.behind = True
        self._changes, self._size = [], 0
        self._motion = self._health = ""

    async def next(self) -> str:
        """Wait until there is something to say; return it as one frame."""
        texts: list[str] = []
        while not texts:
            self.idle = True
            await self._news.wait()
            self._news.clear()
            self.idle = False
            texts = [*self._answers, *self._changes, *filter(None, (self._motion, self._health))]
            self._answers.clear()
            self._changes, self._size = [], 0
            self._motion = self._health = ""
        return f"[{','.join(texts)}]"
