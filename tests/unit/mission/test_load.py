"""What comes out of a mission file that is right."""

from __future__ import annotations

import dataclasses
import json
import math
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from covey.errors import ArgumentError
from covey.mission import Assignment, Mission, OptimizerName, Trade, load_mission, mission_schema, parse_mission

DATA: dict[str, Any] = {
    "schema_version": 1,
    "name": "round trip",
    "seed": 3,
    "georeference": {"lon_deg": 18.07, "lat_deg": 59.35, "alt_m": 20.0},
    "environment": {
        "landmarks": {"points": [[0, 0], [1.5, 2e-3], [-3, 4]], "weights": [1, 0.5, 2], "normals_deg": [0, 90, -45]},
        "region": {"polygon": {"exterior": [[-5, -5], [5, -5], [5, 5], [-5, 5]], "holes": [[[1, 1], [2, 1], [2, 2]]]}},
    },
    "sensor": {"model": "oriented", "optimal_distance_m": 2.5},
    "agents": [
        {"name": "blå 1", "pose": {"x_m": 3.5, "y_m": -2, "yaw_deg": 450}},
        {"name": "red", "sensor": {"model": "isotropic"}, "region": {"box": {"x_m": [0, 1], "y_m": [0, 1]}}},
    ],
    "coverage": {"sigma": 0.5, "trade": "thesis", "optimizer": "exact", "assignment": {"red": [2, 0], "blå 1": [1]}},
}
TOML = """
schema_version = 1
name = "round trip"
seed = 3
georeference = {lon_deg = 18.07, lat_deg = 59.35, alt_m = 20.0}

[environment.landmarks]
points = [[0, 0], [1.5, 2e-3], [-3, 4]]
weights = [1, 0.5, 2]
normals_deg = [0, 90, -45]
[environment.region.polygon]
exterior = [[-5, -5], [5, -5], [5, 5], [-5, 5]]
holes = [[[1, 1], [2, 1], [2, 2]]]

[sensor]
model = "oriented"
optimal_distance_m = 2.5

[[agents]]
name = "blå 1"
pose = {x_m = 3.5, y_m = -2, yaw_deg = 450}
[[agents]]
name = "red"
sensor.model = "isotropic"
region.box = {x_m = [0, 1], y_m = [0, 1]}

[coverage]
sigma = 0.5
trade = "thesis"
optimizer = "exact"
assignment = {red = [2, 0], "blå 1" = [1]}
"""
YAML = """
schema_version: 1
name: round trip
seed: 0x3
georeference: {lon_deg: 18.07, lat_deg: 59.35, alt_m: 20.0}
environment:
  landmarks:
    points: [[0, 0], [1.5, 2e-3], [-3, 4]]
    weights: [1, 0.5, 2]
    normals_deg: [0, 90, -45]
  region:
    polygon:
      exterior: [[-5, -5], [5, -5], [5, 5], [-5, 5]]
      holes: [[[1, 1], [2, 1], [2, 2]]]
sensor: {model: oriented, optimal_distance_m: 2.5}
agents:
  - name: blå 1
    pose: {x_m: 3.5, y_m: -2, yaw_deg: 450}
  - name: red
    sensor: {model: isotropic}
    region:
      box: &square
        x_m: &side [0, 1]
        y_m: *side
coverage:
  sigma: .5
  trade: thesis
  optimizer: "exact"
  assignment: {red: [2, 0], blå 1: [1]}
"""


def _facts(mission: Mission) -> tuple[object, ...]:
    normals = mission.landmarks.normals_W
    return (
        mission.source,
        mission.name,
        mission.seed,
        mission.landmarks.positions_W.tolist(),
        mission.landmarks.weights.tolist(),
        None if normals is None else normals.tolist(),
        mission.region.exterior.tolist(),
        [hole.tolist() for hole in mission.region.holes],
        [(agent.name, agent.pose, agent.sensor, agent.region.exterior.tolist()) for agent in mission.agents],
        mission.coverage,
        mission.georeference,
    )


