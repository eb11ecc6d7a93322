"""The conformance suite for pose optimisers, over every optimiser; and faulty ones, which it must find."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
from tests.conformance.models import BlackBox, Lantern, Spotlight

from covey.environment import Landmarks
from covey.geometry import Pose2, Region
from covey.optimize import DifferentialEvolution, Exact, PoseOptimizer, PoseProblem, PoseResult, Search, Status
from covey.sensing import Anisotropic, Isotropic, Oriented, VisibilityModel
from covey.testing.optimizers import check_pose_optimizer, check_pose_result

BUILT_IN = [Anisotropic(), Anisotropic(0.2), Anisotropic(30.0), Isotropic(), Oriented(), Oriented(3.0)]
MINE = [Spotlight(), Lantern(), BlackBox(Oriented())]


@pytest.mark.parametrize("model", [*BUILT_IN, *MINE], ids=repr)
@pytest.mark.parametrize("optimizer", [Search(), DifferentialEvolution()], ids=lambda optimizer: optimizer.name)
def test_optimisers_without_proof_conform(
    optimizer: PoseOptimizer, model: VisibilityModel, seeds: Callable[[int, int], range]
) -> None:
    few = 3 if isinstance(optimizer, Search) and model in BUILT_IN else 1
    for seed in seeds(few, 20):
        check_pose_optimizer(optimizer, model, seed=seed)


@pytest.mark.parametrize("model", BUILT_IN, ids=repr)
def test_exact_conforms(model: VisibilityModel, seeds: Callable[[int, int], range]) -> None:
    for seed in seeds(2, 30):
        check_pose_optimizer(Exact(), model, seed=seed, tolerance=1e-3)


@pytest.mark.parametrize("model", MINE, ids=repr)
def test_exact_conforms_with_models_of_a_user(model: VisibilityModel) -> None:
    """With few boxes: a proof by Lipschitz constants alone takes long, and its bound holds at any time."""
    check_pose_optimizer(Exact(limit=20_000), model, tolerance=0.5)


@dataclass(frozen=True)
class Faulty:
    """`exact` with one fault."""

    fault: str
    name: str = "faulty"

    def maximize(
        self,
        problem: PoseProblem,
        *,
        start: Pose2 | None = None,
        tolerance: float = 1e-3,
        rng: np.random.Generator,
    ) -> PoseResult:
        if self.fault == "start":
            start = None
        result = Exact().maximize(problem, start=start, tolerance=tolerance, rng=rng)
        pose, region = result.pose, problem.region
        if self.fault == "outside":
            # by less than anybody would see
            x0, x1, _, _ = region.bounds
            outside = {pose.x < x0 + 1e-6: x0 - 1e-12, pose.x > x1 - 1e-6: x1 + 1e-12}.get(True, pose.x)
            pose = Pose2(outside, pose.y, pose.yaw)
            return PoseResult(pose, problem.score(pose), evaluations=result.evaluations)
        if self.fault == "score":
            return replace(result, score=result.score + 1e-12)
        if self.fault == "understated bound":
            worse = Pose2(*region.project(pose.x + 0.3, pose.y), pose.yaw)
            if start is None and problem.score(worse) > 0.0:
                score = problem.score(worse)
                return replace(result, pose=worse, score=score, upper_bound=score + tolerance)
        if self.fault == "status":
            return replace(result, upper_bound=result.upper_bound + 1.1 * tolerance)
        if self.fault == "bound without proof":
            return replace(result, status=Status.LOCAL)
        if self.fault == "own randomness":
            return replace(result, evaluations=int(np.random.default_rng().integers(2**62)))
        if self.fault == "start" and len(problem.landmarks):
            x, y = region.sample(1, rng=rng)[0]
            pose = Pose2(x, y, 0.0)
            return PoseResult(pose, problem.score(pose))
        if self.fault == "first landmark" and len(problem.landmarks) == 1:
            pose = Pose2(1.0, 1.0, 0.0) if start is None else start
            return PoseResult(pose, problem.score(pose))
        return result


def test_the_optimiser_of_the_faults_conforms_without_one() -> None:
    check_pose_optimizer(Faulty("none"))


@pytest.mark.parametrize(
    ("fault", "text"),
    [
        ("outside", "outside the region"),
        ("score", "the result says"),
        ("understated bound", "is claimed"),
        ("status", "the gap is"),
        ("bound without proof", "nothing is proved"),
        ("own randomness", "same seed"),
        ("start", "no less than the start"),
        ("first landmark", "one landmark"),
    ],
)
def test_a_faulty_optimiser_is_found(fault: str, text: str) -> None:
    with pytest.raises(AssertionError, match=text):
        check_pose_optimizer(Faulty(fault))


@pytest.mark.parametrize(
    "optimizer", [Search(), Exact(), DifferentialEvolution()], ids=lambda optimizer: optimizer.name
)
@pytest.mark.parametrize("offset", [1e3, 1e5, 5e6])
def test_far_from_the_origin(optimizer: PoseOptimizer, offset: float) -> None:
    """Coordinates as map projections give them; the same scene at the origin scores the same up to rounding."""
    rng = np.random.default_rng(5)
    points = rng.uniform(-2.0, 2.0, (20, 2))
    # the best poses are on the boundary: the landmarks lie along the edges of a narrow corridor
    corners = np.array([[-2.0, -0.3], [2.0, -0.3], [2.0, 0.3], [-2.0, 0.3]])
    scores = []
    for shift in (0.0, offset):
        problem = PoseProblem(Anisotropic(), Landmarks(points + shift), Region(corners + shift))
        result = optimizer.maximize(problem, start=None, tolerance=1e-2, rng=np.random.default_rng(1))
        check_pose_result(problem, result, tolerance=1e-2, rng=rng, rounding=1e-13 * max(1.0, offset) + 1e-9)
        scores.append(result.score)
        if isinstance(optimizer, Exact):
            assert result.status is Status.PROVED
    if not isinstance(optimizer, DifferentialEvolution):
        assert scores[0] == pytest.approx(scores[1], rel=1e-3)


def test_a_start_on_the_boundary_of_a_far_region_is_kept_when_nothing_is_better() -> None:
    problem = PoseProblem(Anisotropic(), Landmarks(np.empty((0, 2))), Region.box(1e6, 1e6 + 1, -3, -2))
    start = Pose2(1e6, -3.0, 0.5)
    for optimizer in (Search(), Exact(), DifferentialEvolution()):
        assert optimizer.maximize(problem, start=start, rng=np.random.default_rng(0)).pose == start
