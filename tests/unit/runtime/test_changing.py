"""Missions whose landmarks and agents change while the team is at work."""

from __future__ import annotations

import itertools
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests.unit.runtime.small import AGENTS, small

from covey import certify, plan
from covey.errors import InputError, MissionError
from covey.mission import Mission, agent_text, parse_mission, read_agent
from covey.runtime.changing import UNHEARD
from covey.runtime.fly import fly
from covey.runtime.records.record import read_result
from covey.runtime.result import Deployment
from covey.runtime.watching.feed import Activity, ChangeKind, Scene, TeamChange, Update
from covey.runtime.watching.view import TeamView

GREY = {"name": "grey", "pose": {"x_m": 0.0, "y_m": 0.0, "yaw_deg": 0.0}}
ADD = {"add": {"points": [[1.5, 2.5], [1.7, 2.5]], "weight": 2.0}}
REMOVE = {"remove": [0, 1, 8, 9]}
REWEIGHT = {"reweight": {"landmarks": [63, 62], "weight": 5.0}}
EVERYTHING: list[dict[str, Any]] = [
    {"after_trades": 2, **ADD},
    REMOVE,
    {"reweight": {"landmarks": [64, 63], "weight": 5.0}},
    {"join": GREY},
    {"leave": "red"},
    {"at_s": 0.01, "remove": [65]},
]


def changing(*changes: dict[str, Any], seed: int = 3, **more: Any) -> Mission:
    """Build the small mission with changes."""
    document = {
        "schema_version": 1,
        "name": "changing",
        "seed": seed,
        "environment": {
            "landmarks": {"grid": {"x_m": [-2, 2], "y_m": [-2, 2], "spacing_m": 0.5}},
            "region": {"box": {"x_m": [-3, 3], "y_m": [-3, 3]}},
        },
        "sensor": {"model": "anisotropic", "optimal_distance_m": 0.7},
        "agents": AGENTS,
        "changes": list(changes),
        **more,
    }
    return parse_mission(json.dumps(document), format="json")


def events(deployment: Deployment) -> list[str]:
    return [entry.event for entry in deployment.history]


@pytest.mark.parametrize("seed", range(3))
def test_a_team_settles_again_after_every_change(seed: int, tmp_path: Path) -> None:
    deployment = plan(changing(*EVERYTHING, seed=seed))
    assert deployment.certificate is not None
    assert deployment.certificate.holds
    assert [event for event in events(deployment) if event in ("added", "removed", "reweighted", "joined", "left")] == [
        "added",
        "removed",
        "reweighted",
        "joined",
        "left",
        "removed",
    ]
    assert [agent.name for agent in deployment.agents] == ["blue", "green", "grey"]
    assert len(deployment.mission.landmarks) == 64 + 2 - 4 - 1
    assert sum(len(agent.landmarks) for agent in deployment.agents) == len(deployment.mission.landmarks)
    assert sorted(set(deployment.mission.landmarks.weights.tolist())) == [1.0, 5.0]
    deployment.save(tmp_path / "out")
    again = read_result(tmp_path / "out")
    assert certify(again).holds
    assert again.history == deployment.history


@pytest.mark.parametrize("seed", range(4))
def test_the_score_falls_only_where_the_log_says_why(seed: int) -> None:
    history = plan(changing(*EVERYTHING, seed=seed)).history
    for before, after in itertools.pairwise(history):
        if after.event not in ("added", "removed", "reweighted", "joined", "left"):
            assert after.score >= before.score - 1e-9 or after.detail == UNHEARD, after
    settled = max(i for i, entry in enumerate(history) if entry.event == "adoption" or entry.detail)
    assert all(after.score >= before.score - 1e-9 for before, after in itertools.pairwise(history[settled:]))


def test_the_log_tells_what_became_of_what_a_leaver_owned() -> None:
    history = plan(changing(*EVERYTHING)).history
    left = next(i for i, entry in enumerate(history) if entry.event == "left")
    assert history[left].agents == ("red",)
    assert history[left].score < history[left - 1].score
    assert any(entry.event == "adoption" for entry in history[left:])
    removed = next(entry for entry in history if entry.event == "removed")
    assert removed.detail == "landmarks 0, 1, 8, 9"


def test_watchers_hear_who_adopts_and_not_who_loses_by_it() -> None:
    items: list[Scene | Update] = []
    plan(changing(*EVERYTHING, seed=0), watch=items.append)
    scenes = [item for item in items if isinstance(item, Scene)]
    names = [agent.name for agent in scenes[-1].agents]
    changes = [item for item in items if isinstance(item, TeamChange) and item.kind is ChangeKind.ADOPTION]
    assert any(len(item.agents) > 1 for item in changes)
    assert all(item.text.startswith(f"{names[item.agents[0]]} adopts ") for item in changes)


def test_the_same_seed_gives_the_same_deployment() -> None:
    first, second = (plan(changing(*EVERYTHING)) for _ in range(2))
    assert first.history == second.history
    assert first.poses == second.poses


def test_nothing_is_left_of_what_is_removed() -> None:
    deployment = plan(changing(REMOVE))
    grid = small().landmarks.positions_W
    kept = np.setdiff1d(np.arange(64), REMOVE["remove"])
    assert np.array_equal(deployment.mission.landmarks.positions_W, grid[kept])


