"""TOML with the place of every entry."""

from __future__ import annotations

import re
import tomllib
from typing import Any

from covey.environment.json_text import KeyPath, LineIndex, Places
from covey.errors import Mistake

_TOKEN = re.compile(
    r'"""(?:\\.|[^\\])*?"{3,5}'
    r"|'''.*?'{3,5}"
    r'|"(?:[^"\\\n]|\\.)*"'
    r"|'[^'\n]*'"
    r"|\#[^\n]*|\n|[{}\[\],=.]"
    r"|[^\s{}\[\],=.\#\"']+",
    re.DOTALL,
)
_AT = re.compile(r" \(at (?:line (\d+), column (\d+)|end of document)\)$")


def load_toml(text: str, source: str) -> tuple[Any, list[Mistake]]:
    """Parse TOML; a mistake of syntax comes with its place."""
    try:
        return tomllib.loads(text), []
    except tomllib.TOMLDecodeError as error:
        match = _AT.search(str(error))
        line = column = None
        if match and match.group(1):
            line, column = int(match.group(1)), int(match.group(2))
        elif match:
            line, column = LineIndex(text)(max(0, len(text.rstrip()) - 1))
        message = f"not valid TOML: {_AT.sub('', str(error))}"
    except RecursionError:
        line, column, message = None, None, "expected a mission, got lists nested too deeply"
    except ValueError as error:  # an integer of more digits than Python converts, a date out of range
        line, column, message = None, None, f"not valid TOML: {error}"
    return None, [Mistake(source, line, column, "", message)]


def toml_places(text: str) -> Places:
    """Find the place of every entry of a text that `tomllib.loads` accepts."""
    return _Scanner(text).scan()


class _Scanner:
    """Walks over the tokens; the values themselves are `tomllib`'s business."""

    def __init__(self, text: str) -> None:
        self._tokens = [(match.group(), match.start()) for match in _TOKEN.finditer(text)]
        self._next = 0
        self._line_of = LineIndex(text)
        self._places = Places()
        self._tables: dict[KeyPath, int] = {}  # arrays of tables: how many items so far

    def scan(self) -> Places:
        base: KeyPath = ()
        while (token := self._peek()) is not None:
            if token == "\n" or token.startswith("#"):
                self._next += 1
            elif token == "[":
                base = self._header()
            else:
                self._entry(base)
        return self._places

    def _peek(self) -> str | None:
        return self._tokens[self._next][0] if self._next < len(self._tokens) else None

    def _offset(self) -> int:
        return self._tokens[min(self._next, len(self._tokens) - 1)][1]

    def _note(self, path: KeyPath, offset: int) -> None:
        for n in range(1, len(path) + 1):  # a dotted key also opens the tables it passes through
            self._places.found.setdefault(path[:n], self._line_of(offset))

    def _keys(self, end: str) -> list[str]:
        keys = []
        while (token := self._peek()) is not None and token != end:
            self._next += 1
            if token[0] in "\"'":
                keys.append(next(iter(tomllib.loads(token + " = 0"))))
            elif token != ".":
                keys.append(token)
        self._next += 1
        return keys

    def _header(self) -> KeyPath:
        offset = self._offset()
        self._next += 1
        array = self._peek() == "[" and self._offset() == offset + 1
        self._next += array
        keys = self._keys("]")
        self._next += array
        path: KeyPath = ()
        for i, key in enumerate(keys):
            path = (*path, key)
            if array and i == len(keys) - 1:
                self._tables[path] = self._tables.get(path, 0) + 1
            if path in self._tables:
                path = (*path, self._tables[path] - 1)
        self._note(path, offset)
        return path

    def _entry(self, base: KeyPath) -> None:
        offset = self._offset()
        path = (*base, *self._keys("="))
        self._note(path, offset)
        self._value(path)

    def _value(self, path: KeyPath) -> None:
        token = self._peek()
        if token not in ("[", "{"):
            while (token := self._peek()) is not None and token not in (",", "]", "}", "\n") and token[0] != "#":
                self._next += 1
            return
        self._next += 1
        index = 0
        while (inner := self._peek()) is not None and inner not in ("]", "}"):
            if inner in (",", "\n") or inner.startswith("#"):
                self._next += 1
            elif token == "{":
                self._entry(path)
            else:
                self._note((*path, index), self._offset())
                self._value((*path, index))
                index += 1
        self._next += 1
