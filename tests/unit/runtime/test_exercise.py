"""Exercises as they are flown: what the result tells, and that it tells the truth."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from covey.flight.layout import P
from covey.mission.exercise import Exercise, load_exercise, navigation_options, parse_exercise
from covey.runtime.exercise import ExerciseResult, fly_exercise
from covey.runtime.reproduce.findings import Run, offset_error
from covey.runtime.reproduce.scenes import SCENES, scene
from covey.runtime.result import Progress
from covey.runtime.watching.feed import NO_TRADE, Ended, Health, Motion, Scene, TeamState, Update
from covey.vehicles.fleet import Kind

HOVER = Path(__file__).parents[3] / "examples" / "exercises" / "hover.yaml"
HEAD = "schema_version: 1\nname: t\nexercise:\n"
ONE = """
  duration_s: {duration}
  vehicles:
    - {{name: a, start: {{x_m: 0, y_m: 0, z_m: {z}}}, goal: {{x_m: 2, y_m: 0, z_m: 1}}}}
"""
DIRECT = """
  duration_s: 6
  vehicles:
    - {name: a, start: {x_m: 0, y_m: 0, z_m: 1}, goal: {x_m: 2, y_m: 0, z_m: 1, direct: true}}
    - {name: b, start: {x_m: 2, y_m: 0, z_m: 1}, goal: {x_m: 0, y_m: 0, z_m: 1, direct: true}}
