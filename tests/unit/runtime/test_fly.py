"""Missions flown: what happens in the air, and what a flight adds to the result."""

from __future__ import annotations

import dataclasses
import html
import itertools
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

import covey
from covey.errors import InputError, MissionError, OutputError
from covey.flight.fence import SLACK, Fences
from covey.flight.layout import P, V
from covey.mission import Mission, load_mission, parse_mission
from covey.runtime.certify import certify
from covey.runtime.flight import Flight
from covey.runtime.fly import fly
from covey.runtime.plan import plan
from covey.runtime.records.record import read_result, result_text
from covey.runtime.records.sortie_record import film_flight, write_flight
from covey.runtime.result import PlanStatus, Progress
from covey.runtime.watching.feed import Motion, ObstacleAppeared
from covey.runtime.watching.steering import AddObstacle, Command, Kill, Steering
from covey.vehicles.fleet import OUTSIDE
from covey.vehicles.flight_log import FlightLog

SCENE: dict[str, Any] = {
    "schema_version": 1,
    "name": "field",
    "seed": 3,
    "environment": {
        "landmarks": {"grid": {"x_m": [-4, 4], "y_m": [-4, 4], "spacing_m": 1}},
        "region": {"box": {"x_m": [-4, 4], "y_m": [-4, 4]}},
    },
    "agents": [
        {"name": "blue", "pose": {"x_m": -3, "y_m": -3}},
        {"name": "red", "pose": {"x_m": 3, "y_m": -3}},
        {"name": "green", "pose": {"x_m": 0, "y_m": 3}},
    ],
}


def scene(**flight: Any) -> Mission:
    """Return a small mission with this flight section."""
    return parse_mission(json.dumps({**SCENE, "flight": flight}), format="json")


@pytest.fixture(scope="module")
def calm() -> Flight:
    """A flight on which nothing goes wrong."""
    return fly(scene(), vehicles="reference")


def lives_up_to_its_word(flight: Flight) -> None:
    """Check what holds for every flight that ended by itself."""
    deployment, log = flight.deployment, flight.log
    report = deployment.flight
    assert report is not None
    assert deployment.status is PlanStatus.SETTLED
    assert deployment.certificate is not None
    assert deployment.certificate.holds
    assert report.min_separation >= report.required_separation
    assert report.min_separation <= log.separation.min()
    everybody_landed(flight)
    assert report.max_outside_region <= OUTSIDE or report.lost  # one without a motor drifts
    assert report.waypoints_missed == sum(event.kind == "missed" for event in log.events)
    assert report.waypoints_reached == sum(event.kind == "reached" for event in log.events)


def everybody_landed(flight: Flight) -> None:
    """Check that those who were not lost stand on the ground with their motors off, and that it is told."""
    log, report = flight.log, flight.deployment.flight
    assert report is not None
    flown = [i for i, name in enumerate(log.names) if name not in report.lost]
    assert np.abs(log.state[-1, flown, 2]).max() < 0.02
    assert np.abs(log.state[-1, flown, V : V + 3]).max() < 0.01
    assert (log.command[-1, flown, 0] == 0.0).all()
    for kind in ("airborne", "home", "landed"):
        told = [name for event in log.events if event.kind == kind for name in event.vehicles]
        assert sorted(told) == sorted(set(told))
        assert {log.names[i] for i in flown} <= set(told)


WINDY: dict[str, Any] = {
    "wind": {"steady_m_s": [2, 1], "gust_m_s": 2.0},
    "noise": {"position_m": 0.02, "velocity_m_s": 0.05, "latency_s": 0.02},
}


@pytest.mark.parametrize("vehicles", ["reference", "mujoco"])
def test_landing_lands_in_wind(vehicles: str) -> None:
    lives_up_to_its_word(fly(scene(**WINDY), vehicles=vehicles))


