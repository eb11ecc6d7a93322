"""`covey validate` and `covey schema`."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner

from covey.cli.schema import schema
from covey.cli.validate import validate

app = typer.Typer()
app.command()(validate)
app.command()(schema)


@pytest.fixture
def broken(tmp_path: Path, root: Path) -> Path:
    text = (root / "examples" / "thesis-5.1.yaml").read_text(encoding="utf-8")
    path = tmp_path / "broken.yaml"
    path.write_text(text.replace("spacing_m", "spacing").replace("y_m: -2", "y_m: -22"), encoding="utf-8")
    return path


def test_valid_mission_is_summed_up(root: Path) -> None:
    result = CliRunner().invoke(app, ["validate", str(root / "examples" / "plaza-mayor.yaml")])
    assert result.exit_code == 0
    for words in ("valid", "757", "cells of 4 m", "12,058", "1 hole", "optimal distance 12 m", "lat 40.4", "panaderia"):
        assert words in result.output


def test_each_mistake_has_a_line_of_its_own(broken: Path) -> None:
    result = CliRunner().invoke(app, ["validate", str(broken)])
    assert result.exit_code == 2
    first, second = result.output.splitlines()
    assert first.startswith(f"{broken}:7:")
    assert "did you mean 'spacing_m'?" in first
    assert "agents[0].pose" in second


def test_one_broken_file_among_several(broken: Path, root: Path) -> None:
    good = root / "examples" / "eight-agents.yaml"
    result = CliRunner().invoke(app, ["validate", "--json", str(good), str(broken), str(broken.parent)])
    assert result.exit_code == 2
    report = json.loads(result.output)
    assert report["valid"] is False
    assert [finding["valid"] for finding in report["files"]] == [True, False, False]
    mistake = report["files"][1]["mistakes"][0]
    assert (mistake["line"], mistake["key"]) == (7, "environment.landmarks.grid.spacing")
    assert set(mistake) == {"file", "line", "column", "key", "message", "hint"}
    assert "8 with a pose drawn from the seed" in report["files"][0]["summary"]["agents"]


def test_strip_that_no_cell_fits_into_is_told(tmp_path: Path, root: Path) -> None:
    text = (root / "examples" / "thesis-5.2.yaml").read_text(encoding="utf-8")
    (tmp_path / "m.yaml").write_text(text.replace("spacing_m: 0.2", "spacing_m: 0.3"), encoding="utf-8")
    result = CliRunner().invoke(app, ["validate", str(tmp_path / "m.yaml")])
    assert result.exit_code == 0
    assert "208, cells of 0.3 m" in result.output
    assert "0.2 m in x and 0.1 m in y left over" in result.output


def test_schema_is_json() -> None:
    result = CliRunner().invoke(app, ["schema"])
    assert result.exit_code == 0
    assert json.loads(result.output)["title"] == "covey mission"
