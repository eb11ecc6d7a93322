"""One seed, many independent streams of random numbers."""

from __future__ import annotations

import enum

import numpy as np


class Stream(enum.IntEnum):
    """What a stream is for; the number is part of what a seed means, so it never changes.

    1 draws the poses that a mission leaves open (`covey.mission.model.draw_pose`).
    """

    ASSIGNMENT = 2
    PLANNER = 3
    BUS = 4
    NODE = 5
    PROOF = 6
    BASELINE = 7
    BOUND = 8
    WEATHER = 9


def generator(seed: int, stream: Stream, index: int = 0) -> np.random.Generator:
    """Return the generator of one stream; streams of different purpose or index are independent."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(int(stream), index)))