"""


def one(duration: float = 8.0, z: float = 1.0, more: str = "") -> Exercise:
    return parse_exercise(HEAD + ONE.format(duration=duration, z=z) + more)


def reference(exercise: Exercise) -> ExerciseResult:
    return fly_exercise(exercise, simulator="reference")


def test_the_summary_can_be_written_as_json() -> None:
    result = reference(one())
    summary = json.loads(json.dumps(dict(result.summary), allow_nan=False))
    assert (summary["simulator"], summary["duration_s"]) == ("reference", 8.0)
    assert (summary["waypoints_reached"], summary["waypoints_missed"], summary["collisions"]) == (1, 0, 0)
    assert summary["min_separation_m"] is None
    assert summary["min_object_gap_m"] is None
    assert summary["required_separation_m"] == pytest.approx(0.96)
    assert 0.0 < summary["tracking_rms_m"] < 0.1
    assert summary["wall_s"] > 0.0
    assert summary["real_time_factor"] == pytest.approx(8.0 / summary["wall_s"])
    (event,) = summary["events"]
    assert (event["event"], event["agents"]) == ("reached", ["a"])
    assert 1.0 < event["time_s"] < 8.0
    assert result.log.names == ("a",)
    assert result.log.time[-1] == pytest.approx(8.0)


def test_a_goal_that_is_not_reached_in_time_is_missed() -> None:
    summary = reference(one(duration=1.0)).summary
    assert (summary["waypoints_reached"], summary["waypoints_missed"], summary["events"]) == (0, 1, [])


def test_a_vehicle_on_the_ground_takes_off() -> None:
    result = reference(one(z=0.0, duration=12.0))
    assert result.log.state[0, 0, P + 2] < 0.2
    assert result.summary["waypoints_reached"] == 1


def test_an_obstacle_is_flown_around() -> None:
    straight, around = (
        reference(one(duration=15.0)),
        reference(
            one(duration=15.0, more="  obstacles:\n    - box: {x_m: [0.9, 1.1], y_m: [-0.4, 0.5], z_m: [0, 9]}\n")
        ),
    )
    assert around.summary["collisions"] == 0
    assert around.summary["waypoints_reached"] == 1
    assert np.abs(straight.log.state[:, 0, P + 1]).max() < 0.05
    assert np.abs(around.log.state[:, 0, P + 1]).max() > 0.7


def test_without_navigation_vehicles_collide_and_the_result_says_so() -> None:
    result = reference(parse_exercise(HEAD + DIRECT))
    assert result.summary["collisions"] >= 1
    assert result.summary["min_separation_m"] < 0.3
    assert "collision" in {event["event"] for event in result.summary["events"]}
    assert result.summary["min_separation_m"] == pytest.approx(result.log.separation.min(), abs=0.1)


@pytest.mark.parametrize("kind", list(Kind))
def test_every_simulator_flies_it(kind: Kind) -> None:
    result = fly_exercise(one(), simulator=kind)
    assert result.summary["simulator"] == result.log.simulator == kind.value
    assert result.summary["waypoints_reached"] == 1


def test_a_seed_is_what_decides_on_gusts_and_noise() -> None:
    exercise = one(duration=2.0, more="  wind: {steady_m_s: [1, 0], gust_m_s: 1}\n  noise: {position_m: 0.01}\n")
    first, again, other = (fly_exercise(exercise, simulator="reference", seed=seed).log.state for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - other).max() > 1e-3
    np.testing.assert_array_equal(
        reference(exercise).log.state, fly_exercise(exercise, simulator="reference", seed=0).log.state
    )


def test_progress_is_told_and_ctrl_c_keeps_what_happened() -> None:
    told: list[Progress] = []
    fly_exercise(one(duration=2.0), simulator="kinematic", on_progress=told.append)
    assert [news.fraction for news in told] == [0.0, 0.25, 0.5, 0.75]

    def stop(news: Progress) -> None:
        if news.fraction:
            raise KeyboardInterrupt

    result = fly_exercise(one(duration=2.0), simulator="kinematic", on_progress=stop)
    assert result.interrupted
    assert result.summary["duration_s"] == 0.5
    assert result.log.time[-1] == pytest.approx(0.5)
    assert not reference(one(duration=1.0)).interrupted


def test_in_real_time_it_waits_for_the_clock(monkeypatch: pytest.MonkeyPatch) -> None:
    waits: list[float] = []
    monkeypatch.setattr("covey.vehicles.fleet.time.sleep", waits.append)
    fly_exercise(one(duration=0.5), simulator="kinematic", realtime=True)
    assert waits
    assert 0.0 < max(waits) <= 0.5
    waits.clear()
    fly_exercise(one(duration=0.5), simulator="kinematic")
    assert not waits


def test_objects_are_where_they_should_be() -> None:
    more = "  objects:\n    - {name: o, radius_m: 0.2, path_m: [[5, 5, 1], [5, 7, 1]], speed_m_s: 1, start_s: 1}\n"
    result = reference(one(duration=4.0, more=more))
    at = np.searchsorted(result.log.time, 2.0)
    np.testing.assert_allclose(result.log.objects[at, 0], [5.0, 6.0, 1.0], atol=0.06)
    np.testing.assert_allclose(result.log.objects[-1, 0], [5.0, 7.0, 1.0])
    assert result.log.object_radii.tolist() == [0.2]
    nearest = np.linalg.norm(result.log.state[:, 0, :3] - result.log.objects[:, 0], axis=1).min() - 0.2 - 0.38
    assert result.summary["min_object_gap_m"] == pytest.approx(nearest, abs=0.05)


def test_feed_forward_takes_the_lag_away() -> None:
    text = SCENES["leader-follower"]
    known = parse_exercise(HEAD + text.replace("-1.5, 0]}", "-1.5, 0], feed_forward: true}"))
    errors = [offset_error(Run(e, reference(e).log))[-200:].max() for e in (scene("leader-follower"), known)]
    assert errors[1] < 0.3 * errors[0]


def test_options_of_one_vehicle_and_of_many() -> None:
    vehicle = scene("swap").vehicles[0].parameters
    given = {"k_rep": 1.0, "threshold": 1.0}
    assert navigation_options(vehicle, given, alone=True).max_speed > 0.3
    assert navigation_options(vehicle, given).max_speed < 0.05  # the field alone stops them only when they are slow
    assert navigation_options(vehicle, {}).max_speed > 1.0
    assert scene("hover").options(0).stall_time > 100.0
    assert scene("swap").options(0).stall_time < 10.0


@pytest.mark.parametrize("name", SCENES)
def test_scenes_are_the_examples(name: str, root: Path) -> None:
    assert load_exercise(root / "examples" / "exercises" / f"{name}.yaml").source == scene(name).source


def test_no_example_is_forgotten(root: Path) -> None:
    assert {path.stem for path in (root / "examples" / "exercises").glob("*.yaml")} == set(SCENES)


def test_what_happens_is_told_to_whoever_watches() -> None:
    told: list[Scene | Update] = []
    exercise = replace(load_exercise(HOVER), duration=2.0)
    result = fly_exercise(exercise, simulator="reference", watch=told.append)
    scene, state, *rest = told
    assert isinstance(scene, Scene)
    assert isinstance(state, TeamState)
    assert (scene.trade, len(scene.positions_W)) == (NO_TRADE, 0)
    (x0, y0), (x1, y1) = scene.region[0].min(axis=0), scene.region[0].max(axis=0)
    for item in exercise.objects:
        assert all(x0 < x < x1 and y0 < y < y1 for x, y, _ in item.path_W)
    motions = [item for item in rest if isinstance(item, Motion)]
    assert motions[-1].time == result.log.time[-1] == 2.0
    np.testing.assert_array_equal(motions[-1].poses[:, :3], result.log.state[-1][:, P : P + 3])
    assert motions[-1].objects_W.shape == (len(exercise.objects), 3)
    assert isinstance(rest[-1], Ended)
    assert rest[-1].status == "settled"
    plain = fly_exercise(exercise, simulator="reference")
    np.testing.assert_array_equal(plain.log.state, result.log.state)  # to be watched changes nothing
    batteries = np.array([item.battery for item in told if isinstance(item, Health)])
    assert len(batteries) >= 3
    assert (np.diff(batteries, axis=0) <= 0.0).all()
    assert (batteries[-1] < batteries[0]).all()
