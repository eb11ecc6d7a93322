from __future__ import annotations

import re
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image, ImageSequence
from tests.unit.runtime.flights import Moment, flight, flight_of, moments

from covey.errors import ArgumentError, OutputError
from covey.flight.obstacles import Box
from covey.runtime.drawing import film
from covey.runtime.drawing.film_frames import FilmFrames
from covey.runtime.drawing.flight_paths import pale
from covey.runtime.drawing.palette import colours, rgb
from covey.runtime.result import Deployment
from covey.vehicles.flight_log import FlightEvent, FlightLog

MakeDeployment = Callable[..., Deployment]
Flown = tuple[Deployment, FlightLog, list[Moment]]


@pytest.fixture
def flown(make_deployment: MakeDeployment) -> Flown:
    deployment = make_deployment(agents=3)
    log = flight_of(deployment, duration=12.0)
    return deployment, log, moments(deployment, log, count=4)


@pytest.fixture
def without_ffmpeg(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(film, "find_ffmpeg", lambda: None)


@pytest.fixture
def ffmpeg() -> str:
    program = film.find_ffmpeg()
    if program is None:
        pytest.skip("no ffmpeg with H.264 here")
    return program


def frames_of(flown: Flown, *, dpi: float = 50.0, fps: int = 5, **options: Any) -> FilmFrames:
    deployment, log, snapshots = flown
    times = film.film_times(log, 4.0, fps)
    options = {"mission": deployment.mission, "moments": snapshots, "scene": None, **options}
    return FilmFrames(log, times, dpi=dpi, speed=4.0, **options)


def near(pixels: NDArray[np.uint8], colour: NDArray[np.float64]) -> int:
    """How many pixels have a colour."""
    return int(np.count_nonzero(np.abs(pixels[:, :, :3].astype(int) - np.rint(255 * colour)).max(axis=2) <= 2))


def test_speed_is_round_and_the_film_short() -> None:
    for duration in (1.0, 26.0, 60.0, 100.0, 777.0, 1e5):
        speed = film.choose_speed(duration)
        assert speed >= 1.0
        assert duration / speed <= film.LONGEST
        assert duration < 30.0 or duration / speed > 0.6 * film.LONGEST


def test_times_begin_and_end_with_the_flight() -> None:
    log = flight(1, duration=12.0)
    times = film.film_times(log, 2.0, 25)
    assert (times[0], times[-1]) == (0.0, 12.0)
    assert len(times) == 151
    np.testing.assert_allclose(np.diff(times)[:-1], 0.08)
    assert film.film_times(log, 1000.0, 25).tolist() == [0.0, 12.0]


@pytest.mark.usefixtures("without_ffmpeg")
def test_gif_has_the_right_pictures(flown: Flown, tmp_path: Path) -> None:
    deployment, log, snapshots = flown
    told: list[float] = []
    path = film.write_film(
        log, tmp_path / "a.b", mission=deployment.mission, snapshots=snapshots, speed=6.0, on_progress=told.append
    )
    assert path == tmp_path / "a.b.gif"
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.b.gif"]
    with Image.open(path) as image:
        assert image.size == (800, 450)
        durations = [frame.info["duration"] for frame in ImageSequence.Iterator(image)]
        image.seek(len(durations) - 1)
        last = np.asarray(image.convert("RGB"))
    assert sum(durations) == 20 * 1000 // film.GIF_FPS + 1000 * film.HOLD
    assert len(durations) == 21
    assert told == pytest.approx(np.arange(1, 22) / 21)
    counts = np.bincount(deployment.owner, minlength=3)
    shades = [int((np.abs(last - 255 * rgb(colour)).max(axis=2) < 14).sum()) for colour in pale(colours(log.names))]
    assert np.argsort(shades).tolist() == np.argsort(counts).tolist()


def test_mp4_starts_at_once_and_has_the_right_pictures(flown: Flown, ffmpeg: str, tmp_path: Path) -> None:
    deployment, log, snapshots = flown
    path = film.write_film(log, tmp_path / "film", mission=deployment.mission, snapshots=snapshots, speed=12.0)
    assert path == tmp_path / "film.mp4"
    assert [entry.name for entry in tmp_path.iterdir()] == ["film.mp4"]
    data = path.read_bytes()
    assert data[4:8] == b"ftyp"
    assert data.index(b"moov") < data.index(b"mdat")
    shown = subprocess.run([ffmpeg, "-i", str(path), "-f", "null", "-"], capture_output=True, check=True, text=True)
    assert "h264" in shown.stderr
    assert "yuv420p" in shown.stderr
    assert "1280x720" in shown.stderr
    assert re.findall(r"frame=\s*(\d+)", shown.stderr)[-1] == str(26 + round(film.HOLD * film.FPS))


def test_cells_change_hands(flown: Flown) -> None:
    deployment, log, _ = flown
    everyone: list[Moment] = [(0.0, np.zeros_like(deployment.owner), ()), (6.0, np.ones_like(deployment.owner), ())]
    frames = frames_of(flown, moments=everyone)
    first, second, _ = (rgb(colour) for colour in pale(colours(log.names)))
    start, end = frames.picture(0).copy(), frames.picture(len(frames.times) - 1).copy()
    assert near(start, first) > 5000 > 50 > near(start, second)
    assert near(end, second) > 0.4 * near(start, first)
    assert near(end, first) < 50
    fading = frames_of(flown, moments=everyone, fps=10)
    late = int(np.searchsorted(fading.times, 6.0))
    mixed = [near(fading.picture(index), second) for index in range(late + 10)]
    assert mixed[late] < 50 < mixed[late + 9]


def test_vehicles_are_where_they_were(flown: Flown) -> None:
    deployment, log, _ = flown
    frames = frames_of(flown, dpi=100.0, moments=())
    index = len(frames.times) // 2
    image = frames.picture(index)
    row = int(np.searchsorted(log.time, frames.times[index]))
    for vehicle in range(3):
        x, y = frames.map.transData.transform(log.state[row, vehicle, :2])
        around = image[image.shape[0] - int(y) - 2 : image.shape[0] - int(y) + 2, int(x) - 1 : int(x) + 2, :3]
        assert around.mean() < 60.0  # the black dot
    assert len(deployment.agents) == 3


def test_page_changes_only_where_something_moves(flown: Flown) -> None:
    frames = frames_of(flown, moments=())
    before, after = frames.picture(5).copy(), frames.picture(6).copy()
    assert (before != after).any()
    height, width = before.shape[:2]
    assert np.array_equal(before[: height // 10, : width // 2], after[: height // 10, : width // 2])
    assert np.array_equal(frames.picture(5), before)  # drawn again it is the same


def test_scene_is_shown_beside_the_map(flown: Flown, tmp_path: Path) -> None:
    asked: list[float] = []

    def scene(time: float) -> NDArray[np.uint8] | None:
        asked.append(time)
        return None if time > 6.0 else np.full((90, 160, 3), (10, 200, 30), dtype=np.uint8)

    frames = frames_of(flown, scene=scene)
    green = np.array([10, 200, 30]) / 255
    counts = [near(frames.picture(index), green) for index in range(len(frames.times))]
    assert min(counts) > 10000
    assert asked[1:] == frames.times.tolist()
    assert near(frames_of(flown).picture(0), green) == 0


def test_without_mission_and_with_obstacle() -> None:
    log = flight(2, duration=12.0, scored=False, objects=1)
    times = film.film_times(log, 4.0, 5)
    options: dict[str, Any] = {"mission": None, "moments": (), "dpi": 50.0, "speed": 4.0, "scene": None}
    plain = FilmFrames(log, times, **options).picture(3)
    box = Box((-1.0, -1.0, 0.0), (1.0, 1.0, 3.0))
    with_box = FilmFrames(log, times, **options, obstacles=[box]).picture(3)
    assert np.count_nonzero((plain != with_box).any(axis=2)) > 500


def test_an_obstacle_is_shown_from_when_it_appears() -> None:
    log = flight(2, duration=12.0, scored=False, objects=1)
    times = film.film_times(log, 4.0, 5)
    options: dict[str, Any] = {"mission": None, "moments": (), "dpi": 50.0, "speed": 4.0, "scene": None}
    there, later = Box((-1.0, -1.0, 0.0), (0.0, 1.0, 3.0)), Box((0.5, -1.0, 0.0), (1.5, 1.0, 3.0))
    both = FilmFrames(log, times, **options, obstacles=[there, later])
    frames = FilmFrames(log, times, **options, obstacles=[there, later], appeared=[0.0, float(times[4])])
    for _ in range(2):
        same = [np.array_equal(frames.picture(k), both.picture(k)) for k in range(8)]
        assert same == [False] * 4 + [True] * 4
        frames.rewind()
        both.rewind()


@pytest.mark.parametrize(
    "change", [{"side": 60, "spacing": 0.2}, {"spacing": None}, {"own_region": True, "agents": 40}]
)
def test_other_missions(change: dict[str, Any], make_deployment: MakeDeployment) -> None:
    deployment = make_deployment(**{"agents": 3, **change})
    log = flight_of(deployment, duration=12.0)
    frames = frames_of((deployment, log, moments(deployment, log, count=3)))
    assert frames.picture(2).shape == (360, 640, 4)


def test_lost_vehicles_are_crossed_out_and_grave_events_told(flown: Flown) -> None:
    deployment, log, snapshots = flown
    lost = FlightEvent(0.1, "lost", (log.names[0],), "agent 1 is lost")
    other = FlightEvent(0.2, "trade", log.names[1:], "a trade")
    changed = flight_of(deployment, duration=12.0, events=(lost, other))
    frames = frames_of((deployment, changed, snapshots))
    plain = frames_of((deployment, flight_of(deployment, duration=12.0, events=()), snapshots))
    red = rgb("#D55E00")
    assert near(frames.picture(3), red) > near(plain.picture(3), red)
    assert any("agent 1 is lost" in text.get_text() for text in frames.figure.texts)


@pytest.mark.parametrize("suffix", ["gif", "mp4"])
def test_interrupted_film_leaves_nothing(
    suffix: str, flown: Flown, tmp_path: Path, request: pytest.FixtureRequest
) -> None:
    request.getfixturevalue("without_ffmpeg" if suffix == "gif" else "ffmpeg")
    deployment, log, snapshots = flown
    children: list[subprocess.Popen[bytes]] = []
    popen = subprocess.Popen

    def start(*arguments: Any, **options: Any) -> subprocess.Popen[bytes]:
        children.append(popen(*arguments, **options))
        return children[-1]

    def stop(done: float) -> None:
        assert any(tmp_path.iterdir())
        if done > 0.3:
            raise KeyboardInterrupt

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(subprocess, "Popen", start)
        with pytest.raises(KeyboardInterrupt):
            film.write_film(
                log, tmp_path / "film", mission=deployment.mission, snapshots=snapshots, speed=12.0, on_progress=stop
            )
    assert list(tmp_path.iterdir()) == []
    assert all(child.poll() is not None for child in children)


@pytest.mark.usefixtures("without_ffmpeg")
def test_nothing_is_overwritten(flown: Flown, tmp_path: Path) -> None:
    (tmp_path / "film.gif").write_text("mine")
    with pytest.raises(OutputError, match=r"film\.gif: is there already"):
        film.write_film(flown[1], tmp_path / "film", mission=None)
    assert (tmp_path / "film.gif").read_text() == "mine"
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="cannot be written"):
        film.write_film(flown[1], tmp_path / "file" / "film", mission=None, speed=100.0)


def script(folder: Path, text: str) -> Path:
    path = folder / "ffmpeg"
    path.write_text(f"#!/bin/sh\n{text}\n")
    path.chmod(0o755)
    return path


def test_ffmpeg_that_fails(flown: Flown, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    program = script(tmp_path, "echo 'no such codec' >&2; exit 3")
    monkeypatch.setattr(film, "find_ffmpeg", lambda: str(program))
    target = tmp_path / "out"
    with pytest.raises(OutputError, match="ffmpeg failed: no such codec"):
        film.write_film(flown[1], target / "film", mission=None, speed=20.0)
    assert not target.exists()


def test_ffmpeg_without_h264_is_not_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def nothing(_: str) -> Any:
        raise ImportError

    monkeypatch.setattr("covey.runtime.drawing.film.importlib.import_module", nothing)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=":")
    program = script(tmp_path, "echo ' V..... libx264  H.264'")
    assert film.find_ffmpeg() == str(program)
    for text in ("echo ' V..... mpeg4'", "exit 1"):
        script(tmp_path, text)
        assert film.find_ffmpeg() is None


def test_bad_input(flown: Flown, tmp_path: Path) -> None:
    deployment, log, snapshots = flown
    empty = FlightLog(**{**vars(log), "time": np.empty(0)})
    still = FlightLog(**{**vars(log), "time": np.zeros(len(log.time))})
    mission = deployment.mission
    few: list[Moment] = [(0.0, deployment.owner[:-1], ())]
    strange: list[Moment] = [(0.0, deployment.owner + 9, ())]
    for wrong, text in (
        ({"log": empty}, "got 0 moments"),
        ({"log": still}, "expected a flight of some duration"),
        ({"speed": 0.0}, "speed: expected a number above 0, got 0.0"),
        ({"speed": float("nan")}, "speed: expected a number above 0, got nan"),
        ({"log": flight(2, duration=12.0)}, "mission: expected 2 agents, as in the log, got 3"),
        ({"obstacles": [Box((0, 0, 0), (1, 1, 1))], "appeared": [0.0, 1.0]}, "appeared: expected one time an obstacle"),
        ({"snapshots": few}, r"snapshots: expected an owner for each of 400 landmarks, got \(399,\)"),
        ({"snapshots": strange}, "snapshots: expected owners from -1 to 2"),
    ):
        arguments: dict[str, Any] = {"log": log, "mission": mission, "snapshots": snapshots, **wrong}
        with pytest.raises(ArgumentError, match=text):
            film.write_film(path_stem=tmp_path / "film", **arguments)
    assert list(tmp_path.iterdir()) == []
