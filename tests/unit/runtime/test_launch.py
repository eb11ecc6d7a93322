"""Real processes over a real network: they settle with a proof, whoever dies."""

from __future__ import annotations

import json
import math
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.net import free_endpoint, wait_until
from tests.unit.runtime.launched import LONGEST, check, write_small
from tests.unit.runtime.small import check_deployment, small

from covey.cli.main import main
from covey.errors import NetworkError
from covey.mission import load_mission, mission_digest
from covey.protocol import Sender
from covey.runtime.certify import certify
from covey.runtime.network import launch as launching
from covey.runtime.network.launch import Blow, LaunchOptions, launch
from covey.runtime.network.network_file import NetworkPlan
from covey.runtime.network.network_telling import NetworkTeller
from covey.runtime.network.observer import Observer
from covey.runtime.network.remote_agent import NETWORK_TIMES, mission_codec
from covey.runtime.records.record import read_result
from covey.runtime.result import PlanStatus, Progress
from covey.runtime.watching.feed import Activity, Health, Motion, Scene, Update
from covey.transports.network import NetworkOptions
from covey.transports.zenoh import ZenohTransport


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """The file of a small mission."""
    return write_small(tmp_path)


def test_a_team_of_processes_plans_a_mission(path: Path) -> None:
    observers: list[Observer] = []
    mission = load_mission(path)
    deployment, report = launch(mission, path, LaunchOptions(timeout=LONGEST), on_observer=observers.append)
    check(deployment, report)
    check_deployment(deployment)
    assert report.died == ()
    assert report.strangers == {}
    assert [one.code for one in report.exits] == [0, 0, 0]
    assert {agent["ending"] for agent in report.agents} == {"released"}
    assert deployment.trades == sum(agent["trades"] for agent in report.agents) >= 1
    assert deployment.score.final > deployment.score.initial
    assert len(observers) == 1


def test_the_vehicles_of_a_team_of_processes_are_seen_on_their_way(path: Path) -> None:
    told: list[Scene | Update] = []
    tellers: list[NetworkTeller] = []

    def begin(observer: Observer) -> None:
        tellers.append(NetworkTeller(told.append, observer, dead_after=NETWORK_TIMES.dead_after))

    def listen(progress: Progress) -> None:
        for teller in tellers:
            teller.update()

    deployment, report = launch(
        load_mission(path),
        path,
        LaunchOptions(vehicles="kinematic", timeout=LONGEST),
        on_observer=begin,
        on_progress=listen,
    )
    tellers[0].end("settled", True)
    check(deployment, report)
    assert report.strangers == {}
    motions = [item for item in told if isinstance(item, Motion)]
    flight, last = deployment.mission.flight, motions[-1]
    away = [math.dist(row[:2], agent.pose.position_W) for row, agent in zip(last.poses, deployment.agents, strict=True)]
    assert max(away) <= flight.arrival_position
    np.testing.assert_allclose(last.poses[:, 2], flight.altitudes(3))
    assert last.score_flown == pytest.approx(deployment.score.final, rel=0.05)
    speeds = np.array([np.linalg.norm(motion.velocities_W, axis=1) for motion in motions])
    assert (np.nanmax(speeds, axis=0) > 0.3).all()  # each was seen while it flew
    activity = np.concatenate([item.activity for item in told if isinstance(item, Health)])
    assert Activity.FLYING in activity