def test_what_kinematic_vehicles_do_not_feel_is_told() -> None:
    flight = fly(scene(**WINDY, faults=[{"at_s": 9, "motor": {"agent": "blue"}}]), vehicles="kinematic")
    lives_up_to_its_word(flight)
    report = flight.deployment.flight
    assert report is not None
    (event,) = [event for event in report.events if event.kind == "ignored"]
    assert "do not feel wind, noise, motors that stop" in event.text
    assert not any("rotor" in event.text for event in report.events)


@pytest.mark.parametrize("vehicles", ["kinematic", "reference"])
@pytest.mark.parametrize("name", ["inspection", "plaza-mayor"])
def test_nobody_flies_through_a_hole(name: str, vehicles: str, root: Path) -> None:
    """References stay inside the region; vehicles leave it by what they are off, in still air a few centimetres."""
    flight = fly(load_mission(root / "examples" / f"{name}.yaml"), vehicles=vehicles)
    report = flight.deployment.flight
    assert report is not None
    assert (report.waypoints_missed, report.lost) == (0, ())
    assert report.max_outside_region <= (SLACK if vehicles == "kinematic" else 0.05)
    fences = Fences([agent.region for agent in flight.deployment.mission.agents])
    rooms = np.array([fences.rooms(state[:, P : P + 3]) for state in flight.log.state])
    assert rooms.min() >= -report.max_outside_region
    everybody_landed(flight)


def test_a_region_that_a_hole_splits_in_two() -> None:
    """Behind a gap too narrow to fly through nothing is reached: the waypoint is given up, the other part with it."""
    hole = [[-0.5, -3.98], [0.5, -3.98], [0.5, 3.98], [-0.5, 3.98]]
    outline = [[-4, -4], [4, -4], [4, 4], [-4, 4]]
    document = {
        **SCENE,
        "environment": {
            "landmarks": {"grid": {"x_m": [1, 4], "y_m": [-4, 4], "spacing_m": 1}},
            "region": {"polygon": {"exterior": outline, "holes": [hole]}},
        },
        "agents": [{"name": "blue", "pose": {"x_m": -3, "y_m": 0}}],
    }
    flight = fly(parse_mission(json.dumps(document), format="json"), vehicles="kinematic")
    lives_up_to_its_word(flight)
    report = flight.deployment.flight
    assert report is not None
    assert report.waypoints_missed == 1
    assert flight.log.state[:, 0, 0].max() <= -0.5 + SLACK
    assert flight.deployment.poses[0].x <= -0.5


@pytest.mark.parametrize("vehicles", ["kinematic", "reference", "mujoco"])
def test_the_outcome_is_that_of_planning(vehicles: str) -> None:
    """However long the way takes, the order of meetings is kept, and with it trades, poses and score."""
    mission = scene()
    flown, planned = fly(mission, vehicles=vehicles).deployment, plan(mission)
    assert flown.score == planned.score
    assert flown.poses == planned.poses
    assert [(entry.event, entry.agents) for entry in flown.history] == [
        (entry.event, entry.agents) for entry in planned.history
    ]


def test_a_calm_flight(calm: Flight) -> None:
    lives_up_to_its_word(calm)
    report, log = calm.deployment.flight, calm.log
    assert report is not None
    assert (report.collisions, report.waypoints_missed, report.lost) == (0, 0, ())
    assert report.score_flown == pytest.approx(calm.deployment.score.final, rel=0.01)
    assert report.tracking_rms < 0.1
    # layers: while the team trades, everybody keeps to an altitude of its own
    cruise = np.isfinite(log.score_flown) & (log.time > 20.0) & (log.state[:, :, 2].min(axis=1) > 1.2)
    np.testing.assert_allclose(log.state[cruise][:, :, 2], np.tile(report.altitudes, (cruise.sum(), 1)), atol=0.6)
    assert np.diff(report.altitudes).min() >= report.required_separation


def test_the_committed_score_never_falls_and_the_flown_one_follows(calm: Flight) -> None:
    committed, flown = calm.log.score_committed, calm.log.score_flown
    assert (np.diff(committed) >= -1e-12).all()
    assert committed[-1] == calm.deployment.score.final
    assert (flown <= committed.max() + 1.0).all()


