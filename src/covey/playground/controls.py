"""What a visitor may ask of a run: only with the token, and only what the run carries out."""

from __future__ import annotations

import secrets
from collections.abc import Callable

from covey.errors import ArgumentError
from covey.playground.messages import Asked, Refused, Steered
from covey.runtime.watching.steering import Steering


class Controls:
    """The token, and what is done for those who have it.

    Parameters
    ----------
    steering : Steering or None
        Of the run; None where there is nothing to steer.

    Attributes
    ----------
    token : str
        New for each server.
    """

    def __init__(self, steering: Steering | None) -> None:
        self.token = secrets.token_urlsafe(24)
        self._steering = steering

    @property
    def commands(self) -> tuple[str, ...]:
        """Names of the commands that the run carries out."""
        return () if self._steering is None else self._steering.commands

    @property
    def steered(self) -> Steered:
        """How the run is steered now."""
        if self._steering is None:
            return Steered(paused=False, speed=0.0, loss=0.0)
        pace = self._steering.pace
        return Steered(pace.paused, pace.speed, self._steering.loss)

    def knows(self, token: str) -> bool:
        """Whether this is the token."""
        return secrets.compare_digest(token.encode("utf-8", "surrogatepass"), self.token.encode())

    def ask(self, asked: Asked, refused: Callable[[Refused], object]) -> None:
        """Pass a command on; `refused` is called, from any thread, if it is not carried out."""
        if self._steering is None:
            refused(Refused(asked.name, "there is nothing to steer"))
            return
        try:
            self._steering.ask(asked.command, lambda why: refused(Refused(asked.name, why)))
        except ArgumentError as error:
            refused(Refused(asked.name, str(error)))