def test_who_dies_is_replaced_and_comes_back_with_its_memory(
    path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(launching, "RESTART_AFTER", 1.5 * NETWORK_TIMES.dead_after)  # others adopt before it is back
    blows = (Blow(1, 0.5), Blow(0, 12.0))
    options = LaunchOptions(restart=True, blows=blows, state=tmp_path / "state", timeout=LONGEST)
    deployment, report = launch(load_mission(path), path, options)
    check(deployment, report)
    assert [one.name for one in report.exits if one.code == -signal.SIGKILL] == ["red", "blue"]
    assert {agent["name"] for agent in report.agents if agent["remembered"]} == {"red", "blue"}
    events = [(entry.event, entry.agents) for entry in deployment.history]
    assert ("return", ("red",)) in events
    assert any(event == "adoption" for event, _ in events)
    assert len(deployment.agents[1].landmarks) > 0


def test_who_does_not_come_back_is_blind_in_the_result(path: Path) -> None:
    deployment, report = launch(load_mission(path), path, LaunchOptions(blows=(Blow(2, 0.5),), timeout=LONGEST))
    check(deployment, report)
    assert [agent.sensor.model for agent in deployment.mission.agents] == ["anisotropic", "anisotropic", "blind"]
    assert len(deployment.agents[2].landmarks) == 0
    assert ("death", ("green",)) in [(entry.event, entry.agents) for entry in deployment.history]


def hard_times(seed: int, agents: int) -> tuple[Blow, ...]:
    """Draw when which agents are killed, or stopped for a while, every few seconds."""
    rng = np.random.default_rng(seed)
    at, blows = float(rng.uniform(0.0, 2.0)), []
    for _ in range(3):
        agent = int(rng.integers(agents))
        if rng.random() < 0.3:
            stopped = float(rng.uniform(0.5, 2.0 * NETWORK_TIMES.dead_after))
            blows += [Blow(agent, at, signal.SIGSTOP), Blow(agent, at + stopped, signal.SIGCONT)]
            at += stopped
        else:
            blows.append(Blow(agent, at))
        at += float(rng.uniform(1.5, 2.5)) * NETWORK_TIMES.dead_after
    return tuple(blows)


def test_missions_survive_kills_and_stops(path: Path, seeds: Callable[[int, int], range]) -> None:
    for seed in seeds(2, 100):
        mission = load_mission(path, seed=seed)
        blows = hard_times(seed, len(mission.agents))
        deployment, report = launch(mission, path, LaunchOptions(restart=True, blows=blows, timeout=LONGEST))
        check(deployment, report)
        assert all(agent.landmarks.size for agent in deployment.agents), f"seed {seed}"


def test_an_agent_that_cannot_start_ends_the_launch(path: Path, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    options = LaunchOptions(state=tmp_path / "file", timeout=LONGEST)
    with pytest.raises(NetworkError, match=r"did not start \(exit code 2\): .*cannot be made"):
        launch(load_mission(path), path, options)
    assert children_of(os.getpid()) == []


def test_when_time_is_up_what_is_known_is_kept(path: Path) -> None:
    deployment, report = launch(load_mission(path), path, LaunchOptions(blows=(Blow(0, 1e6),), timeout=8.0))
    assert not report.settled
    assert deployment.status is PlanStatus.INTERRUPTED
    assert deployment.certificate is None
    assert {one.code for one in report.exits} <= {130, -signal.SIGKILL}
    assert math.isfinite(deployment.score.final)


def test_when_all_have_died_nobody_is_waited_for(path: Path) -> None:
    blows = tuple(Blow(agent, 0.0) for agent in range(3))
    deployment, report = launch(load_mission(path), path, LaunchOptions(blows=blows, timeout=LONGEST))
    assert [one.code for one in report.exits] == [-signal.SIGKILL] * 3
    assert not report.settled
    assert deployment.status is PlanStatus.INTERRUPTED
    assert report.settle_s is not None
    assert report.settle_s < LONGEST / 2, "it waited until its time was up"


# The command.


def children_of(pid: int) -> list[int]:
    """Return the agents' processes that a process has started."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            parent = int((folder / "stat").read_text().rpartition(")")[2].split()[1])
            words = (folder / "cmdline").read_bytes().split(b"\0")
        except OSError:
            continue
        if parent == pid and b"agent" in words:
            found.append(int(folder.name))
    return found


def lives(pid: int) -> bool:
    try:
        return (Path("/proc") / str(pid) / "stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@pytest.fixture
def launched(path: Path) -> Iterator[subprocess.Popen[str]]:
    """A launch that does not end by itself, with all its agents there."""
    command = [sys.executable, "-W", "error", "-m", "covey", "launch", str(path), "--out", str(path.parent / "out")]
    with subprocess.Popen(
        [*command, "--kill", "red@100000"], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        wait_until(lambda: len(children_of(process.pid)) == 3, "all agents are started")
        yield process
        process.kill()


def test_ctrl_c_is_passed_on_and_keeps_what_is_known(launched: subprocess.Popen[str], path: Path) -> None:
    children = children_of(launched.pid)
    time.sleep(2.0)
    launched.send_signal(signal.SIGINT)
    _, err = launched.communicate(timeout=60.0)
    assert launched.returncode == 130
    assert "Traceback" not in err
    assert "interrupted; what was known by then is in" in err
    assert read_result(path.parent / "out").status is PlanStatus.INTERRUPTED
    report = json.loads((path.parent / "out" / "launch.json").read_text())
    assert not report["settled"]
    assert not any(lives(child) for child in children)


def test_no_agent_outlives_its_parent(launched: subprocess.Popen[str]) -> None:
    children = children_of(launched.pid)
    launched.kill()
    launched.wait()
    wait_until(lambda: not any(lives(child) for child in children), "all agents leave")


def run(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as ended:
        main(list(arguments))
    printed = capsys.readouterr()
    return int(ended.value.code or 0), printed.out, printed.err


def test_agents_started_by_hand_are_watched(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Three agents that know of one endpoint each, and an observer that comes when they have long been done."""
    first, second = free_endpoint(), free_endpoint()
    agent = [sys.executable, "-W", "error", "-m", "covey", "agent", "--mission", str(path), "--attached", "--json"]
    words = (
        ["--name", "blue", "--listen", first],
        ["--name", "red", "--listen", second, "--connect", first],
        ["--name", "green", "--connect", second],
    )
    out = path.parent / "watched"
    processes = [
        subprocess.Popen([*agent, *more], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) for more in words
    ]
    try:
        arguments = ("--observe", "--connect", second, "--out", str(out), "--timeout", str(LONGEST), "--quiet")
        time.sleep(5.0)
        code, _, err = run(capsys, "launch", str(path), *arguments)
        assert code == 0, err
        assert err == ""
        reports: list[dict[str, Any]] = []
        for process in processes:
            said, _ = process.communicate(timeout=60.0)
            assert process.returncode == 0
            reports.append(json.loads(said))
    finally:
        for process in processes:
            process.kill()
            process.communicate()
    assert [report["name"] for report in reports] == ["blue", "red", "green"]
    assert certify(out).holds


def test_an_observer_says_that_it_hears_nobody(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = path.parent / "watched"
    words = ("--observe", "--connect", free_endpoint(), "--out", str(out), "--timeout", "1")
    code, _, err = run(capsys, "launch", str(path), *words)
    assert code == 1
    assert "starting, 0 of 3 agents heard" in err
    assert "covey: not all agents were heard; do they have this mission file and seed?" in err
    assert "nan" not in err
    text = (out / "launch.json").read_text("utf-8")
    report = json.loads(text, parse_constant=pytest.fail)
    assert report["start_s"] is None
    assert report["settle_s"] is None


def test_the_command_writes_and_prints_what_planning_does(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = path.parent / "out"
    code, printed, err = run(capsys, "launch", str(path), "--out", str(out), "--json", "--seed", "5")
    assert code == 0
    assert "Traceback" not in err
    assert json.loads(printed) == json.loads((out / "result.json").read_text())
    assert {file.name for file in out.iterdir()} == {
        "result.json",
        "agents.csv",
        "deployment.png",
        "deployment.pdf",
        "launch.json",
        "record.mcap",
    }
    assert read_result(out).seed == 5
    code, _, err = run(capsys, "launch", str(path), "--out", str(out))
    assert code == 2
    assert "is not empty" in err


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["launch", "FILE", "--kill", "pink@3"], "--kill: expected NAME@SECONDS with an agent of blue, red, green"),
        (["launch", "FILE", "--kill", "blue"], "--kill: expected NAME@SECONDS"),
        (["launch", "FILE", "--kill", "blue@-1"], "--kill: expected NAME@SECONDS"),
        (["launch", "FILE", "--connect", "tcp/127.0.0.1:1"], "--connect: expected --observe"),
        (["launch", "FILE", "--observe", "--restart"], "--observe: expected neither"),
        (["launch", "FILE", "--network", "absent.toml"], "absent.toml"),
        (["agent", "--mission", "FILE", "--name", "pink"], "--name: expected an agent of"),
        (["agent", "--mission", "FILE", "--name", "blue", "--listen", "nonsense"], "expected one such as tcp/"),
        (["agent", "--mission", "FILE", "--name", "blue", "--connect", "tcp/localhost"], "expected one such as tcp/"),
        (["agent", "--mission", "FILE", "--name", "blue", "--listen", "tcp/203.0.113.1:1"], "cannot join the network"),
        (["playground", "FILE", "--connect", "nonsense"], "expected one such as tcp/"),
        (["launch", "FILE", "--observe"], "--observe: expected --connect with it"),
        (["launch", "FILE", "--observe", "--connect", "nonsense"], "expected one such as tcp/"),
        (["agent", "--mission", "FILE", "--name", "blue", "--router", "tcp/a:1", "--listen", "tcp/b:1"], "--router"),
    ],
)
def test_bad_input_is_one_error(
    path: Path,
    arguments: list[str],
    said: str,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(path.parent)
    code, _, err = run(capsys, *(str(path) if word == "FILE" else word for word in arguments))
    assert code == 2
    assert said in err
    assert "Traceback" not in err
    assert ".rs:" not in err
    assert not (path.parent / "covey-out").exists()


def test_a_mission_that_changes_is_not_played_with(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path.write_text(json.dumps({**small().source, "changes": [{"remove": [0]}]}), "utf-8")
    code, out, err = run(capsys, "playground", str(path))
    assert (code, out) == (2, "")
    assert err.startswith(f"covey: {path}: changes: only `covey plan` and `covey launch` act on them; ")
    assert err.count("\n") == 1


def test_agents_of_another_mission_are_named_while_one_waits_in_vain(
    path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    endpoint = free_endpoint()
    other = mission_codec(load_mission(path, seed=99))
    assert other.digest != mission_digest(load_mission(path))
    transport = ZenohTransport(Sender(1, 1), other, NetworkOptions(listen=(endpoint,)))
    try:
        words = ["agent", "--mission", str(path), "--name", "blue", "--connect", endpoint]
        code, _, err = run(capsys, *words, "--wait", "2", "--timeout", "1")
    finally:
        transport.close()
    assert code == 1
    assert "begins without red, green, not heard of in 2 s" in err
    assert "hears agents of 1 other mission: compare the mission files and seeds" in err


def test_a_plan_without_a_file_is_the_default() -> None:
    assert LaunchOptions().network == NetworkPlan()
