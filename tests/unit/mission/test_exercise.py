"""The exercise file: what comes out of a right one, and which key and line a mistake is named by."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest

from covey.errors import ArgumentError, MissionError
from covey.flight.obstacles import Box, Prism, Sphere
from covey.mission import parse_mission
from covey.mission.exercise import (
    Circle,
    Follow,
    Goal,
    MovingObject,
    exercise_schema,
    is_exercise,
    load_exercise,
    parse_exercise,
)

VALID = """\
schema_version: 1
name: base
seed: 7
exercise:
  duration_s: 30
  vehicles:
    - {name: blue, model: iris, start: {x_m: 0, y_m: 0, z_m: 1, yaw_deg: 90}, goal: {x_m: 4, y_m: 0, z_m: 2}}
    - {name: red, start: {x_m: 0, y_m: 4, z_m: 1}, circle: {radius_m: 1, rate_rad_s: -0.5, altitude_m: 1}}
    - {name: green, start: {x_m: 0, y_m: 8, z_m: 1}, follow: {leader: red, offset_m: [0, 1, -1]}}
    - {name: grey, start: {x_m: 0, y_m: 12, z_m: 1}, hold: true}
  objects:
    - {name: stick, radius_m: 0.1, path_m: [[-3, 9, 1], [3, 9, 1]], speed_m_s: 0.5, start_s: 2}
  obstacles:
    - sphere: {center_m: [20, 0, 1], radius_m: 1}
    - box: {x_m: [30, 31], y_m: [0, 1], z_m: [0, 2]}
    - prism: {corners: [[40, 0], [41, 0], [40, 1]], z_m: [0, 3]}
  navigation: {k_wp: 1, k_v: 5, k_rep: 2, threshold_m: 1.5, max_speed_m_s: 0.25}
  wind: {steady_m_s: [1, 0], gust_m_s: 0.5}
  noise: {position_m: 0.02, attitude_deg: 1, latency_s: 0.02}
  arrival: {position_m: 0.2, yaw_deg: 10}
