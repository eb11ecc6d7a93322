"""``--view`` and ``covey playground``: the page beside a run."""

from __future__ import annotations

import asyncio
import base64
import contextlib
import gzip
import json
import math
import os
import re
import signal
import subprocess
import sys
import threading
import time
import urllib.request
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import pytest
from mcap.reader import make_reader
from tests.net import free_endpoint
from tests.visitors import HELLO, listen
from websockets.asyncio.client import connect

from covey.cli.main import main
from covey.cli.view import Live, eyes_of, live
from covey.environment import Landmarks
from covey.errors import InputError
from covey.mission import load_mission
from covey.runtime.agent import build_models
from covey.runtime.network.remote_agent import NETWORK_TIMES
from covey.runtime.plan import plan
from covey.runtime.records.mcap_reader import Record
from covey.runtime.records.mcap_record import Recorder
from covey.runtime.watching.feed import Activity, Ended, Motion, Run, Scene
from covey.runtime.watching.steering import Steering
from covey.runtime.watching.telling import describe
from covey.sensing import build_model

MISSION = """
schema_version: 1
name: small
seed: 3
environment:
  landmarks: {grid: {x_m: [-2, 2], y_m: [-2, 2], spacing_m: 1}}
  region: {box: {x_m: [-2, 2], y_m: [-2, 2]}}
agents:
  - {name: a, pose: {x_m: 1, y_m: 0, yaw_deg: 90}}
  - {name: b, pose: {x_m: -1, y_m: 0, yaw_deg: 0}}
"""


@pytest.fixture
def mission(tmp_path: Path) -> Path:
    path = tmp_path / "mission.yaml"
    path.write_text(MISSION)
    return path


