"""What every visibility model must do, as checks that raise AssertionError."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from covey.environment import Landmarks
from covey.geometry import Pose2
from covey.sensing import VisibilityModel

STEPS = (1e-6, 1e-3, 0.1, 1.0, 10.0)
"""How far apart two poses are whose visibilities are compared, times the model's length and in radians."""


def check_visibility_model(
    model: VisibilityModel, *, seed: int = 0, samples: int = 400, invariant: bool = True
) -> None:
    """Run every check of the suite on a visibility model.

    Parameters
    ----------
    model : VisibilityModel
    seed : int
        Root of all random poses and landmarks.
    samples : int
        How many poses are drawn for each check.
    invariant : bool
        Also check that moving camera and landmarks together changes nothing.  False is for a model that knows where
        in the world it is, such as one with walls.

    Raises
    ------
    AssertionError
        If a check fails; the text says which and how.

    Notes
    -----
    The proofs of `exact` rest on `maximum` and `lipschitz`; samples can refute them, not prove them.

    Examples
    --------
    >>> from covey.sensing import Isotropic
    >>> check_visibility_model(Isotropic(optimal_distance=2.0))
    """
    check_attributes(model)
    for number, check in enumerate((check_shapes, check_range, check_independence, check_lipschitz)):
        check(model, samples, rng=np.random.default_rng([seed, number]))
    if invariant:
        check_invariance(model, samples, rng=np.random.default_rng([seed, 99]))


def check_attributes(model: VisibilityModel) -> None:
    """A name, whether normals are needed, a positive maximum, two Lipschitz constants of at least 0."""
    _require(isinstance(model.name, str) and bool(model.name), f"name: expected some text, got {model.name!r}")
    _require(
        isinstance(model.needs_normals, bool), f"needs_normals: expected True or False, got {model.needs_normals!r}"
    )
    finite = math.isfinite(model.maximum) and model.maximum > 0.0
    _require(finite, f"maximum: expected a finite number above 0, got {model.maximum!r}")
    _require(len(model.lipschitz) == 2, f"lipschitz: expected (per metre, per radian), got {model.lipschitz!r}")
    for constant in model.lipschitz:
        finite = math.isfinite(constant) and constant >= 0.0
        _require(finite, f"lipschitz: expected finite numbers of at least 0, got {model.lipschitz!r}")


def check_shapes(model: VisibilityModel, samples: int, *, rng: np.random.Generator) -> None:
    """One row a pose, one column a landmark, numbers of type float64; nothing that was given is changed."""
    for m, n in ((0, 0), (0, 3), (1, 0), (1, 1), (4, 7)):
        landmarks = sample_landmarks(model, n, rng=rng)
        poses = sample_poses(model, m, rng=rng)
        before = poses.copy()
        seen = model.visibility(poses, landmarks)
        _require(seen.shape == (m, n), f"visibility: expected shape {(m, n)}, got {seen.shape}")
        _require(seen.dtype == np.float64, f"visibility: expected float64, got {seen.dtype}")
        _require(np.array_equal(poses, before), "visibility: the poses that were given were changed")


def check_range(model: VisibilityModel, samples: int, *, rng: np.random.Generator) -> None:
    """From 0 to `maximum`, near and far, and at the landmark itself."""
    landmarks = sample_landmarks(model, 30, rng=rng)
    seen = model.visibility(sample_poses(model, samples, landmarks, rng=rng), landmarks)
    _require(bool(np.isfinite(seen).all()), "visibility: expected finite numbers, got NaN or infinity")
    _require(bool((seen >= 0.0).all()), f"visibility: expected at least 0, got {seen.min()}")
    highest = float(seen.max())
    _require(highest <= model.maximum * (1.0 + 1e-12), f"visibility: expected at most {model.maximum}, got {highest}")


def check_independence(model: VisibilityModel, samples: int, *, rng: np.random.Generator) -> None:
    """Each number depends on its pose and its landmark alone, not on weights, neighbours or earlier calls."""
    landmarks = sample_landmarks(model, 12, rng=rng)
    poses = sample_poses(model, samples, landmarks, rng=rng)
    seen = model.visibility(poses, landmarks)
    weighted = Landmarks(landmarks.positions_W, rng.uniform(0.0, 2.0, 12), landmarks.normals_W)
    _require(np.array_equal(seen, model.visibility(poses, weighted)), "visibility: must not depend on the weights")
    chosen = rng.permutation(12)[:5]
    part = model.visibility(poses[::-1], landmarks.subset(chosen))[::-1]
    text = "visibility: must depend on its own pose and landmark alone"
    _require(np.allclose(part, seen[:, chosen], rtol=1e-12, atol=1e-12 * model.maximum), text)
    _require(np.array_equal(seen, model.visibility(poses, landmarks)), "visibility: must be the same when asked again")
    turned = poses + np.array([0.0, 0.0, 2.0 * math.pi])
    same = np.allclose(model.visibility(turned, landmarks), seen, rtol=0.0, atol=1e-9 * model.maximum)
    _require(same, "visibility: must not change by a full turn")


