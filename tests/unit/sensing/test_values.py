"""Values of the models worked out by hand, and the laws of their parameters."""

from __future__ import annotations

import math

import numpy as np
import pytest

from covey.environment import Landmarks
from covey.errors import ArgumentError, InputError
from covey.geometry import Region
from covey.optimize import Exact, PoseProblem
from covey.sensing import MODELS, Anisotropic, Isotropic, Oriented, VisibilityModel, build_model
from covey.testing.visibility import sample_landmarks, sample_poses

R = math.sqrt(0.5)


def see(
    model: VisibilityModel, pose: tuple[float, float, float], point: tuple[float, float], normal: float = 0.0
) -> float:
    """Visibility of one landmark whose outward normal has this bearing, radians."""
    landmarks = Landmarks(np.array([point]), normals_W=np.array([[math.cos(normal), math.sin(normal)]]))
    return float(model.visibility(np.array([pose]), landmarks)[0, 0])


@pytest.mark.parametrize(
    ("pose", "point", "expected"),
    [
        # (4.1), R1: behind the camera, and exactly beside it
        ((0, 0, 0), (-1.0, 0.0), 0.0),
        ((0, 0, 0), (-0.1, 5.0), 0.0),
        ((0, 0, 0), (0.0, 1.0), 0.0),
        # R2: in front and nearer than 1: s_x
        ((0, 0, 0), (0.25, 0.0), 0.25),
        ((0, 0, 0), (0.5, 0.5), 0.5),
        ((0, 0, 0), (0.6, -0.8), 0.6),
        # R3: in front and further than 1: s_x / |s|^2
        ((0, 0, 0), (2.0, 0.0), 0.5),
        ((0, 0, 0), (1.0, 1.0), 0.5),
        ((0, 0, 0), (3.0, -4.0), 0.12),
        ((0, 0, 0), (1.0, 7.0), 0.02),
        # the best there is, and the landmark itself
        ((0, 0, 0), (1.0, 0.0), 1.0),
        ((2, 3, 1), (2.0, 3.0), 0.0),
        # (4.3): the landmark in the frame of a camera at (1, 2), looking along y
        ((1, 2, math.pi / 2), (1.0, 3.0), 1.0),
        ((1, 2, math.pi / 2), (1.0, 4.0), 0.5),
        ((1, 2, math.pi / 2), (-3.0, 5.0), 0.12),
        ((1, 2, math.pi / 2), (1.0, 1.0), 0.0),
        ((-1, 0, math.pi / 4), (-0.5, 0.5), R),
    ],
)
def test_values_of_the_thesis_formula(
    pose: tuple[float, float, float], point: tuple[float, float], expected: float
) -> None:
    assert see(Anisotropic(), pose, point) == pytest.approx(expected, abs=1e-15)


@pytest.mark.parametrize(("distance", "expected"), [(0.0, 0.0), (0.3, 0.3), (1.0, 1.0), (2.0, 0.5), (10.0, 0.1)])
@pytest.mark.parametrize("bearing", [0.0, 1.0, 3.0, -2.0])
def test_isotropic_depends_on_the_distance_alone(distance: float, expected: float, bearing: float) -> None:
    point = (distance * math.cos(bearing), distance * math.sin(bearing))
    for yaw in (0.0, 1.0, -3.0):
        assert see(Isotropic(), (0.0, 0.0, yaw), point) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize(
    ("point", "normal", "expected"),
    [
        # the landmark faces the camera: -cos(phi) = 1 (the thesis prints cos(phi), negative here: I1)
        ((1.0, 0.0), math.pi, 1.0),
        ((2.0, 0.0), math.pi, 0.5),
        ((0.5, 0.5), math.pi, 0.5),
        # it faces away, or exactly aside
        ((1.0, 0.0), 0.0, 0.0),
        ((1.0, 0.0), math.pi / 2, 0.0),
        # 60 degrees aside: -cos(120 degrees) = 1/2
        ((1.0, 0.0), math.radians(120.0), 0.5),
        ((1.0, 0.0), math.radians(-120.0), 0.5),
        ((2.0, 0.0), math.radians(120.0), 0.25),
        # behind the camera, facing as the camera does: both factors are negative, and nothing is seen
        ((-1.0, 0.0), 0.0, 0.0),
        ((-1.0, 0.0), math.pi, 0.0),
    ],
)
def test_oriented_sees_what_faces_it(point: tuple[float, float], normal: float, expected: float) -> None:
    assert see(Oriented(), (0.0, 0.0, 0.0), point, normal) == pytest.approx(expected, abs=1e-15)


