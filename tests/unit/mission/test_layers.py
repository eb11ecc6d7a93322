"""Who shares an altitude: what the flight section says, and what the ceiling leaves."""

from __future__ import annotations

import json
import math
from typing import Any

import pytest

from covey.errors import MissionError
from covey.geometry import Pose2
from covey.mission import Mission, parse_mission
from covey.mission.flight import Separation


def mission(agents: int = 5, size: float = 8.0, **flight: Any) -> Mission:
    side = [-0.5 * size, 0.5 * size]
    document = {
        "schema_version": 1,
        "name": "layers",
        "seed": 1,
        "environment": {
            "landmarks": {"grid": {"x_m": [-1, 1], "y_m": [-1, 1], "spacing_m": 1}},
            "region": {"box": {"x_m": side, "y_m": side}},
        },
        "agents": {"count": agents},
        "flight": flight,
    }
    return parse_mission(json.dumps(document), format="json")


@pytest.mark.parametrize(
    ("flight", "layers"),
    [
        ({}, (0, 1, 2, 3, 4)),
        ({"ceiling_m": 11.1}, (0, 1, 2, 3, 4)),  # 1.5 m and four times 2.4 m
        ({"ceiling_m": 11.0}, (0, 1, 2, 3, 0)),
        ({"ceiling_m": 1.5}, (0, 0, 0, 0, 0)),
        ({"layers": 2}, (0, 1, 0, 1, 0)),
        ({"layers": 9}, (0, 1, 2, 3, 4)),
        ({"layers": 2, "layer_spacing_m": 3.0, "ceiling_m": 4.5}, (0, 1, 0, 1, 0)),
        ({"layer_spacing_m": 3.0, "ceiling_m": 8.0}, (0, 1, 2, 0, 1)),
    ],
)
def test_agents_take_the_layers_in_turn(flight: dict[str, Any], layers: tuple[int, ...]) -> None:
    made = mission(**flight)
    spacing = flight.get("layer_spacing_m", 2.4)
    assert made.flight.altitudes(5) == pytest.approx([1.5 + spacing * layer for layer in layers])
    assert max(made.flight.altitudes(5)) <= made.flight.ceiling
    if len(set(layers)) == 5:
        assert made.separation is None
    else:
        assert made.separation == Separation(1.06, layers)


def test_a_mission_that_does_not_speak_of_flight_has_nobody_keep_apart() -> None:
    made = mission()
    assert made.separation is None
    assert made.flight.start_spacing == 0.96


def test_starts_are_drawn_clear_of_each_other() -> None:
    for seed in range(20):
        made = mission(agents=9, layers=1).with_seed(seed)
        assert made.separation is not None
        poses = [agent.pose for agent in made.agents]
        assert made.separation.too_close(poses, made.separation.clear) == []
        assert made.flight.start_spacing == made.separation.clear


@pytest.mark.parametrize(
    ("flight", "says"),
    [
        ({"ceiling_m": 1.0}, r"flight.ceiling_m: expected at least altitude_m, 1.5 m, got 1"),
        ({"layers": 3, "ceiling_m": 6.0}, r"flight.ceiling_m: expected room for 3 layers up to 6.3 m, got 6"),
        ({"layers": 0}, r"flight.layers: expected"),
        ({"layers": 1.5}, r"flight.layers: expected"),
        ({"layers": "auto"}, r"flight.layers: expected"),
        ({"layer_spacing_m": 1.0}, r"flight.layer_spacing_m: expected at least 1.92 m"),
        (
            {"layers": 1, "size": 1.0, "agents": 3},
            r"flight: expected 3 agents in one layer to start at least 1.08 m apart .*start 0.\d+ m apart.*\(move",
        ),
        ({"layers": 2, "size": 1.0, "agents": 6}, r"expected 6 agents in 2 layers to start"),
    ],
)
def test_what_cannot_work_is_one_clear_error(flight: dict[str, Any], says: str) -> None:
    with pytest.raises(MissionError, match=says) as error:
        mission(**flight)
    assert str(error.value).count("expected") == 1


def test_separation_knows_who_is_near() -> None:
    separation = Separation(1.0, (0, 1, 0, None, 0))
    assert separation.sharing(0) == (2, 4)
    assert separation.sharing(3) == ()
    assert separation.without(2).sharing(0) == (4,)
    poses = [Pose2(x, 0.0, 0.0) for x in (0.0, 0.1, 0.5, 0.0, 2.0)]
    assert separation.too_close(poses, 1.0) == [(0, 2, 0.5)]
    assert separation.clear == pytest.approx(1.0 / math.cos(math.pi / 16))
