"""Mistakes in JSON, TOML, GeoJSON and CSV, and files that hold no mission at all."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from covey.errors import MissionError
from covey.mission import load_mission, parse_mission

SITE = """\
{"type": "Polygon",
 "coordinates": [
  [[11.330, 43.318],
   [11.332, 43.318],
   [11.331, 43.319],
   [11.330, 43.318]]
 ]}
"""
MISSION = """\
schema_version: 1
name: base
environment:
  landmarks: {LANDMARKS}
  region: {REGION}
agents: {count: 2}
"""
POINTS = "points: [[0, 0]]"
BOX = "box: {x_m: [-5, 5], y_m: [-5, 5]}"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "site.geojson").write_text(SITE)
    return tmp_path


def _mission(landmarks: str, region: str) -> str:
    return MISSION.replace("LANDMARKS", landmarks).replace("REGION", region)


@pytest.mark.parametrize(
    ("format", "text", "line", "words"),
    [
        ("json", '{"name": "a",\n "name": "b"}', 2, "'name' is here again"),
        ("json", '{"name": "a",\n "seed": }', 2, "not valid JSON: Expecting value"),
        ("json", '{"name": "a",\n "seed": NaN}', 2, "expected a whole number, got nan"),
        ("json", '{"coverage":\n {"sigma": NaN}}', 2, "expected a finite number, got nan"),
        ("json", '{"name": "a",\n "sed": 1}', 2, "did you mean 'seed'"),
        ("json", "[" * 100_000, None, "nested too deeply"),
        ("json", '{"seed": 1' + "0" * 5000 + "}", None, "not valid JSON"),
        ("json", "null", None, "got nothing"),
        ("toml", 'name = "a"\nname = "b"', 2, "not valid TOML"),
        ("toml", 'name = "a"\nseed = ', 2, "not valid TOML"),
        ("toml", 'name = "a"\nsed = 1', 2, "did you mean 'seed'"),
        ("toml", 'name = "a"\nseed = nan', 2, "expected a whole number, got nan"),
        ("toml", 'name = "a"\nseed = 1979-05-27', 2, "expected a whole number, got a date"),
        ("toml", "a = " + "[" * 20_000, None, "nested too deeply"),
        ("toml", "seed = 0x" + "f" * 9000, 1, "beyond 64 bits"),
        ("toml", "seed = 1" + "0" * 5000, None, "not valid TOML"),
    ],
)
def test_json_and_toml(format: str, text: str, line: int | None, words: str) -> None:
    with pytest.raises(MissionError) as caught:
        parse_mission(text, format=format)
    told = [str(mistake) for mistake in caught.value.mistakes if line is None or mistake.line == line]
    assert any(words in mistake for mistake in told), caught.value


def test_lines_in_nested_toml() -> None:
    text = """\
schema_version = 1
name = "base"
[environment.landmarks.grid]
x_m = [-5, 5]
y_m = [-5,
  "5"]  # a comment