@pytest.mark.parametrize("name", sorted(MODELS))
@pytest.mark.parametrize("scale", [0.01, 0.5, 3.0, 1000.0])
def test_the_optimal_distance_is_the_unit_of_length(name: str, scale: float) -> None:
    rng = np.random.default_rng(2)
    one = build_model(name)
    landmarks = sample_landmarks(one, 20, rng=rng)
    poses = sample_poses(one, 100, landmarks, rng=rng)
    scaled = Landmarks(scale * landmarks.positions_W, normals_W=landmarks.normals_W)
    seen = build_model(name, {"optimal_distance": scale}).visibility(poses * [scale, scale, 1.0], scaled)
    np.testing.assert_allclose(seen, one.visibility(poses, landmarks), rtol=0.0, atol=1e-11)


@pytest.mark.parametrize("name", sorted(MODELS))
def test_the_best_distance_is_the_optimal_one(name: str) -> None:
    model = build_model(name, {"optimal_distance": 2.5})
    seen = [see(model, (0.0, 0.0, 0.0), (x, 0.0), math.pi) for x in (1.0, 2.4, 2.5, 2.6, 5.0)]
    assert seen[2] == 1.0
    assert max(seen[:2] + seen[3:]) < 1.0
    assert model.lipschitz[0] == pytest.approx(0.4)


def test_oriented_is_never_better_than_the_same_camera_without_orientation() -> None:
    rng = np.random.default_rng(4)
    landmarks = sample_landmarks(Oriented(), 30, rng=rng)
    poses = sample_poses(Oriented(), 300, landmarks, rng=rng)
    assert (Oriented().visibility(poses, landmarks) <= Anisotropic().visibility(poses, landmarks) + 1e-15).all()
    assert (Anisotropic().visibility(poses, landmarks) <= Isotropic().visibility(poses, landmarks) + 1e-15).all()


@pytest.mark.parametrize("distance", [0.0, -1.0, math.nan, math.inf])
@pytest.mark.parametrize("name", sorted(MODELS))
def test_an_impossible_optimal_distance_is_refused(name: str, distance: float) -> None:
    with pytest.raises(ArgumentError, match="optimal_distance: expected a number of metres above 0"):
        MODELS[name](optimal_distance=distance)


def test_oriented_needs_normals() -> None:
    with pytest.raises(ArgumentError, match="needs normals"):
        Oriented().visibility(np.zeros((1, 3)), Landmarks(np.zeros((1, 2))))


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("thermal", "expected one of anisotropic"),
        ("no.such.module:Model", "cannot be loaded"),
        ("gone.py:Model", "gone.py"),
    ],
)
def test_an_unknown_model_is_refused(name: str, text: str) -> None:
    with pytest.raises(InputError, match=text):
        build_model(name)


def test_an_unknown_option_is_refused() -> None:
    with pytest.raises(InputError, match="cannot be built"):
        build_model("anisotropic", {"field_of_view": 1.0})
    with pytest.raises(InputError, match="as in VisibilityModel"):
        build_model("covey.geometry:Pose2", {"x": 0.0, "y": 0.0, "yaw": 0.0})


def test_a_blind_camera_sees_nothing() -> None:
    """What a lost vehicle gets: every rule of a model holds, and there is nothing to see or to find."""
    blind = build_model("blind")
    landmarks = Landmarks(np.random.default_rng(0).uniform(-3.0, 3.0, (20, 2)))
    np.testing.assert_array_equal(blind.visibility(np.zeros((3, 3)), landmarks), np.zeros((3, 20)))
    assert blind.maximum == 0.0
    result = Exact().maximize(PoseProblem(blind, landmarks, Region.box(-3, 3, -3, 3)), rng=np.random.default_rng(0))
    assert (result.score, result.upper_bound) == (0.0, 0.0)
