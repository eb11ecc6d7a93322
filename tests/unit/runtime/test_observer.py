"""An observer of a team on a bus of its own: when the mission is over, who lives, how long a landmark had no owner."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest
from tests.unit.runtime.small import small

from covey.errors import Drop
from covey.geometry import Pose2
from covey.mission import Mission
from covey.protocol import (
    AgentBuried,
    AgentReturned,
    Cause,
    Heartbeat,
    LandmarkRecords,
    LandmarksAdopted,
    Map,
    PoseOptimized,
    PoseRecord,
    PoseRecords,
    Sender,
    TradeCommitted,
    TradeId,
    WaypointAbandoned,
)
from covey.protocol.adoption import map_digest
from covey.runtime.network.observed_team import ObservedTeam
from covey.runtime.network.observer import Content, Heard, Observer
from covey.runtime.network.remote_agent import NETWORK_TIMES

DEAD_AFTER = NETWORK_TIMES.dead_after


class Wire:
    """What an observer hears, written by hand; and a clock."""

    def __init__(self) -> None:
        self.said: list[Content] = []
        self.asked = 0
        self.now = 0.0
        self.dropped: Mapping[Drop, int] = {}

    def receive(self) -> list[Content]:
        said, self.said = self.said, []
        return said

    def wait(self, timeout: float) -> bool:
        self.now += timeout
        return bool(self.said)

    def ask_for_maps(self) -> None:
        self.asked += 1

    def clock(self) -> float:
        return self.now


@pytest.fixture
def mission() -> Mission:
    return small()


@pytest.fixture
def wire() -> Wire:
    return Wire()


@pytest.fixture
def observer(mission: Mission, wire: Wire) -> Observer:
    return Observer(mission, wire, clock=wire.clock)


def records_of(mission: Mission, owners: list[int], *, life: int = 1) -> LandmarkRecords:
    n = len(mission.landmarks)
    partition = {agent: np.arange(n)[i :: len(owners)] for i, agent in enumerate(owners)}
    return LandmarkRecords.initial(n, partition, incarnation=life)


def map_of(agent: int, records: LandmarkRecords, mission: Mission) -> tuple[Map, bytes]:
    poses = PoseRecords.initial({i: specification.pose for i, specification in enumerate(mission.agents)})
    digest = map_digest(records, poses)
    return Map(Sender(agent, 1), records.known(), poses.as_mapping()), digest


def beat(agent: int, sequence: int, digest: bytes, *, life: int = 1, quiescent: bool = True) -> Heartbeat:
    pose = PoseRecord(1, 0, Pose2(0.0, 0.0, 0.0))
    return Heartbeat(Sender(agent, life), sequence, quiescent, 3, pose, {}, {}, digest if quiescent else b"")


def test_over_means_quiescent_with_one_map_that_was_fetched(observer: Observer, wire: Wire, mission: Mission) -> None:
    known, digest = map_of(0, records_of(mission, [0, 1, 2]), mission)
    wire.said = [beat(agent, 1, digest) for agent in range(3)]
    observer.step(0.1)
    assert wire.asked == 1
    assert not observer.over
    wire.said = [known]
    observer.step(0.1)
    assert observer.over
    assert observer.settle()
    assert np.array_equal(observer.team.owner, np.arange(len(mission.landmarks)) % 3)
    wire.said = [beat(1, 2, b"", quiescent=False)]
    observer.step(0.1)
    assert not observer.over


def test_who_comes_to_a_running_team_late_sees_what_it_has_come_to(mission: Mission, wire: Wire) -> None:
    observer = Observer(mission, wire, late=True, clock=wire.clock)
    n, pose = len(mission.landmarks), Pose2(0.5, -0.5, 1.0)
    records, poses = LandmarkRecords.unknown(n), {2: PoseRecord(3, 1, pose)}
    before = observer.team.owner.tolist()
    wire.said = [beat(0, 1, b""), Map(Sender(0, 1), records.known(), poses)]  # it has not begun
    observer.step(0.1)
    assert observer.team.owner.tolist() == before
    records.merge(LandmarkRecords.initial(n, {0: np.arange(9), 1: np.arange(9, n)}).all())
    known = Map(Sender(0, 1), records.known(), poses)
    wire.said = [beat(0, 2, b""), known]
    observer.step(0.1)
    assert observer.team.owner.tolist() == [0] * 9 + [1] * (n - 9)
    assert observer.team.poses[2] == pose
    wire.said = [Map(Sender(0, 1), LandmarkRecords.initial(n, {0: np.arange(n)}).all(), {})]  # only the first counts
    observer.step(0.1)
    assert observer.team.owner.tolist() == [0] * 9 + [1] * (n - 9)


@pytest.mark.parametrize("late", [True, False])
def test_an_event_counts_more_than_maps_that_may_be_older(mission: Mission, wire: Wire, late: bool) -> None:
    observer = Observer(mission, wire, late=late, clock=wire.clock)
    n, moved = len(mission.landmarks), Pose2(0.5, -0.5, 1.0)
    known = Map(Sender(1, 1), LandmarkRecords.initial(n, {0: np.arange(n)}).all(), {})
    before = observer.team.owner.tolist()
    wire.said = [beat(0, 1, b""), known, PoseOptimized(0, moved, 0.0, 1.0, Cause.OPTIMIZER)]
    observer.step(0.1)
    wire.said = [known]
    observer.step(0.1)
    assert observer.team.owner.tolist() == before
    assert observer.team.poses[0] == moved


def test_a_map_of_another_digest_does_not_end_the_mission(observer: Observer, wire: Wire, mission: Mission) -> None:
    known, _ = map_of(0, records_of(mission, [0, 1, 2]), mission)
    wire.said = [*(beat(agent, 1, b"12345678") for agent in range(3)), known]
    observer.step(0.1)
    assert not observer.over
    assert not observer.settle()


def test_two_maps_do_not_end_the_mission(observer: Observer, wire: Wire, mission: Mission) -> None:
    first, one = map_of(0, records_of(mission, [0, 1, 2]), mission)
    second, other = map_of(1, records_of(mission, [1, 0, 2]), mission)
    wire.said = [beat(0, 1, one), beat(1, 1, other), beat(2, 1, one), first, second]
    observer.step(0.1)
    assert not observer.over


@pytest.mark.parametrize(("owners", "life"), [([0, 1], 2), ([0, 1, 2], 1)])
def test_an_owner_that_does_not_speak_keeps_the_mission_open(
    observer: Observer, wire: Wire, mission: Mission, owners: list[int], life: int
) -> None:
    """Agent 2 is silent, or agent 1 is in another life than the map says."""
    wire.now = DEAD_AFTER
    known, digest = map_of(0, records_of(mission, owners), mission)
    wire.said = [beat(0, 1, digest), beat(1, 1, digest, life=life), known]
    observer.step(0.1)
    assert not observer.over


def test_who_is_silent_is_left_out(observer: Observer, wire: Wire, mission: Mission) -> None:
    known, digest = map_of(0, records_of(mission, [0, 1]), mission)
    wire.said = [*(beat(agent, 1, digest) for agent in (0, 1)), beat(2, 1, b"", quiescent=False)]
    observer.step(0.1)
    wire.said = [known]
    observer.step(0.1)
    assert not observer.over
    wire.now += DEAD_AFTER - 0.5
    wire.said = [beat(agent, 2, digest) for agent in (0, 1)]
    observer.step(0.1)
    assert not observer.over
    observer.step(1.0)
    assert set(observer.living) == {0, 1}
    assert observer.over


def test_who_died_before_the_observer_came_is_dead_for_it(observer: Observer, wire: Wire, mission: Mission) -> None:
    """It has heard neither of the death nor of who is gone, and must not take who is slow to speak for dead."""
    known, digest = map_of(0, records_of(mission, [0, 1]), mission)
    wire.said = [*(beat(agent, 1, digest) for agent in (0, 1)), known]
    observer.step(0.1)
    assert not observer.over
    wire.now = DEAD_AFTER
    wire.said = [beat(agent, 2, digest) for agent in (0, 1)]
    observer.step(0.1)
    assert observer.over
    assert observer.settle()
    assert observer.team.dead == {2}
    agents = observer.team.standing().mission.agents
    assert [agent.sensor.model for agent in agents] == ["anisotropic", "anisotropic", "blind"]


def test_how_long_a_landmark_had_no_owner(observer: Observer, wire: Wire, mission: Mission) -> None:
    records = records_of(mission, [0, 1, 2])
    known, digest = map_of(0, records, mission)
    wire.said = [*(beat(agent, 1, digest) for agent in range(3)), known]
    observer.step(1.0)
    assert observer.longest_unowned == 0.0
    for second in range(2, 7):
        wire.said = [beat(agent, second, digest) for agent in (0, 1)]
        observer.step(1.0)
    assert observer.unowned() == pytest.approx(5.0)
    wire.said = [LandmarksAdopted(0, records.slice(records.owned_by(2, 1)).adopted_by(0, 1))]
    observer.step(0.25)
    assert observer.longest_unowned == pytest.approx(5.25)
    assert observer.unowned() == pytest.approx(0.25)


def test_whoever_subscribes_hears_everything_in_order(observer: Observer, wire: Wire, mission: Mission) -> None:
    heard: list[Heard] = []
    observer.subscribe(heard.append)
    known, digest = map_of(0, records_of(mission, [0, 1, 2]), mission)
    content: list[Content] = [beat(0, 1, digest), AgentBuried(0, 2), known]
    wire.said = list(content)
    assert observer.step(0.5) == heard
    assert [item.content for item in heard] == content
    assert {item.time for item in heard} == {0.5}


def view_of(mission: Mission) -> ObservedTeam:
    view = ObservedTeam(mission, np.arange(len(mission.landmarks)) % 3)
    view.set_living(range(3))
    return view


def recomputed(view: ObservedTeam) -> list[float]:
    standing = view.standing()
    landmarks = [standing.mission.landmarks.subset(own) for own in standing.sets]
    return [
        float(model.visibility(pose.as_array()[None, :], own)[0] @ own.weights)
        for model, pose, own in zip(standing.models, standing.poses, landmarks, strict=True)
    ]


def test_events_change_the_view(mission: Mission) -> None:
    """A trade or a better pose adds its gain; from a death, return or adoption on the score is that of the state."""
    view = view_of(mission)
    everything = np.arange(len(mission.landmarks))
    pose, held = Pose2(0.5, 0.5, 0.3), Pose2(-0.5, 0.2, 1.0)
    trade = TradeId(0, 1, 1)
    records = records_of(mission, [2, 0])
    events = (
        (PoseOptimized(0, pose, 1.0, 2.0, Cause.OPTIMIZER), "optimization", ("blue",), 1.0),
        (PoseOptimized(1, pose, 1.0, 2.5, Cause.PROOF), "proof", ("red",), 1.5),
        (
            TradeCommitted(trade, 0, 1, pose, held, everything[::2], everything[1::2], 5, 1.0, 1.25),
            "trade",
            ("blue", "red"),
            0.25,
        ),
        (WaypointAbandoned(2, pose, held, 2.0, 1.0), "abandoned", ("green",), -1.0),
        (AgentBuried(0, 1), "death", ("red",), None),
        (LandmarksAdopted(2, records.slice(records.owned_by(2, 1)).adopted_by(2, 1)), "adoption", ("green",), None),
        (AgentReturned(0, Sender(1, 2)), "return", ("red",), None),
        (PoseOptimized(0, held, 1.0, 9.0, Cause.OPTIMIZER), "optimization", ("blue",), None),
    )
    for event, kind, names, gain in events:
        view.set_living({0, 2} if kind in ("death", "adoption") else {0, 1, 2})
        before = view.score
        view.take(event)
        entry = view.history[-1]
        assert (entry.event, entry.agents, entry.score) == (kind, names, view.score)
        assert view.score == pytest.approx(sum(recomputed(view)) if gain is None else before + gain)
        assert list(view.standing().scores) == pytest.approx(recomputed(view))
    assert (view.trades, view.optimizations) == (1, 3)


def test_a_first_adoption_that_was_overtaken_by_a_trade_takes_nothing_back(mission: Mission) -> None:
    view = view_of(mission)
    everything = np.arange(len(mission.landmarks))
    poses = (Pose2(0.5, 0.5, 0.3), Pose2(-0.5, 0.2, 1.0))
    view.take(TradeCommitted(TradeId(0, 1, 1), 0, 1, *poses, everything[::2], everything[1::2], 5, 1.0, 1.25))
    owner, history = view.owner.copy(), list(view.history)
    first = LandmarkRecords.unknown(len(everything)).slice(everything).adopted_by(2, 1)
    view.take(LandmarksAdopted(2, first))
    assert np.array_equal(view.owner, owner)
    assert view.history == history
    view.take(LandmarksAdopted(2, first.adopted_by(2, 1)))
    assert (view.owner == 2).all()


def test_of_two_that_adopt_the_same_the_larger_keeps_it_whoever_is_heard_first(mission: Mission) -> None:
    for order in ((0, 2), (2, 0)):
        view = view_of(mission)
        own = np.flatnonzero(view.owner == 1)
        old = records_of(mission, [0, 1, 2]).slice(own)
        for agent in order:
            view.take(LandmarksAdopted(agent, old.adopted_by(agent, 1)))
        assert (view.owner[own] == 2).all()
        assert view.score == pytest.approx(sum(recomputed(view)))


def test_what_several_report_is_told_once(mission: Mission) -> None:
    view = view_of(mission)
    for agent in (0, 2):
        view.take(AgentBuried(agent, 1))
    for agent in (0, 2):
        view.take(AgentReturned(agent, Sender(1, 2)))
    assert [entry.event for entry in view.history] == ["initial", "death", "return"]


def test_the_dead_are_blind_in_the_result(mission: Mission) -> None:
    view = view_of(mission)
    view.set_living({0, 2})
    view.take(AgentBuried(0, 1))
    n = len(mission.landmarks)
    view.settle(np.arange(n) % 2 * 2, dict(enumerate(view.poses)))
    standing = view.standing()
    assert [agent.sensor.model for agent in standing.mission.agents] == ["anisotropic", "blind", "anisotropic"]
    assert [len(own) for own in standing.sets] == [n // 2, 0, n // 2]
    assert standing.scores[1] == 0.0
    assert view.score == pytest.approx(sum(standing.scores))
    assert view.history[-1].score == view.score
