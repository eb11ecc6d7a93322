"""The identity of a mission: two processes with the same digest plan the same one."""

from __future__ import annotations

import hashlib
import json

import numpy as np

from covey.mission.model import Mission

DECIMALS = 6
"""Coordinates are compared to a micrometre: what is computed anew may round differently on another processor."""


def mission_digest(mission: Mission) -> bytes:
    """Return 16 bytes that tell a mission and its seed from any other.

    Everything counts that agents must agree on: the file's text as plain data, the seed, the landmarks, the poses at
    the start and how the team trades.  Where files lie does not.

    Parameters
    ----------
    mission : Mission

    Returns
    -------
    bytes, shape (16,)
    """
    coverage = mission.coverage
    text = json.dumps(
        {
            "source": mission.source,
            "name": mission.name,
            "seed": mission.seed,
            "agents": [agent.name for agent in mission.agents],
            "coverage": [coverage.sigma, coverage.trade.value, coverage.optimizer.value],
        },
        sort_keys=True,
        default=str,
    )
    landmarks = mission.landmarks
    poses = np.array([agent.pose.as_array() for agent in mission.agents]).reshape(-1, 3)
    digest = hashlib.blake2b(text.encode(), digest_size=16)
    for array in (landmarks.positions_W, landmarks.normals_W, landmarks.weights, poses):
        rounded = np.empty(0) if array is None else np.round(array, DECIMALS) + 0.0  # no negative zeros
        digest.update(str(rounded.shape).encode())
        digest.update(rounded.astype("<f8").tobytes())
    return digest.digest()
