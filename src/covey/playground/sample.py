"""A made-up run, to try pages and servers on: ``python -m covey.playground.sample > sample.jsonl``."""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from covey.playground.messages import encode
from covey.runtime.drawing.palette import colours
from covey.runtime.watching.feed import (
    NOBODY,
    Activity,
    BoundFound,
    ChangeKind,
    Ended,
    Health,
    Motion,
    Note,
    Run,
    Scene,
    SceneAgent,
    SceneObstacle,
    TeamChange,
    TeamState,
    Trading,
    Update,
)

OFFER = 0.4
"""Seconds that an offer stands."""


def sample_feed(
    *,
    agents: int = 6,
    landmarks: int = 400,
    seconds: float = 30.0,
    rate: float = 30.0,
    trades: float = 2.0,
    seed: int = 0,
) -> Iterator[Scene | Update]:
    """Yield the feed of a flight that never was: consistent, but no vehicle could fly it and no agent would trade so.

    Parameters
    ----------
    agents, landmarks : int
    seconds : float
    rate : float
        `Motion`s a second.
    trades : float
        Trades a second.
    seed : int
    """
    made_up = _MadeUp(agents, landmarks, np.random.default_rng(seed))
    yield made_up.scene(seed)
    yield made_up.state(0.0)
    yield Note(0.0, "takeoff", tuple(range(agents)), "take-off")
    yield BoundFound(0.0, float(landmarks))
    per_trade = max(2, round(rate / trades))
    offered: Trading | None = None
    for frame in range(round(seconds * rate)):
        now = frame / rate
        yield made_up.motion(now)
        if frame % round(rate) == 0:
            yield made_up.health(now)
        if frame % per_trade == 0:
            offered = made_up.offer(now)
            yield offered
        elif offered is not None and now >= offered.time + min(OFFER, 0.5 / trades):
            yield made_up.trade(now, offered)
            yield Trading(now, offered.client, offered.server, offered.give, offered.want, open=False)
            offered = None
        if frame == round(0.6 * seconds * rate):
            if offered is not None:
                yield Trading(now, offered.client, offered.server, offered.give, offered.want, open=False)
                offered = None
            yield from made_up.death(now, agents - 1)
    yield Ended(seconds, "settled", True, made_up.score)