class Watched:
    """The command in a process of its own, and where its page is."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self.process = process
        assert process.stderr is not None
        self.before: list[str] = []
        self.url = ""
        for line in process.stderr:
            found = re.search(r"watch at (\S+)", line)
            if found:
                self.url = found[1]
                return
            self.before.append(line)

    @property
    def token(self) -> str:
        return urlsplit(self.url).fragment.removeprefix("token=")

    def visit(self, until: str, *commands: dict[str, Any]) -> list[dict[str, Any]]:
        """Greet, give commands once the state is there, and listen."""

        async def talk() -> list[dict[str, Any]]:
            async with connect(f"ws://{urlsplit(self.url).netloc}/api/feed", proxy=None, max_size=None) as socket:
                await socket.send(HELLO % self.token)
                messages = await listen(socket, until if until == "Hello" else "Steered")
                for command in commands:
                    await socket.send(json.dumps({"type": "command", "token": self.token, **command}))
                if any(message["type"] == until for message in messages):
                    return messages
                return messages + await listen(socket, until)

        return asyncio.run(talk())

    def activity_at_the_end(self) -> list[int]:
        """What each agent is said to be doing, as soon as the mission is over."""
        messages = self.visit("Ended")
        assert next(message["status"] for message in messages if message["type"] == "Ended") == "settled"
        states = [message["activity"]["data"] for message in messages if message["type"] in ("TeamState", "Health")]
        return list(base64.b64decode(states[-1]))

    def end(self) -> tuple[int, str]:
        _, err = self.process.communicate(timeout=120)
        return self.process.returncode, err


@contextlib.contextmanager
def covey(*arguments: str, folder: Path) -> Iterator[Watched]:
    process = subprocess.Popen(
        [sys.executable, "-m", "covey", *arguments],
        cwd=folder,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={name: value for name, value in os.environ.items() if name != "CI"},
    )
    with process:
        try:
            yield Watched(process)
        finally:
            process.kill()


def score_of(messages: list[dict[str, Any]]) -> float:
    """The score in the end, as the page is told."""
    return float(next(message["score"] for message in messages if message["type"] == "Ended"))


def test_a_plan_is_watched_while_it_runs(mission: Path) -> None:
    with covey("plan", str(mission), "--view", "--speed", "4", "--out", "out", folder=mission.parent) as watched:
        messages = watched.visit("Ended")
        code, err = watched.end()
    assert (code, err.count("Traceback")) == (0, 0)
    result = json.loads((mission.parent / "out" / "result.json").read_text())
    assert score_of(messages) == pytest.approx(result["score"]["final"])
    assert messages[0]["commands"] == ["pause", "resume", "step", "speed"]
    assert messages[0]["may_steer"] is True


def test_ctrl_c_ends_a_paused_run_with_what_it_has(mission: Path) -> None:
    with covey("plan", str(mission), "--view", "--speed", "2", "--out", "out", folder=mission.parent) as watched:
        messages = watched.visit("Steered", {"command": "pause"}, {"command": "kill", "agent": 0})
        watched.process.send_signal(signal.SIGINT)
        code, err = watched.end()
    assert "Scene" in {message["type"] for message in messages}
    assert (code, err.count("Traceback")) == (130, 0)
    assert json.loads((mission.parent / "out" / "result.json").read_text())["status"] == "interrupted"


def test_processes_are_watched_and_recorded(mission: Path) -> None:
    with covey("launch", str(mission), "--view", "--out", "out", folder=mission.parent) as watched:
        messages = watched.visit("Ended")
        code, err = watched.end()
    assert (code, err.count("Traceback")) == (0, 0)
    hello = [message for message in messages if message["type"] == "Hello"][-1]
    assert hello["commands"] == ["kill", "revive", "weight"]
    result = json.loads((mission.parent / "out" / "result.json").read_text())
    with Record(mission.parent / "out") as record:
        ended = list(record.items())[-1]
    assert isinstance(ended, Ended)
    assert (ended.status, ended.holds) == ("settled", True)
    assert score_of(messages) == pytest.approx(ended.score) == pytest.approx(result["score"]["final"])


def test_a_team_to_play_with(mission: Path) -> None:
    with covey("playground", str(mission), "--speed", "4", folder=mission.parent) as watched:
        messages = watched.visit("Refused", {"command": "kill", "agent": 5})
        watched.process.send_signal(signal.SIGINT)
        code, err = watched.end()
    assert (code, err.count("Traceback")) == (0, 0)
    hello = [message for message in messages if message["type"] == "Hello"][-1]
    assert hello["commands"] == ["pause", "resume", "step", "speed", "kill", "revive", "weight", "loss"]
    refused = next(message for message in messages if message["type"] == "Refused")
    assert refused["text"] == "agent: expected one that lives"
    assert list(mission.parent.iterdir()) == [mission]


def test_a_team_of_processes_is_watched_to_the_end_and_beyond(mission: Path) -> None:
    """It goes on after the end when somebody dies, and who leaves after the end is not dead."""
    folder, meeting_point = mission.parent, free_endpoint()
    agent = [sys.executable, "-m", "covey", "agent", "--mission", str(mission), "--attached", "--name"]
    with contextlib.ExitStack() as stack:

        def start(name: str, *where: str) -> subprocess.Popen[bytes]:
            process = subprocess.Popen([*agent, name, *where], stdin=subprocess.PIPE, stderr=subprocess.DEVNULL)
            stack.callback(process.communicate)  # closes what it is attached to
            return process

        start("a", "--listen", meeting_point)
        second = start("b", "--connect", meeting_point)
        with covey("playground", str(mission), "--connect", meeting_point, folder=folder) as watched:
            assert watched.activity_at_the_end() == [Activity.QUIESCENT, Activity.QUIESCENT]
            second.kill()
            while watched.activity_at_the_end() != [Activity.QUIESCENT, Activity.DEAD]:
                time.sleep(0.2)
            stack.close()
            time.sleep(NETWORK_TIMES.dead_after + 0.5)
            assert watched.activity_at_the_end() == [Activity.QUIESCENT, Activity.DEAD]
            watched.process.send_signal(signal.SIGINT)
            code, err = watched.end()
    assert (code, err.count("Traceback")) == (0, 0)


def test_where_nobody_is_heard_it_is_said_what_may_be_wrong(mission: Path) -> None:
    with covey("playground", str(mission), "--connect", free_endpoint(), folder=mission.parent) as watched:
        assert watched.process.stderr is not None
        said = next(line for line in watched.process.stderr if "no agent of this mission is heard yet" in line)
        watched.process.send_signal(signal.SIGINT)
        code, _ = watched.end()
    assert "same mission file and --seed" in said
    assert code == 0


@pytest.mark.parametrize("command", ["plan", "fly", "playground"])
def test_a_port_that_is_taken_is_said_before_anything_runs(mission: Path, command: str) -> None:
    from covey.playground.server import bind

    with bind("127.0.0.1", 0) as taken:
        view = [] if command == "playground" else ["--view"]
        port = str(taken.getsockname()[1])
        with covey(command, str(mission), *view, "--port", port, folder=mission.parent) as watched:
            code, _ = watched.end()
    assert code == 2
    expected = f"covey: the Playground cannot listen on 127.0.0.1, port {port}: Address already in use; "
    assert watched.before == [f"{expected}choose another --host or --port\n"]
    assert list(mission.parent.iterdir()) == [mission]


def test_an_exercise_is_shown_in_real_time_and_recorded(tmp_path: Path) -> None:
    exercise = tmp_path / "short.yaml"
    source = (Path(__file__).parents[3] / "examples" / "exercises" / "swap.yaml").read_text()
    exercise.write_text(re.sub(r"duration_s: \d+", "duration_s: 3", source))
    options = ("--view", "--vehicles", "kinematic", "--out", "out")
    with covey("fly", str(exercise), *options, folder=tmp_path) as watched:
        messages = watched.visit("Ended")
        code, err = watched.end()
    assert (code, err.count("Traceback")) == (1, 0)  # so soon nobody is there
    assert messages[0]["commands"] == []
    with Record(tmp_path / "out") as record:
        items = list(record.items())
    motions = [item for item in items if isinstance(item, Motion)]
    assert motions[-1].time == pytest.approx(3.0, abs=0.1)
    assert len(motions) > 50
    assert isinstance(items[-1], Ended)
    with covey("fly", str(exercise), "--view", "--speed", "2", folder=tmp_path) as watched:
        assert watched.end()[0] == 2


def test_other_hosts_are_warned_of(mission: Path, capsys: pytest.CaptureFixture[str]) -> None:
    loaded = load_mission(mission)
    options: dict[str, Any] = {"port": 0, "open_page": False, "speed": None, "usual": 3.0}
    with live(True, mission=loaded, host="127.0.0.1", **options) as shown:
        assert isinstance(shown.steering, Steering)
        assert shown.steering.pace.speed == 3.0
    assert "unencrypted" not in capsys.readouterr().err
    with live(True, mission=loaded, host="0.0.0.0", **options):
        pass
    err = capsys.readouterr().err
    assert "watch at http://127.0.0.1:" in err
    assert "unencrypted" in err
    with live(False, mission=loaded, host="127.0.0.1", **options) as shown:
        assert shown == Live()
    assert capsys.readouterr().err == ""


def test_where_no_browser_can_be_opened_it_is_said_and_not_waited_for(
    mission: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[str] = []

    def nowhere(url: str) -> bool:
        asked.append(url)
        return False

    monkeypatch.setattr("webbrowser.open", nowhere)
    monkeypatch.setattr("covey.cli.view.OPENING", math.inf)
    options: dict[str, Any] = {"port": 0, "open_page": True, "speed": None, "usual": 3.0}
    with live(True, mission=load_mission(mission), host="127.0.0.1", **options):
        pass
    assert "#token=" in asked[0]
    assert "open the address yourself" in capsys.readouterr().err


@pytest.mark.parametrize("option", [{"port": 8000}, {"host": "0.0.0.0"}, {"open_page": True}, {"speed": 2.0}])
def test_options_of_the_page_need_the_page(mission: Path, option: dict[str, Any]) -> None:
    options: dict[str, Any] = {"host": "127.0.0.1", "port": 0, "open_page": False} | option
    with (
        pytest.raises(InputError, match="expected --view"),
        live(False, mission=load_mission(mission), usual=1.0, **options),
    ):
        pass


def test_the_page_stays_until_ctrl_c_only_where_somebody_is(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("CI", raising=False)
    shown = Live(watch=lambda item: None)
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(isatty=lambda: False))
    shown.stay()
    monkeypatch.setattr(sys, "stdin", SimpleNamespace(isatty=lambda: True))
    monkeypatch.setenv("CI", "true")
    shown.stay()
    monkeypatch.delenv("CI")
    Live().stay()
    stayed: list[bool] = []

    def press() -> None:
        while signal.getsignal(signal.SIGINT) is before:
            time.sleep(0.01)
        stayed.append(True)
        os.kill(os.getpid(), signal.SIGINT)

    before = signal.getsignal(signal.SIGINT)
    thread = threading.Thread(target=press)
    thread.start()
    shown.stay()
    thread.join()
    assert stayed == [True]


def test_heat_maps_are_those_of_the_sensor(mission: Path) -> None:
    loaded = load_mission(mission)
    scene = describe(loaded, build_models(loaded), run=Run.PLAN, software={})
    pose = loaded.agents[0].pose
    row = np.array([pose.x, pose.y, 1.5, np.cos(0.5 * pose.yaw), 0.0, 0.0, np.sin(0.5 * pose.yaw)])
    seen = eyes_of(loaded)(scene, 0, row)
    sensor = loaded.agents[0].sensor
    expected = build_model(sensor.model, sensor.options).visibility(pose.as_array()[None, :], loaded.landmarks)[0]
    np.testing.assert_allclose(seen, expected, rtol=1e-9)


def test_heat_maps_are_also_of_those_who_join_and_of_what_is_added(mission: Path) -> None:
    changes = """changes:
  - {add: {points: [[1.5, 1.5], [1.7, 1.5]]}}
  - {join: {name: c, pose: {x_m: 0, y_m: 1}, sensor: {model: isotropic, optimal_distance_m: 1.5}}}
