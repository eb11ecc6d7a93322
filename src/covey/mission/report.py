"""Collects the mistakes in a mission file and words those that pydantic finds."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Sequence
from typing import Any

from pydantic import BaseModel
from pydantic_core import ErrorDetails

from covey.environment.json_text import KeyPath, describe, key_text
from covey.errors import Mistake
from covey.mission.document import Document
from covey.mission.schema import BRANCH, SCHEMA_VERSIONS, MissionFile, known_keys

_MAX_HINTS = 200
"""Looking for near words takes time, and a report is cut long before so many."""


class Report:
    """The mistakes so far.

    Parameters
    ----------
    source : str
        The file as the user named it.
    document : Document
        Knows the places; its own mistakes come first.
    file : type
        What the file should hold, so that unknown keys can be told from known ones.
    """

    def __init__(self, source: str, document: Document, file: type[BaseModel] = MissionFile) -> None:
        self._file = file
        self.mistakes: list[Mistake] = list(document.mistakes)
        self._source = source
        self._document = document
        self._seen: set[tuple[KeyPath, str]] = set()

    def add(self, path: KeyPath, message: str, hint: str = "") -> None:
        """Note a mistake at a key."""
        if (path, message) in self._seen:
            return
        self._seen.add((path, message))
        line, column = self._document.place(path) or (None, None)
        self.mistakes.append(Mistake(self._source, line, column, key_text(path), message, hint))

    def add_foreign(self, mistakes: Iterable[Mistake]) -> None:
        """Note mistakes in a file that the mission names."""
        self.mistakes += [mistake for mistake in mistakes if mistake not in self.mistakes]

    def inside(self, path: KeyPath) -> bool:
        """Whether a mistake at this key or below it is noted already."""
        return any(seen[: len(path)] == path for seen, _ in self._seen)

    def in_order(self) -> list[Mistake]:
        """Return the mistakes in the order of the file, those in other files after them."""
        return sorted(self.mistakes, key=lambda m: (m.file != self._source, m.file, m.line or 0, m.column or 0))

    def add_pydantic(self, errors: Sequence[ErrorDetails]) -> None:
        """Note what pydantic found, in the words of this file format."""
        meant: set[KeyPath] = set()
        # That there is nothing where a value belongs has been noted for the whole document.
        located = [(plain_path(e["loc"]), e) for e in errors if e["type"] == "missing" or e["input"] is not None]
        for path, error in located:
            if error["type"] == "extra_forbidden":
                key = str(error["loc"][-1])
                near, hint = _suggest(self._file, path[:-1], key) if len(self.mistakes) < _MAX_HINTS else (None, "")
                if near is not None:
                    meant.add((*path[:-1], near))
                self.add(path, f"unknown key {key[:60]!r}", hint)
        for path, error in located:
            if error["type"] == "extra_forbidden" or (error["type"] == "missing" and path in meant):
                continue  # a misspelt key is one mistake, not also a missing one
            message, hint = _words(error, path)
            self.add(path, message, hint)


def nearest(word: str, known: Sequence[str]) -> str | None:
    """Find the known word that was probably meant.

    Examples
    --------
    >>> nearest("spacing", ["x_m", "y_m", "spacing_m"]), nearest("yaw", ["yaw_deg"]), nearest("colour", ["pose"])
    ('spacing_m', 'yaw_deg', None)
    """
    plain = word.lower().replace("-", "_").replace(" ", "_")
    for candidate in known:
        if candidate.replace("-", "_") == plain or candidate.startswith(plain + "_"):
            return candidate
    close = difflib.get_close_matches(plain[:100], known, n=1)
    return close[0] if close else None


def one_of(words: Iterable[str], conjunction: str = "or") -> str:
    """Write a choice: ``'a', 'b' or 'c'``."""
    quoted = [repr(word) for word in words]
    return quoted[0] if len(quoted) == 1 else f"{', '.join(quoted[:-1])} {conjunction} {quoted[-1]}"


def wrong_version(got: object) -> str:
    """Say which versions of the file format are read."""
    known = " or ".join(map(str, SCHEMA_VERSIONS))
    return f"expected version {known}, which this covey reads, got {describe(got)}"


def plain_path(loc: tuple[int | str, ...]) -> KeyPath:
    """Path in the file of one of pydantic's: without the branches of unions."""
    return tuple(part for part in loc if not (isinstance(part, str) and part.startswith(BRANCH)))


