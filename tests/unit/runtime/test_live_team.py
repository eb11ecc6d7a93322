"""A team to play with: killed, revived, on a bus that loses messages."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from covey.mission import Mission, parse_mission
from covey.runtime.live_team import MOST_LOSS, LiveTeam
from covey.runtime.watching.feed import Activity, ChangeKind, Ended, Health, Note, Scene, TeamChange, Update
from covey.runtime.watching.steering import Command, Kill, Revive, SetLoss, SetWeight, Steering
from covey.runtime.watching.view import TeamView


def mission() -> Mission:
    scene: dict[str, Any] = {
        "schema_version": 1,
        "name": "field",
        "seed": 3,
        "environment": {
            "landmarks": {"grid": {"x_m": [-3, 3], "y_m": [-3, 3], "spacing_m": 1}},
            "region": {"box": {"x_m": [-3, 3], "y_m": [-3, 3]}},
        },
        "agents": [
            {"name": "blue", "pose": {"x_m": -3, "y_m": -3}},
            {"name": "red", "pose": {"x_m": 3, "y_m": -3}},
            {"name": "green", "pose": {"x_m": 0, "y_m": 3}},
        ],
    }
    return parse_mission(json.dumps(scene), format="json")


class Play:
    """A team, what it told, and what its visitors were refused."""

    def __init__(self) -> None:
        self.told: list[Scene | Update] = []
        self.refused: list[str] = []
        self.view = TeamView()
        self.steering = Steering()
        self.team = LiveTeam(mission(), watch=self.watch, steering=self.steering)

    def watch(self, item: Scene | Update) -> None:
        self.told.append(item)
        self.view.apply(item)

    def run(self, *commands: Command) -> None:
        """Play until nothing is left to do, then ask for the next thing, and so on to the end."""
        waiting = list(commands)
        asked_at = 0.0

        def until() -> bool:
            nonlocal asked_at
            if not (self.team.over and self.team.bus.now > asked_at + 4.0):
                return False
            if not waiting:
                return True
            asked_at = self.team.bus.now
            self.steering.ask(waiting.pop(0), self.refused.append)
            return False

        self.team.play(until=until, on_progress=lambda news: None)

    def kinds(self) -> list[ChangeKind]:
        return [item.kind for item in self.told if isinstance(item, TeamChange)]


def test_a_team_at_rest_tells_every_second_who_was_heard_when() -> None:
    play = Play()
    play.run(Kill(1))
    quiet = [item for item in play.told if isinstance(item, Health)]
    assert max(np.diff([health.time for health in quiet])) < 2.0
    assert quiet[-1].time > 4.0
    silence = quiet[-1].time - quiet[-1].heard
    assert silence[1] > 3.0
    assert max(silence[0], silence[2]) < 1.0


def test_the_team_settles_as_told() -> None:
    play = Play()
    play.run()
    assert play.refused == []
    ended = play.told[-1]
    assert isinstance(ended, Ended)
    assert ended.status == "settled"
    np.testing.assert_array_equal(play.view.owner, play.team.owner)
    np.testing.assert_allclose(play.view.scores, play.team.scores)
    assert play.view.trades == play.team.trades > 0
    for agent, node in enumerate(play.team.nodes):
        np.testing.assert_array_equal(node.landmarks, np.flatnonzero(play.view.owner == agent))
    assert set(play.view.activity) == {Activity.QUIESCENT}
    assert play.steering.commands == ("pause", "resume", "step", "speed", "kill", "revive", "weight", "loss")


def test_landmarks_of_the_killed_are_adopted_and_traded_back() -> None:
    play = Play()
    play.run(Kill(1), Revive(1))
    kinds = [kind for kind in play.kinds() if kind in (ChangeKind.DEATH, ChangeKind.ADOPTION, ChangeKind.RETURN)]
    assert kinds[0] is ChangeKind.DEATH
    assert kinds[1] is ChangeKind.ADOPTION
    death = next(item for item in play.told if isinstance(item, TeamChange) and item.kind is ChangeKind.DEATH)
    returned = next(item for item in play.told if isinstance(item, TeamChange) and item.kind is ChangeKind.RETURN)
    assert (death.agents, returned.agents) == ((1,), (1,))
    between = TeamView()
    for item in play.told[: play.told.index(returned)]:
        between.apply(item)
    assert 1 not in between.owner
    assert between.scores[1] == 0.0
    assert between.activity[1] == Activity.DEAD
    assert any(isinstance(item, Note) and item.kind == "buried" for item in play.told)
    assert 1 in play.view.owner
    assert play.view.activity[1] == Activity.QUIESCENT
    assert play.view.score > between.score


def test_a_lossy_bus_only_slows_the_team_down() -> None:
    play = Play()
    play.steering.ask(SetLoss(0.2), play.refused.append)
    play.run()
    assert play.steering.loss == 0.2
    healths = [item for item in play.told if isinstance(item, Health)]
    assert healths[-1].link.tolist() == [0.8, 0.8, 0.8]
    assert isinstance(play.told[-1], Ended)
    assert play.told[-1].status == "settled"


@pytest.mark.parametrize("loss", [0.0, 0.3])
def test_a_landmark_that_is_worth_more_draws_its_owner(loss: float) -> None:
    play = Play()
    play.steering.ask(SetLoss(loss), play.refused.append)
    play.run(Kill(2), SetWeight(0, 40.0), Revive(2), SetWeight(35, 0.0))
    assert play.refused == []
    assert play.view.weights[[0, 1, 35]].tolist() == [40.0, 1.0, 0.0]
    np.testing.assert_array_equal(play.view.weights, play.team.planner.weights)
    np.testing.assert_allclose(play.view.scores, play.team.scores)
    assert play.kinds().count(ChangeKind.LANDMARKS) == 2
    owner = play.team.owner[0]
    assert play.team.planner.visibility(owner, play.team.poses[owner])[0] > 0.9
    for node in play.team.nodes:  # the one that was dead meanwhile has heard of it as well
        assert node.catalogue.digest == play.team.planner.catalogue.digest


@pytest.mark.parametrize(
    ("command", "reason"),
    [
        (Kill(3), "expected one that lives"),
        (Kill(-1), "expected one that lives"),
        (Revive(0), "expected one that was killed"),
        (SetLoss(1.0), f"expected 0 to {MOST_LOSS}"),
        (SetLoss(-0.1), "expected 0 to"),
        (SetWeight(36, 1.0), "expected one of 36"),
        (SetWeight(0, -1.0), "expected a finite number"),
        (SetWeight(0, float("nan")), "expected a finite number"),
    ],
)
def test_what_cannot_be_done_is_refused(command: Command, reason: str) -> None:
    play = Play()
    play.run(command)
    assert len(play.refused) == 1
    assert reason in play.refused[0]


def test_the_last_one_is_not_killed() -> None:
    play = Play()
    play.run(Kill(0), Kill(0), Kill(1), Kill(2))
    assert [text.partition(":")[2] for text in play.refused] == [" expected one that lives", " it is the last one"]


def test_the_same_seed_plays_the_same() -> None:
    first, second = Play(), Play()
    first.run(Kill(2), Revive(2))
    second.run(Kill(2), Revive(2))
    texts = [[item.text for item in play.told if isinstance(item, TeamChange)] for play in (first, second)]
    assert texts[0] == texts[1]
