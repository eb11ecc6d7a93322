"""From a mission file to a `Mission`, or to every mistake in it at once."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from covey.environment.files import read_text
from covey.environment.json_text import as_mistake
from covey.errors import ArgumentError, InputError, MissionError, Mistake
from covey.mission.model import Mission

MAX_BYTES = 10_000_000
"""Size of a mission file, bytes; more landmarks belong in a CSV file."""

MAX_MISTAKES = 100
"""After so many the report stops: one cause, such as a wrong column, often makes thousands."""


def load_mission(path: str | Path, *, seed: int | None = None) -> Mission:
    """Read a mission file.

    Parameters
    ----------
    path : str or Path
        YAML (``.yaml``, ``.yml`` or no ending), TOML (``.toml``) or JSON (``.json``).
    seed : int, optional
        Instead of the file's seed; poses that the file leaves out are drawn from it.

    Raises
    ------
    MissionError
        With every mistake in the file and in the files it names, in order, each with its line and key.

    See Also
    --------
    mission_schema : every key and what it means.
    """
    path = Path(path)
    from covey.mission.document import FORMATS

    source = str(path)
    try:
        text = read_text(path, limit=MAX_BYTES)
    except InputError as error:
        raise MissionError((as_mistake(error, source),)) from None
    syntax = FORMATS.get(path.suffix.lower())
    if syntax is None:
        message = f"expected a file name ending in .yaml, .yml, .json or .toml, got {path.suffix!r}"
        raise MissionError((Mistake(source, None, None, "", message),))
    return _mission(text, syntax, source=source, folder=path.parent, path=path, seed=seed)


def parse_mission(
    text: str,
    *,
    format: str = "yaml",
    source: str = "<text>",
    folder: str | Path = ".",
    seed: int | None = None,
) -> Mission:
    """Read a mission from a text.

    Parameters
    ----------
    text : str
    format : str
        "yaml", "toml" or "json".
    source : str
        How mistakes call the text.
    folder : str or Path
        Where the files are that the mission names.
    seed : int, optional
        Instead of the text's seed.

    Raises
    ------
    MissionError
        With every mistake, in order.
    ArgumentError
        If the format is not one of the three.

    Examples
    --------
    >>> mission = parse_mission('''
    ... schema_version: 1
    ... name: pair
    ... environment:
    ...   landmarks: {grid: {x_m: [0, 2], y_m: [0, 1], spacing_m: 0.5}}
    ...   region: {box: {x_m: [0, 2], y_m: [0, 1]}}
    ... agents: {count: 2}
    ... ''')
    >>> len(mission.landmarks), [agent.name for agent in mission.agents]
    (8, ['agent-1', 'agent-2'])
    """
    if format not in ("yaml", "toml", "json"):
        raise ArgumentError(f"format: expected 'yaml', 'toml' or 'json', got {format!r}")
    if len(text) > MAX_BYTES:
        raise MissionError((Mistake(source, None, None, "", f"expected at most {MAX_BYTES:,} characters"),))
    return _mission(text, format, source=source, folder=Path(folder), path=None, seed=seed)


def mission_schema() -> dict[str, Any]:
    """Return the JSON Schema (2020-12) of the mission file, each key described.

    Examples
    --------
    >>> sorted(mission_schema()["required"])
    ['agents', 'environment', 'name', 'schema_version']
    """
    from covey.mission.schema import json_schema

    return json_schema()


def holds_exercise(data: object) -> bool:
    """Whether the content of a file is an exercise and no mission."""
    return isinstance(data, dict) and "exercise" in data and "environment" not in data


def _mission(text: str, syntax: str, *, source: str, folder: Path, path: Path | None, seed: int | None) -> Mission:
    from covey.mission.build import build
    from covey.mission.document import parse
    from covey.mission.report import Report

    if seed is not None and not 0 <= seed < 2**63:
        raise ArgumentError(f"seed: expected an integer from 0 to 2^63 - 1, got {seed}")
    document = parse(text, syntax, source)
    report = Report(source, document)
    mission = None
    if holds_exercise(document.data):
        report.add(("exercise",), "expected a mission, got an exercise", "`covey fly` flies it")
    elif document.data is not None or not document.mistakes:
        mission = build(document.data, report, folder=folder, path=path, seed=seed)
    if mission is None or report.mistakes:
        raise MissionError(_limited(report.in_order(), source))
    return mission


def _limited(mistakes: list[Mistake], source: str) -> tuple[Mistake, ...]:
    rest = len(mistakes) - MAX_MISTAKES
    if rest > 0:
        mistakes = [*mistakes[:MAX_MISTAKES], Mistake(source, None, None, "", f"and {rest:,} more mistakes")]
    return tuple(mistakes)
