"""Chapters 2 and 3 of the thesis: Figures 2.2 to 2.9 (p. 22), 3.1 and 3.2 (p. 30), 3.3 and 3.4 (p. 32), sections 2.3.2
(p. 23), 3.4.2 and 3.4.3 (p. 35).

`covey.runtime.reproduce.findings` has one sentence for each thing that the thesis shows and what it asks of a flight.
Each is flown by the thesis's model and in the reference simulator, those with more than one body in MuJoCo too.
"""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from covey.flight.layout import SIG_DV3, SIG_EP, SIG_EV, SIG_V3, P
from covey.flight.parameters import load_vehicle
from covey.flight.trajectories import Circle, Follow, Hold
from covey.mission.exercise import Goal, parse_exercise
from covey.runtime.exercise import fly_exercise
from covey.runtime.reproduce.findings import STATEMENTS, Run, Statement, agrees, predicted_lag
from covey.runtime.reproduce.flights import ideal_run
from covey.runtime.reproduce.scenes import SCENES, scene
from covey.simulators.ideal import fly_ideal

REST = [0.0] * 6 + [1.0, 0.0, 0.0, 0.0]


@cache
def run(name: str, simulator: str) -> Run:
    """Fly a scene; what several tests look at is flown once."""
    exercise = scene(name)
    if simulator == "ideal":
        model = ideal_run(exercise)
        assert model is not None
        return model
    result = fly_exercise(exercise, simulator=simulator)
    assert result.summary["lost"] == []
    return Run(exercise, result.log, result.summary["collisions"])


def statement(key: str) -> Statement:
    return next(item for item in STATEMENTS if item.key == key)


@pytest.mark.parametrize("item", STATEMENTS, ids=lambda item: item.key)
@pytest.mark.parametrize("simulator", ["ideal", "reference"])
def test_it_happens_as_the_thesis_says(item: Statement, simulator: str) -> None:
    if (item.scene, simulator) == ("leader-follower", "ideal"):
        assert ideal_run(scene(item.scene)) is None  # the thesis has it in a simulator only
        return
    measures = item.measure(run(item.scene, simulator))
    assert agrees(measures), [measure for measure in measures if measure.holds is False]
    assert any(measure.holds for measure in measures)


@pytest.mark.parametrize("key", ["leader-follower", "go-to-two", "go-to-three", "swap", "hover"])
def test_it_happens_in_mujoco_too(key: str) -> None:
    measures = statement(key).measure(run(key, "mujoco"))
    assert agrees(measures), [measure for measure in measures if measure.holds is False]


@pytest.mark.parametrize(("name", "start"), [("regulation", 28.0), ("circle", 2.5)])
def test_v_falls_at_every_step(name: str, start: float) -> None:
    """Figures 2.5 and 2.9 (p. 22): by the model V3 has a negative derivative, and no two samples rise."""
    signals = run(name, "ideal").log.signals[:, 0]
    assert signals[0, SIG_V3] > start
    noise = 1e-12 * signals[0, SIG_V3]
    assert signals[:, SIG_DV3].max() < noise
    assert np.diff(signals[:, SIG_V3]).max() < noise


@pytest.mark.parametrize("pure", [True, False])
@pytest.mark.parametrize("vehicle", ["iris", "crazyflie"])
@pytest.mark.parametrize("trajectory", [Hold((1.0, 3.0, 2.0)), Circle((0.0, 0.0, 0.5))], ids=["regulation", "circle"])
def test_errors_vanish_by_the_model(trajectory: Hold | Circle, vehicle: str, pure: bool) -> None:
    """From rest, with the law itself and in the form that is flown; V falls below a billionth of what it was."""
    flight = fly_ideal(trajectory, REST, load_vehicle(vehicle), duration=25.0, pure=pure)
    assert flight.signals[-400:, SIG_EP].max() < 1e-6
    assert flight.signals[-400:, SIG_EV].max() < 1e-6
    assert flight.signals[-1, SIG_V3] < 1e-9 * flight.signals[0, SIG_V3]


@pytest.mark.parametrize(("name", "least"), [("go-to-two", 0.61), ("go-to-three", 0.56), ("swap", 0.61)])
def test_least_distances_by_the_field_alone(name: str, least: float) -> None:
    """Figures 3.3 and 3.4 (p. 32) and the swap (p. 35), repulsive and not gated (P2): of a separate implementation."""
    assert run(name, "ideal").log.separation.min() == pytest.approx(least, abs=0.006)