def test_yaml_toml_and_json_say_the_same() -> None:
    missions = [
        parse_mission(YAML),
        parse_mission(TOML, format="toml"),
        parse_mission(json.dumps(DATA), format="json"),
        parse_mission(json.dumps(DATA, indent=2, ensure_ascii=False)),  # JSON is YAML
    ]
    assert missions[0].source == DATA
    for mission in missions[1:]:
        assert _facts(mission) == _facts(missions[0])


def test_the_source_builds_the_same_mission_again() -> None:
    mission = parse_mission(YAML)
    assert _facts(parse_mission(json.dumps(mission.source), format="json")) == _facts(mission)


def test_every_value_arrives() -> None:
    mission = parse_mission(TOML, format="toml")
    blue, red = mission.agents
    assert (blue.pose.x, blue.pose.y, blue.drawn) == (3.5, -2.0, False)
    assert blue.pose.yaw == pytest.approx(math.pi / 2)
    assert blue.sensor == mission.sensor
    assert blue.region is mission.region
    assert (blue.sensor.model, blue.sensor.options) == ("oriented", {"optimal_distance": 2.5})
    assert (red.sensor.model, red.sensor.options) == ("isotropic", {"optimal_distance": 1.0})
    assert red.drawn
    assert red.region.contains(red.pose.x, red.pose.y)
    assert mission.coverage.sigma == 0.5
    assert mission.coverage.trade is Trade.THESIS
    assert mission.coverage.optimizer is OptimizerName.EXACT
    assert mission.coverage.assignment == {"red": (2, 0), "blå 1": (1,)}
    assert mission.landmarks.normals_W is not None
    np.testing.assert_allclose(mission.landmarks.normals_W[1:], [[0, 1], [0.5**0.5, -(0.5**0.5)]], atol=1e-12)


MINIMAL = """
schema_version: 1
name: minimal
environment:
  landmarks: LANDMARKS
  region: {box: {x_m: [-5, 5], y_m: [-5, 5]}}
agents: {count: 3}
"""


def _minimal(landmarks: str, folder: Path | str = ".", seed: int | None = None) -> Mission:
    return parse_mission(MINIMAL.replace("LANDMARKS", landmarks), folder=folder, seed=seed)


def test_defaults() -> None:
    mission = _minimal("{points: [[1, 2]]}")
    assert mission.seed == 0
    assert (mission.sensor.model, mission.sensor.options) == ("anisotropic", {"optimal_distance": 1.0})
    assert mission.coverage.trade is Trade.PAIRWISE
    assert mission.coverage.optimizer is OptimizerName.SEARCH
    assert mission.coverage.assignment is Assignment.RANDOM
    assert mission.coverage.sigma == 0.01
    assert mission.georeference is None
    assert mission.path is None


def test_thesis_grid_is_400_cell_centres(root: Path) -> None:
    """Deviation V5: cell centres, ±4.75 m in steps of 0.5 m."""
    mission = load_mission(root / "examples" / "thesis-5.1.yaml")
    x, y = mission.landmarks.positions_W.T
    line = np.arange(-4.75, 4.76, 0.5)
    assert len(mission.landmarks) == 400
    np.testing.assert_allclose(np.unique(x), line, atol=1e-12)
    np.testing.assert_allclose(np.unique(y), line, atol=1e-12)
    assert mission.landmarks.cell_size == 0.5
    assert [(agent.name, agent.pose.x, agent.pose.y, agent.pose.yaw) for agent in mission.agents] == [
        ("blue", 3.5, -2.0, 0.0),
        ("red", 3.5, 4.5, 0.0),
        ("green", 3.5, -4.0, 0.0),
        ("yellow", -5.0, 4.0, 0.0),
    ]


@pytest.mark.parametrize(
    ("name", "landmarks", "area", "agents"),
    [
        ("thesis-5.1", 400, 100.0, 4),
        ("thesis-5.2", 500, 20.0, 4),
        ("eight-agents", 400, 100.0, 8),
        ("sixteen-agents", 400, 100.0, 16),
        ("inspection", 68, 81.26, 4),
        # Published: 129 m by 94 m, less the statue; 700 m above the ellipsoid everything is 0.02 % larger.
        ("plaza-mayor", 757, 129 * 94 - 70, 6),
    ],
)
def test_examples(name: str, landmarks: int, area: float, agents: int, root: Path) -> None:
    mission = load_mission(root / "examples" / f"{name}.yaml")
    assert mission.name == name
    assert len(mission.landmarks) == landmarks
    assert mission.region.shape.area == pytest.approx(area, rel=1e-3)
    assert len(mission.agents) == agents
    for agent in mission.agents:
        assert agent.region.contains(agent.pose.x, agent.pose.y)


