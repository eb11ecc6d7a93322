"""The text of a mission file as plain data, with the place of every entry."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from covey.environment.json_text import KeyPath, Place, Places, json_places, load_json
from covey.errors import Mistake

FORMATS = {".yaml": "yaml", ".yml": "yaml", ".json": "json", ".toml": "toml", "": "yaml"}
"""File name endings and what they stand for."""


@dataclass
class Document:
    """A parsed file.

    Parameters
    ----------
    data : object
        Mappings, lists, text, numbers, booleans, None.
    find_places : callable
        Finds the place of every entry; called once, when a mistake needs one.
    mistakes : list of Mistake
        What is wrong with the text itself; `data` is None when it could not be parsed at all.
    """

    data: Any
    find_places: Callable[[], Places]
    mistakes: list[Mistake]
    _places: Places | None = None

    def place(self, path: KeyPath) -> Place | None:
        """Place of an entry, or of the closest one around it."""
        if self._places is None:
            self._places = self.find_places()
        return self._places.nearest(path)


def parse(text: str, syntax: str, source: str) -> Document:
    """Parse a text in the syntax "yaml", "toml" or "json"; mistakes in it come back in the document."""
    if syntax == "json":
        data, _, mistakes = load_json(text, source)
        return Document(data, lambda: json_places(text), mistakes)
    if syntax == "toml":
        from covey.mission.toml_text import load_toml, toml_places

        data, mistakes = load_toml(text, source)
        return Document(data, lambda: toml_places(text), mistakes)
    from covey.mission.yaml_text import load_yaml

    data, places, mistakes = load_yaml(text, source)
    return Document(data, lambda: places, mistakes)
