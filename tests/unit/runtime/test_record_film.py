"""Films of what a run told."""

from __future__ import annotations

import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from covey.errors import OutputError, ResultError
from covey.playground.sample import sample_feed
from covey.runtime.drawing.palette import rgb
from covey.runtime.drawing.record_film import RecordFrames, clock_of, headings, score_curve, write_record_film
from covey.runtime.watching.feed import (
    NOBODY,
    Activity,
    Health,
    Run,
    Scene,
    TeamChange,
    TeamState,
    Trading,
    Update,
)

Feed = list[Scene | Update]


@pytest.fixture(scope="module")
def flight() -> Feed:
    return list(sample_feed(agents=4, landmarks=60, seconds=10.0, rate=10.0))


@pytest.fixture(scope="module")
def plan(flight: Feed) -> Feed:
    return [replace(item, run=Run.PLAN) if isinstance(item, Scene) else item for item in flight]


def test_the_clock_of_a_flight_is_its_time_and_of_a_plan_what_was_to_be_seen(flight: Feed, plan: Feed) -> None:
    clock = clock_of(flight, Run.FLIGHT)
    assert (clock[0], clock[-1]) == (0.0, 10.0)
    assert all(first <= second for first, second in itertools.pairwise(clock))
    counted = clock_of(plan, Run.PLAN)
    assert counted[-1] == sum(isinstance(item, TeamChange | Trading) for item in plan)


def test_a_picture_every_so_often(flight: Feed, plan: Feed) -> None:
    frames = RecordFrames(flight, fps=10, dpi=40, speed=2.0)
    assert len(frames.times) == 51
    assert frames.times[-1] == 10.0
    assert frames.size == (512, 288)
    count = sum(isinstance(item, TeamChange | Trading) for item in plan)
    assert len(RecordFrames(plan, fps=10, dpi=40, speed=5.0).times) == pytest.approx(2 * count + 1, abs=1)


def test_pictures_show_the_owners_and_change_with_them(flight: Feed) -> None:
    frames = RecordFrames(flight, fps=1, dpi=100, speed=1.0)
    first = frames.picture(0).copy()
    last = frames.picture(len(frames.times) - 1).copy()
    assert first.shape == (720, 1280, 4)
    assert (first != last).any()
    scene = flight[0]
    assert isinstance(scene, Scene)
    for agent in scene.agents:
        dot = np.round(255 * rgb(agent.colour)).astype(np.int64)
        assert (np.abs(first[:, :, :3].astype(np.int64) - dot).max(axis=2) <= 2).sum() > 20
    frames.rewind()
    np.testing.assert_array_equal(frames.picture(0), first)


def test_the_dead_are_grey_and_who_has_left_is_not_there(flight: Feed) -> None:
    health = next(item for item in flight if isinstance(item, Health))
    scene = next(item for item in flight if isinstance(item, Scene))
    unlike = replace(scene, agents=(replace(scene.agents[0], colour="#123456"), *scene.agents[1:]))
    others = [item for item in flight[1:] if not isinstance(item, Health | TeamState)]
    state = next(item for item in flight if isinstance(item, TeamState))
    nothing = replace(state, owner=np.full_like(state.owner, NOBODY))

    def dots(activity: Activity) -> int:
        """How much of agent 1's colour is in the picture."""
        first = np.array([activity, *health.activity[1:]], dtype=np.uint8)
        feed = [unlike, nothing, replace(health, activity=first), *others]
        picture = RecordFrames(feed, fps=1, dpi=100, speed=1.0).picture(0)[:, :, :3].astype(np.int64)
        return int((np.abs(picture - np.array([0x12, 0x34, 0x56])).max(axis=2) <= 2).sum())

    assert dots(Activity.IDLE) > 20
    assert dots(Activity.DEAD) == dots(Activity.GONE) == 0


def test_the_curve_and_the_headings(flight: Feed) -> None:
    curve = score_curve(flight, clock_of(flight, Run.FLIGHT))
    assert len(curve) == 1 + sum(isinstance(item, TeamChange) for item in flight)
    yaw = np.array([0.0, 1.0, -2.0])
    rows = np.zeros((3, 7))
    rows[:, 3], rows[:, 6] = np.cos(0.5 * yaw), np.sin(0.5 * yaw)
    np.testing.assert_allclose(headings(rows), yaw)


def test_a_gif_is_written_whole(plan: Feed, tmp_path: Path) -> None:
    told: list[float] = []
    write_record_film(plan, tmp_path / "film.gif", speed=10.0, on_progress=told.append)
    with Image.open(tmp_path / "film.gif") as image:
        assert image.size == (800, 450)
        assert getattr(image, "n_frames", 1) > 3
    assert told[-1] == 1.0
    assert [path.name for path in tmp_path.iterdir()] == ["film.gif"]


def test_what_cannot_be_filmed_is_said(flight: Feed, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(OutputError, match=r"film.avi: expected a name that ends in .mp4 or .gif"):
        write_record_film(flight, tmp_path / "film.avi")
    monkeypatch.setattr("covey.runtime.drawing.record_film.find_ffmpeg", lambda: None)
    with pytest.raises(OutputError, match="needs ffmpeg"):
        write_record_film(flight, tmp_path / "film.mp4")
    with pytest.raises(ResultError, match="no scene"):
        write_record_film([], tmp_path / "film.gif")
    assert list(tmp_path.iterdir()) == []