def _suggest(file: type[BaseModel], parent: KeyPath, key: str) -> tuple[str | None, str]:
    keys = known_keys(file)
    parents = tuple(part if isinstance(part, str) else "[]" for part in parent)
    here = keys.get(parents, [])
    near = nearest(key, here)
    if near is not None:
        return near, f"did you mean {near!r}?"
    elsewhere = [key_text((*place, key)) for place, known in keys.items() if key in known and "[]" not in place]
    if elsewhere:
        return None, f"{key!r} belongs at {elsewhere[0]}"
    return None, f"known here: {', '.join(here)}" if here else ""


def _words(error: ErrorDetails, path: KeyPath) -> tuple[str, str]:
    """Message and hint for one of pydantic's errors."""
    kind, value, context = error["type"], error["input"], error.get("ctx", {})
    got = describe(value)
    if kind == "missing":
        return "expected this key, it is missing", ""
    if path == ("schema_version",):
        return wrong_version(value), ""
    if kind in ("float_type", "int_type", "int_from_float", "float_parsing", "int_parsing"):
        noun = "a number" if kind.startswith("float") else "a whole number"
        return f"expected {noun}, got {got}", "take the quotes away" if _is_number(value) else ""
    if kind == "finite_number":
        return f"expected a finite number, got {got}", ""
    if kind in ("greater_than", "greater_than_equal", "less_than", "less_than_equal"):
        words = {"gt": "above", "ge": "of at least", "lt": "below", "le": "of at most"}
        key = next(key for key in words if key in context)
        return f"expected a number {words[key]} {_limit(context[key])}, got {got}", ""
    if kind in ("too_short", "too_long"):
        limit = context["min_length"] if kind == "too_short" else context["max_length"]
        bound = "at least" if kind == "too_short" else "at most"
        return f"expected {bound} {limit:,} entries, got {context.get('actual_length')}", ""
    if kind in ("string_too_short", "string_too_long", "string_pattern_mismatch"):
        if path[-1:] == ("name",):
            return f"expected 1 to 100 characters without slashes or control characters, got {got}", ""
        return f"expected 1 to {1000:,} characters, got {got}", ""
    if kind == "literal_error":
        words_known = _literals(context)
        near = nearest(value, words_known) if isinstance(value, str) else None
        return f"expected {one_of(words_known)}, got {got}", f"did you mean {near!r}?" if near else ""
    return f"expected {_EXPECTED.get(kind) or _UNION.get(_last_key(path), 'another type')}, got {got}", ""


_EXPECTED = {
    "string_type": "text",
    "bool_type": "true or false",
    "list_type": "a list",
    "dict_type": "a mapping",
    "model_type": "a mapping",
    "model_attributes_type": "a mapping",
}

_UNION = {
    "agents": "a list of agents, or {count: n}",
    "polygon": "a list of corners [x, y], or {exterior, holes}",
    "weights": "a number, or a list of numbers",
    "normals_deg": "a number, or a list of numbers",
    "assignment": "'random', 'nearest', or a mapping from agents to lists of landmarks",
}


def _limit(value: float) -> str:
    return f"{value:,}" if isinstance(value, int) else f"{value:,.12g}"


def _last_key(path: KeyPath) -> str:
    return next((part for part in reversed(path) if isinstance(part, str)), "")


def _literals(context: dict[str, Any]) -> list[str]:
    # pydantic only offers the choice as text: "'left', 'right' or 'outside'"
    return [word.strip().strip("'") for word in str(context["expected"]).replace(" or ", ", ").split(",")]


def _is_number(value: object) -> bool:
    if not isinstance(value, str):
        return False
    try:
        float(value)
    except ValueError:
        return False
    return value.strip()[-1:].isdigit()