"""

BROKEN = [  # what is replaced, by what, the key and the line that the report names, what it says
    ("seed: 7", "sed: 7", "sed", 3, "did you mean 'seed'"),
    ("seed: 7", "wind: {gust_m_s: 1}", "wind", 3, "'wind' belongs at exercise.wind"),
    (
        "schema_version: 1",
        "schema_version: 2",
        "schema_version",
        1,
        "expected version 1, which this covey reads, got 2",
    ),
    ("name: base\n", "", "name", 1, "expected this key, it is missing"),
    ("duration_s: 30", "duration: 30", "exercise.duration", 5, "did you mean 'duration_s'"),
    ("duration_s: 30", "duration_s: 0", "exercise.duration_s", 5, "expected a number above 0, got 0"),
    ("duration_s: 30", "duration_s: .inf", "exercise.duration_s", 5, "expected a finite number"),
    ("duration_s: 30", "duration_s:", "exercise.duration_s", 5, "expected a value, got nothing"),
    ("model: iris", "model: irs", "exercise.vehicles[0].model", 7, "did you mean 'iris'"),
    ("model: iris", "model: my.toml", "exercise.vehicles[0].model", 7, "my.toml"),
    ("z_m: 1, yaw_deg: 90", "z_m: -1, yaw_deg: 90", "exercise.vehicles[0].start.z_m", 7, "of at least 0, got -1"),
    ("yaw_deg: 90", "yaw: 90", "exercise.vehicles[0].start.yaw", 7, "did you mean 'yaw_deg'"),
    ("goal: {x_m: 4, y_m: 0, z_m: 2}", "goal: {x_m: 4, z_m: 2}", "exercise.vehicles[0].goal.y_m", 7, "it is missing"),
    ("y_m: 0, z_m: 2", "y_m: 0, z_m: 0", "exercise.vehicles[0].goal.z_m", 7, "expected a height above 0"),
    ("x_m: 4, y_m: 0, z_m: 2", "x_m: '4', y_m: 0, z_m: 2", "exercise.vehicles[0].goal.x_m", 7, "take the quotes away"),
    (", goal: {x_m: 4, y_m: 0, z_m: 2}", "", "exercise.vehicles[0]", 7, "expected exactly one task of goal, circle"),
    ("z_m: 2}}", "z_m: 2}, hold: true}", "exercise.vehicles[0]", 7, "got goal, hold"),
    ("z_m: 2}}", "z_m: 2, direct: 1}}", "exercise.vehicles[0].goal.direct", 7, "expected true or false, got 1"),
    ("name: grey", "name: blue", "exercise.vehicles[3].name", 10, "'blue' is already vehicles[0]"),
    ("y_m: 4, z_m: 1}", "y_m: 0.5, z_m: 1}", "exercise.vehicles[1].start", 8, "0.96 m from that of 'blue', got 0.5 m"),
    ("y_m: 4, z_m: 1}", "y_m: 0, z_m: 2.5}", "exercise.vehicles[1].start", 8, "heights count 1/2 of their difference"),
    ("radius_m: 1,", "radius_m: -1,", "exercise.vehicles[1].circle.radius_m", 8, "expected a number above 0, got -1"),
    ("rate_rad_s: -0.5", "rate_rad_s: 0", "exercise.vehicles[1].circle.rate_rad_s", 8, "other than 0"),
    ("altitude_m: 1", "altitude_m: 0", "exercise.vehicles[1].circle.altitude_m", 8, "expected a height above 0"),
    ("leader: red", "leader: rod", "exercise.vehicles[2].follow.leader", 9, "did you mean 'red'"),
    ("leader: red", "leader: green", "exercise.vehicles[2].follow.leader", 9, "got its own name"),
    ("[0, 1, -1]", "[0, 1]", "exercise.vehicles[2].follow.offset_m", 9, "at least 3 entries, got 2"),
    ("[0, 1, -1]", "[0, 0.2, 0]", "exercise.vehicles[2].follow", 9, "0.96 m from its leader, got 0.2 m"),
    ("hold: true", "hold: false", "exercise.vehicles[3].hold", 10, "expected true, got false"),
    ("hold: true", "goal: {x_m: 4, y_m: 0, z_m: 2}", "exercise.vehicles[3].goal", 10, "from that of 'blue', got 0 m"),
    ("name: stick", "name: red", "exercise.objects[0].name", 12, "'red' is already vehicles[1]"),
    (", [3, 9, 1]]", "]", "exercise.objects[0].path_m", 12, "at least 2 entries, got 1"),
    ("[3, 9, 1]]", "[-3, 9, 1]]", "exercise.objects[0].path_m", 12, "expected a path of some length"),
    ("speed_m_s: 0.5", "speed_m_s: 0", "exercise.objects[0].speed_m_s", 12, "expected a number above 0"),
    ("start_s: 2", "start_s: 30", "exercise.objects[0].start_s", 12, "expected a time before the end at 30 s, got 30"),
    ("- sphere", "- spere", "exercise.obstacles[0].spere", 14, "did you mean 'sphere'"),
    ("[20, 0, 1]", "[0, 0, 1.5]", "exercise.vehicles[0].start", 7, "got -0.50 m"),
    ("x_m: [30, 31]", "x_m: [31, 30]", "exercise.obstacles[1].box", 15, "min < max"),
    ("[40, 1]]", "[42, 0]]", "exercise.obstacles[2].prism", 16, "does not cross itself"),
    ("k_wp: 1", "kwp: 1", "exercise.navigation.kwp", 17, "did you mean 'k_wp'"),
    ("k_rep: 2", "k_rep: 0", "exercise.navigation.k_rep", 17, "expected a number above 0"),
    ("max_speed_m_s: 0.25", "max_speed_m_s: 1", "exercise.navigation", 17, "set max_speed <= 0.293 m/s"),
    ("threshold_m: 1.5", "threshold_m: 0.9", "exercise.navigation", 17, "more than the required separation of 0.96 m"),
    ("gust_m_s: 0.5", "gust_m_s: -1", "exercise.wind.gust_m_s", 18, "of at least 0, got -1"),
    ("latency_s: 0.02", "latency_s: 2", "exercise.noise.latency_s", 19, "of at most 1, got 2"),
    ("arrival:", "arival:", "exercise.arival", 20, "did you mean 'arrival'"),
    ("steady_m_s: [1, 0]", "steady_m_s: [1, 0", "", 18, "not valid YAML"),
]


def _broken(old: str, new: str) -> str:
    assert old in VALID, f"{old!r} is not in the valid exercise"
    return VALID.replace(old, new, 1)


def test_what_comes_out_is_in_si_units() -> None:
    exercise = parse_exercise(VALID)
    assert (exercise.name, exercise.seed, exercise.duration) == ("base", 7, 30.0)
    blue, red, green, grey = exercise.vehicles
    assert blue.parameters.name == "iris"
    assert (blue.start_W, blue.yaw) == ((0.0, 0.0, 1.0), math.radians(90))
    assert blue.task == Goal((4.0, 0.0, 2.0))
    assert red.task == Circle((0.0, 0.0, 1.0), 1.0, -0.5)
    assert green.task == Follow(1, (0.0, 1.0, -1.0))
    assert grey.task is None
    assert exercise.objects == (MovingObject("stick", 0.1, ((-3.0, 9.0, 1.0), (3.0, 9.0, 1.0)), 0.5, 2.0),)
    assert [type(obstacle) for obstacle in exercise.obstacles] == [Sphere, Box, Prism]
    assert exercise.navigation == {"k_wp": 1.0, "k_v": 5.0, "k_rep": 2.0, "threshold": 1.5, "max_speed": 0.25}
    assert exercise.wind.steady_W == (1.0, 0.0, 0.0)
    assert exercise.noise.attitude == pytest.approx(math.radians(1))
    assert (exercise.arrival_position, exercise.arrival_yaw) == (0.2, math.radians(10))


def test_what_is_left_out_has_its_default() -> None:
    text = VALID[: VALID.index("  objects")]
    exercise = parse_exercise(text, seed=11)
    assert exercise.seed == 11
    assert (exercise.objects, exercise.obstacles, exercise.navigation) == ((), (), {})
    assert exercise.wind.calm
    assert exercise.noise.exact
    with pytest.raises(ArgumentError, match="seed"):
        parse_exercise(text, seed=-1)
    with pytest.raises(ArgumentError, match="format"):
        parse_exercise(text, format="xml")


@pytest.mark.parametrize("suffix", [".json", ".yaml", ""])
def test_other_formats_hold_the_same(suffix: str, tmp_path: Path) -> None:
    expected = parse_exercise(VALID)
    path = tmp_path / f"exercise{suffix}"
    path.write_text(json.dumps(expected.source) if suffix == ".json" else VALID, encoding="utf-8")
    exercise = load_exercise(path)
    assert exercise.source == expected.source
    assert exercise.path == path
    assert [vehicle.task for vehicle in exercise.vehicles] == [vehicle.task for vehicle in expected.vehicles]


def test_a_model_of_ones_own_lies_beside_the_file(tmp_path: Path, root: Path) -> None:
    built_in = root / "src" / "covey" / "flight" / "params" / "iris.toml"
    (tmp_path / "own.toml").write_text(built_in.read_text("utf-8").replace("1.442", "1.6"), "utf-8")
    (tmp_path / "exercise.yaml").write_text(VALID.replace("model: iris", "model: own.toml"), "utf-8")
    blue, red, *_ = load_exercise(tmp_path / "exercise.yaml").vehicles
    assert (blue.parameters.mass, red.parameters.mass) == (1.6, 1.442)


def test_there_are_enough_cases() -> None:
    assert len(BROKEN) >= 25


@pytest.mark.parametrize(("old", "new", "key", "line", "says"), BROKEN, ids=[f"{c[2]}-{c[1][:20]}" for c in BROKEN])
def test_mistake_is_named_with_key_and_line(old: str, new: str, key: str, line: int, says: str, tmp_path: Path) -> None:
    """It is the only one: nothing else seems wrong because of it."""
    path = tmp_path / "exercise.yaml"
    path.write_text(_broken(old, new), encoding="utf-8")
    with pytest.raises(MissionError) as caught:
        load_exercise(path)
    (mistake,) = caught.value.mistakes
    assert (mistake.file, mistake.key, mistake.line) == (str(path), key, line), caught.value
    assert says in str(mistake)
    assert caught.value.exit_code == 2


def test_every_mistake_is_reported_at_once_in_the_order_of_the_file() -> None:
    text = VALID
    for old, new in (
        ("seed: 7", "sed: 7"),
        ("model: iris", "model: iriz"),
        ("rate_rad_s: -0.5", "rate_rad_s: 0"),
        ("leader: red", "leader: nobody"),
        ("hold: true", "hold: 3"),
        ("speed_m_s: 0.5", "speed: 0.5"),
        ("x_m: [30, 31]", "x_m: [30, 30]"),
        ("k_v: 5", "k_v: -5"),
    ):
        assert old in text
        text = text.replace(old, new)
    with pytest.raises(MissionError) as caught:
        parse_exercise(text)
    assert [mistake.key for mistake in caught.value.mistakes] == [
        "sed",
        "exercise.vehicles[0].model",
        "exercise.vehicles[1].circle.rate_rad_s",
        "exercise.vehicles[2].follow.leader",
        "exercise.vehicles[3].hold",
        "exercise.objects[0].speed",
        "exercise.obstacles[1].box",
        "exercise.navigation.k_v",
    ]


def test_followers_in_a_ring_are_one_mistake() -> None:
    ring = _broken(
        "circle: {radius_m: 1, rate_rad_s: -0.5, altitude_m: 1}", "follow: {leader: grey, offset_m: [0, 9, 0]}"
    )
    ring = ring.replace("hold: true", "follow: {leader: green, offset_m: [0, 9, 0]}")
    with pytest.raises(MissionError) as caught:
        parse_exercise(ring)
    (mistake,) = caught.value.mistakes
    assert mistake.key == "exercise.vehicles[1].follow.leader"
    assert "red after grey after green after red" in mistake.message


def test_two_followers_of_one_leader_keep_apart() -> None:
    with pytest.raises(MissionError, match=r"vehicles\[3\]\.follow: expected at least 0\.96 m from that of 'green'"):
        parse_exercise(_broken("hold: true", "follow: {leader: red, offset_m: [0, 1.5, -1]}"))


def test_thousands_of_mistakes_end_in_a_count() -> None:
    points = ", ".join("[a, 0, 0]" for _ in range(3000))
    with pytest.raises(MissionError, match="and 2,900 more mistakes"):
        parse_exercise(_broken("[-3, 9, 1], [3, 9, 1]", points))


@pytest.mark.parametrize(
    "text", ["3", "[1, 2]", "# nothing", "a: &a [*a]", "exercise: 3", "exercise: {vehicles: {a: 1}}"]
)
def test_what_is_no_exercise_at_all_is_refused(text: str) -> None:
    with pytest.raises(MissionError):
        parse_exercise(text)


@pytest.mark.parametrize(
    ("name", "text", "expected"),
    [
        ("a.yaml", VALID, True),
        ("a.yaml", "{schema_version: 1, exercise: {}}", True),
        ("a.yaml", "name: [\nexercise:\n", True),
        ("a.json", '{"exercise": {', True),
        ("a.json", '{"exercise": {}}', True),
        ("a.toml", "[exercise]\nduration_s = 3", True),
        ("a.toml", "[exercise.wind\n", True),
        ("a.yaml", "name: exercise\nenvironment: {}", False),
        ("a.yaml", "name: [exercise\n", False),
        ("a.yaml", "environment: {exercise: 1}", False),
        ("a.yaml", "", False),
    ],
)
def test_an_exercise_is_told_from_a_mission(name: str, text: str, expected: bool, tmp_path: Path) -> None:
    (tmp_path / name).write_text(text, encoding="utf-8")
    assert is_exercise(tmp_path / name) is expected


def test_missions_are_no_exercises(root: Path, tmp_path: Path) -> None:
    assert not any(is_exercise(path) for path in root.glob("examples/*.yaml"))
    assert all(is_exercise(path) for path in root.glob("examples/exercises/*.yaml"))
    assert not is_exercise(tmp_path / "nothing.yaml")
    with pytest.raises(MissionError, match="exercise: expected a mission, got an exercise"):
        parse_mission(VALID)
    with pytest.raises(MissionError, match=r"found nothing at"):
        load_exercise(tmp_path / "nothing.yaml")
    (tmp_path / "a.txt").write_text(VALID, encoding="utf-8")
    with pytest.raises(MissionError, match=r"ending in \.yaml"):
        load_exercise(tmp_path / "a.txt")


def test_the_schema_describes_every_key() -> None:
    schema = exercise_schema()
    assert schema["$schema"] == "https://json-schema.org/draft/2020-12/schema"

    def check(node: Any) -> None:
        if isinstance(node, dict):
            assert node.get("type") != "null"
            for name, value in node.get("properties", {}).items():
                assert value.get("description"), name
        for item in node.values() if isinstance(node, dict) else node if isinstance(node, list) else ():
            check(item)

    check(schema)
    assert {"required": ["hold"]} in schema["$defs"]["VehicleSection"]["oneOf"]


def test_an_object_moves_at_its_speed_and_stays_at_the_end() -> None:
    (stick,) = parse_exercise(VALID).objects
    assert stick.position(0.0) == stick.position(2.0) == (-3.0, 9.0, 1.0)
    assert stick.position(4.0) == pytest.approx((-2.0, 9.0, 1.0))
    assert stick.position(14.0) == stick.position(1e6) == (3.0, 9.0, 1.0)