def test_what_becomes_worth_more_is_seen_better() -> None:
    before, after = plan(changing()), plan(changing(REWEIGHT))

    def seen(deployment: Deployment, k: int) -> float:
        from covey.runtime.agent import build_models

        agent = int(deployment.owner[k])
        pose = deployment.poses[agent].as_array()[None]
        return float(build_models(deployment.mission)[agent].visibility(pose, deployment.mission.landmarks)[0, k])

    assert sum(seen(after, k) for k in (62, 63)) > sum(seen(before, k) for k in (62, 63))


def test_who_joins_takes_part_and_helps() -> None:
    without, more = plan(changing()), plan(changing({"join": {**GREY, "sensor": {"model": "isotropic"}}}))
    assert more.score.final > without.score.final
    assert len(more.agents[3].landmarks) > 0
    assert more.mission.agents[3].sensor.model == "isotropic"


def test_links_and_changes_go_together() -> None:
    mission = changing({"join": GREY}, communication={"links": [["blue", "red"], ["red", "green"]]})
    deployment = plan(mission)
    assert deployment.certificate is not None
    assert deployment.certificate.holds
    assert deployment.certificate.links is not None
    assert deployment.certificate.links.groups == (("blue", "red", "green"), ("grey",))


@pytest.mark.parametrize(
    ("change", "key", "says"),
    [
        ({}, "changes[0]", "exactly one of add, remove"),
        ({**ADD, **REMOVE}, "changes[0]", "got add, remove"),
        ({"at_s": 1.0, "after_trades": 3, **REMOVE}, "changes[0]", "at most one of after_trades and at_s"),
        ({"remove": [64]}, "changes[0].remove[0]", "from 0 to 63, got 64"),
        ({"remove": list(range(64))}, "changes[0].remove", "a landmark to be left"),
        ({"reweight": {"landmarks": [3], "weight": -1.0}}, "changes[0].reweight.weight", "-1"),
        ({"join": {**GREY, "name": "red"}}, "changes[0].join.name", "a new name"),
        ({"join": {"name": "grey"}}, "changes[0].join", "expected a pose"),
        ({"join": {"name": "grey", "pose": {"x_m": 9.0, "y_m": 0.0}}}, "changes[0].join.pose", "6 m outside"),
        ({"leave": "rde"}, "changes[0].leave", "did you mean 'red'"),
        ({"add": {"points": [[0.0, 0.0]], "normal_deg": 3.0}}, "changes[0].add", "no normal_deg"),
    ],
)
def test_a_change_that_cannot_be_made_is_refused(change: dict[str, Any], key: str, says: str) -> None:
    with pytest.raises(MissionError) as caught:
        changing(change)
    assert any(mistake.key == key and says in mistake.message + mistake.hint for mistake in caught.value.mistakes), (
        caught.value.mistakes
    )


def test_changes_are_checked_with_those_before_them_in_mind() -> None:
    changing(ADD, {"remove": [64, 65]})
    for second in (REMOVE, {"remove": [64]}):
        with pytest.raises(MissionError, match=r"changes\[1\]"):
            changing(REMOVE, second)
    with pytest.raises(MissionError, match="an agent to be left"):
        changing({"leave": "blue"}, {"leave": "red"}, {"leave": "green"})


def test_a_description_that_travels_is_checked() -> None:
    mission = changing()
    assert read_agent(mission, 3, agent_text(GREY)).pose.x == 0.0
    outside = agent_text({"name": "grey", "pose": {"x_m": 9.0, "y_m": 0.0}})
    for text in ("", "[]", "{}", '{"name": 3}', outside, "x" * 70_000):
        with pytest.raises(InputError, match="agent 3"):
            read_agent(mission, 3, text)


def test_a_mission_without_changes_is_planned_as_ever() -> None:
    mission = changing()
    deployment = plan(mission)
    assert deployment.history == plan(replace(mission, changes=())).history
    assert all(entry.detail == "" for entry in deployment.history)


def test_changes_are_not_flown() -> None:
    with pytest.raises(InputError, match="only `covey plan` and `covey launch` act on them"):
        fly(changing(REMOVE), vehicles="kinematic")


def test_who_watches_is_told_of_every_change() -> None:
    view, kinds, scenes = TeamView(), [], 0

    def watch(item: Scene | Update) -> None:
        nonlocal scenes
        view.apply(item)
        scenes += isinstance(item, Scene)
        if isinstance(item, TeamChange):
            kinds.append(item.kind)
            assert item.score == pytest.approx(view.scores.sum())

    mission = changing(*EVERYTHING)
    deployment = plan(mission, watch=watch)
    assert deployment.history == plan(mission).history
    assert scenes == 3  # at the start, with landmarks more, with an agent more
    assert kinds.count(ChangeKind.LANDMARKS) == 4
    assert kinds.count(ChangeKind.JOINED) == kinds.count(ChangeKind.LEFT) == 1
    assert ChangeKind.ADOPTION in kinds
    assert view.score == pytest.approx(deployment.score.final)
    assert view.scene is not None
    names = [agent.name for agent in view.scene.agents]
    gone = names.index("red")
    assert view.health is not None
    assert view.health.activity[gone] == Activity.GONE
    assert not (view.owner == gone).any()
    removed = view.weights == 0.0
    assert removed.sum() == 5
    for agent in deployment.agents:
        here = view.scene.positions_W[view.owner == names.index(agent.name), :2]
        assert np.array_equal(here, deployment.mission.landmarks.positions_W[agent.landmarks])
