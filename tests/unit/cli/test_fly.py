"""``covey fly`` as a user meets it."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
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
EXERCISE = """
schema_version: 1
name: hop
exercise:
  duration_s: 12
  vehicles:
    - {name: a, start: {x_m: 0, y_m: 0, z_m: 0}, goal: {x_m: 1, y_m: 0, z_m: 1}}
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
    (tmp_path / "hop.yaml").write_text(EXERCISE)
    return tmp_path


def test_a_mission_is_flown_certified_and_not_overwritten(folder: Path) -> None:
    flown = covey(folder, "fly", "mission.yaml", "--vehicles", "reference", "--out", "r", "--json", "--quiet")
    assert (flown.returncode, flown.stderr) == (0, "")
    result: dict[str, Any] = json.loads(flown.stdout)
    assert result["flight"]["simulator"] == "reference"
    assert result["flight"]["collisions"] == 0
    planned = json.loads(covey(folder, "plan", "mission.yaml", "--out", "p", "--json", "--quiet").stdout)
    assert planned["score"] == result["score"]
    assert planned["flight"] is None
    assert covey(folder, "certify", "r").returncode == 0
    again = covey(folder, "fly", "mission.yaml", "--vehicles", "reference", "--out", "r")
    assert again.returncode == 2
    assert "is not empty" in again.stderr
    names = {path.name for path in (folder / "r").iterdir()}
    assert names == {
        "agents.csv",
        "deployment.pdf",
        "deployment.png",
        "flight.npz",
        "flight.pdf",
        "flight.png",
        "record.mcap",
        "result.json",
    }


def test_a_flight_is_told_in_words(folder: Path) -> None:
    flown = covey(folder, "fly", "mission.yaml", "--vehicles", "kinematic", "--seed", "4")
    assert flown.returncode == 0
    assert "s in kinematic with iris" in flown.stdout
    assert "0 collisions" in flown.stdout
    assert "covey-out/small-flown-4" in flown.stdout


def test_an_exercise_is_flown(folder: Path) -> None:
    flown = covey(folder, "fly", "hop.yaml", "--vehicles", "reference", "--out", "r")
    assert flown.returncode == 0
    assert "1 reached, 0 missed" in flown.stdout
    result = json.loads((folder / "r" / "result.json").read_text())
    assert (result["exercise"], result["status"]) == ("hop", "flown")
    assert [(event["event"], event["agents"]) for event in result["flight"]["events"]] == [("reached", ["a"])]
    checked = covey(folder, "certify", "r")
    assert checked.returncode == 2
    assert "got that of an exercise" in checked.stderr
    assert covey(folder, "fly", "hop.yaml", "--vehicles", "reference", "--out", "r").returncode == 2
    assert covey(folder, "fly", "hop.yaml", "--vehicles", "kinematic", "--out", "r", "--force").returncode == 0


def test_an_exercise_that_misses_its_goal_says_so(folder: Path) -> None:
    (folder / "short.yaml").write_text(EXERCISE.replace("12", "1"))
    flown = covey(folder, "fly", "short.yaml", "--vehicles", "reference", "--out", "r")
    assert flown.returncode == 1
    assert "0 reached, 1 missed" in flown.stdout


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("x_m: 1,", "x_m: -0.5,", "a and b start 0.50 m apart, expected at least 0.96 m"),
        ("seed: 3", "flight: {vehicle: iriss}", "mission.yaml:4:10: flight.vehicle: expected 'crazyflie' or 'iris'"),
        ("seed: 3", "flight: {ceiling_m: 1}", "flight.ceiling_m: expected at least altitude_m, 1.5 m, got 1"),
        ("seed: 3", "flight: {ceiling_m: 2, layers: 2}", "flight.ceiling_m: expected room for 2 layers up to 3.9 m"),
        ("seed: 3", "flight: {layers: 0}", "flight.layers: expected"),
    ],
)
def test_a_mission_that_cannot_be_flown(old: str, new: str, says: str, folder: Path) -> None:
    (folder / "mission.yaml").write_text(MISSION.replace(old, new))
    flown = covey(folder, "fly", "mission.yaml", "--out", "r")
    assert flown.returncode == 2
    assert says in flown.stderr
    assert not (folder / "r").exists()


def test_there_must_be_a_file(folder: Path) -> None:
    flown = covey(folder, "fly", "nowhere.yaml")
    assert flown.returncode == 2
    assert "nowhere.yaml" in flown.stderr


def test_a_flight_that_loses_a_vehicle_has_a_code_of_its_own(folder: Path) -> None:
    fault = "flight: {faults: [{at_s: 8, motor: {agent: b}}]}\n"
    (folder / "faulty.yaml").write_text(MISSION + fault)
    flown = covey(folder, "fly", "faulty.yaml", "--vehicles", "reference", "--out", "f")
    assert flown.returncode == 4
    assert "the flight failed, lost: b; collisions: 0" in flown.stderr
    assert "Proof     holds" in flown.stdout
    checked = covey(folder, "validate", "faulty.yaml")
    assert "iris, 2 layers at 1.5 to 3.9 m, 1 fault" in checked.stdout


@pytest.mark.parametrize("file", ["mission.yaml", "hop.yaml"])
def test_ctrl_c_while_filming_keeps_the_flight(file: str, folder: Path) -> None:
    command = [sys.executable, "-m", "covey", "fly", file, "--vehicles", "kinematic", "--film", "--out", "r"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=folder) as process:
        assert process.stderr is not None
        while not (line := process.stderr.readline()).startswith("covey: filming"):
            assert line, "it ended before it filmed"
        process.send_signal(signal.SIGINT)
        out, err = process.communicate()
    assert process.returncode == 130, err
    assert "the flight was over and is in r, without a film" in err
    assert "Files" in out
    names = {path.name for path in (folder / "r").iterdir()}
    assert {"result.json", "flight.npz", "flight.png", "flight.pdf", "record.mcap"} <= names
    assert not any(name.startswith(".") or name.endswith((".mp4", ".gif")) for name in names)


def test_exercise_files_are_files_like_others(folder: Path) -> None:
    checked = covey(folder, "validate", "hop.yaml", "mission.yaml")
    assert checked.returncode == 0
    assert "hop, seed 0, 12 s" in checked.stdout
    assert "1: a (iris) goes to (1, 0, 1) m" in checked.stdout
    (folder / "hop.yaml").write_text(EXERCISE.replace("duration_s", "duratoin_s"))
    wrong = covey(folder, "validate", "hop.yaml")
    assert wrong.returncode == 2
    assert "did you mean 'duration_s'?" in wrong.stdout
    planned = covey(folder, "plan", "hop.yaml")
    assert planned.returncode == 2
    assert "hop.yaml:4:1: exercise: expected a mission, got an exercise" in planned.stderr
    assert "`covey fly` flies it" in planned.stderr
    schema = json.loads(covey(folder, "schema", "--exercise").stdout)
    assert "exercise" in schema["properties"]
    assert "exercise" not in json.loads(covey(folder, "schema").stdout)["properties"]