@pytest.mark.parametrize("name", ["go-to-two", "go-to-three", "swap"])
def test_nobody_waits_for_ever(name: str) -> None:
    """All reach their goals; in the air nobody comes closer than required, which is more than 0.5 m."""
    flown = run(name, "reference")
    goals = np.array([vehicle.task.p_W for vehicle in flown.exercise.vehicles if isinstance(vehicle.task, Goal)])
    assert np.linalg.norm(flown.log.state[-1, :, P : P + 3] - goals, axis=1).max() < 0.02
    assert flown.log.required_separation == pytest.approx(0.96)
    assert flown.log.separation.min() >= flown.log.required_separation
    assert {event.kind for event in flown.log.events} == {"reached"}


def test_the_swap_turns_the_same_way_for_both() -> None:
    """Section 3.4.2 (p. 35), "a seemingly circular path": point-symmetric about the middle."""
    state = run("swap", "reference").log.state[:, :, P : P + 3]
    np.testing.assert_allclose(
        state[:, 0] + state[:, 1], np.broadcast_to([2.0, 0.0, 2.0], state[:, 0].shape), atol=0.02
    )
    assert np.abs(state[:, 0, 1]).max() > 0.4


@pytest.mark.parametrize("offset", [0.0, 0.02, 0.3])
@pytest.mark.parametrize("speed", [0.2, 0.5])
def test_an_object_never_hits_whatever_way_it_comes(offset: float, speed: float) -> None:
    """Section 3.4.3 (p. 35): right through the vehicle's place, a little beside it, and well beside it."""
    text = SCENES["hover"].replace("0.1, 1.2]", f"{offset}, 1.2]").replace("speed_m_s: 0.3", f"speed_m_s: {speed}")
    exercise = parse_exercise(f"schema_version: 1\nname: hover\nexercise:{text}")
    assert exercise.objects[0].path_W[0] == (-3.0, offset, 1.2)
    result = fly_exercise(exercise, simulator="reference")
    assert result.summary["collisions"] == 0
    assert result.summary["min_object_gap_m"] > 0.0
    assert np.linalg.norm(result.log.state[-1, 0, P : P + 3] - [0.0, 0.0, 1.2]) < 0.05


@pytest.mark.parametrize("rate", [0.3, 1.0])
def test_a_followers_lag_is_what_its_gains_say(rate: float) -> None:
    """Section 2.3.2 (p. 23): by the model to 2 %; the formula is linear, and the vehicle tilts."""
    circle = Circle((0.0, 0.0, 1.5), 1.0, rate)
    now = [0.0]
    follow = Follow(lambda: circle(now[0])[:3], (0.0, 0.0, 0.0))

    def trajectory(time: float) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
        now[0] = time
        return follow(time)

    vehicle = load_vehicle("iris")
    flight = fly_ideal(trajectory, [1.0, 0.0, 1.5, *REST[3:]], vehicle, duration=25.0)
    lag = np.linalg.norm(flight.state[-1, :3] - flight.reference[-1, :3])
    assert lag == pytest.approx(predicted_lag(vehicle.gains, 1.0, rate), rel=0.02)


def test_a_flight_that_goes_wrong_does_not_agree() -> None:
    """The swap without navigation: they meet in the middle."""
    text = (
        SCENES["swap"]
        .replace("z_m: 1}\n", "z_m: 1, direct: true}}\n")
        .replace("z_m: 1}}\n", "z_m: 1, direct: true}}\n")
    )
    exercise = parse_exercise(f"schema_version: 1\nname: swap\nexercise:{text}")
    result = fly_exercise(exercise, simulator="reference")
    measures = statement("swap").measure(Run(exercise, result.log, result.summary["collisions"]))
    wrong = {measure.quantity for measure in measures if measure.holds is False}
    assert {"least scaled distance between centres", "contacts"} <= wrong
    assert not agrees(measures)
    wrong_log = run("regulation", "reference")
    log = wrong_log.log
    short = Run(wrong_log.exercise, type(log)(**{**vars(log), "signals": log.signals[:20], "time": log.time[:20]}))
    assert not agrees(statement("regulation").measure(short))
    rising = Run(wrong_log.exercise, type(log)(**{**vars(log), "signals": log.signals[::-1]}))
    assert not agrees(statement("regulation-v").measure(rising))
