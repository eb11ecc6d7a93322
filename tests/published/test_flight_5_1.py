"""Section 5.1 flown: four quadrotors in MuJoCo, then gusts, noise and larger teams."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from covey.mission import Mission, load_mission, parse_mission
from covey.runtime.flight import Flight
from covey.runtime.fly import fly
from covey.runtime.plan import plan
from covey.runtime.result import PlanStatus

WEATHER = {
    "wind": {"gust_m_s": 3.0},
    "noise": {"position_m": 0.02, "velocity_m_s": 0.05, "attitude_deg": 1.0, "rate_deg_s": 2.0, "latency_s": 0.02},
}


def example(root: Path, name: str, seed: int, **flight: Any) -> Mission:
    """Return an example mission with this flight section."""
    source = dict(load_mission(root / "examples" / f"{name}.yaml").source)
    return parse_mission(json.dumps({**source, "flight": flight}), format="json", seed=seed)


def is_sound(flight: Flight) -> None:
    """Check that it ended, proved, with everybody back on the ground and nobody touched."""
    deployment, report = flight.deployment, flight.deployment.flight
    assert report is not None
    assert deployment.status is PlanStatus.SETTLED
    assert deployment.certificate is not None
    assert deployment.certificate.holds
    assert (report.collisions, report.lost) == (0, ())
    assert report.min_separation >= report.required_separation
    assert flight.log.state[-1, :, 2].max() < 0.02
    assert (flight.log.command[-1, :, 0] == 0.0).all()
    assert sum(event.kind == "landed" for event in flight.log.events) == len(flight.log.names)


def test_the_mission_flown_is_the_mission_planned(root: Path) -> None:
    """Same seed, same order of meetings: same trades and score (p. 66-69; the thesis's one draw ends at 118.99)."""
    mission = load_mission(root / "examples" / "thesis-5.1.yaml")
    flight, planned = fly(mission, vehicles="mujoco"), plan(mission)
    is_sound(flight)
    assert flight.deployment.score == planned.score
    assert flight.deployment.trades == planned.trades
    assert flight.deployment.poses == planned.poses
    report = flight.deployment.flight
    assert report is not None
    assert report.waypoints_missed == 0
    assert report.score_flown == pytest.approx(planned.score.final, rel=0.01)


def test_the_published_rule_is_flown_too(root: Path) -> None:
    mission = load_mission(root / "examples" / "thesis-5.1.yaml")
    source = {**mission.source, "coverage": {**mission.source["coverage"], "trade": "thesis"}}
    flight = fly(parse_mission(json.dumps(source), format="json"), vehicles="reference")
    is_sound(flight)
    assert 110.0 < flight.deployment.score.final < 121.0


@pytest.mark.parametrize(
    ("name", "few", "many"), [("thesis-5.1", 2, 50), ("eight-agents", 1, 10), ("sixteen-agents", 1, 10)]
)
def test_gusts_and_noise(name: str, few: int, many: int, root: Path, seeds: Callable[[int, int], range]) -> None:
    """Gusts of 3 m/s and noisy, late measurements: everybody arrives, nobody touches anybody or falls."""
    for seed in seeds(few, many):
        is_sound(fly(example(root, name, seed, **WEATHER), vehicles="mujoco"))
