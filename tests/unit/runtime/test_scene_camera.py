"""Pictures of a flight: the ground's paint, the framing, and what is seen where."""

from __future__ import annotations

import importlib
from collections.abc import Iterator

import numpy as np
import pytest
from numpy.typing import NDArray

from covey.errors import ArgumentError
from covey.flight.layout import OBSERVATION, QUAT
from covey.flight.obstacles import Box, Prism, Sphere
from covey.flight.parameters import load_vehicle
from covey.runtime.drawing.palette import rgb
from covey.runtime.drawing.scene_camera import SceneCamera, Stage, View, frame_all, pictures, why_no_pictures
from covey.runtime.drawing.scene_model import FOV, magnification, paint_ground

IRIS = load_vehicle("iris")
BLUE, ORANGE = "#0072B2", "#E69F00"
LANDMARKS = np.array([[-1.0, -2.0], [1.0, 2.0]])
STAGE = Stage(
    [IRIS, IRIS],
    (BLUE, ORANGE),
    (-4.0, -3.0),
    (4.0, 3.0),
    obstacles=[Box((3, 2, 0), (4, 3, 1)), Sphere((-3, 2, 1), 0.3), Prism(((3, -3), (4, -3), (4, -2)), 0, 1)],
    object_radii=[0.2],
    landmarks_W=LANDMARKS,
    cell_m=1.0,
)
DOWN = View((0.0, 0.0, 0.0), 12.0, np.pi / 2.0, -np.pi / 2.0)
"""From above, north up."""


def states(*places: tuple[float, float, float]) -> NDArray[np.float64]:
    state = np.zeros((len(places), OBSERVATION))
    state[:, :3], state[:, QUAT] = places, 1.0
    return state


def nearest_to(colour: NDArray[np.float64]) -> str:
    """Which agent's colour a pixel is most like, by hue."""
    centred = colour - colour.mean()
    return max((BLUE, ORANGE), key=lambda name: float(centred @ (rgb(name) - rgb(name).mean())))


def test_landmarks_are_painted_where_they_are() -> None:
    pixels = paint_ground(STAGE, (BLUE, None))
    rows, columns = pixels.shape[:2]
    assert columns / rows == pytest.approx(8.0 / 6.0, rel=1e-3)

    def at(x: float, y: float) -> NDArray[np.float64]:
        return np.asarray(pixels[round((3.0 - y) / 6.0 * rows), round((x + 4.0) / 8.0 * columns)] / 255.0)

    np.testing.assert_allclose(at(-1.3, -2.2), 0.35 * np.array([0.93, 0.94, 0.95]) + 0.65 * rgb(BLUE), atol=0.01)
    assert np.ptp(at(1.2, 2.2)) < 0.08, "what nobody owns is grey"
    assert at(1.2, 2.2).mean() < at(2.3, 0.3).mean() - 0.05, "and darker than the floor"


def test_small_vehicles_are_drawn_larger_so_that_they_are_seen() -> None:
    crazyflie = load_vehicle("crazyflie")
    small = Stage([crazyflie, IRIS], (BLUE, ORANGE), (0.0, 0.0), (3.0, 4.0))
    assert magnification(small)[0] * crazyflie.body_radius == pytest.approx(0.028 * 5.0)
    assert magnification(small)[1] == 1.0


@pytest.mark.parametrize("aspect", [16.0 / 9.0, 1.0])
@pytest.mark.parametrize("azimuth", [0.0, 0.85, 2.5, -1.0])
def test_everything_is_in_the_frame_and_nothing_is_wasted(azimuth: float, aspect: float) -> None:
    places = np.array([[[0.0, 5.0, 4.0], [np.nan, 0.0, 0.0]], [[-6.0, 0.0, 2.0], [0.0, 0.0, 7.0]]])
    view = frame_all(STAGE, places, azimuth=azimuth, elevation=-0.5, aspect=aspect)
    ground = np.array([[x, y, 0.0] for x in (-4.0, 4.0) for y in (-3.0, 3.0)])
    everything = np.concatenate([ground, places.reshape(-1, 3)[[0, 2, 3]]])
    ce, se, ca, sa = np.cos(-0.5), np.sin(-0.5), np.cos(azimuth), np.sin(azimuth)
    forward, right, up = np.array([ce * ca, ce * sa, se]), np.array([sa, -ca, 0.0]), np.array([-se * ca, -se * sa, ce])
    from_eye = everything - (np.array(view.centre_W) - view.distance * forward)
    depth = from_eye @ forward
    across = np.abs(from_eye @ right) / depth / (aspect * np.tan(FOV / 2.0))
    upwards = np.abs(from_eye @ up) / depth / np.tan(FOV / 2.0)
    assert depth.min() > 0.0
    assert max(across.max(), upwards.max()) <= 1.0
    assert max(across.max(), upwards.max()) > 0.85


def test_a_stage_that_makes_no_sense_is_refused() -> None:
    with pytest.raises(ArgumentError, match="colours: expected one a vehicle, 2, got 1"):
        Stage([IRIS, IRIS], (BLUE,), (0.0, 0.0), (1.0, 1.0))
    with pytest.raises(ArgumentError, match="low_W, high_W"):
        Stage([IRIS], (BLUE,), (0.0, 0.0), (1.0, 0.0))


@pytest.fixture
def forget() -> Iterator[None]:
    why_no_pictures.cache_clear()
    yield
    why_no_pictures.cache_clear()