"""
    mission.write_text(MISSION + changes)
    loaded = load_mission(mission)
    scenes: list[Scene] = []
    plan(loaded, watch=lambda item: scenes.append(item) if isinstance(item, Scene) else None)
    seen_by, scene = eyes_of(loaded), scenes[-1]
    seen = seen_by(scene, 2, np.array([0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0]))
    sensor = build_model("isotropic", {"optimal_distance": 1.5})
    landmarks = Landmarks(scene.positions_W[:, :2])
    assert len(landmarks) == len(loaded.landmarks) + 2
    np.testing.assert_allclose(seen, sensor.visibility(np.array([[0.0, 1.0, 0.0]]), landmarks)[0], rtol=1e-9)


@pytest.mark.parametrize("speed", ["inf", "nan", "1e9", "-1"])
@pytest.mark.parametrize("command", ["plan", "fly", "playground", "replay"])
def test_a_speed_is_a_number(command: str, speed: str, mission: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as left:
        main([command, str(mission), "--speed", speed])
    assert left.value.code == 2
    assert "--speed" in capsys.readouterr().err


def test_a_record_is_replayed_served_and_written_as_one_file(mission: Path) -> None:
    folder = mission.parent
    subprocess.run([sys.executable, "-m", "covey", "plan", str(mission), "--out", "out", "-q"], cwd=folder, check=True)
    with covey("replay", "out", "--speed", "2", folder=folder) as watched:
        (hello,) = watched.visit("Hello")
        with urllib.request.urlopen(f"http://{urlsplit(watched.url).netloc}/api/record") as response:
            served = response.read()
        watched.process.send_signal(signal.SIGINT)
        code, err = watched.end()
    assert (code, err.count("Traceback"), hello["source"], hello["speed"]) == (0, 0, "record", 2.0)
    kinds = [json.loads(line)["type"] for line in gzip.decompress(served).splitlines()]
    assert (kinds[0], kinds[1], kinds[-1]) == ("Scene", "TeamState", "Ended")

    write = [sys.executable, "-m", "covey", "replay", "out/record.mcap", "--html", "page.html"]
    subprocess.run(write, cwd=folder, check=True)
    page = (folder / "page.html").read_text()
    assert base64.b64encode(served).decode() in page
    again = subprocess.run(write, cwd=folder, check=False, capture_output=True, text=True)
    assert again.returncode == 2
    assert again.stderr == "covey: page.html: is there already; choose another name, or replace it with --force\n"
    subprocess.run([*write, "--force"], cwd=folder, check=True)
    assert sorted(path.name for path in folder.iterdir()) == ["mission.yaml", "out", "page.html"]


@pytest.mark.parametrize("name", ["none.mcap", "mission.yaml"])
def test_what_is_no_record_is_said(mission: Path, name: str) -> None:
    with covey("replay", name, folder=mission.parent) as watched:
        assert watched.end()[0] == 2
    assert len(watched.before) == 1
    assert watched.before[0].startswith(f"covey: {name}: ")


def test_a_replay_says_what_is_missing_of_a_damaged_record(mission: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plan(load_mission(mission), watch=(recorder := Recorder(mission.parent / "record.mcap")))
    recorder.close()
    with recorder.path.open("r+b") as stream:
        summary = make_reader(stream).get_summary()
        assert summary is not None
        chunk = summary.chunk_indexes[-1]
        stream.seek(chunk.chunk_start_offset + chunk.chunk_length // 2)
        stream.write(b"damaged")
    with pytest.raises(SystemExit) as left:
        main(["replay", str(recorder.path), "--html", str(mission.parent / "replay.html")])
    err = capsys.readouterr().err
    assert left.value.code == 0
    assert "is damaged and left out" in err


def test_a_replay_is_not_written_in_place_of_a_directory(mission: Path, capsys: pytest.CaptureFixture[str]) -> None:
    plan(load_mission(mission), watch=(recorder := Recorder(mission.parent / "record.mcap")))
    recorder.close()
    for target in ("--html", "--video"):
        with pytest.raises(SystemExit) as left:
            main(["replay", str(recorder.path), target, str(mission.parent), "--force"])
        assert left.value.code == 2
        assert f"{mission.parent}: expected a file to write, got a directory" in capsys.readouterr().err
