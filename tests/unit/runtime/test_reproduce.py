from __future__ import annotations

import csv
import re
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from covey.errors import InputError, OutputError
from covey.mission import SensorSpec, Trade
from covey.runtime.reproduce.mission import NAMES, draw_heatmap, reproduce_thesis, table_text, thesis_mission
from covey.runtime.result import Deployment, Progress

MakeDeployment = Callable[..., Deployment]


@pytest.fixture
def planned(make_deployment: MakeDeployment, monkeypatch: pytest.MonkeyPatch) -> list[dict[str, Any]]:
    """Stand in for planning; returns what it was asked for."""
    asked: list[dict[str, Any]] = []

    def plan(mission: object, **options: Any) -> Deployment:
        asked.append(options)
        made = make_deployment(seed=options["seed"], names=("blue", "red", "green", "yellow"))
        return replace(made, mission=replace(made.mission, agents=made.mission.agents))

    monkeypatch.setitem(sys.modules, "covey.runtime.plan", SimpleNamespace(plan=plan))
    return asked


def test_scene_is_the_thesiss() -> None:
    mission = thesis_mission()
    assert len(mission.landmarks) == 400
    assert mission.landmarks.positions_W.min() == -4.75
    assert mission.region.bounds == (-5.0, 5.0, -5.0, 5.0)
    assert [(agent.pose.x, agent.pose.y, agent.pose.yaw) for agent in mission.agents] == [
        (3.5, -2.0, 0.0),
        (3.5, 4.5, 0.0),
        (3.5, -4.0, 0.0),
        (-5.0, 4.0, 0.0),
    ]
    assert mission.coverage.trade is Trade.THESIS


def test_page_figures_and_table(planned: list[dict[str, Any]], tmp_path: Path) -> None:
    told: list[object] = []
    deployments = reproduce_thesis(tmp_path / "r", seeds=3, on_progress=told.append)
    assert [options["seed"] for options in planned] == [0, 1, 2]
    assert {options["trade"] for options in planned} == {Trade.THESIS}
    assert len(told) == 3
    assert sorted(path.name for path in (tmp_path / "r").iterdir()) == sorted(NAMES)
    page = (tmp_path / "r" / "index.html").read_text(encoding="utf-8")
    for link in re.findall(r'href="([^"]+)"', page):
        assert (tmp_path / "r" / link).stat().st_size > 100
    sources = re.findall(r'src="([^"]+)"', page)
    assert len(sources) == 5
    assert all(source.startswith("data:image/png;base64,") for source in sources)
    for score in ("21.39", "72.55", "79.89", "118.99"):
        assert score in page
        assert score in table_text(deployments)
    with (tmp_path / "r" / "scores.csv").open(encoding="utf-8", newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [row["seed"] for row in rows] == ["thesis", "0", "1", "2"]
    assert float(rows[1]["final"]) == deployments[0].score.final


@pytest.mark.usefixtures("planned")
def test_ctrl_c_keeps_the_seeds_that_are_done(tmp_path: Path) -> None:
    def stop(news: Progress) -> None:
        if news.stage == "seed 1":
            raise KeyboardInterrupt

    deployments = reproduce_thesis(tmp_path / "r", seeds=5, on_progress=stop)
    assert [deployment.seed for deployment in deployments] == [0, 1]
    page = (tmp_path / "r" / "index.html").read_text(encoding="utf-8")
    assert "of 2 seeds" in page
    assert "The run was interrupted; 5 were asked for." in page
    assert sorted(path.name for path in (tmp_path / "r").iterdir()) == sorted(NAMES)


@pytest.mark.usefixtures("planned")
def test_an_earlier_reproduction_is_replaced_only_when_asked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def draw_nothing(deployment: Deployment, staging: Path) -> None:
        for name in NAMES:
            if name.endswith(".png"):
                (staging / name).touch()

    monkeypatch.setattr("covey.runtime.reproduce.mission._write_figures", draw_nothing)
    reproduce_thesis(tmp_path, seeds=1)
    with pytest.raises(OutputError, match="not empty"):
        reproduce_thesis(tmp_path, seeds=1)
    reproduce_thesis(tmp_path, seeds=1, overwrite=True)
    (tmp_path / "index.html").write_text("mine")
    with pytest.raises(OutputError, match="not written by covey"):
        reproduce_thesis(tmp_path, seeds=1, overwrite=True)


@pytest.mark.parametrize("suffix", [".png", ".pdf", ".svg"])
def test_heat_map_files(suffix: str, tmp_path: Path) -> None:
    file = tmp_path / f"map{suffix}"
    sensor = SensorSpec("oriented", {"optimal_distance": 2.0})
    draw_heatmap(sensor, file)
    assert file.stat().st_size > 1000
    with pytest.raises(OutputError, match="already"):
        draw_heatmap(sensor, file)
    draw_heatmap(sensor, file, overwrite=True)
    assert [path.name for path in tmp_path.iterdir()] == [file.name]


def test_heat_map_errors(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match=r"\.png, \.pdf or \.svg"):
        draw_heatmap(SensorSpec(), tmp_path / "map.txt")
    with pytest.raises(OutputError, match="cannot be written"):
        draw_heatmap(SensorSpec(), tmp_path / "no" / "map.png")
    with pytest.raises(InputError, match="lidar"):
        draw_heatmap(SensorSpec("lidar", {}), tmp_path / "map.png")
