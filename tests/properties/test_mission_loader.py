"""Whatever the text, the loader gives a mission or a `MissionError`, never anything else."""

from __future__ import annotations

import copy
import json
import tomllib
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from covey.environment.json_text import json_places
from covey.errors import MissionError, Mistake
from covey.mission import Mission, parse_mission
from covey.mission.toml_text import toml_places
from covey.mission.yaml_text import load_yaml

ROOT = Path(__file__).parents[2]
TEXTS = [
    (ROOT / "examples" / f"{name}.yaml").read_text(encoding="utf-8")
    for name in ("thesis-5.1", "thesis-5.2", "eight-agents", "inspection", "plaza-mayor")
]
SEEDS: list[dict[str, Any]] = [dict(parse_mission(text, folder=ROOT / "examples").source) for text in TEXTS]

scalars = (
    st.none()
    | st.booleans()
    | st.integers(-(10**30), 10**30)
    | st.floats(allow_nan=True, allow_infinity=True)
    | st.sampled_from(
        [0, -1, 1, 1e-12, 1e7, 1e308, "", "random", "oriented", "x.py:C", "\0", "../x", "plaza-mayor.geojson"]
    )
    | st.text(max_size=8)
)
keys = st.sampled_from(
    [
        "schema_version",
        "name",
        "seed",
        "environment",
        "landmarks",
        "region",
        "grid",
        "points",
        "csv",
        "curve",
        "polygon",
        "geojson",
        "spacing_m",
        "closed",
        "faces",
        "weights",
        "normals",
        "normals_deg",
        "box",
        "x_m",
        "y_m",
        "exterior",
        "holes",
        "sensor",
        "model",
        "optimal_distance_m",
        "options",
        "agents",
        "count",
        "pose",
        "yaw_deg",
        "coverage",
        "sigma",
        "trade",
        "optimizer",
        "assignment",
        "georeference",
        "lon_deg",
        "lat_deg",
        "alt_m",
        "<polygon>",
        "x",
    ]
) | st.text(max_size=4)
values = st.recursive(
    scalars,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(keys, inner, max_size=4),
    max_leaves=12,
)


def _only_mission_errors(text: str, format: str) -> Mission | None:
    """Parse; a mistake must name the file, and a line that the text has."""
    mistakes: tuple[Mistake, ...] = ()
    mission = None
    try:
        mission = parse_mission(text, format=format, source="fuzz", folder=ROOT / "examples")
    except MissionError as error:
        mistakes = error.mistakes
    assert (mission is None) == bool(mistakes)
    for mistake in mistakes:
        assert mistake.message
        str(mistake).encode()  # it can be printed
        if mistake.file == "fuzz" and mistake.line is not None:
            assert 1 <= mistake.line <= text.count("\n") + 2
    return mission


def _paths(value: Any, path: tuple[str | int, ...] = ()) -> list[tuple[str | int, ...]]:
    items: list[tuple[str | int, Any]] = []
    if isinstance(value, dict):
        items = list(value.items())
    elif isinstance(value, list):
        items = list(enumerate(value))
    return [path, *(inner for key, item in items for inner in _paths(item, (*path, key)))]


def _at(data: Any, path: tuple[str | int, ...]) -> Any:
    for part in path:
        data = data[part]
    return data


@st.composite
def mutated(draw: st.DrawFn) -> Any:
    """A right mission with one to three entries changed, moved, added or taken out."""
    data = copy.deepcopy(draw(st.sampled_from(SEEDS)))
    for _ in range(draw(st.integers(1, 3))):
        path = draw(st.sampled_from(_paths(data)))
        if not path:
            continue
        parent = _at(data, path[:-1])
        match draw(st.sampled_from(["set", "delete", "add", "move", "scale"])):
            case "set":
                parent[path[-1]] = draw(values)
            case "delete":
                del parent[path[-1]]
            case "add" if isinstance(parent, dict):
                parent[draw(keys)] = draw(values)
            case "move":
                parent[path[-1]] = copy.deepcopy(_at(data, draw(st.sampled_from(_paths(data)))))
            case "scale" if isinstance(parent[path[-1]], (int, float)) and not isinstance(parent[path[-1]], bool):
                parent[path[-1]] = parent[path[-1]] * draw(st.sampled_from([-1, 0, 0.1, 3, 1e-9, 1e9]))
            case _:
                pass
    return data


