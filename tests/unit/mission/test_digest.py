"""The identity of a mission: the same for the same mission, another for any other."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from covey.geometry import Pose2
from covey.mission import Mission, Trade, load_mission, mission_digest


@pytest.fixture
def mission(root: Path) -> Mission:
    return load_mission(root / "examples" / "thesis-5.1.yaml")


def test_a_mission_read_twice_is_the_same(mission: Mission, root: Path) -> None:
    again = load_mission(root / "examples" / "thesis-5.1.yaml")
    assert mission_digest(mission) == mission_digest(again)
    assert mission_digest(mission) == mission_digest(replace(mission, path=None))
    assert len(mission_digest(mission)) == 16


def test_rounding_in_the_last_bits_does_not_matter(mission: Mission) -> None:
    landmarks = mission.landmarks
    moved = replace(landmarks, positions_W=landmarks.positions_W + 1e-13)
    assert mission_digest(replace(mission, landmarks=moved)) == mission_digest(mission)


def test_whatever_the_team_must_agree_on_matters(mission: Mission) -> None:
    landmarks = mission.landmarks
    moved = landmarks.positions_W.copy()
    moved[0] += 1e-3
    first = replace(mission.agents[0], pose=Pose2(0.0, 0.0, 0.0))
    others = [
        replace(mission, seed=mission.seed + 1),
        replace(mission, landmarks=replace(landmarks, positions_W=moved)),
        replace(mission, landmarks=replace(landmarks, weights=2.0 * landmarks.weights)),
        replace(mission, agents=(first, *mission.agents[1:])),
        replace(mission, agents=mission.agents[:-1]),
        replace(mission, coverage=replace(mission.coverage, trade=Trade.THESIS)),
        replace(mission, coverage=replace(mission.coverage, sigma=0.5)),
        replace(mission, source={}),
    ]
    assert len({mission_digest(mission), *(mission_digest(other) for other in others)}) == 1 + len(others)
