"""What goes between server and page, as JSON.

`docs/playground.md` describes it.  To the page go `Scene`, `Update`s and the messages of this module; from the page
come `Greeting`s and commands.
"""

from __future__ import annotations

import base64
import dataclasses
import enum
import json
import math
from dataclasses import dataclass
from typing import Any, TypeAlias, get_type_hints

import numpy as np
from numpy.typing import NDArray

from covey.errors import ArgumentError
from covey.runtime.watching.feed import ChangeKind, Scene, Update
from covey.runtime.watching.steering import COMMANDS, Command

LONGEST = 4096
"""Characters of the longest frame that a visitor may send."""

DTYPES = {"<f8": "f8", "<f4": "f4", "<i4": "i4", "|u1": "u1"}
"""The dtypes of arrays, and what the page calls them."""


@dataclass(frozen=True, slots=True)
class Hello:
    """The first message to a visitor.

    Parameters
    ----------
    source : str
        ``live``, or ``record``: then nothing follows, and the page loads ``/api/record`` and plays that.
    may_steer : bool
        Whether this visitor may command.
    commands : tuple of str
        Names of the commands that this run carries out.
    speed : float
        How fast a record is to be played at first.
    """

    source: str
    may_steer: bool
    commands: tuple[str, ...]
    speed: float = 1.0


@dataclass(frozen=True, slots=True)
class Steered:
    """How the run is steered now; after the scene, and whenever it changes.

    Parameters
    ----------
    paused : bool
    speed : float
        See `covey.runtime.watching.steering.SetSpeed`.
    loss : float
        Share of the messages that are lost.
    """

    paused: bool
    speed: float
    loss: float


@dataclass(frozen=True, slots=True)
class PastChange:
    """One change of the past, without what it changed; `step` as in `History`."""

    time: float
    step: int
    kind: ChangeKind
    agents: tuple[int, ...]
    score: float
    text: str


@dataclass(frozen=True, eq=False, slots=True)
class History:
    """What went before; it replaces what the page has of score curves, paths and log.

    Parameters
    ----------
    step : int
        So many changes and offers were there.
    times, steps, scores : array, shape (k,)
        The curve of the team score, thinned out: when, after how many changes and offers, and how much.
    times_flown, scores_flown : array, shape (q,)
        The curve of the team score from the true poses, thinned out.
    path_counts : array of int32, shape (m,)
        How many points of each agent's path there are.
    path_x : array, shape (r,)
        When the agents were where `path_points` says, agent after agent: the time, of a plan the step.
    path_points : array of float32, shape (r, 3)
        Frame W, metres; true places where vehicles fly, else committed ones.
    changes : tuple of PastChange
        The newest ones, in the order of time.
    partners : array of int32, shape (p, 3)
        Two agents, and how often they have traded.
    """

    step: int
    times: NDArray[np.float64]
    steps: NDArray[np.int32]
    scores: NDArray[np.float64]
    times_flown: NDArray[np.float64]
    scores_flown: NDArray[np.float64]
    path_counts: NDArray[np.int32]
    path_x: NDArray[np.float64]
    path_points: NDArray[np.float32]
    changes: tuple[PastChange, ...]
    partners: NDArray[np.int32]


@dataclass(frozen=True, slots=True)
class Refused:
    """The answer to a command that is not carried out; only its sender gets it."""

    command: str
    text: str


@dataclass(frozen=True, eq=False, slots=True)
class HeatMap:
    """The answer to ``/api/heatmap?agent=``: what an agent sees from its committed pose.

    Parameters
    ----------
    agent : int
    visibility : array of float32, shape (n,)
        Of each landmark.
    """

    agent: int
    visibility: NDArray[np.float32]


Message: TypeAlias = Scene | Update | Hello | Steered | History | Refused | HeatMap
"""Anything that goes to the page."""


@dataclass(frozen=True, slots=True)
class Greeting:
    """The first frame of a visitor; the token is empty for one that only watches."""

    token: str


@dataclass(frozen=True, slots=True)
class Asked:
    """A command, and the token that came with it."""

    token: str
    command: Command
    name: str


def encode(message: Message) -> str:
    """Return a message as JSON.

    Examples
    --------
    >>> from covey.runtime.watching.feed import BoundFound
    >>> encode(BoundFound(1.5, float("inf")))
    '{"type":"BoundFound","time":1.5,"bound":null}'
    """
    document = {"type": type(message).__name__, **_plain_fields(message)}
    return json.dumps(document, separators=(",", ":"), allow_nan=False)


def _plain_fields(message: Any) -> dict[str, Any]:
    return {name: _plain(getattr(message, name)) for name in message.__dataclass_fields__}


def _plain(value: Any) -> Any:
    """Return a field's value as JSON has it."""
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    if isinstance(value, enum.Enum):
        return value.value
    if value is None or isinstance(value, str | bool | int):
        return value
    if isinstance(value, np.ndarray):
        return plain_array(value)
    if dataclasses.is_dataclass(value):
        return _plain_fields(value)
    if isinstance(value, tuple | list):
        return [_plain(item) for item in value]
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    return str(value)


def plain_array(array: NDArray[Any]) -> dict[str, Any]:
    """Return an array as JSON has it: its type, its shape and its values in base64."""
    little = np.ascontiguousarray(array, dtype=array.dtype.newbyteorder("<"))
    return {
        "dtype": DTYPES[little.dtype.str],
        "shape": list(array.shape),
        "data": base64.b64encode(little.data).decode("ascii"),
    }


def decode(text: str) -> Greeting | Asked:
    """Return what a visitor's frame says.

    Raises
    ------
    ArgumentError
        If it is not such a frame.

    Examples
    --------
    >>> decode('{"type":"command","token":"t","command":"kill","agent":3}')
    Asked(token='t', command=Kill(agent=3), name='kill')
    """
    if len(text) > LONGEST:
        raise ArgumentError(f"frame: expected at most {LONGEST} characters, got {len(text)}")
    try:
        document = json.loads(text, parse_constant=_no_constant)
    except (ValueError, RecursionError) as error:
        raise ArgumentError("frame: expected JSON") from error
    if not isinstance(document, dict):
        raise ArgumentError("frame: expected an object")
    kind, token = document.pop("type", None), document.pop("token", None)
    if not isinstance(token, str):
        raise ArgumentError("token: expected a string")
    if kind == "hello" and not document:
        return Greeting(token)
    name = document.pop("command", None)
    if kind != "command" or not isinstance(name, str) or name not in COMMANDS:
        raise ArgumentError(f"command: expected one of {', '.join(COMMANDS)}")
    return Asked(token, _command(COMMANDS[name], document), name)


def _no_constant(name: str) -> float:
    raise ValueError(f"{name} is no JSON")


def _command(kind: type[Command], values: dict[str, Any]) -> Command:
    types = get_type_hints(kind)
    if values.keys() != types.keys():
        raise ArgumentError(f"{kind.__name__}: expected {', '.join(types) or 'nothing else'}")
    for name, value in values.items():
        wanted = (int,) if types[name] is int else (int, float)
        if not isinstance(value, wanted) or isinstance(value, bool) or not abs(value) < 1e9:
            raise ArgumentError(f"{name}: expected a {types[name].__name__}")
    return kind(**{name: types[name](value) for name, value in values.items()})
