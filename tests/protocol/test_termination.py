"""Termination is declared over one consistent set of heartbeats, and never early."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from covey.geometry import Pose2
from covey.protocol import Heartbeat, PoseRecord, Sender, TerminationDetector

POSE = PoseRecord(1, 0, Pose2(0.0, 0.0, 0.0))
NONE: Mapping[int, int] = {}


def beat(
    agent: int,
    sequence: int,
    quiescent: bool = True,
    *,
    committed: Mapping[int, int] = NONE,
    served: Mapping[int, int] = NONE,
    incarnation: int = 1,
) -> Heartbeat:
    return Heartbeat(Sender(agent, incarnation), sequence, quiescent, sequence, POSE, committed, served)


def test_everybody_must_be_heard_and_quiescent() -> None:
    detector = TerminationDetector([4, 9])
    assert not detector.receive(beat(4, 1))
    assert not detector.receive(beat(9, 1, quiescent=False))
    assert detector.receive(beat(9, 2))
    assert detector.versions() == {4: (1, 1), 9: (1, 2)}


def test_the_newest_heartbeat_counts_whatever_the_order() -> None:
    detector = TerminationDetector([0, 1])
    detector.receive(beat(0, 5, quiescent=False))
    detector.receive(beat(0, 4))
    assert not detector.receive(beat(1, 1))
    assert detector.receive(beat(0, 6))
    assert detector.receive(beat(0, 5, quiescent=False))
    assert not detector.receive(beat(0, 1, quiescent=False, incarnation=2))


def test_a_trade_that_the_server_has_not_merged_is_in_flight() -> None:
    detector = TerminationDetector([0, 1])
    detector.receive(beat(0, 1, committed={1: 3}))
    assert not detector.receive(beat(1, 1, served={0: 2}))
    assert detector.receive(beat(1, 2, served={0: 3}))


def test_a_pair_s_counts_must_agree_not_only_their_sum() -> None:
    detector = TerminationDetector([0, 1, 2])
    detector.receive(beat(0, 1, committed={1: 1}))
    detector.receive(beat(1, 1, served={2: 1}))
    assert not detector.receive(beat(2, 1))


def test_strangers_are_ignored() -> None:
    detector = TerminationDetector([0])
    assert not detector.receive(beat(7, 1))
    assert detector.receive(beat(0, 1))


class Model:
    """Agents that wake each other by commits, and heartbeats that take any time: the detector against the truth.

    A quiescent agent does nothing; an active one commits with somebody (and waits until that one has merged), or goes
    quiescent.  Merging a commit makes an agent active.
    """

    def __init__(self, rng: np.random.Generator, detector: TerminationDetector, agents: int) -> None:
        self.rng, self.detector, self.n = rng, detector, agents
        self.active, self.waits = [True] * agents, [False] * agents
        self.committed: list[dict[int, int]] = [{} for _ in range(agents)]
        self.served: list[dict[int, int]] = [{} for _ in range(agents)]
        self.sequence = [0] * agents
        self.commits: list[tuple[int, int]] = []
        self.beats: list[Heartbeat] = []

    def over(self) -> bool:
        return not any(self.active) and not any(self.waits) and not self.commits

    def publish(self, agent: int) -> None:
        self.sequence[agent] += 1
        quiescent = not self.active[agent] and not self.waits[agent]
        self.beats.append(
            beat(
                agent,
                self.sequence[agent],
                quiescent,
                committed=dict(self.committed[agent]),
                served=dict(self.served[agent]),
            )
        )

    def step(self) -> None:
        movers = [a for a in range(self.n) if self.active[a] and not self.waits[a]]
        kind = self.rng.integers(3)
        if kind == 0 and movers:
            agent = int(self.rng.choice(movers))
            if self.rng.random() < 0.6:
                self.active[agent] = False
            else:
                other = int(self.rng.choice([a for a in range(self.n) if a != agent]))
                self.committed[agent][other] = self.committed[agent].get(other, 0) + 1
                self.waits[agent] = True
                self.commits.append((agent, other))
            self.publish(agent)
        elif kind == 1 and self.commits:
            client, server = self.commits.pop(int(self.rng.integers(len(self.commits))))
            self.served[server][client] = self.served[server].get(client, 0) + 1
            self.active[server], self.waits[client] = self.rng.random() < 0.7, False
            self.active[client] = self.rng.random() < 0.5
            self.publish(server)
            self.publish(client)
        elif kind == 2 and self.beats:
            self.detector.receive(self.beats.pop(int(self.rng.integers(len(self.beats)))))


def first_mistake(detector: Callable[[range], TerminationDetector], runs: int) -> str | None:
    for seed in range(runs):
        rng = np.random.default_rng(seed)
        agents = int(rng.integers(2, 5))
        model = Model(rng, detector(range(agents)), agents)
        for _ in range(3000):
            model.step()
            if model.detector.terminated:
                break
        if not model.detector.terminated:
            return f"seed {seed}: never"
        if not model.over():
            return f"seed {seed}: early"
    return None


class IgnoresTradesInFlight(TerminationDetector):
    def _no_trade_in_flight(self) -> bool:
        return True


class ComparesOnlySums(TerminationDetector):
    def _no_trade_in_flight(self) -> bool:
        beats = [heartbeat for heartbeat in self._newest.values() if heartbeat is not None]
        return sum(sum(b.committed.values()) for b in beats) == sum(sum(b.served.values()) for b in beats)


class TakesAnyOrder(TerminationDetector):
    def receive(self, heartbeat: Heartbeat) -> bool:
        self._newest[heartbeat.sender.agent] = heartbeat
        self._active = {a for a, known in self._newest.items() if known is None or not known.quiescent}
        return self.terminated


def test_it_is_never_early_and_always_comes(seeds: Callable[[int, int], range]) -> None:
    assert first_mistake(TerminationDetector, len(seeds(500, 20_000))) is None


def test_a_detector_that_ignores_trades_in_flight_is_caught() -> None:
    assert "early" in (first_mistake(IgnoresTradesInFlight, 500) or "")


def test_a_detector_that_compares_only_sums_is_caught() -> None:
    assert "early" in (first_mistake(ComparesOnlySums, 20_000) or "")


def test_a_detector_that_takes_old_news_is_caught() -> None:
    assert first_mistake(TakesAnyOrder, 500) is not None