@pytest.mark.usefixtures("forget")
def test_what_is_missing_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(name: str) -> object:
        raise ImportError("no library of that name")

    monkeypatch.delenv("MUJOCO_GL", raising=False)
    monkeypatch.setattr(importlib, "import_module", refuse)
    assert "no library of that name" in (why_no_pictures() or "")
    with pytest.raises(ArgumentError, match="scene camera: expected mujoco-core, PyOpenGL"):
        SceneCamera(STAGE)
    why_no_pictures.cache_clear()
    monkeypatch.setenv("MUJOCO_GL", "off")
    assert "switched off by MUJOCO_GL=off" in (why_no_pictures() or "")


@pytest.fixture(scope="module")
def camera() -> Iterator[SceneCamera]:
    missing = why_no_pictures()
    if missing is not None:
        pytest.skip(missing)
    with SceneCamera(STAGE, width=320, height=240) as opened:
        yield opened


class TestPictures:
    """Needs a graphics library."""

    def test_vehicles_are_where_they_are_and_in_their_colours(self, camera: SceneCamera) -> None:
        empty = camera.picture(states((30.0, 0.0, 0.5), (30.0, 1.0, 0.5)), DOWN) / 255.0
        picture = camera.picture(states((-2.0, 0.0, 0.5), (2.0, 1.0, 0.5)), DOWN) / 255.0
        changed = np.abs(picture - empty).max(axis=2) > 0.1
        for x, y, colour in ((-2.0, 0.0, BLUE), (2.0, 1.0, ORANGE)):
            scale = 120.0 / np.tan(FOV / 2.0) / 11.5
            row, column = round(120.0 - y * scale), round(160.0 + x * scale)
            window = (slice(row - 12, row + 13), slice(column - 12, column + 13))
            assert changed[window].mean() > 0.2
            seen = picture[window][changed[window]]
            assert nearest_to(seen[np.argmax(np.ptp(seen, axis=1))]) == colour

    def test_landmarks_show_their_owners_and_change_with_them(self, camera: SceneCamera) -> None:
        away = states((30.0, 0.0, 0.5), (30.0, 1.0, 0.5))
        scale = 120.0 / np.tan(FOV / 2.0) / 12.0
        for owners in ((BLUE, ORANGE), (ORANGE, BLUE)):
            picture = camera.picture(away, DOWN, landmark_colours=owners) / 255.0
            for (x, y), owner in zip(LANDMARKS, owners, strict=True):
                assert nearest_to(picture[round(120.0 - y * scale), round(160.0 + x * scale)]) == owner

    def test_moving_objects_and_trails_are_seen(self, camera: SceneCamera) -> None:
        away = states((30.0, 0.0, 0.5), (30.0, 1.0, 0.5))
        plain = camera.picture(away, DOWN, objects_W=np.array([[30.0, 0.0, 1.0]]))
        assert not np.array_equal(camera.picture(away, DOWN, objects_W=np.array([[0.0, 0.0, 1.0]])), plain)
        trail = np.linspace([[-2.0, -1.0, 1.0], [-2.0, 1.0, 1.0]], [[2.0, -1.0, 1.0], [2.0, 1.0, 1.0]], 20)
        trails = camera.picture(away, DOWN, objects_W=np.array([[30.0, 0.0, 1.0]]), trails_W=trail)
        assert (np.abs(trails.astype(int) - plain).max(axis=2) > 20).sum() > 50

    def test_an_obstacle_that_is_not_there_yet_is_not_seen(self, camera: SceneCamera) -> None:
        away = states((30.0, 0.0, 0.5), (30.0, 1.0, 0.5))
        everything = camera.picture(away, DOWN).astype(int)
        scale = 120.0 / np.tan(FOV / 2.0) / 12.0
        places = [(3.5, 2.5), (-3.0, 2.0), (3.6, -2.6)]
        for k, (x, y) in enumerate(places):
            seen = np.abs(camera.picture(away, DOWN, hidden={k}).astype(int) - everything).max(axis=2) > 20
            rows, columns = np.nonzero(seen)
            assert len(rows) > 20
            assert abs(np.median(rows) - (120.0 - y * scale)) < 15
            assert abs(np.median(columns) - (160.0 + x * scale)) < 15
        assert np.array_equal(camera.picture(away, DOWN), everything)

    def test_what_does_not_fit_is_refused(self, camera: SceneCamera) -> None:
        fine = states((0.0, 0.0, 1.0), (1.0, 0.0, 1.0))
        with pytest.raises(ArgumentError, match=r"state: expected shape \(2, 13 or more\)"):
            camera.picture(fine[:1], DOWN)
        with pytest.raises(ArgumentError, match="objects_W: expected shape"):
            camera.picture(fine, DOWN, objects_W=np.zeros((2, 3)))
        with pytest.raises(ArgumentError, match="trails_W: expected shape"):
            camera.picture(fine, DOWN, trails_W=np.zeros((4, 3, 3)))
        with pytest.raises(ArgumentError, match="landmark_colours: expected one a landmark, 2, got 1"):
            camera.picture(fine, DOWN, landmark_colours=(BLUE,))

    def test_a_film_has_as_many_pictures_as_it_should(self, camera: SceneCamera) -> None:
        time = np.arange(0.0, 2.01, 0.1)
        state = np.repeat(states((-1.0, 0.0, 1.0), (1.0, 0.0, 1.0))[None], len(time), axis=0)
        state[:, 0, 0] += time
        film = list(pictures(STAGE, time, state, fps=2.0, speed=2.0, width=96, height=64))
        assert len(film) == 3
        assert all(picture.shape == (64, 96, 3) and picture.dtype == np.uint8 for picture in film)
        assert not np.array_equal(film[0], film[1])
