"""Changes of a team on the network: who makes them, who hears of them, and what an observer makes of it."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.net import PATIENCE, free_endpoint, wait_until
from tests.unit.runtime.small import small
from tests.unit.runtime.test_observer import Wire, beat, map_of, records_of

from covey.cli.main import main
from covey.environment import Landmarks
from covey.errors import InputError, NetworkError
from covey.mission import ChangeSpec, Mission, load_mission
from covey.protocol import (
    EMPTY,
    AgentChange,
    Catalogue,
    LandmarkChange,
    LandmarkRecords,
    LandmarksAdopted,
    Map,
    PoseRecords,
    Sender,
)
from covey.protocol.adoption import map_digest
from covey.runtime.certify import certify
from covey.runtime.network.launch import LaunchOptions, launch
from covey.runtime.network.observed_team import ObservedTeam
from covey.runtime.network.observer import Observer
from covey.runtime.network.operator import TELL_EVERY, Operator
from covey.runtime.network.remote_agent import join_mission, mission_codec
from covey.runtime.records.record import read_result
from covey.runtime.result import Progress
from covey.runtime.watching.steering import Command, Kill, Revive, SetWeight, Steering
from covey.transports.network import NetworkOptions
from covey.transports.zenoh import ZenohTransport
from covey.transports.zenoh_observer import ZenohObserver

LONGEST = 240.0
"""Seconds after which a launch is given up: much longer than it takes."""

ORANGE = {"name": "orange", "pose": {"x_m": 0.1, "y_m": 0.2}}
CHANGES: list[dict[str, Any]] = [
    {"after_trades": 1, "reweight": {"landmarks": [0, 1], "weight": 5.0}},
    {"at_s": 0.5, "add": {"points": [[1.9, 1.9], [1.8, 1.9]], "weight": 2.0}},
    {"join": ORANGE},
    {"remove": [5, 6]},
    {"leave": "red"},
]


class Ear:
    """What an operator said."""

    def __init__(self) -> None:
        self.said: list[Catalogue] = []

    def announce(self, news: Catalogue) -> None:
        self.said.append(news)


@pytest.fixture
def mission() -> Mission:
    return small()


@pytest.fixture
def wire() -> Wire:
    return Wire()


@pytest.fixture
def observer(mission: Mission, wire: Wire) -> Observer:
    return Observer(mission, wire, clock=wire.clock)


def knowing(agent: int, catalogue: Catalogue, mission: Mission) -> Map:
    known, _ = map_of(agent, records_of(mission, [0, 1, 2]), mission)
    return Map(known.sender, known.records, known.poses, catalogue)


# What an observer makes of changes.


def test_every_kind_of_change_is_in_the_history_with_the_score_after_it(mission: Mission) -> None:
    n = len(mission.landmarks)
    view = ObservedTeam(mission, np.arange(n) % 3)
    view.set_living(range(3))
    planner = view.planner
    steps = (
        (Catalogue({0: planner.landmark(0)._replace(version=1, weight=9.0)}), "reweighted", ()),
        (Catalogue({n: LandmarkChange(2, True, 2.0, 1.0, 1.0)}), "added", ()),
        (Catalogue({4: planner.landmark(4)._replace(version=3, alive=False, weight=0.0)}), "removed", ()),
        (Catalogue(agents={3: AgentChange(4, True, json.dumps(ORANGE))}), "joined", ("orange",)),
        (Catalogue(agents={1: AgentChange(5, False)}), "left", ("red",)),
    )
    standing = view.standing()
    for catalogue, event, names in steps:
        assert view.learn(catalogue)
        assert not view.learn(catalogue)
        entry = view.history[-1]
        assert (entry.event, entry.agents) == (event, names)
        standing = view.standing()
        recomputed = [
            float(model.visibility(pose.as_array()[None, :], own)[0] @ own.weights)
            for model, pose, own in zip(
                standing.models,
                standing.poses,
                (standing.mission.landmarks.subset(own) for own in standing.sets),
                strict=True,
            )
        ]
        assert view.score == entry.score == pytest.approx(sum(recomputed))
    assert [agent.name for agent in standing.mission.agents] == ["blue", "green", "orange"]
    assert len(standing.mission.landmarks) == n
    assert (
        sorted(view.finish()[0].owner.tolist()).count(-1) == np.count_nonzero(np.arange(n) % 3 == 1) - (4 % 3 == 1) + 1
    )


def test_an_agent_that_nobody_can_build_changes_nothing(mission: Mission, observer: Observer, wire: Wire) -> None:
    for text in ("{", "[]", '{"name": 1}', '{"name": "grey", "sensor": {"model": "absent.py:Eye"}}'):
        bad = Catalogue({0: LandmarkChange(1, True, 9.0, 0.0, 0.0)}, {3: AgentChange(1, True, text)})
        before = observer.team.score
        with pytest.raises(InputError):
            observer.team.learn(bad)
        wire.said = [knowing(0, bad, mission)]
        observer.step(0.1)
        assert observer.team.planner.catalogue is EMPTY
        assert (len(observer.team.names), observer.team.score) == (3, before)


def test_events_about_what_is_not_known_yet_wait_for_it(mission: Mission, observer: Observer, wire: Wire) -> None:
    n = len(mission.landmarks)
    new = LandmarkRecords.unknown(n + 1).slice(np.array([n])).adopted_by(3, 1)
    wire.said = [beat(3, 1, b"12345678"), LandmarksAdopted(3, new)]
    observer.step(0.1)
    assert len(observer.team.history) == 1
    assert 3 not in observer.living
    news = Catalogue({n: LandmarkChange(1, True, 2.0, 1.0, 1.0)}, {3: AgentChange(2, True, json.dumps(ORANGE))})
    wire.said = [knowing(0, news, mission)]
    observer.step(0.1)
    assert [entry.event for entry in observer.team.history] == ["initial", "added", "joined", "adoption"]
    assert observer.team.owner[n] == 3
    assert 3 in observer.living


def test_the_mission_is_over_only_when_all_know_of_the_change(mission: Mission, observer: Observer, wire: Wire) -> None:
    known, digest = map_of(0, records_of(mission, [0, 1, 2]), mission)
    wire.said = [*(beat(agent, 1, digest) for agent in range(3)), known]
    observer.step(0.1)
    assert observer.over
    news = Catalogue({0: LandmarkChange(1, False, 0.0, 0.0, 0.0)})
    observer.learn(news)
    assert not observer.over
    assert not observer.informed
    records = records_of(mission, [0, 1, 2])
    later = map_digest(records, PoseRecords(known.poses), news)
    wire.said = [*(beat(agent, 2, later) for agent in range(3)), *(knowing(a, news, mission) for a in range(3))]
    observer.step(0.1)
    assert observer.informed
    assert observer.over
    assert observer.settle()
    assert observer.team.owner[0] == -1


# An operator.


def test_a_change_is_told_until_all_that_speak_know_it(mission: Mission, observer: Observer, wire: Wire) -> None:
    ear = Ear()
    operator = Operator(observer, ear)
    assert operator.told
    wire.said = [beat(agent, 1, b"12345678") for agent in range(3)]
    observer.step(0.1)
    news = operator.change(ChangeSpec(remove=(3,)))
    assert (news.event, news.detail) == ("removed", "landmarks 3")
    for _ in range(2):
        operator.step()
        operator.step()
        wire.now += TELL_EVERY
    assert ear.said == [news.catalogue] * 2
    for agents in ((0,), (0, 2)):
        wire.said = [knowing(agent, news.catalogue, mission) for agent in agents]
        wire.said += [beat(agent, 2 + len(agents), b"12345678") for agent in range(3)]
        observer.step(0.0)
        assert not operator.told
    wire.said = [knowing(1, news.catalogue, mission)]
    observer.step(0.0)
    assert operator.told
    operator.step()
    assert len(ear.said) == 2


def test_a_change_that_another_operator_overrules_is_reported(mission: Mission, observer: Observer, wire: Wire) -> None:
    operator = Operator(observer, Ear())
    news = operator.change(ChangeSpec(reweight={3: 2.0}))
    other = Catalogue({3: news.catalogue.landmarks[3]._replace(weight=7.0)})
    wire.said = [knowing(0, other, mission)]
    observer.step(0.1)
    with pytest.raises(NetworkError, match="another operator"):
        _ = operator.told


def test_with_an_access_list_agents_join_in_its_order(observer: Observer) -> None:
    operator = Operator(observer, Ear(), joining=("grey", "orange"))
    with pytest.raises(InputError, match="lets 'grey' join now, got 'orange'"):
        operator.change(ChangeSpec(join=ORANGE))
    operator.change(ChangeSpec(join={**ORANGE, "name": "grey"}))
    operator.change(ChangeSpec(join=ORANGE))
    with pytest.raises(InputError, match="lets nobody else join now"):
        operator.change(ChangeSpec(join={**ORANGE, "name": "pink"}))


def test_an_agent_drops_a_change_that_it_cannot_take_in_and_goes_on(mission: Mission) -> None:
    codec, endpoint = mission_codec(mission), free_endpoint()
    trouble: list[str] = []
    with ExitStack() as stack:
        transport = ZenohTransport(Sender(0, 1), codec, NetworkOptions(listen=(endpoint,)))
        stack.callback(transport.close)
        agent = join_mission(mission, transport, on_trouble=trouble.append)
        stack.callback(agent.close)
        chief = ZenohObserver(codec, NetworkOptions(connect=(endpoint,)))
        stack.callback(chief.close)
        agent.start()

        def step_until(holds: Callable[[], bool], news: Catalogue) -> None:
            def told() -> bool:
                chief.announce(news)
                agent.step(0.01)
                return holds()

            wait_until(told, "the agent hears")

        bad = Catalogue({0: LandmarkChange(1, True, 9.0, 0.0, 0.0)}, {3: AgentChange(1, True, "{}")})
        step_until(lambda: agent.unreadable > 0, bad)
        assert agent.node.catalogue is EMPTY
        assert "name: expected this key" in trouble[0]
        good = Catalogue({0: LandmarkChange(1, True, 9.0, 0.0, 0.0)})
        step_until(lambda: agent.node.catalogue == good, good)


# Processes.


@pytest.fixture
def changing(tmp_path: Path, mission: Mission) -> Path:
    """The file of a mission that changes."""
    file = tmp_path / "changing.json"
    file.write_text(json.dumps({**mission.source, "changes": CHANGES}), "utf-8")
    return file


def test_a_launched_team_carries_out_the_changes_of_its_mission(changing: Path) -> None:
    mission = load_mission(changing)
    deployment, report = launch(mission, changing, LaunchOptions(timeout=LONGEST))
    assert report.settled
    assert report.died == ()
    assert report.strangers == {}
    assert certify(deployment).holds
    changes = [entry.event for entry in deployment.history if entry.event in ("added", "removed", "joined", "left")]
    assert changes == ["added", "joined", "removed", "left"]
    assert "reweighted" in [entry.event for entry in deployment.history]
    assert [agent.name for agent in deployment.agents] == ["blue", "green", "orange"]
    assert len(deployment.mission.landmarks) == len(mission.landmarks)
    assert sorted(deployment.mission.landmarks.weights.tolist())[-4:] == [2.0, 2.0, 5.0, 5.0]
    endings = {agent["name"]: agent["ending"] for agent in report.agents}
    assert endings == {"red": "left", "blue": "released", "green": "released", "orange": "released"}


def test_a_visitor_kills_an_agent_lets_it_come_back_and_weighs_a_landmark(tmp_path: Path, mission: Mission) -> None:
    file = tmp_path / "small.json"
    file.write_text(json.dumps(mission.source), "utf-8")
    steering, refused, observers = Steering(paced=False), list[str](), list[Observer]()
    assert not steering.commands
    wishes: list[tuple[str, tuple[Command, ...]]] = [
        ("initial", (Kill(1), Revive(0), Kill(7), SetWeight(64, 1.0), SetWeight(3, math.inf))),
        ("death", (Revive(1), SetWeight(3, 9.0))),
    ]

    def steer(news: Progress) -> None:
        events = [entry.event for entry in observers[0].team.history] if observers else []
        if news.stage == "trading" and wishes and wishes[0][0] in events:
            for command in wishes.pop(0)[1]:
                steering.ask(command, refused.append)

    deployment, report = launch(
        load_mission(file),
        file,
        LaunchOptions(timeout=LONGEST),
        on_progress=steer,
        on_observer=observers.append,
        steering=steering,
    )
    assert report.settled
    assert certify(deployment).holds
    assert steering.commands == ("kill", "revive", "weight")
    assert [text.partition(":")[0] for text in refused] == ["agent", "agent", "landmark", "weight"]
    assert [one.name for one in report.exits if one.code < 0] == ["red"]
    events = [entry.event for entry in deployment.history]
    assert {"death", "return", "reweighted"} <= set(events)
    assert len(deployment.agents[1].landmarks) > 0
    assert deployment.mission.landmarks.weights[3] == 9.0


@pytest.fixture
def team(tmp_path: Path, mission: Mission) -> Iterator[tuple[Path, str, Callable[..., subprocess.Popen[bytes]]]]:
    """A mission's file, two of whose agents stay until they are let go, where one listens, and how to start another."""
    file, endpoint = tmp_path / "small.json", free_endpoint()
    file.write_text(json.dumps(mission.source), "utf-8")
    started: list[subprocess.Popen[bytes]] = []

    def start(name: str, *more: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-W", "error", "-m", "covey", "agent", "--mission", str(file), "--attached"]
        process = subprocess.Popen(
            [*command, "--name", name, "--wait", "1", *more], stdin=subprocess.PIPE, stderr=subprocess.PIPE
        )
        started.append(process)
        return process

    start("blue", "--listen", endpoint)
    start("red", "--connect", endpoint)
    try:
        yield file, endpoint, start
    finally:
        for process in started:
            process.kill()
            process.communicate()


def run(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as ended:
        main(list(arguments))
    printed = capsys.readouterr()
    return int(ended.value.code or 0), printed.out, printed.err


def test_an_operator_changes_a_team_that_was_started_by_hand(
    team: tuple[Path, str, Callable[..., subprocess.Popen[bytes]]], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file, endpoint, start = team
    (tmp_path / "orange.yaml").write_text("name: orange\npose: {x_m: 0.1, y_m: 0.2}\n", "utf-8")

    def change(*words: str) -> tuple[int, str, str]:
        return run(capsys, "change", str(file), "--connect", endpoint, "--timeout", str(PATIENCE), *words)

    code, said, err = change("--reweight", "3", "--reweight", "4", "--weight", "7")
    assert (code, err) == (0, "")
    assert said.startswith("landmarks 3, 4 reweighted; known to blue")
    code, said, err = change("--join", str(tmp_path / "orange.yaml"), "--json")
    assert (code, json.loads(said)["event"], err) == (0, "joined", "")
    joined = start("orange", "--connect", endpoint)

    code, _, err = change("--join", str(tmp_path / "orange.yaml"))
    assert code == 2
    assert "join.name: expected a new name, got 'orange'" in err
    code, _, err = change("--remove", "64")
    assert code == 2
    assert "expected a landmark from 0 to 63, got 64" in err

    def watch() -> list[str]:
        words = ("--observe", "--connect", endpoint, "--out", str(tmp_path / "seen"), "--force", "--quiet")
        code, _, err = run(capsys, "launch", str(file), *words, "--timeout", str(PATIENCE))
        assert code == 0, err
        assert certify(tmp_path / "seen").holds
        return [agent.name for agent in read_result(tmp_path / "seen").agents if len(agent.landmarks)]

    wait_until(lambda: watch() == ["blue", "red", "orange"], "orange takes part")
    code, said, err = change("--leave", "orange")
    assert (code, err) == (0, "")
    assert joined.wait(PATIENCE) == 0
    assert watch() == ["blue", "red"]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ((), "expected exactly one of --add, --remove, --reweight, --join and --leave, got none"),
        (("--remove", "1", "--leave", "red"), "got --remove, --leave"),
        (("--reweight", "1"), "--weight: expected what the landmarks are worth"),
        (("--add", "1;2"), "--add: expected X,Y in metres, got '1;2'"),
        (("--add", "1,2,3"), "--add: expected X,Y in metres, got '1,2,3'"),
        (("--add", "nan,2"), "--add: expected X,Y in metres, got 'nan,2'"),
        (("--remove", "1", "--connect", "nonsense"), "expected one such as tcp/"),
        (("--join", "absent.yaml"), "absent.yaml"),
        (("--remove", "1", "--timeout", "1"), "is heard of none of its agents"),
    ],
)
def test_bad_input_is_one_error(
    tmp_path: Path, mission: Mission, words: tuple[str, ...], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "small.json"
    file.write_text(json.dumps(mission.source), "utf-8")
    code, out, err = run(capsys, "change", str(file), "--connect", free_endpoint(), *words)
    assert (code, out) == (2, "")
    assert said in err
    assert "Traceback" not in err


def test_an_agent_of_whom_nobody_knows_says_so(
    tmp_path: Path, mission: Mission, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "small.json"
    file.write_text(json.dumps(mission.source), "utf-8")
    code, _, err = run(capsys, "agent", "--mission", str(file), "--name", "pink", "--wait", "0.3")
    assert code == 2
    assert "--name: expected an agent of the mission: blue, red, green; or one that joins it, got 'pink'" in err


def test_added_landmarks_may_have_numbers_that_others_have_not_heard_of(mission: Mission) -> None:
    """What is added in two steps may be heard of in the other order."""
    n = len(mission.landmarks)
    view = ObservedTeam(mission, np.arange(n) % 3)
    view.learn(Catalogue({n + 1: LandmarkChange(2, True, 1.0, 0.5, 0.5)}))
    assert len(view.standing().mission.landmarks) == n + 1
    view.learn(Catalogue({n: LandmarkChange(1, True, 3.0, 0.5, 0.5)}))
    standing = view.standing()
    assert isinstance(standing.mission.landmarks, Landmarks)
    assert standing.mission.landmarks.weights[-2:].tolist() == [3.0, 1.0]
