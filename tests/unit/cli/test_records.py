"""Records as a user meets them: every run leaves one, `covey info` and `covey figures` read it."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

MISSION = """
schema_version: 1
name: small
seed: 3
environment:
  landmarks: {grid: {x_m: [-2, 2], y_m: [-2, 2], spacing_m: 1}}
  region: {box: {x_m: [-2, 2], y_m: [-2, 2]}}
agents:
  - {name: a, pose: {x_m: -1, y_m: 0}}
  - {name: b, pose: {x_m: 1, y_m: 0}}
"""


def covey(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run the command in a folder."""
    command = [sys.executable, "-W", "error", "-m", "covey", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=folder)
    assert "Traceback" not in done.stderr, done.stderr
    return done


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "mission.yaml").write_text(MISSION)
    return tmp_path


def test_a_plan_leaves_a_record_that_info_and_figures_read(folder: Path) -> None:
    planned = covey(folder, "plan", "mission.yaml", "--out", "p")
    assert planned.returncode == 0
    assert "covey: recording to p.partial.mcap" in planned.stderr
    assert sorted(path.name for path in folder.iterdir()) == ["mission.yaml", "p"]
    told = covey(folder, "info", "p")
    assert (told.returncode, told.stderr) == (0, "")
    assert "complete" in told.stdout
    assert "the certificate holds" in told.stdout
    found: dict[str, Any] = json.loads(covey(folder, "info", "p/record.mcap", "--json").stdout)
    result: dict[str, Any] = json.loads((folder / "p" / "result.json").read_text())
    assert found["score"]["end"] == result["score"]["final"]
    assert found["trades"] == result["trades"]
    assert (found["mission"], found["seed"], found["run"], found["status"]) == ("small", 3, "plan", "settled")
    assert [agent["name"] for agent in found["agents"]] == ["a", "b"]
    assert found["topics"]["/covey/scene"]["messages"] == 1
    drawn = covey(folder, "figures", "p", "--out", "f", "--kind", "deployment,score", "--format", "pdf,png")
    assert (drawn.returncode, drawn.stderr) == (0, "")
    assert sorted(path.name for path in (folder / "f").iterdir()) == [
        "deployment.pdf",
        "deployment.png",
        "score.pdf",
        "score.png",
    ]
    again = covey(folder, "figures", "p", "--out", "f")
    assert again.returncode == 2
    assert "is not empty" in again.stderr
    assert covey(folder, "figures", "p", "--out", "f", "--kind", "score", "--force").returncode == 0
    assert (folder / "f" / "deployment.png").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["info", "nothing"], "nothing: no record here"),
        (["info", "mission.yaml"], "mission.yaml: expected an MCAP file, got something else"),
        (["figures", "mission.yaml", "--out", "f"], "expected an MCAP file"),
        (["figures", "mission.yaml", "--out", "f", "--kind", "scores"], "expected some of deployment, score"),
        (["figures", "mission.yaml", "--out", "f", "--format", "jpg"], "expected some of pdf, png, svg, got 'jpg'"),
        (["figures", "mission.yaml", "--out", "f", "--width-mm", "1"], "50"),
    ],
)
def test_mistakes_are_told_in_a_line(folder: Path, arguments: list[str], message: str) -> None:
    done = covey(folder, *arguments)
    assert done.returncode == 2
    assert message in " ".join(done.stderr.replace("│", " ").split())
    assert not (folder / "f").exists()


def test_a_figure_that_the_record_cannot_give_is_told(folder: Path) -> None:
    covey(folder, "plan", "mission.yaml", "--out", "p", "--quiet")
    done = covey(folder, "figures", "p", "--out", "f", "--kind", "separation")
    assert done.returncode == 2
    assert "got separation" in done.stderr
    assert not (folder / "f").exists()


def test_bad_input_leaves_no_record(folder: Path) -> None:
    (folder / "mission.yaml").write_text(MISSION + "sensor: {model: 'no_such_module:Model'}\n")
    assert covey(folder, "plan", "mission.yaml").returncode == 2
    assert [path.name for path in folder.iterdir()] == ["mission.yaml"]


def test_a_flight_that_is_killed_leaves_its_record_where_it_said(folder: Path) -> None:
    command = [
        sys.executable,
        "-m",
        "covey",
        "fly",
        "mission.yaml",
        "--realtime",
        "--vehicles",
        "kinematic",
        "--out",
        "r",
    ]
    partial = folder / "r.partial.mcap"
    with subprocess.Popen(command, cwd=folder, stderr=subprocess.PIPE, text=True) as process:
        deadline = time.monotonic() + 120.0
        while time.monotonic() < deadline and process.poll() is None:
            if partial.exists() and covey(folder, "info", partial.name).returncode == 0:
                break
            time.sleep(0.2)
        process.send_signal(signal.SIGKILL)
        _, said = process.communicate()
    assert "covey: recording to r.partial.mcap" in said
    assert not (folder / "r").exists()
    found = json.loads(covey(folder, "info", partial.name, "--json").stdout)
    assert not found["complete"]
    assert "without its index" in found["problems"][0]
    assert found["run"] == "flight"
    before = partial.read_bytes()
    assert covey(folder, "plan", "mission.yaml", "--out", "r", "--quiet").returncode == 0
    assert partial.read_bytes() == before  # the next run is recorded elsewhere