def test_every_mission_among_the_examples_loads(root: Path) -> None:
    for path in sorted((root / "examples").glob("*.yaml")):
        assert len(load_mission(path).agents) >= 1, path.name


def test_statue_of_the_real_site_is_no_landmark(root: Path) -> None:
    mission = load_mission(root / "examples" / "plaza-mayor.yaml")
    (statue,) = mission.region.holes
    middle = statue.mean(axis=0)
    assert np.abs(middle).max() < 0.1  # the statue is the origin
    assert np.hypot(*(mission.landmarks.positions_W - middle).T).min() > 3.0
    assert not mission.region.contains(0.0, 0.0)


def test_drawn_poses_follow_the_seed() -> None:
    first = _minimal("{points: [[1, 2]]}", seed=1)
    again = _minimal("{points: [[1, 2]]}", seed=1)
    other = _minimal("{points: [[1, 2]]}", seed=2)
    assert first.seed == 1
    assert [agent.pose for agent in first.agents] == [agent.pose for agent in again.agents]
    assert first.agents[0].pose != other.agents[0].pose
    assert len({agent.pose for agent in first.agents}) == 3
    assert [agent.pose for agent in first.with_seed(2).agents] == [agent.pose for agent in other.agents]
    assert first.with_seed(2).seed == 2


def test_replacing_the_seed_keeps_the_poses() -> None:
    mission = _minimal("{points: [[1, 2]]}")
    assert dataclasses.replace(mission, seed=5).agents == mission.agents


def test_given_poses_survive_another_seed() -> None:
    mission = parse_mission(YAML)
    assert mission.with_seed(9).agents[0] == mission.agents[0]
    assert mission.with_seed(9).agents[1].pose != mission.agents[1].pose


def test_an_agent_more_moves_no_one_else() -> None:
    three = _minimal("{points: [[1, 2]]}")
    four = parse_mission(MINIMAL.replace("LANDMARKS", "{points: [[1, 2]]}").replace("count: 3", "count: 4"))
    assert [agent.pose for agent in four.agents[:3]] == [agent.pose for agent in three.agents]