def test_waypoints_are_reached_before_the_agent_is_heard_of_again(calm: Flight) -> None:
    """Between two changes of an agent's committed pose, its vehicle has been at the first of them."""
    arrival = scene().flight.arrival_position
    for agent in range(3):
        changes = [moment for moment in calm.moments if moment.time > 0.0]
        legs = [
            (first, second)
            for first, second in itertools.pairwise(changes)
            if first.poses[agent] != second.poses[agent]
        ]
        for first, second in legs:
            pose = first.poses[agent]
            window = (calm.log.time <= second.time + 0.11) & (calm.log.time >= first.time - 60.0)
            away = np.hypot(calm.log.state[window, agent, 0] - pose.x, calm.log.state[window, agent, 1] - pose.y)
            assert away.min() <= arrival + 0.05


def test_the_same_seed_gives_the_same_flight() -> None:
    mission = scene(wind={"gust_m_s": 2.0}, noise={"position_m": 0.02})
    first, second = (fly(mission, vehicles="reference").log for _ in range(2))
    np.testing.assert_array_equal(first.state, second.state)
    other = fly(mission, vehicles="reference", seed=4).log
    assert first.state.shape != other.state.shape or (first.state != other.state).any()


def test_a_motor_stops(calm: Flight) -> None:
    """Its vehicle falls, its agent sees nothing any more, and its partners take over what they see."""
    flight = fly(scene(faults=[{"at_s": 15.0, "motor": {"agent": "blue", "rotor": 2}}]), vehicles="mujoco")
    lives_up_to_its_word(flight)
    report = flight.deployment.flight
    assert report is not None
    assert report.lost == ("blue",)
    assert [event.kind for event in report.events if event.kind in ("fault", "lost")] == ["fault", "lost"]
    blue, *others = flight.deployment.agents
    assert blue.score == 0.0
    assert flight.deployment.mission.agents[0].sensor.model == "blind"
    seen = sum(agent.score for agent in others)
    assert seen == pytest.approx(flight.deployment.score.final)
    assert 0.5 * calm.deployment.score.final < seen < calm.deployment.score.final
    assert any(entry.event == "lost" for entry in flight.deployment.history)


def test_whoever_is_lost_the_rest_is_proved(seeds: Callable[[int, int], range]) -> None:
    """At any time of the flight; also when a trade has just sent the lost one elsewhere."""
    for seed in seeds(4, 60):
        names = [agent["name"] for agent in SCENE["agents"]]
        fault = {"at_s": 6.0 + 3.0 * seed, "motor": {"agent": names[seed % 3], "rotor": seed % 4}}
        lives_up_to_its_word(fly(scene(faults=[fault]), vehicles="reference", seed=seed))


def test_an_obstacle_appears_on_a_waypoint(calm: Flight) -> None:
    """Whose waypoint it takes holds elsewhere, and the poses that are left are proved without that place."""
    blocked = calm.deployment.poses[0]
    sphere = {"center_m": [blocked.x, blocked.y, 1.5], "radius_m": 0.6}
    flight = fly(scene(faults=[{"at_s": 8.0, "obstacle": {"sphere": sphere}}]), vehicles="reference")
    lives_up_to_its_word(flight)
    blue = flight.deployment.agents[0]
    assert math.dist((blue.pose.x, blue.pose.y), (blocked.x, blocked.y)) > 0.6
    log = flight.log
    after = log.time > 20.0
    away = np.linalg.norm(log.state[after, 0, :3] - [blocked.x, blocked.y, 1.5], axis=1)
    assert away.min() > 0.6


def test_a_waypoint_behind_walls_is_given_up() -> None:
    x, y = -3.0, -3.0  # red is shut out of where it would see most
    walls = [
        {"box": {"x_m": [x - 1, x + 3.4], "y_m": [y + 3.0, y + 3.4], "z_m": [0, 20]}},
        {"box": {"x_m": [x + 3.0, x + 3.4], "y_m": [y - 1.2, y + 3.4], "z_m": [0, 20]}},
        {"box": {"x_m": [x - 1.4, x - 1], "y_m": [y - 1.2, y + 3.4], "z_m": [0, 20]}},
        {"box": {"x_m": [x - 1.4, x + 3.4], "y_m": [y - 1.4, y - 1.0], "z_m": [0, 20]}},
    ]
    flight = fly(scene(obstacles=walls), vehicles="reference")
    lives_up_to_its_word(flight)
    report = flight.deployment.flight
    assert report is not None
    assert report.waypoints_missed > 0
    assert any("cannot reach" in event.text for event in report.events)