def check_lipschitz(model: VisibilityModel, samples: int, *, rng: np.random.Generator) -> None:
    """No visibility changes faster than `lipschitz` says, over steps of any size."""
    position, heading = sampled_slopes(model, samples, rng=rng)
    for slope, constant, unit in ((position, model.lipschitz[0], "metre"), (heading, model.lipschitz[1], "radian")):
        text = f"lipschitz: expected at most {constant} per {unit}, got a change of {slope} per {unit}"
        _require(slope <= constant * (1.0 + 1e-6) + 1e-6 * model.maximum / max(_length(model), 1.0), text)


def check_invariance(model: VisibilityModel, samples: int, *, rng: np.random.Generator) -> None:
    """A motion of the plane, applied to camera and landmarks, changes nothing."""
    landmarks = sample_landmarks(model, 20, rng=rng)
    poses = sample_poses(model, samples, landmarks, rng=rng)
    seen = model.visibility(poses, landmarks)
    for _ in range(3):
        motion = Pose2.from_array([*(3.0 * _length(model) * rng.normal(size=2)), rng.uniform(-math.pi, math.pi)])
        turn = Pose2(0.0, 0.0, motion.yaw)
        normals = None if landmarks.normals_W is None else turn.transform(landmarks.normals_W)
        moved = Landmarks(motion.transform(landmarks.positions_W), landmarks.weights, normals)
        moved_poses = np.column_stack([motion.transform(poses[:, :2]), poses[:, 2] + motion.yaw])
        away = np.abs(model.visibility(moved_poses, moved) - seen).max()
        text = f"visibility: moving camera and landmarks together changed it by {away}"
        _require(away <= 1e-9 * max(1.0, model.maximum), text)


def sampled_slopes(model: VisibilityModel, samples: int, *, rng: np.random.Generator) -> tuple[float, float]:
    """Return the steepest change of one visibility found per metre and per radian."""
    length = _length(model)
    landmarks = sample_landmarks(model, 30, rng=rng)
    steepest = [0.0, 0.0]
    for step in STEPS:
        poses = sample_poses(model, samples, landmarks, rng=rng)
        seen = model.visibility(poses, landmarks)
        bearing = rng.uniform(-math.pi, math.pi, samples)
        moves = np.column_stack([np.cos(bearing), np.sin(bearing), np.zeros(samples)]) * step * length
        turns = np.zeros((samples, 3))
        turns[:, 2] = rng.choice([-1.0, 1.0], samples) * min(step, math.pi)
        for axis, (change, size) in enumerate(((moves, step * length), (turns, min(step, math.pi)))):
            slope = np.abs(model.visibility(poses + change, landmarks) - seen) / size
            # a difference of two rounded numbers, divided by a small one
            slope = np.maximum(0.0, slope - 1e-14 * model.maximum / size)
            steepest[axis] = max(steepest[axis], float(slope.max(initial=0.0)))
    return steepest[0], steepest[1]


def sample_landmarks(model: VisibilityModel, n: int, *, rng: np.random.Generator) -> Landmarks:
    """Draw landmarks with normals, a few of the model's lengths apart."""
    bearing = rng.uniform(-math.pi, math.pi, n)
    normals = np.column_stack([np.cos(bearing), np.sin(bearing)])
    return Landmarks(2.0 * _length(model) * rng.normal(size=(n, 2)), normals_W=normals)


def sample_poses(
    model: VisibilityModel, m: int, landmarks: Landmarks | None = None, *, rng: np.random.Generator
) -> NDArray[np.float64]:
    """Draw poses, shape (m, 3), from 0.001 to 1000 of the model's lengths away from a landmark, some right upon it."""
    around = landmarks.positions_W if landmarks is not None and len(landmarks) else np.zeros((1, 2))
    distance = _length(model) * 10.0 ** rng.uniform(-3.0, 3.0, m)
    # where built-in models have their kink, and where the landmark itself is
    distance[::5] = _length(model) * rng.uniform(0.9, 1.1, len(distance[::5]))
    distance[::17] = 0.0
    bearing = rng.uniform(-math.pi, math.pi, m)
    aside = np.choose(rng.integers(0, 3, m), [np.zeros(m), rng.normal(0.0, 0.3, m), rng.uniform(-4.0, 4.0, m)])
    centre = around[rng.integers(0, len(around), m)]
    offset = distance[:, None] * np.column_stack([np.cos(bearing), np.sin(bearing)])
    return np.column_stack([centre + offset, bearing + math.pi + aside])


def _length(model: VisibilityModel) -> float:
    """Return the distance over which visibility can go from 0 to its maximum, metres: the scale of all samples."""
    per_metre = model.lipschitz[0]
    return model.maximum / per_metre if per_metre > 0.0 else 1.0


def _require(holds: bool, text: str) -> None:
    if not holds:
        raise AssertionError(text)


__all__ = ["check_visibility_model"]
