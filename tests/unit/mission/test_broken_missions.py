"""Every mistake a mission file can hold: which key and line is named, and in which words."""

from __future__ import annotations

from pathlib import Path

import pytest
from ruamel.yaml import YAML

from covey.errors import MissionError
from covey.mission import load_mission, parse_mission

VALID = """\
schema_version: 1
name: base
seed: 7
environment:
  landmarks:
    grid: {x_m: [-5, 5], y_m: [-5, 5], spacing_m: 0.5}
  region:
    box: {x_m: [-5, 5], y_m: [-5, 5]}
sensor: {model: anisotropic, optimal_distance_m: 1.0}
agents:
  - {name: blue, pose: {x_m: 3.5, y_m: -2, yaw_deg: 0}}
  - {name: red, pose: {x_m: -5, y_m: 4, yaw_deg: 90}}
coverage: {sigma: 0.01, trade: pairwise, optimizer: search, assignment: random}
"""
GRID = "grid: {x_m: [-5, 5], y_m: [-5, 5], spacing_m: 0.5}"
PARTS = {
    "$ALL": VALID,
    "$GRID": GRID,
    "$BOX": "box: {x_m: [-5, 5], y_m: [-5, 5]}",
    "$ENVIRONMENT": VALID[VALID.index("environment") : VALID.index("sensor")],
    "$AGENTS": VALID[VALID.index("agents") : VALID.index("coverage")],
}
SITE = """\
{"type": "Polygon", "coordinates": [[[11.330, 43.318], [11.332, 43.318], [11.331, 43.319], [11.330, 43.318]]]}
"""
CASES = {
    case.pop("case"): case
    for case in YAML(typ="safe").load(Path(__file__).with_name("broken_missions.yaml").read_text(encoding="utf-8"))
}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "site.geojson").write_text(SITE)
    (tmp_path / "folder").mkdir()
    return tmp_path


def _broken(old: str, new: str) -> str:
    for name, part in PARTS.items():
        old, new = old.replace(name, part), new.replace(name, part)
    assert old in VALID, f"{old!r} is not in the valid mission"
    return VALID.replace(old, new, 1)


def test_there_are_enough_cases() -> None:
    assert len(CASES) >= 40


def test_the_mission_that_gets_broken_is_valid() -> None:
    assert len(parse_mission(VALID).landmarks) == 400


@pytest.mark.parametrize("name", CASES)
def test_mistake_is_named_with_key_and_line(name: str, folder: Path) -> None:
    case = CASES[name]
    (folder / "mission.yaml").write_text(_broken(case["replace"], case["by"]), encoding="utf-8")
    with pytest.raises(MissionError) as caught:
        load_mission(folder / "mission.yaml")
    found = [mistake for mistake in caught.value.mistakes if (mistake.key, mistake.line) == (case["key"], case["line"])]
    assert any(case["says"] in str(mistake) for mistake in found), caught.value
    assert caught.value.exit_code == 2


@pytest.mark.parametrize("name", CASES)
def test_one_mistake_is_reported_once(name: str, folder: Path) -> None:
    """Nothing else seems wrong because of it."""
    # These leave landmarks without an owner too, and a key that is no text is an unknown one.
    two = ("assignment to a stranger", "assignment out of range", "assignment twice", "yaml number as key")
    with pytest.raises(MissionError) as caught:
        parse_mission(_broken(CASES[name]["replace"], CASES[name]["by"]), folder=folder)
    assert len(caught.value.mistakes) == (2 if name in two else 1), caught.value


def test_every_mistake_is_reported_at_once_in_the_order_of_the_file() -> None:
    text = VALID
    for old, new in (
        ("seed: 7", "sed: 7"),
        ("spacing_m: 0.5", "spacing: 0.5"),
        ("optimal_distance_m: 1.0", "optimal_distance_m: -1"),
        ("model: anisotropic", "model: anisotropc"),
        ("y_m: -2", "y_m: -12"),
        ("name: red", "name: blue"),
        ("sigma: 0.01", "sigma: .nan"),
        ("assignment: random", "assignment: {green: [0]}"),
    ):
        text = text.replace(old, new)
    with pytest.raises(MissionError) as caught:
        parse_mission(text)
    keys = [mistake.key for mistake in caught.value.mistakes]
    assert keys == [
        "sed",
        "environment.landmarks.grid.spacing",
        "sensor.model",
        "sensor.optimal_distance_m",
        "agents[0].pose",
        "agents[1].name",
        "coverage.sigma",
        "coverage.assignment.green",
    ]


def test_integer_of_thousands_of_digits() -> None:
    with pytest.raises(MissionError, match=r":11:.*cannot read '1000000"):
        parse_mission(_broken("x_m: 3.5", "x_m: 1" + "0" * 5000))


def test_thousands_of_mistakes_end_in_a_count() -> None:
    points = ", ".join("[a, 0]" for _ in range(3000))
    with pytest.raises(MissionError) as caught:
        parse_mission(_broken(GRID, f"points: [{points}]"))
    assert len(caught.value.mistakes) == 101
    assert "and 2,900 more mistakes" in str(caught.value)


def test_alias_bomb_is_refused() -> None:
    lines = ["a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1, 1]"]
    lines += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]" for i in range(1, 10)]
    with pytest.raises(MissionError, match="aliases unfolded"):
        parse_mission("\n".join(lines))


@pytest.mark.parametrize("text", ["a: &a [*a]", "a: &a {b: *a}", "[" * 5000, "{a: " * 3000, "- " * 5000, "? " * 3000])
def test_bottomless_yaml_is_refused(text: str) -> None:
    with pytest.raises(MissionError):
        parse_mission(text)
