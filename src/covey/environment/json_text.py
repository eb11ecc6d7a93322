"""JSON with the place of every value, so that a mistake in a GeoJSON or mission file can be pointed at."""

from __future__ import annotations

import bisect
import json
import re
from dataclasses import dataclass, field
from typing import Any

from covey.errors import InputError, Mistake

KeyPath = tuple[str | int, ...]
"""Keys and indices that lead from the top of a document to a value."""

Place = tuple[int, int]
"""One-based line and column."""

_TOKEN = re.compile(r'"(?:[^"\\]|\\.)*"|[{}\[\]:,]|[^\s{}\[\]:,"]+', re.DOTALL)


class LineIndex:
    r"""Turns offsets into a text into lines and columns.

    Examples
    --------
    >>> LineIndex("a: 1\nb: 2")(5)
    (2, 1)
    """

    def __init__(self, text: str) -> None:
        self._starts = [0, *(match.end() for match in re.finditer("\n", text))]

    def __call__(self, offset: int) -> Place:
        """Return the one-based (line, column) of an offset."""
        line = bisect.bisect_right(self._starts, offset) - 1
        return line + 1, offset - self._starts[line] + 1


@dataclass
class Places:
    """Where things are in a document.

    Parameters
    ----------
    found : dict
        Place of each entry: of its key in a mapping, of the value itself in a list.
    duplicates : list
        Path and place of each key that a mapping has already.
    """

    found: dict[KeyPath, Place] = field(default_factory=dict)
    duplicates: list[tuple[KeyPath, Place]] = field(default_factory=list)

    def add(self, path: KeyPath, place: Place) -> None:
        """Note an entry; a second one of the same path is a duplicate."""
        if path in self.found:
            self.duplicates.append((path, place))
        else:
            self.found[path] = place

    def nearest(self, path: KeyPath) -> Place | None:
        """Place of the entry, or of the closest one that encloses it."""
        for n in range(len(path), -1, -1):
            if path[:n] in self.found:
                return self.found[path[:n]]
        return None


def key_text(path: KeyPath) -> str:
    """Write a path as users read it.

    Examples
    --------
    >>> key_text(("agents", 0, "pose", "x_m"))
    'agents[0].pose.x_m'
    """
    text = ""
    for part in path:
        if isinstance(part, int):
            text += f"[{part}]"
        else:
            shown = part if part.isprintable() else repr(part)[1:-1]
            text += f".{shown}" if text else shown
    return text


def describe(value: Any) -> str:
    """Say what came instead of what was expected.

    Examples
    --------
    >>> describe("3.5"), describe(None), describe(True), describe([1])
    ("the text '3.5'", 'nothing', 'true', 'a list')
    """
    if value is None:
        return "nothing"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return f"the text {value if len(value) <= 40 else value[:37] + '...'!r}"
    if isinstance(value, float):
        return repr(value)
    if isinstance(value, int):
        return str(value) if value.bit_length() <= 64 else "an integer beyond 64 bits"
    if isinstance(value, dict):
        return "a mapping"
    return "a list" if isinstance(value, list) else f"a {type(value).__name__}"


def json_places(text: str) -> Places:
    """Find the place of every entry of a text that `json.loads` accepts."""
    place = LineIndex(text)
    places = Places()
    stack: list[list[str | int | None]] = []  # one [key or index] an open container; None: a mapping awaits a key
    for match in _TOKEN.finditer(text):
        token = match.group()
        if token in ("}", "]"):
            stack.pop()
        elif token == ",":
            last = stack[-1][0]
            stack[-1][0] = last + 1 if isinstance(last, int) else None
        elif token == ":":
            continue
        elif stack and stack[-1][0] is None:
            stack[-1][0] = json.loads(token, strict=False)
            places.add(_path(stack), place(match.start()))
        else:
            if not stack or isinstance(stack[-1][0], int):
                places.found[_path(stack)] = place(match.start())
            if token in ("{", "["):
                stack.append([None if token == "{" else 0])
    return places


def _path(stack: list[list[str | int | None]]) -> KeyPath:
    return tuple(part for (part,) in stack if part is not None)


def load_json(text: str, source: str) -> tuple[Any, Places | None, list[Mistake]]:
    """Parse JSON: the data, the places when they were needed already, and mistakes of syntax or repeated keys.

    Parameters
    ----------
    text : str
    source : str
        The file as the user named it, for the mistakes.
    """
    repeated = False

    def pairs(items: list[tuple[str, Any]]) -> dict[str, Any]:
        nonlocal repeated
        result = dict(items)
        repeated = repeated or len(result) < len(items)
        return result

    try:
        data = json.loads(text, object_pairs_hook=pairs)
    except json.JSONDecodeError as error:
        return None, None, [Mistake(source, error.lineno, error.colno, "", f"not valid JSON: {error.msg}")]
    except RecursionError:
        return None, None, [Mistake(source, None, None, "", "expected a mission, got lists nested too deeply")]
    except ValueError as error:  # an integer of more digits than Python converts
        return None, None, [Mistake(source, None, None, "", f"not valid JSON: {error}")]
    if not repeated:
        return data, None, []
    places = json_places(text)
    mistakes = [
        Mistake(source, *place, key_text(path), f"expected each key once, {path[-1]!r} is here again")
        for path, place in places.duplicates
    ]
    return data, places, mistakes


def single(message: str, source: str, place: Place | None = None, key: str = "", hint: str = "") -> Mistake:
    """Build a mistake from a place that may be unknown."""
    line, column = place if place is not None else (None, None)
    return Mistake(source, line, column, key, message, hint)


def as_mistake(error: InputError, source: str) -> Mistake:
    """Turn the one-sentence error of `read_text` into a mistake of the file as a whole."""
    return Mistake(source, None, None, "", str(error))
