"""Reading JSON of which nothing may be taken for granted."""

from __future__ import annotations

import enum
import json
from dataclasses import dataclass
from typing import Any, NoReturn, TypeVar

import numpy as np
from numpy.typing import NDArray

from covey.errors import ResultError

E = TypeVar("E", bound=enum.Enum)


def parse_json(text: str) -> CheckedValue:
    """Parse a JSON document; NaN and infinity, which JSON does not have, are refused.

    Raises
    ------
    ResultError
        If the text is something else.
    """
    try:
        return CheckedValue(json.loads(text, parse_constant=_refuse_constant), "")
    except (ValueError, RecursionError) as error:
        raise ResultError(f"expected JSON, got something else: {error}") from error


@dataclass(frozen=True)
class CheckedValue:
    """A value of a JSON document and where it stands: each method asks for one type.

    Parameters
    ----------
    value : object
        What the JSON parser gave.
    place : str
        Its keys, for example ``agents[0].pose.x_m``; empty for the document.

    Raises
    ------
    ResultError
        By every method, if the value is something else; the text names the place.

    Examples
    --------
    >>> parse_json('{"agents": [{"name": 3}]}')["agents"].items()[0]["name"].text()
    Traceback (most recent call last):
    covey.errors.ResultError: agents[0].name: expected text, got 3
    """

    value: Any
    place: str

    def fail(self, expected: str) -> NoReturn:
        """Say what was expected here."""
        shown = repr(self.value)
        shown = shown if len(shown) <= 60 else f"{shown[:57]}..."
        raise ResultError(f"{self.place or 'the document'}: expected {expected}, got {shown}")

    def mapping(self) -> dict[str, Any]:
        """Return the object as plain data."""
        if not isinstance(self.value, dict):
            self.fail("an object")
        return self.value

    def __getitem__(self, key: str) -> CheckedValue:
        place = f"{self.place}.{key}" if self.place else key
        mapping = self.mapping()
        if key not in mapping:
            raise ResultError(f"{place}: expected this key, got none")
        return CheckedValue(mapping[key], place)

    def get(self, key: str) -> CheckedValue | None:
        """Return the value of a key, None where it is null."""
        found = self[key]
        return None if found.value is None else found

    def members(self) -> list[tuple[str, CheckedValue]]:
        """Return the keys and values of an object."""
        return [(key, self[key]) for key in self.mapping()]

    def items(self) -> list[CheckedValue]:
        """Return the elements of a list."""
        if not isinstance(self.value, list):
            self.fail("a list")
        return [CheckedValue(item, f"{self.place}[{index}]") for index, item in enumerate(self.value)]

    def number(self) -> float:
        """Return a finite number."""
        if type(self.value) not in (int, float) or not abs(self.value) <= 1e300:
            self.fail("a finite number")
        return float(self.value)

    def known(self, unknown: float) -> float:
        """Return the number, or `unknown` for null."""
        return unknown if self.value is None else self.number()

    def integer(self) -> int:
        """Return a whole number of at least 0."""
        if type(self.value) is not int or not 0 <= self.value < 2**63:
            self.fail("a whole number of at least 0")
        return int(self.value)

    def truth(self) -> bool:
        """Return true or false."""
        if not isinstance(self.value, bool):
            self.fail("true or false")
        return self.value

    def text(self) -> str:
        """Return text that can be printed."""
        # Lone surrogates are valid in JSON but can neither be printed nor written again.
        if not isinstance(self.value, str) or any("\ud800" <= character <= "\udfff" for character in self.value):
            self.fail("text")
        return self.value

    def member(self, kind: type[E]) -> E:
        """Return the member of an enum of texts."""
        members = {member.value: member for member in kind}
        if not isinstance(self.value, str) or self.value not in members:
            self.fail("one of " + ", ".join(members))
        return members[self.value]

    def array(self, columns: int | None) -> NDArray[np.float64]:
        """Return numbers, shape (n,), or rows of `columns` numbers, shape (n, columns)."""
        items = self.value
        if not isinstance(items, list):
            self.fail("a list")
        if columns is None:
            numbers = items
        else:
            for index, row in enumerate(items):
                if not isinstance(row, list) or len(row) != columns:
                    CheckedValue(row, f"{self.place}[{index}]").fail(f"a list of {columns} numbers")
            numbers = [number for row in items for number in row]
        for index, number in enumerate(numbers):
            if type(number) not in (int, float) or not abs(number) <= 1e300:
                CheckedValue(number, f"{self.place}[{index // (columns or 1)}]").fail("finite numbers")
        array = np.array(numbers, dtype=np.float64)
        return array if columns is None else array.reshape(-1, columns)

    def indices(self, n: int) -> NDArray[np.int64]:
        """Return landmark indices, shape (k,), each below n."""
        if not isinstance(self.value, list):
            self.fail("a list")
        for index, item in enumerate(self.value):
            if type(item) is not int or not 0 <= item < n:
                CheckedValue(item, f"{self.place}[{index}]").fail(f"the index of a landmark, 0 to {n - 1}")
        return np.array(self.value, dtype=np.int64)


def _refuse_constant(name: str) -> NoReturn:
    raise ValueError(f"{name} is no JSON")