class _MadeUp:
    """The state of the made-up run."""

    def __init__(self, agents: int, landmarks: int, rng: np.random.Generator) -> None:
        self.m, self.n, self.rng = agents, landmarks, rng
        self.columns = math.ceil(math.sqrt(1.5 * landmarks))
        index = np.arange(landmarks)
        self.positions = np.stack([index % self.columns + 0.5, index // self.columns + 0.5], axis=1).astype(np.float64)
        self.width, self.height = self.columns, math.ceil(landmarks / self.columns)
        seeds = rng.uniform((0.0, 0.0), (self.width, self.height), (agents, 2))
        away = ((self.positions[:, None] - seeds[None]) ** 2).sum(axis=2)
        self.owner = away.argmin(axis=1).astype(np.int32)
        self.dead: set[int] = set()
        self.poses = np.zeros((agents, 7))
        self.poses[:, 2], self.poses[:, 3] = 1.5, 1.0
        self.poses[:, :2] = seeds
        self.scores = np.zeros(agents)
        self.trades = 0
        self._settle(range(agents))

    @property
    def score(self) -> float:
        return float(self.scores.sum())

    def _settle(self, whom: range | tuple[int, ...]) -> None:
        for agent in whom:
            own = self.positions[self.owner == agent]
            if len(own):
                self.poses[agent, :2] = own.mean(axis=0)
            away = np.hypot(*(own - self.poses[agent, :2]).T)
            self.scores[agent] = float((1.0 / (1.0 + (0.2 * away) ** 2)).sum())

    def scene(self, seed: int) -> Scene:
        names = [f"agent-{index + 1}" for index in range(self.m)]
        box = np.array([[0.0, 0.0], [self.width, 0.0], [self.width, self.height], [0.0, self.height]])
        post = np.array([[0.4, 0.4], [0.6, 0.4], [0.6, 0.6], [0.4, 0.6]]) * (self.width, self.height)
        shown = zip(names, colours(names), strict=True)
        return Scene(
            run=Run.FLIGHT,
            mission="sample",
            seed=seed,
            sigma=0.01,
            trade="pairwise",
            agents=tuple(SceneAgent(name, colour, (box,), "isotropic", 2.0) for name, colour in shown),
            positions_W=np.concatenate([self.positions, np.zeros((self.n, 1))], axis=1),
            weights=np.ones(self.n),
            normals_W=None,
            cell_size=1.0,
            region=(box,),
            obstacles=(SceneObstacle(post, 0.0, 3.0),),
            body_radius=0.25,
            required_separation=1.0,
            source={"name": "sample"},
            software={"covey": "0"},
        )

    def state(self, now: float) -> TeamState:
        return TeamState(
            time=now,
            owner=self.owner.copy(),
            poses=self.poses.copy(),
            scores=self.scores.copy(),
            weights=np.ones(self.n),
            activity=self._activity(),
            trading=np.zeros(0, dtype=np.int32),
            trades=self.trades,
            bound=float(self.n),
        )

    def motion(self, now: float) -> Motion:
        angle = now + np.arange(self.m)
        circle = np.stack([np.cos(angle), np.sin(angle), 0.1 * np.sin(2.0 * angle)], axis=1)
        velocities = np.stack([-np.sin(angle), np.cos(angle), 0.2 * np.cos(2.0 * angle)], axis=1)
        poses = self.poses.copy()
        poses[:, :3] += circle
        yaw = angle + 0.5 * np.pi
        poses[:, 3], poses[:, 6] = np.cos(0.5 * yaw), np.sin(0.5 * yaw)
        rates = np.tile([0.0, 0.0, 1.0], (self.m, 1))
        return Motion(now, poses, velocities, rates, np.zeros((0, 3)), 0.95 * self.score, 1.5 + 0.5 * math.sin(now))

    def health(self, now: float) -> Health:
        battery = np.clip(1.0 - 0.002 * now - 0.01 * np.arange(self.m), 0.0, 1.0)
        heard = np.full(self.m, now)
        return Health(now, self._activity(), battery, np.full(self.m, 0.98), heard)

    def _activity(self) -> NDArray[np.uint8]:
        activity = np.full(self.m, Activity.FLYING, dtype=np.uint8)
        activity[list(self.dead)] = Activity.DEAD
        return activity

    def offer(self, now: float) -> Trading:
        alive = [agent for agent in range(self.m) if agent not in self.dead]
        client, server = (int(agent) for agent in self.rng.choice(alive, 2, replace=False))
        return Trading(now, client, server, self._nearest(server, client), self._nearest(client, server), open=True)

    def _nearest(self, owner: int, to: int) -> NDArray[np.int32]:
        own = np.flatnonzero(self.owner == owner)
        away = np.hypot(*(self.positions[own] - self.poses[to, :2]).T)
        few = own[np.argsort(away, kind="stable")[: max(1, self.n // 100)]]
        return np.sort(few).astype(np.int32)

    def trade(self, now: float, offer: Trading) -> TeamChange:
        self.owner[offer.give], self.owner[offer.want] = offer.client, offer.server
        self.trades += 1
        pair = (offer.client, offer.server)
        landmarks = np.concatenate([offer.give, offer.want])
        text = f"agent-{pair[0] + 1} and agent-{pair[1] + 1} trade"
        return self._change(now, ChangeKind.TRADE, pair, landmarks, pair, text)

    def death(self, now: float, agent: int) -> Iterator[Update]:
        self.dead.add(agent)
        left = np.flatnonzero(self.owner == agent).astype(np.int32)
        self.owner[left] = NOBODY
        yield self._change(now, ChangeKind.DEATH, (agent,), left, (agent,), f"agent-{agent + 1} is dead")
        heir = (agent + 1) % self.m
        self.owner[left] = heir
        text = f"agent-{heir + 1} adopts {len(left)} landmarks"
        yield self._change(now, ChangeKind.ADOPTION, (heir,), left, (heir,), text)

    def _change(
        self,
        now: float,
        kind: ChangeKind,
        agents: tuple[int, ...],
        landmarks: NDArray[np.int32],
        whom: tuple[int, ...],
        text: str,
    ) -> TeamChange:
        self._settle(whom)
        rows = list(whom)
        return TeamChange(
            time=now,
            kind=kind,
            agents=agents,
            landmarks=landmarks,
            owner=self.owner[landmarks],
            posed=whom,
            poses=self.poses[rows],
            scored=whom,
            scores=self.scores[rows],
            score=self.score,
            text=text,
        )


def main() -> None:
    """Print the messages of a sample, one a line."""
    parser = argparse.ArgumentParser(description="Print the messages of a made-up run, one a line.")
    parser.add_argument("--agents", type=int, default=6)
    parser.add_argument("--landmarks", type=int, default=400)
    parser.add_argument("--seconds", type=float, default=30.0)
    options = parser.parse_args()
    for message in sample_feed(agents=options.agents, landmarks=options.landmarks, seconds=options.seconds):
        print(encode(message))


if __name__ == "__main__":
    main()
