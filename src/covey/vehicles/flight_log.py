"""What a flight leaves behind: arrays over time and the events on them."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from covey.errors import ResultError
from covey.flight.layout import COMMAND, OBSERVATION, REFERENCE, SIGNALS

VERSION = 1

ARRIVALS = ("airborne", "reached", "home", "landed")
"""Kinds of events that end a way: a vehicle is at its altitude, its waypoint, above its start, on the ground."""

TROUBLE = ("fault", "lost", "collision", "missed", "outside", "grounded", "astray", "aloft", "ignored")
"""Kinds of events that people should hear of."""


@dataclass(frozen=True, slots=True)
class FlightEvent:
    """Something worth telling about a flight.

    Parameters
    ----------
    time : float
        Seconds since the flight began.
    kind : str
        One word: ``takeoff``, ``trade``, one of `ARRIVALS` or of `TROUBLE`.
    vehicles : tuple of str
        Names of those concerned.
    text : str
        What happened, for people.
    """

    time: float
    kind: str
    vehicles: tuple[str, ...]
    text: str


@dataclass(frozen=True, eq=False)
class FlightLog:
    """A recorded flight of n vehicles at k moments.

    Parameters
    ----------
    names : tuple of str
        The vehicles, n of them.
    models : tuple of str
        Their parameter files, for example ``iris``.
    simulator : str
    time : array, shape (k,)
        Seconds since the flight began, rising.
    state : array, shape (k, n, 13)
        True position, velocity, attitude and rates; columns as in `covey.flight.layout`.
    reference : array, shape (k, n, 14)
        What the controller tracked.
    command : array, shape (k, n, 4)
        Normalised thrust and body rates.
    signals : array, shape (k, n, 6)
        V1, V2, V3, dV3/dt and the norms of the errors in position and velocity.
    goal : array, shape (k, n, 4)
        Waypoint and yaw; NaN where a vehicle has none.
    separation : array, shape (k,)
        Least scaled distance between two vehicles in the air, metres; infinite where fewer than two fly.
    objects : array, shape (k, m, 3)
        Centres of the moving objects, frame W, metres.
    object_radii : array, shape (m,)
        Their radii, metres.
    score_committed, score_flown : array, shape (k,)
        Team score at the committed poses, and at the true ones; NaN for a flight without a mission.
    required_separation : float
        What `separation` must not fall below, metres.
    vertical_ratio : float
        Vertical offsets count as much less: see docs/flight.md.
    events : tuple of FlightEvent
    """

    names: tuple[str, ...]
    models: tuple[str, ...]
    simulator: str
    time: NDArray[np.float64]
    state: NDArray[np.float64]
    reference: NDArray[np.float64]
    command: NDArray[np.float64]
    signals: NDArray[np.float64]
    goal: NDArray[np.float64]
    separation: NDArray[np.float64]
    objects: NDArray[np.float64]
    object_radii: NDArray[np.float64]
    score_committed: NDArray[np.float64]
    score_flown: NDArray[np.float64]
    required_separation: float
    vertical_ratio: float
    events: tuple[FlightEvent, ...] = ()

    def save(self, path: str | Path) -> None:
        """Write the log as a compressed ``.npz`` file without pickled objects."""
        arrays = {name: getattr(self, name) for name in _ARRAYS}
        head: dict[str, Any] = {name: getattr(self, name) for name in _PLAIN}
        head |= {"version": VERSION, "events": [asdict(event) for event in self.events]}
        np.savez_compressed(path, head=np.array(json.dumps(head)), **arrays)

    @classmethod
    def load(cls, path: str | Path) -> FlightLog:
        """Read a log.

        Raises
        ------
        ResultError
            If the file is no flight log that this covey reads.
        """
        try:
            with Path(path).open("rb") as stream, np.load(stream, allow_pickle=False) as file:
                head = json.loads(str(file["head"]))
                if head["version"] != VERSION:
                    raise ResultError(f"{path}: expected a flight log of version {VERSION}, got {head['version']}")
                events = tuple(
                    FlightEvent(event["time"], event["kind"], tuple(event["vehicles"]), event["text"])
                    for event in head["events"]
                )
                plain = {name: head[name] for name in _PLAIN}
                plain |= {name: tuple(plain[name]) for name in ("names", "models")}
                return cls(**plain, **{name: file[name] for name in _ARRAYS}, events=events)
        except (OSError, EOFError, zipfile.BadZipFile, ValueError, KeyError, TypeError) as error:
            raise ResultError(f"{path}: expected a flight log written by covey fly, got {error}") from error


_ARRAYS = (
    "time",
    "state",
    "reference",
    "command",
    "signals",
    "goal",
    "separation",
    "objects",
    "object_radii",
    "score_committed",
    "score_flown",
)
_PLAIN = ("names", "models", "simulator", "required_separation", "vertical_ratio")


class FlightRecorder:
    """Collects the rows of a `FlightLog`.

    Parameters
    ----------
    names, models : sequence of str
    simulator : str
    required_separation, vertical_ratio : float
    object_radii : sequence of float
        One a moving object.
    """

    def __init__(
        self,
        names: Sequence[str],
        models: Sequence[str],
        simulator: str,
        *,
        required_separation: float,
        vertical_ratio: float,
        object_radii: Sequence[float] = (),
    ) -> None:
        self.names, self.models, self.simulator = tuple(names), tuple(models), simulator
        self.required_separation, self.vertical_ratio = required_separation, vertical_ratio
        self.events: list[FlightEvent] = []
        self._radii = np.asarray(object_radii, dtype=np.float64)
        n, m = len(self.names), len(self._radii)
        shapes = {
            "time": (),
            "state": (n, OBSERVATION),
            "reference": (n, REFERENCE),
            "command": (n, COMMAND),
            "signals": (n, SIGNALS),
            "goal": (n, 4),
            "separation": (),
            "objects": (m, 3),
            "score_committed": (),
            "score_flown": (),
        }
        self._rows = {name: np.empty((256, *shape)) for name, shape in shapes.items()}
        self._count = 0

    def note(self, time: float, kind: str, vehicles: Sequence[int], text: str) -> None:
        """Add an event."""
        self.events.append(FlightEvent(time, kind, tuple(self.names[i] for i in vehicles), text))

    def add(
        self,
        time: float,
        state: NDArray[np.float64],
        reference: NDArray[np.float64],
        command: NDArray[np.float64],
        signals: NDArray[np.float64],
        goal: NDArray[np.float64],
        separation: float,
        *,
        objects: NDArray[np.float64] | None = None,
        score_committed: float = np.nan,
        score_flown: float = np.nan,
    ) -> None:
        """Add one moment; the arrays are copied."""
        if self._count == len(self._rows["time"]):
            self._rows = {name: np.concatenate([rows, np.empty_like(rows)]) for name, rows in self._rows.items()}
        values: dict[str, Any] = {
            "time": time,
            "state": state[:, :OBSERVATION],
            "reference": reference,
            "command": command,
            "signals": signals,
            "goal": goal,
            "separation": separation,
            "objects": np.empty((0, 3)) if objects is None else objects,
            "score_committed": score_committed,
            "score_flown": score_flown,
        }
        for name, value in values.items():
            self._rows[name][self._count] = value
        self._count += 1

    def log(self) -> FlightLog:
        """Return what has been collected so far."""
        return FlightLog(
            names=self.names,
            models=self.models,
            simulator=self.simulator,
            required_separation=self.required_separation,
            vertical_ratio=self.vertical_ratio,
            object_radii=self._radii.copy(),
            events=tuple(self.events),
            **{name: rows[: self._count].copy() for name, rows in self._rows.items()},
        )