@given(mutated())
@settings(suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large])
def test_mutated_documents(data: Any) -> None:
    text = json.dumps(data)
    mission = _only_mission_errors(text, "json")
    if mission is not None:
        for agent in mission.agents:
            assert agent.region.contains(agent.pose.x, agent.pose.y)
        assert len({agent.name for agent in mission.agents}) == len(mission.agents) > 0
        assert 0 < len(mission.landmarks) <= 1_000_000


@given(values)
def test_documents_of_anything(data: Any) -> None:
    _only_mission_errors(json.dumps(data), "json")


@given(st.sampled_from(TEXTS), st.data())
@settings(suppress_health_check=[HealthCheck.too_slow])
def test_mutated_yaml_text(text: str, data: st.DataObject) -> None:
    for _ in range(data.draw(st.integers(1, 4))):
        start = data.draw(st.integers(0, len(text)))
        end = min(len(text), start + data.draw(st.integers(0, 12)))
        piece = data.draw(
            st.sampled_from([*"{}[]:,-#&*!|>'\"%@`? \n\t\\é\0", "\n- ", "&a ", "*a", "!!", "<<: ", "---\n"])
            | st.text(max_size=3)
        )
        text = text[:start] + piece + text[end:]
    _only_mission_errors(text, "yaml")


@pytest.mark.parametrize("format", ["yaml", "json", "toml"])
@given(text=st.text(max_size=60) | st.text(alphabet="{}[]:,-#&*!|>'\"%@`?=. \n\tab10_\\", max_size=40))
@example(text="%YAML 9.9\n---\na: 1")
@example(text="%TAG ! tag:x,2000:\n---\n!a b")
@example(text='"\\UFFFFFFFF": 1')
@example(text="!<!> a")
@example(text="? a\n? b")
@example(text="a: 2001-99-99")
@example(text="a: 0x_")
@example(text="a: 0o9")
@example(text="a: 1e")
@example(text="a: !!int b")
@example(text="a: !!float b")
@example(text="a: !!binary b")
@example(text="a: !!bool b")
@example(text="- !!set {a}")
@example(text="\ud800")
@example(text='{"\\ud800": 1}')
@example(text='"\\ud800" = 1')
@example(text='{"name": "\\ud800"}')
def test_any_text(format: str, text: str) -> None:
    _only_mission_errors(text, format)


# Beyond this YAML wants other escapes than JSON's.
words = st.text(st.characters(max_codepoint=0xD7FF), max_size=5)
documents = st.recursive(
    st.integers() | st.booleans() | words | st.floats(allow_nan=False, allow_infinity=False),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(words, inner, max_size=4),
    max_leaves=20,
)


@given(st.dictionaries(st.text(max_size=5), documents, max_size=5), st.sampled_from([None, 1]))
def test_every_entry_of_json_has_a_place(data: dict[str, Any], indent: int | None) -> None:
    text = json.dumps(data, indent=indent)
    places = json_places(text)
    assert set(places.found) == set(_paths(data))
    assert not places.duplicates


@given(st.dictionaries(st.text(alphabet="abc '\"", max_size=5), documents, max_size=5))
def test_every_entry_of_toml_has_a_place(data: dict[str, Any]) -> None:
    text = "".join(f"{json.dumps(key)} = {_toml(value)}\n" for key, value in data.items())
    try:
        parsed = tomllib.loads(text)
    except tomllib.TOMLDecodeError:  # an escape that JSON has and TOML has not
        return
    assert set(toml_places(text).found) == set(_paths(parsed)) - {()}


def _toml(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(key)} = {_toml(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ",\n ".join(map(_toml, value)) + "]"
    return json.dumps(value, ensure_ascii=False)


@given(st.dictionaries(st.text(alphabet="abc", max_size=5), documents, max_size=5))
def test_yaml_reads_what_json_says(data: dict[str, Any]) -> None:
    text = json.dumps(data)
    parsed, places, mistakes = load_yaml(text, "fuzz")
    assert not mistakes
    assert parsed == data
    assert set(places.found) == set(_paths(data))