def test_vehicles_that_start_too_close_are_refused() -> None:
    document = {**SCENE, "agents": [*SCENE["agents"], {"name": "late", "pose": {"x_m": 0.5, "y_m": 3}}]}
    with pytest.raises(InputError, match=r"green and late start 0\.50 m apart"):
        fly(parse_mission(json.dumps(document), format="json"), vehicles="kinematic")


def test_starts_that_an_obstacle_or_another_vehicle_blocks_are_named_with_their_line() -> None:
    over = {"box": {"x_m": [-3.5, -2.5], "y_m": [-3.5, -2.5], "z_m": [0.5, 1]}}
    with pytest.raises(MissionError) as caught:
        scene(obstacles=[over])
    (mistake,) = caught.value.mistakes
    assert mistake.key == "agents[0].pose"
    assert mistake.line is not None
    assert "in blue's way" in mistake.message
    with pytest.raises(MissionError) as caught:
        scene(obstacles=[{"sphere": {"center_m": [0, 0, 0], "radius_m": 30}}])
    assert [mistake.key for mistake in caught.value.mistakes] == [f"agents[{i}].pose" for i in range(3)]
    scene(obstacles=[{"box": {"x_m": [-3.5, -2.5], "y_m": [-3.5, -2.5], "z_m": [2.5, 3]}}])
    close = {**SCENE, "flight": {}, "agents": [*SCENE["agents"], {"name": "late", "pose": {"x_m": 0.5, "y_m": 3}}]}
    with pytest.raises(MissionError, match=r"green and late start 0\.50 m apart"):
        parse_mission(json.dumps(close), format="json")


def test_ctrl_c_keeps_what_is_known() -> None:
    def interrupt(news: Progress) -> None:
        if news.trades >= 1:
            raise KeyboardInterrupt

    flight = fly(scene(), vehicles="reference", on_progress=interrupt)
    assert flight.deployment.status is PlanStatus.INTERRUPTED
    assert flight.deployment.certificate is None
    assert flight.deployment.flight is not None
    assert flight.deployment.flight.duration > 0.0
    assert len(flight.log.time) > 10


def test_ctrl_c_before_anything_is_known() -> None:
    def interrupt(news: Progress) -> None:
        raise KeyboardInterrupt

    flight = fly(scene(), vehicles="reference", on_progress=interrupt)
    assert flight.deployment.status is PlanStatus.INTERRUPTED


def test_a_film_that_is_interrupted_leaves_the_flight(calm: Flight, tmp_path: Path) -> None:
    def interrupt(news: Progress) -> None:
        assert news.stage == "filming"
        if news.fraction:
            raise KeyboardInterrupt

    target = write_flight(calm, tmp_path / "out")
    before = {path.name: path.read_bytes() for path in target.iterdir()}
    with pytest.raises(KeyboardInterrupt):
        film_flight(calm, target, on_progress=interrupt)
    assert {path.name: path.read_bytes() for path in target.iterdir()} == before


def test_a_flight_draws_saves_and_shows_itself(calm: Flight, tmp_path: Path) -> None:
    assert isinstance(calm, covey.Flight)
    assert isinstance(calm.log, covey.FlightLog)
    axes = calm.plot()
    assert (axes.get_xlabel(), len(axes.figure.axes) > 3) == ("x [m]", True)
    alone = Figure().subplots()
    assert calm.plot(alone) is alone
    assert {"blue", "red", "green"} <= {line.get_label() for line in alone.lines}
    picture = calm._repr_png_()
    assert picture is not None
    assert picture.startswith(b"\x89PNG")
    assert "<img" in calm._repr_html_()
    assert repr(calm).startswith(f"Flight('{calm.deployment.mission.name}', ")
    assert read_result(calm.save(tmp_path / "out")).flight == calm.deployment.flight
    with pytest.raises(OutputError, match="is not empty"):
        calm.save(tmp_path / "out")
    assert (calm.save(tmp_path / "out", overwrite=True) / "flight.npz").exists()


