"""What somebody who watches a run may ask of it, and the mailbox through which the run hears of it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TypeAlias

from covey.errors import ArgumentError
from covey.runtime.watching.feed import Scene, TeamChange, Trading, Update, Watcher


@dataclass(frozen=True, slots=True)
class Pause:
    """Let nothing more happen until `Resume`."""


@dataclass(frozen=True, slots=True)
class Resume:
    """Go on."""


@dataclass(frozen=True, slots=True)
class Step:
    """Let the next thing happen that can be seen, then pause: of a plan the next change or offer, of a flight 0.1 s."""


@dataclass(frozen=True, slots=True)
class SetSpeed:
    """Go as fast as this.

    Parameters
    ----------
    speed : float
        Of a plan: changes and offers a second; of a flight: simulated seconds a second.  0: as fast as possible.
    """

    speed: float


@dataclass(frozen=True, slots=True)
class Kill:
    """Let an agent fail: its process ends, or its motors stop."""

    agent: int


@dataclass(frozen=True, slots=True)
class Revive:
    """Let a killed agent come back."""

    agent: int


@dataclass(frozen=True, slots=True)
class SetWeight:
    """Let a landmark be worth something else."""

    landmark: int
    weight: float


@dataclass(frozen=True, slots=True)
class AddObstacle:
    """Put a cylinder on the ground in the way.

    Parameters
    ----------
    x, y : float
        Its centre in frame W, metres.
    radius, height : float
        Metres.
    """

    x: float
    y: float
    radius: float
    height: float


@dataclass(frozen=True, slots=True)
class SetLoss:
    """Lose this share of the messages, from 0 to 1."""

    loss: float


Command: TypeAlias = Pause | Resume | Step | SetSpeed | Kill | Revive | SetWeight | AddObstacle | SetLoss
"""Anything that may be asked of a run."""

COMMANDS: Mapping[str, type[Command]] = {
    "pause": Pause,
    "resume": Resume,
    "step": Step,
    "speed": SetSpeed,
    "kill": Kill,
    "revive": Revive,
    "weight": SetWeight,
    "obstacle": AddObstacle,
    "loss": SetLoss,
}
"""The commands by their names."""

WAITING = 50
"""So many commands may wait for a run; further ones are refused."""

GLANCE = 0.05
"""Seconds between two looks at the world while a run is held."""


@dataclass(frozen=True)
class Request:
    """A command that waits for the run.

    Parameters
    ----------
    command : Command
    refuse : callable
        Takes the reason, for people, if it cannot be carried out.
    """

    command: Command
    refuse: Callable[[str], object]


@dataclass(frozen=True)
class Pace:
    """How a run goes on.

    Parameters
    ----------
    paused : bool
    speed : float
        See `SetSpeed`.
    """

    paused: bool
    speed: float


class Steering:
    """A mailbox between those who watch a run and the run, which looks into it between its steps.

    Any thread may `ask`; the rest is the run's.

    Parameters
    ----------
    speed : float
        At first; see `SetSpeed`.
    paced : bool
        Whether the run can pause and go faster or slower.

    Attributes
    ----------
    loss : float
        Share of the messages that are lost, as the run has set it.
    """

    def __init__(self, *, speed: float = 0.0, paced: bool = True) -> None:
        self.loss = 0.0
        self._told = 0
        self._progress: Callable[[], float] = lambda: self._told
        self._stride = 1.0
        self._changed = threading.Condition()
        self._kinds: set[type[Command]] = {Pause, Resume, Step, SetSpeed} if paced else set()
        self._requests: list[Request] = []
        self._pace = Pace(paused=False, speed=speed)
        self._steps = 0
        self._until: float | None = None
        self._anchor: tuple[float, float] | None = None  # wall clock and progress that speed is counted from

    # The visitors' side.

    @property
    def commands(self) -> tuple[str, ...]:
        """Names of the commands that the run carries out."""
        return tuple(name for name, kind in COMMANDS.items() if kind in self._kinds)

    @property
    def pace(self) -> Pace:
        """How the run goes on."""
        return self._pace

    def ask(self, command: Command, refuse: Callable[[str], object]) -> None:
        """Ask for something; it happens when the run comes to it.

        Raises
        ------
        ArgumentError
            If the run carries out no such command, has too much to do, or a speed is negative.
        """
        with self._changed:
            if type(command) not in self._kinds:
                raise ArgumentError("command: this run does not carry it out")
            match command:
                case Pause():
                    self._pace, self._steps = Pace(True, self._pace.speed), 0
                case Resume():
                    self._pace = Pace(False, self._pace.speed)
                case Step():
                    self._pace = Pace(True, self._pace.speed)
                    self._steps = min(self._steps + 1, WAITING)
                case SetSpeed(speed):
                    if not speed >= 0.0:
                        raise ArgumentError(f"speed: expected at least 0, got {speed}")
                    self._pace = Pace(self._pace.paused, speed)
                case _:
                    if len(self._requests) >= WAITING:
                        raise ArgumentError("command: the run has not carried out earlier ones yet")
                    self._requests.append(Request(command, refuse))
            self._anchor = None
            self._changed.notify_all()

    # The run's side.

    def offer(self, *kinds: type[Command]) -> None:
        """Say what the run carries out, besides pausing and its speed, if it is paced."""
        self._kinds |= set(kinds)

    def measure(self, progress: Callable[[], float], stride: float) -> None:
        """Say how far the run is, in what speed is measured in, and how far `Step` goes.

        By default progress is the number of changes and offers that `counting` has seen, and a step is one of them.
        """
        self._progress, self._stride = progress, stride

    def counting(self, watch: Watcher | None) -> Watcher:
        """Return a watcher that counts what can be seen, and passes it on."""

        def count(item: Scene | Update) -> None:
            self._told += isinstance(item, TeamChange | Trading)
            if watch is not None:
                watch(item)

        return count

    def take(self) -> list[Request]:
        """Take what the run is asked for; the run calls `Request.refuse` for what it cannot do."""
        if not self._requests:
            return []
        with self._changed:
            requests, self._requests = self._requests, []
        return requests

    def hold(self, idle: Callable[[], object]) -> None:
        """Wait while the run is paused or ahead of its speed, or until something is to be taken.

        Parameters
        ----------
        idle : callable
            Called now and then meanwhile; what it raises ends the waiting.
        """
        while True:
            with self._changed:
                wait = 0.0 if self._requests else self._to_wait(self._progress())
                if wait <= 0.0:
                    return
                self._changed.wait(min(wait, GLANCE))
            idle()

    def _to_wait(self, progress: float) -> float:
        """Return for how many seconds the run must wait from now on; more may follow."""
        paused, speed = self._pace.paused, self._pace.speed
        if paused:
            if self._until is None and self._steps > 0:
                self._steps -= 1
                self._until = progress + self._stride
            if self._until is not None and progress < self._until:
                return 0.0
            self._until = None
            return 0.0 if self._steps > 0 and self._to_wait(progress) <= 0.0 else GLANCE
        self._until = None
        if speed == 0.0:
            return 0.0
        now = time.monotonic()
        if self._anchor is None:
            self._anchor = now, progress
        late = now - (self._anchor[0] + (progress - self._anchor[1]) / speed)
        if late > 1.0:  # it cannot keep up: never hurry afterwards
            self._anchor = now, progress
        return -late