def test_csv(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("x_m, y_m, weight, normal_deg\n1, 2, 3, 90\n\n4,5,6,180\n")
    (tmp_path / "b.csv").write_text("\ufeffnormal_x,normal_y,y_m,x_m\r\n0,2,2,1\r\n", encoding="utf-8")
    one = _minimal("{csv: a.csv}", tmp_path).landmarks
    assert one.positions_W.tolist() == [[1, 2], [4, 5]]
    assert one.weights.tolist() == [3, 6]
    assert one.normals_W is not None
    np.testing.assert_allclose(one.normals_W, [[0, 1], [-1, 0]], atol=1e-12)
    two = _minimal("{csv: b.csv, weights: 4}", tmp_path).landmarks
    assert two.positions_W.tolist() == [[1, 2]]
    assert two.weights.tolist() == [4]
    assert two.normals_W is not None
    assert two.normals_W.tolist() == [[0, 1]]


def test_one_normal_for_all() -> None:
    normals = _minimal("{grid: {x_m: [0, 1], y_m: [0, 1], spacing_m: 0.5}, normals_deg: 180}").landmarks.normals_W
    assert normals is not None
    np.testing.assert_allclose(normals, [[-1, 0]] * 4, atol=1e-12)


def test_curve_in_a_mission() -> None:
    landmarks = _minimal("{curve: [[0, 0], [2, 0], [2, 2], [0, 2]], closed: true, spacing_m: 2}").landmarks
    assert landmarks.positions_W.tolist() == [[1, 0], [2, 1], [1, 2], [0, 1]]
    assert landmarks.normals_W is not None
    assert landmarks.normals_W.tolist() == [[0, -1], [1, 0], [0, 1], [-1, 0]]


def test_own_model_is_found_beside_the_mission(tmp_path: Path) -> None:
    (tmp_path / "camera.py").write_text("class Camera: ...\n")
    text = MINIMAL.replace("LANDMARKS", "{points: [[0, 0]]}")
    sensor = "\nsensor: {model: 'camera.py:Camera', optimal_distance_m: 2, options: {range: 3}}\n"
    spec = parse_mission(text + sensor, folder=tmp_path).sensor
    assert spec.model == f"{(tmp_path / 'camera.py').resolve()}:Camera"
    assert spec.options == {"range": 3.0, "optimal_distance": 2.0}
    assert parse_mission(text + "\nsensor: {model: 'my.models:Camera'}\n").sensor.options == {}


def test_origin_is_the_first_geojson_polygon_unless_stated(tmp_path: Path) -> None:
    square = '{"type": "Polygon", "coordinates": [[[LON, 43], [LON.001, 43], [LON.001, 43.001], [LON, 43.001]]]}'
    (tmp_path / "marks.geojson").write_text(square.replace("LON", "11"))
    (tmp_path / "area.geojson").write_text(square.replace("LON", "12"))
    region = "region: {box: {x_m: [-5, 5], y_m: [-5, 5]}}"
    marks = "{geojson: marks.geojson, spacing_m: 5}"
    origin = _minimal(marks, tmp_path).georeference
    assert origin is not None
    assert origin.lon_deg == pytest.approx(11.0005)
    assert origin.lat_deg == pytest.approx(43.0005)
    assert origin.alt_m == 0.0
    text = MINIMAL.replace(region, "region: {geojson: area.geojson}")
    mission = parse_mission(text.replace("LANDMARKS", marks), folder=tmp_path)
    assert mission.georeference == origin
    assert mission.region.bounds[0] == pytest.approx(81_470, rel=1e-3)  # one degree of longitude at 43° north
    points = parse_mission(text.replace("LANDMARKS", "{points: [[0, 0]]}"), folder=tmp_path)
    assert points.georeference is not None
    assert points.georeference.lon_deg == pytest.approx(12.0005)
    stated = parse_mission(
        MINIMAL.replace("LANDMARKS", marks) + "\ngeoreference: {lon_deg: 11, lat_deg: 43}\n", folder=tmp_path
    )
    assert stated.georeference is not None
    assert (stated.georeference.lon_deg, stated.georeference.lat_deg) == (11.0, 43.0)
    assert stated.landmarks.positions_W.min() > 0.0


def test_wrong_arguments() -> None:
    with pytest.raises(ArgumentError, match="format: expected 'yaml', 'toml' or 'json', got 'xml'"):
        parse_mission("", format="xml")
    with pytest.raises(ArgumentError, match="seed: expected"):
        parse_mission(YAML, seed=-1)


def test_schema_describes_every_key() -> None:
    schema = mission_schema()
    assert schema["$schema"] == "https://json-schema.org/draft/2020-12/schema"
    objects = [schema, *schema["$defs"].values()]
    for part in objects:
        assert part["additionalProperties"] is False
        for key, value in part["properties"].items():
            assert value.get("description"), (part["title"], key)
    assert '"null"' not in json.dumps(schema)


def test_schema_and_documented_keys_agree_with_the_examples(root: Path) -> None:
    known = set(re.findall(r'"(\w+)": \{', json.dumps(mission_schema())))
    for path in (root / "examples").glob("*.yaml"):
        text = re.sub(r"#.*", "", path.read_text(encoding="utf-8"))
        text = re.sub(r"options: \{.*?\}", "", text)  # the keys in there are a user's own
        used = set(re.findall(r"[\s{](\w+):", text))
        assert used <= known | {"schema_version"}, path.name


def test_reading_a_mission_needs_no_compiler_or_figures(root: Path) -> None:
    import subprocess

    code = (
        "import sys; import covey.mission; assert not {'pydantic', 'shapely', 'pyproj'} & set(sys.modules);"
        f"covey.mission.load_mission({str(root / 'examples' / 'thesis-5.1.yaml')!r});"
        "print(sorted({'numba', 'scipy', 'matplotlib', 'pyproj'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout.strip()) == (0, "[]"), done.stderr