def test_a_flight_that_ended_at_once_shows_itself_in_words() -> None:
    def interrupt(news: Progress) -> None:
        raise KeyboardInterrupt

    flight = fly(scene(), vehicles="kinematic", on_progress=interrupt)
    empty = dataclasses.replace(flight, log=dataclasses.replace(flight.log, time=flight.log.time[:1]))
    assert empty._repr_png_() is None
    assert empty._repr_html_() == html.escape(repr(empty))
    with pytest.raises(covey.ArgumentError, match="expected two moments"):
        empty.plot()


def test_a_flight_is_written_and_read_back(calm: Flight, tmp_path: Path) -> None:
    target = write_flight(calm, tmp_path / "out")
    names = {path.name for path in target.iterdir()}
    assert {"result.json", "flight.npz", "flight.png", "flight.pdf", "deployment.png", "agents.csv"} <= names
    back = read_result(target)
    assert back.flight == calm.deployment.flight
    assert result_text(back, target) == (target / "result.json").read_text()
    assert certify(target).holds
    keys = json.loads((target / "result.json").read_text())["flight"]
    assert {
        "simulator",
        "duration_s",
        "wall_s",
        "real_time_factor",
        "min_separation_m",
        "required_separation_m",
        "collisions",
        "tracking_rms_m",
        "waypoints_reached",
        "waypoints_missed",
        "events",
    } <= set(keys)
    log = FlightLog.load(target / "flight.npz")
    for field in dataclasses.fields(FlightLog):
        ours, theirs = getattr(calm.log, field.name), getattr(log, field.name)
        np.testing.assert_array_equal(ours, theirs) if isinstance(ours, np.ndarray) else None
        assert isinstance(ours, np.ndarray) or ours == theirs


def test_the_examples_can_be_flown(root: Path) -> None:
    for name in ("thesis-5.1", "eight-agents", "sixteen-agents"):
        mission = load_mission(root / "examples" / f"{name}.yaml")
        starts = np.array([[agent.pose.x, agent.pose.y] for agent in mission.agents])
        away = np.linalg.norm(starts[:, None] - starts[None], axis=2) + 9.0 * np.eye(len(starts))
        assert away.min() >= mission.flight.start_spacing > 0.9


def test_a_visitor_lets_a_vehicle_fail_and_puts_an_obstacle_in_the_way() -> None:
    told: list[Any] = []
    refused: list[str] = []
    steering = Steering()

    def watch(item: Any) -> None:
        told.append(item)
        if isinstance(item, Motion) and len(asks) and item.time >= asks[0][0]:
            steering.ask(asks.pop(0)[1], refused.append)

    asks: list[tuple[float, Command]] = [
        (4.0, AddObstacle(0.0, -1.0, 0.5, 3.0)),
        (4.2, AddObstacle(0.0, 3.0, 0.5, 3.0)),
        (4.4, AddObstacle(0.0, -1.0, 5000.0, 3.0)),
        (5.0, Kill(1)),
        (5.5, Kill(1)),
        (5.6, Kill(7)),
    ]
    flight = fly(scene(), vehicles="reference", watch=watch, steering=steering)
    assert steering.commands == ("pause", "resume", "step", "speed", "kill", "obstacle")
    assert sum(isinstance(item, ObstacleAppeared) for item in told) == 1
    assert len(flight.obstacles) == 1
    report = flight.deployment.flight
    assert report is not None
    assert report.lost == ("red",)
    assert len(refused) == 4
    assert sum("between its centre and each vehicle" in text for text in refused) == 2
    assert sum("still flies" in text for text in refused) == 2
    assert flight.deployment.certificate is not None
    assert flight.deployment.certificate.holds
