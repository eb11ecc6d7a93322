"""What watchers are told of a team on the network."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from tests.unit.runtime.small import small

from covey.coverage import agent_scores, team_visibility
from covey.errors import Drop
from covey.flight.layout import OBSERVATION, QUAT, P, V
from covey.geometry import Pose2
from covey.protocol import (
    AgentBuried,
    AgentChange,
    AgentReturned,
    Catalogue,
    Cause,
    Heartbeat,
    LandmarkChange,
    LandmarksAdopted,
    OfferStands,
    PoseOptimized,
    PoseRecord,
    RecordSlice,
    Sender,
    TradeCommitted,
    TradeId,
)
from covey.runtime.network.network_telling import REPORTED_EVERY, NetworkTeller
from covey.runtime.network.observer import Content, Observer
from covey.runtime.watching.feed import (
    Activity,
    ChangeKind,
    Ended,
    Health,
    Motion,
    Run,
    Scene,
    TeamChange,
    TeamState,
    Trading,
    Update,
    Weights,
)
from covey.runtime.watching.view import TeamView
from covey.transports.telemetry import Telemetry

DEAD_AFTER = 3.0


class Network:
    """An observer that hears what is written here, and what is told of it."""

    def __init__(self) -> None:
        self.said: list[Content] = []
        self.now = 0.0
        self.dropped: Mapping[Drop, int] = {}
        self.told: list[Scene | Update] = []
        self.view = TeamView()
        self.mission = small()
        self.observer = Observer(self.mission, self, clock=lambda: self.now)
        self.teller = NetworkTeller(self.watch, self.observer, dead_after=DEAD_AFTER)

    def watch(self, item: Scene | Update) -> None:
        self.told.append(item)
        self.view.apply(item)

    def receive(self) -> list[Content]:
        said, self.said = self.said, []
        return said

    def wait(self, timeout: float) -> bool:
        self.now += timeout
        return bool(self.said)

    def ask_for_maps(self) -> None:
        pass

    def hear(self, *content: Content, after: float = 0.1) -> list[Scene | Update]:
        """Let the observer hear something; return what is told of it."""
        known = len(self.told)
        self.said = list(content)
        self.observer.step(after)
        self.teller.update()
        return self.told[known:]


def beat(agent: int, *, quiescent: bool = False) -> Heartbeat:
    return Heartbeat(Sender(agent, 1), 1, quiescent, 3, PoseRecord(1, 0, Pose2(0.0, 0.0, 0.0)), {}, {}, b"")


@pytest.fixture
def network() -> Network:
    return Network()


def test_scene_and_state_come_first(network: Network) -> None:
    scene, state = network.told
    assert isinstance(scene, Scene)
    assert scene.run is Run.NETWORK
    assert isinstance(state, TeamState)
    np.testing.assert_array_equal(state.owner, network.observer.team.owner)
    assert set(state.activity) == {Activity.GONE}


def test_events_become_changes(network: Network) -> None:
    moved = Pose2(0.5, 0.25, 1.0)
    told = network.hear(beat(0), PoseOptimized(0, moved, 0.0, 1.0, Cause.OPTIMIZER))
    (change,) = (item for item in told if isinstance(item, TeamChange))
    assert (change.kind, change.agents, change.posed) == (ChangeKind.OPTIMIZATION, (0,), (0,))
    np.testing.assert_allclose(change.poses[0, :2], [0.5, 0.25])
    n = len(network.mission.landmarks)
    halves = np.arange(n // 2), np.arange(n // 2, n)
    pose = network.mission.agents[1].pose
    told = network.hear(TradeCommitted(TradeId(1, 0, 1), 1, 0, pose, moved, halves[0], halves[1], n, 0.0, 1.0))
    (change,) = (item for item in told if isinstance(item, TeamChange))
    assert (change.kind, change.agents) == (ChangeKind.TRADE, (1, 0))
    np.testing.assert_array_equal(network.view.owner, network.observer.team.owner)
    assert network.view.trades == 1
    np.testing.assert_allclose(network.view.scores, network.observer.team.scores)


def test_what_is_heard_at_once_is_told_change_by_change(network: Network) -> None:
    poses = [Pose2(0.1 * index, 0.0, 0.0) for index in range(4)]
    told = network.hear(*(PoseOptimized(0, pose, 0.0, 1.0, Cause.OPTIMIZER) for pose in poses))
    changes = [item for item in told if isinstance(item, TeamChange)]
    assert [item.score for item in changes] == [entry.score for entry in network.observer.team.history[1:]]
    assert len({item.score for item in changes}) == 4  # each tells what the team had then, not what it has now
    np.testing.assert_allclose(network.view.poses[0, :2], [0.3, 0.0])


def test_each_of_several_trades_says_how_many_landmarks_moved(network: Network) -> None:
    pose, n = Pose2(0.0, 0.0, 0.0), len(network.mission.landmarks)
    all_of_them, none = np.arange(n), np.arange(0)
    trades = [
        TradeCommitted(TradeId(0, other, 1), 0, other, pose, pose, all_of_them, none, moved, 0.0, 1.0)
        for other, moved in ((1, 3), (2, 5))
    ]
    texts = [item.text for item in network.hear(*trades) if isinstance(item, TeamChange)]
    assert ["3 landmarks" in texts[0], "5 landmarks" in texts[1]] == [True, True]


def test_silence_is_seen_even_if_nobody_speaks(network: Network) -> None:
    network.hear(beat(0), beat(1, quiescent=True))
    assert network.view.activity.tolist() == [Activity.IDLE, Activity.QUIESCENT, Activity.GONE]
    network.hear(after=0.6 * DEAD_AFTER)
    assert network.view.activity.tolist() == [Activity.SUSPECT, Activity.SUSPECT, Activity.GONE]
    network.hear(beat(1), after=0.6 * DEAD_AFTER)
    assert network.view.activity.tolist() == [Activity.DEAD, Activity.IDLE, Activity.GONE]
    health = network.view.health
    assert isinstance(health, Health)
    assert np.isnan(health.heard[2])
    assert health.heard[1] == pytest.approx(network.now)


def test_death_adoption_and_return(network: Network) -> None:
    network.hear(beat(0), beat(1), beat(2))
    network.hear(after=1.1 * DEAD_AFTER)
    own = np.flatnonzero(network.observer.team.owner == 1)
    values = np.tile(np.array([2, 1, 0, 1], dtype=np.int64), (len(own), 1))
    told = network.hear(beat(0), beat(2), AgentBuried(0, 1), LandmarksAdopted(0, RecordSlice(own, values)))
    kinds = [item.kind for item in told if isinstance(item, TeamChange)]
    assert kinds == [ChangeKind.DEATH, ChangeKind.ADOPTION]
    assert network.view.scores[1] == 0.0
    assert 1 not in network.view.owner
    told = network.hear(beat(1), AgentReturned(0, Sender(1, 2)))
    assert [item.kind for item in told if isinstance(item, TeamChange)] == [ChangeKind.RETURN]
    assert network.view.activity[1] == Activity.IDLE


def offer(server: int, number: int, give: list[int], want: list[int], *, stands: bool = True) -> OfferStands:
    client = (server + 1) % 3
    return OfferStands(TradeId(client, 1, number), client, server, np.array(give), np.array(want), stands)


def white(network: Network) -> list[int]:
    return np.flatnonzero(network.view.trading).tolist()


def test_landmarks_are_white_while_an_offer_stands(network: Network) -> None:
    (told,) = (item for item in network.hear(beat(0), offer(0, 1, [1, 4], [2])) if isinstance(item, Trading))
    assert (told.client, told.server, told.open) == (1, 0, True)
    assert white(network) == [1, 2, 4]
    network.hear(offer(2, 1, [7], []))
    assert white(network) == [1, 2, 4, 7]
    network.hear(offer(0, 1, [1, 4], [2], stands=False))
    assert white(network) == [7]
    network.hear(offer(0, 1, [1, 4], [2], stands=False))  # told twice
    assert white(network) == [7]


def test_an_offer_whose_end_nobody_tells_is_closed_all_the_same(network: Network) -> None:
    network.hear(beat(0), beat(1), beat(2), offer(0, 1, [1], []), offer(1, 1, [2], []), offer(2, 1, [3], []))
    network.hear(offer(0, 2, [5], []))  # in a new life
    assert white(network) == [2, 3, 5]
    network.hear(AgentBuried(0, 1))
    assert white(network) == [3, 5]
    network.teller.end("settled", True)
    assert white(network) == []


def test_what_changes_is_told_with_a_new_scene_where_there_is_more(network: Network) -> None:
    n = len(network.mission.landmarks)
    before = network.view.scene
    planner = network.observer.team.planner
    network.observer.learn(Catalogue({3: planner.landmark(3)._replace(version=1, weight=9.0)}))
    told = network.hear(beat(0))
    assert [type(item).__name__ for item in told if isinstance(item, (Weights, Scene))] == ["Weights"]
    assert network.view.weights[3] == 9.0
    (change,) = (item for item in told if isinstance(item, TeamChange))
    assert change.text.startswith("landmarks 3 reweighted; score ")
    joins = AgentChange(3, True, '{"name": "orange", "pose": {"x_m": 0, "y_m": 0}}')
    network.observer.learn(Catalogue({n: LandmarkChange(2, True, 2.0, 1.0, 1.0)}, {3: joins}))
    told = network.hear(beat(3))
    assert network.view.scene is not None
    assert network.view.scene is not before
    assert [agent.name for agent in network.view.scene.agents] == ["blue", "red", "green", "orange"]
    assert len(network.view.owner) == len(network.view.weights) == n + 1
    assert [item.kind for item in told if isinstance(item, TeamChange)] == [ChangeKind.LANDMARKS, ChangeKind.JOINED]
    network.observer.learn(Catalogue(agents={1: AgentChange(4, False)}))
    network.hear(beat(3))
    assert network.view.activity[1] == Activity.GONE
    assert 1 not in network.view.owner


def fly(network: Network, agent: int, pose: Pose2, *, battery: float = math.nan, speed: float = 1.0) -> Telemetry:
    """The report of a vehicle at a pose."""
    state = np.zeros(OBSERVATION)
    state[P : P + 3] = pose.x, pose.y, network.mission.flight.altitudes(3)[agent]
    state[V] = speed
    state[QUAT : QUAT + 4] = math.cos(0.5 * pose.yaw), 0.0, 0.0, math.sin(0.5 * pose.yaw)
    return Telemetry(Sender(agent, 1), state, battery)


def motions(told: list[Scene | Update]) -> list[Motion]:
    return [item for item in told if isinstance(item, Motion)]


def test_of_a_team_without_vehicles_no_motion_is_told(network: Network) -> None:
    told = network.hear(beat(0), beat(1), beat(2), PoseOptimized(0, Pose2(0.5, 0.0, 0.0), 0.0, 1.0, Cause.OPTIMIZER))
    network.teller.end("settled", True)
    assert motions(told + network.told) == []
    assert network.view.poses[:, 2].tolist() == [0.0, 0.0, 0.0]
    assert network.view.scene is not None
    assert network.view.scene.body_radius == 0.0


def test_the_first_report_brings_the_third_dimension(network: Network) -> None:
    told = network.hear(beat(0), fly(network, 0, Pose2(0.5, 0.25, 1.0)))
    kinds = [type(item) for item in told if not isinstance(item, Health)]
    assert kinds == [Scene, TeamState, Motion]
    assert network.view.scene is not None
    assert network.view.scene.body_radius > 0.0
    np.testing.assert_array_equal(network.view.poses[:, 2], network.mission.flight.altitudes(3))


def test_who_is_not_heard_is_where_it_committed_to_be(network: Network) -> None:
    (motion,) = motions(network.hear(beat(0), fly(network, 0, Pose2(0.5, 0.25, 1.0))))
    assert motion.time == network.now
    np.testing.assert_allclose(motion.poses[0, :2], [0.5, 0.25])
    np.testing.assert_allclose(motion.poses[0, 3:], [math.cos(0.5), 0.0, 0.0, math.sin(0.5)])
    assert motion.velocities_W[0].tolist() == [1.0, 0.0, 0.0]
    np.testing.assert_array_equal(motion.poses[1:], network.view.poses[1:])
    assert np.isnan(motion.velocities_W[1:]).all()
    assert np.isnan(motion.rates_B[1:]).all()
    assert math.isnan(motion.score_flown)
    assert math.isnan(motion.separation)


def test_the_score_flown_is_that_of_the_true_poses(network: Network) -> None:
    poses = [Pose2(0.5, 0.25, 1.0), Pose2(-1.0, 1.5, 2.0), Pose2(1.0, -1.0, 0.0)]
    told = network.hear(*map(beat, range(3)), *(fly(network, agent, pose) for agent, pose in enumerate(poses)))
    network.hear(after=2.0 * REPORTED_EVERY)
    motion = network.view.motion
    assert motion is not None
    team = network.observer.team
    seen = team_visibility(team.planner.models, poses, network.mission.landmarks)
    expected = agent_scores(seen, team.owner, network.mission.landmarks.weights).sum()
    assert motion.score_flown == pytest.approx(expected)
    assert math.isnan(motions(told)[0].score_flown)  # of the others nothing was known then
    assert network.view.scores.sum() == pytest.approx(team.score)


def test_motions_are_told_as_often_as_is_useful(network: Network) -> None:
    told: list[Scene | Update] = []
    for step in range(100):
        told += network.hear(fly(network, step % 3, Pose2(0.01 * step, 0.0, 0.0)), after=0.25 * REPORTED_EVERY)
    times = [motion.time for motion in motions(told)]
    assert 20 <= len(times) <= 26
    assert min(np.diff(times)) >= REPORTED_EVERY - 1e-9
    assert motions(network.hear(after=2.0 * REPORTED_EVERY)) != []  # the last of them
    assert motions(network.hear(after=2.0 * REPORTED_EVERY)) == []  # nothing is new
    network.hear(fly(network, 0, Pose2(1.0, 0.0, 0.0)), fly(network, 0, Pose2(1.5, 0.0, 0.0)), after=0.0)
    network.teller.end("settled", True)
    assert network.view.motion is not None
    assert network.view.motion.poses[0, 0] == 1.5


def test_who_is_on_its_way_flies_and_who_is_there_does_not(network: Network) -> None:
    goals = network.observer.team.poses
    away = Pose2(goals[0].x - 1.0, goals[0].y, goals[0].yaw)
    turned = Pose2(goals[1].x, goals[1].y, goals[1].yaw + 1.0)
    network.hear(*map(beat, range(3)), *(fly(network, i, pose) for i, pose in enumerate((away, turned, goals[2]))))
    assert network.view.activity.tolist() == [Activity.FLYING, Activity.FLYING, Activity.IDLE]
    network.hear(beat(0), fly(network, 0, goals[0]))
    assert network.view.activity.tolist() == [Activity.IDLE, Activity.FLYING, Activity.IDLE]
    network.hear(beat(1, quiescent=True))  # it hovers at the edge of what counts as there
    assert network.view.activity.tolist() == [Activity.IDLE, Activity.QUIESCENT, Activity.IDLE]


def test_of_a_vehicle_that_falls_silent_the_last_is_shown_and_no_speed(network: Network) -> None:
    network.hear(beat(0), beat(1), fly(network, 0, Pose2(0.5, 0.25, 1.0), battery=0.75))
    for _ in range(4):
        network.hear(beat(1), fly(network, 1, Pose2(1.0, 0.0, 0.0)), after=0.3 * DEAD_AFTER)
    motion, health = network.view.motion, network.view.health
    assert motion is not None
    assert health is not None
    np.testing.assert_allclose(motion.poses[0, :2], [0.5, 0.25])
    assert np.isnan(motion.velocities_W[0]).all()
    assert motion.velocities_W[1, 0] == 1.0
    assert health.activity[0] == Activity.DEAD
    assert health.battery[0] == 0.75
    assert np.isnan(health.battery[1:]).all()


def test_when_all_fall_silent_no_speed_and_no_score_are_shown(network: Network) -> None:
    goals = network.observer.team.poses
    network.hear(*map(beat, range(3)), *(fly(network, agent, pose) for agent, pose in enumerate(goals)))
    network.hear(after=2.0 * REPORTED_EVERY)
    assert network.view.motion is not None
    assert network.view.motion.score_flown == pytest.approx(network.observer.team.score)
    for _ in range(10):
        network.hear(after=0.1 * DEAD_AFTER)
    assert math.isnan(network.view.motion.score_flown)
    assert np.isnan(network.view.motion.velocities_W).all()
    assert motions(network.hear(after=DEAD_AFTER)) == []  # it is told once


def test_who_leaves_at_the_end_is_not_silent(network: Network) -> None:
    goals = network.observer.team.poses
    network.hear(*map(beat, range(3)), *(fly(network, agent, pose) for agent, pose in enumerate(goals)))
    network.hear(fly(network, 0, goals[0]), after=0.5 * REPORTED_EVERY)
    network.now += 10.0 * DEAD_AFTER  # processes end, poses are proved
    network.teller.end("settled", True)
    assert network.view.motion is not None
    assert network.view.motion.score_flown == pytest.approx(network.observer.team.score)
    assert network.view.activity.tolist() == [Activity.IDLE] * 3
    network.hear(after=0.1)
    assert math.isnan(network.view.motion.score_flown), "who watches on sees that they are gone"


def test_a_new_life_without_a_vehicle_is_at_its_committed_pose(network: Network) -> None:
    network.hear(beat(0), fly(network, 0, Pose2(0.5, 0.25, 1.0), battery=0.75))
    old = fly(network, 0, Pose2(0.75, 0.25, 1.0))
    network.hear(replace(beat(0), sender=Sender(0, 2)), after=1.0)
    network.hear(old, after=1.0)
    network.hear(after=1.0)
    assert network.view.motion is not None
    assert network.view.health is not None
    pose = network.observer.team.poses[0]
    np.testing.assert_allclose(network.view.motion.poses[0, :2], [pose.x, pose.y])
    assert np.isnan(network.view.health.battery[0])


def test_who_joins_flies_as_well(network: Network) -> None:
    joins = AgentChange(3, True, '{"name": "orange", "pose": {"x_m": 0, "y_m": 0}}')
    late = Telemetry(Sender(3, 1), fly(network, 0, Pose2(0.5, 0.5, 0.0)).state, 0.5)
    assert motions(network.hear(late)) == []  # of whom nothing is known yet
    network.hear(fly(network, 0, Pose2(0.0, 0.0, 0.0)))
    network.observer.learn(Catalogue(agents={3: joins}))
    told = network.hear(beat(3), late, after=2.0 * REPORTED_EVERY)
    (motion,) = motions(told)
    assert motion.poses.shape == (4, 7)
    assert motion.poses[3, 0] == 0.5


def test_the_end_is_told_with_the_state(network: Network) -> None:
    network.hear(beat(0))
    network.teller.end("settled", True)
    state, ended = network.told[-2:]
    assert isinstance(state, TeamState)
    assert ended == Ended(network.now, "settled", True, float(state.scores.sum()))


def test_what_the_team_agreed_on_replaces_what_events_told(network: Network) -> None:
    owner = (network.observer.team.owner + 1) % 3
    network.observer.team.set_living(range(3))
    network.observer.team.settle(owner, {0: Pose2(1.0, 1.0, 0.0)})
    told = network.hear()
    assert any(isinstance(item, TeamState) for item in told)
    np.testing.assert_array_equal(network.view.owner, owner)
    np.testing.assert_allclose(network.view.poses[0, :2], [1.0, 1.0])