spacing_m = 0.5
[environment.region]
box.x_m = [-5, 5]
box . "y_m" = [5, -5]
[[agents]]
name = "blue"
pose = {x_m = 0, y_m = 0, yaw = 0}
[[agents]]
name = '''red'''
[agents.pose]
x_m = "a"
y_m = 0.25
"""
    with pytest.raises(MissionError) as caught:
        parse_mission(text, format="toml")
    assert [(mistake.key, mistake.line) for mistake in caught.value.mistakes] == [
        ("environment.landmarks.grid.y_m[1]", 6),
        ("environment.region.box", 9),
        ("agents[0].pose.yaw", 13),
        ("agents[1].pose.x_m", 17),
    ]


def _write(name: str, content: bytes) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        (folder / name).write_bytes(content)
        return folder / name

    return make


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda folder: folder / "none.yaml", "expected a file, found nothing"),
        (lambda folder: folder / "sit.geojson", "did you mean 'site.geojson'"),
        (lambda folder: folder, "is a directory"),
        (lambda folder: folder / "site.geojson" / "m.yaml", "leads through something that is no directory"),
        (lambda folder: folder / ("x" * 5000), "cannot read"),
        (lambda folder: folder / "a\0b", "cannot read"),
        (_write("empty.yaml", b""), "is empty"),
        (_write("blank.yaml", b" \n\n"), "is empty"),
        (_write("latin.yaml", "name: café".encode("latin-1")), "expected UTF-8 text, got byte 0xe9 at offset 9"),
        (_write("utf16.yaml", "name: cafe".encode("utf-16")), "expected UTF-8 text"),
        (_write("control.yaml", b"name: \x00"), "not valid YAML"),
        (_write("huge.yaml", b"#" * 10_000_001), "expected at most 10,000,000 bytes"),
        (_write("long.yaml", b"#" * 1_000_001), "expected at most 1,000,000 characters of YAML"),
        (_write("mission.xml", b"<a/>"), "ending in .yaml, .yml, .json or .toml, got '.xml'"),
    ],
)
def test_files_that_are_no_mission(make: Callable[[Path], Path], words: str, folder: Path) -> None:
    path = make(folder)
    with pytest.raises(MissionError) as caught:
        load_mission(path)
    (mistake,) = caught.value.mistakes
    assert mistake.file == str(path)
    assert words in str(mistake)


GEOJSON_CASES: dict[str, tuple[str, str, int | None, str]] = {
    "not json": (SITE.replace("]]", "]"), "", 7, "not valid JSON"),
    "no mapping": ("[1]", "", 1, "a mapping with a type"),
    "no type": ("{}", "", 1, "expected a geometry such as Polygon, got nothing"),
    "a point": ('{"type": "Point", "coordinates": [11, 43]}', "", 1, "expected one polygon, got none"),
    "swapped": (SITE.replace("[11.330, 43.318]", "[43.318, 111.330]"), "coordinates[0][0]", 3, "longitude first"),
    "metres": (SITE.replace("11.332, 43.318", "500000, 4800000"), "coordinates[0][1]", 4, "degrees, not metres"),
    "text": (SITE.replace("[11.332, 43.318]", '"x"'), "coordinates[0][1]", 4, "expected a position"),
    "true": (SITE.replace("11.332, 43.318", "true, 3"), "coordinates[0][1]", 4, "expected a position"),
    "NaN": (SITE.replace("11.332", "NaN"), "coordinates[0][1]", 4, "longitude ±180"),
    "huge": (SITE.replace("11.332", "1" + "0" * 400), "coordinates[0][1]", 4, "longitude ±180"),
    "two corners": (
        '{"type": "Polygon", "coordinates": [[[1, 2], [3, 4], [1, 2]]]}',
        "coordinates[0]",
        1,
        "at least 3",
    ),
    "no rings": ('{"type": "Polygon", "coordinates": []}', "coordinates", 1, "expected a list of rings"),
    "crossing itself": (
        '{"type": "Polygon", "coordinates": [[[11, 43], [11.001, 43.001], [11.001, 43], [11, 43.001], [11, 43]]]}',
        "",
        None,
        "Self-intersection",
    ),
    "whole country": (SITE.replace("11.332, 43.318", "14.332, 43.318"), "", None, "within 100 km of the origin"),
    "antimeridian": (SITE.replace("11.332", "-179.0"), "coordinates[0]", 3, "antimeridian"),
    "two parts": (
        '{"type": "MultiPolygon",\n "coordinates": [[[[1, 2], [3, 2], [3, 4]]], [[[5, 2], [6, 2], [6, 4]]]]}',
        "coordinates",
        2,
        "got 2 parts",
    ),
    "two features": (
        """{"type": "FeatureCollection", "features": [
            {"type": "Feature", "geometry": {"type": "Polygon", "coordinates": []}},
            {"type": "Feature", "geometry": {"type": "Polygon", "coordinates": []}}]}""",
        "features[1].geometry",
        3,
        "expected one polygon, got 2",
    ),
    "features missing": ('{"type": "FeatureCollection"}', "features", 1, "expected a list of features"),
    "other CRS": (
        '{"type": "Polygon",\n "crs": {"type": "name", "properties": {"name": "EPSG:3857"}}, "coordinates": []}',
        "crs",
        2,
        "expected WGS84 longitude and latitude, got the text 'EPSG:3857'",
    ),
}


@pytest.mark.parametrize("case", GEOJSON_CASES)
def test_mistakes_in_a_geojson_file(case: str, folder: Path) -> None:
    content, key, line, words = GEOJSON_CASES[case]
    (folder / "site.geojson").write_text(content)
    with pytest.raises(MissionError) as caught:
        parse_mission(_mission(POINTS, "geojson: site.geojson"), folder=folder)
    (mistake,) = caught.value.mistakes
    assert mistake.file.endswith("site.geojson")
    assert (mistake.key, mistake.line) == (key, line)
    assert words in str(mistake)


@pytest.mark.parametrize(
    ("content", "line", "words"),
    [
        ("x_m,y_m\n1,2\n1,a\n", 3, "expected a finite number, got 'a'"),
        ("x_m,y_m\n1,nan\n", 2, "expected a finite number, got 'nan'"),
        ("x_m,y_m\n1\n", 2, "expected 2 columns, got 1"),
        ("x_m,y_m\n1e9,2\n", 2, "at most 10,000,000"),
        ("x_m,y\n1,2\n", 1, "unknown column 'y'"),
        ("x_m;y_m\n1;2\n", 1, "separate columns with commas"),
        ("x_m,y_m,y_m\n1,2,2\n", 1, "got it again"),
        ("x_m,y_m,weight\n1,2,-1\n", 2, "a weight from 0"),
        ("x_m,y_m,normal_x\n1,2,1\n", 1, "normal_x and normal_y together"),
        ("x_m,y_m,normal_x,normal_y\n1,2,0,0\n", 2, "a normal of some length"),
        ("x_m,y_m,normal_x,normal_y,normal_deg\n1,2,0,1,3\n", 1, "got both"),
        ('x_m,y_m\n1,"2\n', 2, "not valid CSV"),
        ("x_m,y_m\n\n", 1, "at least one landmark"),
    ],
)
def test_mistakes_in_a_csv_file(content: str, line: int, words: str, folder: Path) -> None:
    (folder / "marks.csv").write_text(content)
    with pytest.raises(MissionError) as caught:
        parse_mission(_mission("csv: marks.csv", BOX), folder=folder)
    told = [str(mistake) for mistake in caught.value.mistakes if mistake.line == line]
    assert any(words in mistake and "marks.csv" in mistake for mistake in told), caught.value
