"""Proofs of poses: against dense sampling, against another prover, and mutants that claim too much."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests.conformance.models import BlackBox
from tests.unit.optimize.mutants import MODELS, check_boxes, check_solver, mutated, scene, weaken_incumbents

from covey.environment import Landmarks
from covey.errors import ArgumentError, SolverError
from covey.geometry import Pose2, Region
from covey.optimize import Exact, PoseProblem, PoseResult, Search, Status, blackbox
from covey.sensing import Anisotropic, CompiledModel, Isotropic, Oriented
from covey.testing.optimizers import REGIONS, check_pose_result, pose_scores

DENSE = np.array(
    [
        (x, y, psi)
        for x in np.linspace(-4, 4, 81)
        for y in np.linspace(-4, 4, 81)
        for psi in np.linspace(-math.pi, math.pi, 48, endpoint=False)
    ]
)


@pytest.mark.parametrize("model", [Anisotropic(), Anisotropic(0.4), Oriented(1.5), Isotropic(0.7)], ids=repr)
def test_no_pose_of_a_dense_grid_exceeds_the_bound(model: CompiledModel) -> None:
    """315,000 poses: 0.1 m and 7.5 degrees apart."""
    rng = np.random.default_rng(11)
    landmarks, thresholds = scene(rng, 30)
    for limits in (None, thresholds):
        for region in (Region.box(-4, 4, -4, 4), REGIONS["hole"]()):
            problem = PoseProblem(model, landmarks, region, limits)
            result = Exact().maximize(problem, tolerance=1e-3, rng=rng)
            assert result.status is Status.PROVED
            inside = region.contains_points(DENSE[:, :2])
            best = pose_scores(problem, DENSE[inside]).max()
            # the grid is fine enough to come near: a bound far above everything would be caught as well
            step = 0.05 * math.sqrt(2.0) * model.lipschitz[0] + math.pi / 48 * model.lipschitz[1]
            assert best <= result.upper_bound
            assert result.upper_bound <= best + 1e-3 + step * landmarks.weights.sum()


@given(st.integers(0, 2**32 - 1), st.sampled_from(sorted(REGIONS)), st.sampled_from(MODELS), st.booleans())
def test_every_proof_holds(seed: int, region: str, model: CompiledModel, limited: bool) -> None:
    rng = np.random.default_rng(seed)
    landmarks, thresholds = scene(rng, int(rng.integers(0, 25)))
    problem = PoseProblem(model, landmarks, REGIONS[region](), thresholds if limited else None)
    tolerance = 10.0 ** rng.uniform(-4.0, -1.0)
    result = Exact().maximize(problem, tolerance=tolerance, rng=rng)
    assert result.status is Status.PROVED
    check_pose_result(problem, result, tolerance=tolerance, rng=rng)


@pytest.mark.parametrize("limit", [1, 10, 100, 1000])
@pytest.mark.parametrize("model", [*MODELS, BlackBox(Anisotropic())], ids=repr)
def test_a_proof_that_ran_out_of_budget_holds_too(model: CompiledModel, limit: int) -> None:
    rng = np.random.default_rng(limit)
    landmarks, thresholds = scene(rng, 20)
    for region in REGIONS.values():
        problem = PoseProblem(model, landmarks, region(), thresholds)
        result = Exact(limit=limit).maximize(problem, tolerance=1e-9, rng=rng)
        check_pose_result(problem, result, tolerance=1e-9, rng=rng)
        assert math.isfinite(result.upper_bound)
        assert limit > 10 or result.status is Status.BUDGET


def test_the_gap_is_what_was_asked_for(seeds: Callable[[int, int], range]) -> None:
    for seed in seeds(5, 100):
        rng = np.random.default_rng(seed)
        landmarks, _ = scene(rng, 15)
        problem = PoseProblem(MODELS[seed % 3], landmarks, Region.box(-3, 3, -3, 3))
        results = [Exact().maximize(problem, tolerance=t, rng=rng) for t in (1.0, 1e-2, 1e-3, 1e-5)]
        for result, tolerance in zip(results, (1.0, 1e-2, 1e-3, 1e-5), strict=True):
            assert result.status is Status.PROVED
            assert result.gap <= tolerance + 1e-9
        # all of these are about the same optimum
        assert max(result.score for result in results) <= min(result.upper_bound for result in results) + 1e-9


@pytest.mark.parametrize("tolerance", [0.0, -1.0, math.nan])
def test_a_tolerance_that_cannot_be_proved_is_refused(tolerance: float) -> None:
    problem = PoseProblem(Anisotropic(), Landmarks(np.zeros((1, 2))), Region.box(-1, 1, -1, 1))
    with pytest.raises(ArgumentError, match="tolerance: expected a number above 0"):
        Exact().maximize(problem, tolerance=tolerance, rng=np.random.default_rng(0))


@pytest.mark.parametrize("model", MODELS, ids=repr)
def test_two_provers_agree(model: CompiledModel, seeds: Callable[[int, int], range]) -> None:
    """One by linear bounds, the other by the Lipschitz constants alone: they share no formula but the visibility."""
    for seed in seeds(3, 30):
        rng = np.random.default_rng(seed)
        landmarks, thresholds = scene(rng, 4)
        for limits in (None, thresholds):
            region = REGIONS[["box", "hole", "slanted"][seed % 3]]()
            one = Exact().maximize(PoseProblem(model, landmarks, region, limits), tolerance=1e-4, rng=rng)
            problem = PoseProblem(BlackBox(model), landmarks, region, limits)
            known = Search().maximize(problem, rng=rng)
            two = blackbox.prove(problem, known, tolerance=0.2, limit=400_000)
            assert one.status is Status.PROVED
            assert two.gap < 0.4 * landmarks.weights.sum()  # it is slow: enough that the two can disagree
            assert one.score <= two.upper_bound + 1e-9
            assert two.score <= one.upper_bound + 1e-9


def test_known_optima() -> None:
    """Worked out by hand."""
    rng = np.random.default_rng(0)
    for model in MODELS:
        for weight in (1.0, 3.0):
            landmarks = Landmarks(np.array([[0.0, 0.0]]), np.array([weight]), np.array([[1.0, 0.0]]))
            result = Exact().maximize(PoseProblem(model, landmarks, Region.box(-3, 3, -3, 3)), tolerance=1e-4, rng=rng)
            assert result.score == pytest.approx(weight, abs=1e-4)
    # the camera must stay 2 m away: 1/2, straight ahead
    landmarks = Landmarks(np.array([[-2.0, 0.5]]), normals_W=np.array([[1.0, 0.0]]))
    for model in MODELS:
        result = Exact().maximize(PoseProblem(model, landmarks, Region.box(0, 3, 0, 1)), tolerance=1e-6, rng=rng)
        assert result.score == pytest.approx(0.5, abs=1e-6)
    # two landmarks 2 m apart, seen from a distance x on the axis between them: x / (1 + x^2) each
    both = Landmarks(np.array([[0.0, -1.0], [0.0, 1.0]]))
    result = Exact().maximize(PoseProblem(Anisotropic(), both, Region.box(-3, 3, -3, 3)), tolerance=1e-6, rng=rng)
    x = np.linspace(0.0, 3.0, 3001)
    assert result.score >= (2.0 * x / (1.0 + x * x)).max() - 1e-6


def test_the_interpreted_solver_is_sound(monkeypatch: pytest.MonkeyPatch) -> None:
    """The control of the mutants: without a change neither check has anything to say."""
    solver = mutated(monkeypatch)
    check_boxes(solver, seeds=3)
    weaken_incumbents(monkeypatch, solver)
    check_solver(solver, seeds=3)


BOX_MUTANTS = {
    "no remainder": ("rest = remainder if useful else top", "rest = 0.0 if useful else top"),
    "half the remainder": ("remainder = h2 * inverse * i if far", "remainder = 0.5 * h2 * inverse * i if far"),
    "remainder from the centre": ("h2 * inverse * i if far", "0.8 * h2 * r2 ** -1.5 if far"),
    "nearest point ignores the box": ("dx = max(0.0, abs(qx) - hx)", "dx = abs(qx)"),
    "no curvature for isotropic": ("inverse * inverse if far else 0.5", "inverse * inverse if far else 0.0"),
    "one corner left out": ("for corner in range(4)", "for corner in range(3)"),
    "centre instead of corners": ("centre + ex + ey", "centre"),
    "centre instead of corners ahead": ("plus = centre + ex", "plus = centre"),
    "arc cut short": ("ends = box[PSI] + 2.0 * width * (arc + 1)", "ends = box[PSI] + 2.0 * width * (arc + 0.75)"),
    "chord instead of arc": ("return 0.5 * math.sqrt(a * a + b * b)", "return max(first, last)"),
    "thresholds twice": ("out[2, k] = w * (rest - columns[5, k])", "out[2, k] = w * (rest - 2.0 * columns[5, k])"),
    "thresholds grow on the arc": ("return max(level, c * level)", "return level"),
    "wrong sign of the change": ("k2 * qy * qy - i, rest", "i - k2 * qy * qy, rest"),
    "facing forgotten": ("facing = max(max(mx * ax + my * ay, mx * bx + my * by), mx * tx + my * ty)", "facing = -1.0"),
}


@pytest.mark.parametrize("name", sorted(BOX_MUTANTS))
def test_a_wrong_bound_of_a_box_is_caught(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    solver = mutated(monkeypatch, *BOX_MUTANTS[name])
    with pytest.raises(AssertionError, match="a box is bounded by"):
        check_boxes(solver, seeds=10)


SOLVER_MUTANTS = {
    "bounds understated by 5 %": ("min(bounds[arc] + rounding, box[BOUND])", "0.95 * min(bounds[arc], box[BOUND])"),
    "one side of each cut": (
        "for i in range(_cut(kind, stack[top], children)):",
        "for i in range(min(1, _cut(kind, stack[top], children))):",
    ),
    "half of the headings": ("math.pi / arcs, arcs, everything", "math.pi / arcs, arcs // 2 + arcs % 2, everything"),
    "narrow arcs": ("-math.pi, math.pi / arcs", "-math.pi, 0.4 * math.pi / arcs"),
    "arcs not doubled when halved": ("children[0, ARCS] *= 2.0", "children[0, ARCS] *= 1.0"),
    "last arc of a row lost": ("box[ARCS] = last + 1 - first", "box[ARCS] = last - first"),
    "row begins an arc late": ("* box[HALF_ARC] * first", "* box[HALF_ARC] * (first + 1)"),
    "dropped arcs forgotten": ("closed = max(closed, _drop_arcs(", "closed = max(-math.inf, _drop_arcs("),
    "centre outside, box dropped": (
        "if math.hypot(qx - x, qy - y) > math.hypot(box[2], box[3]) + 1e-9:",
        "if True:",
    ),
    "half of the region": ("width, height = 0.5 * (x1 - x0)", "width, height = 0.25 * (x1 - x0)"),
    "closed boxes forgotten": ("upper = max(score, closed,", "upper = max(score,"),
    "closed boxes held to the tolerance": ("max(score, closed,", "max(score, min(closed, score + 0.02),"),
}


@pytest.mark.parametrize("name", sorted(SOLVER_MUTANTS))
def test_a_solver_that_claims_too_much_is_caught(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    solver = mutated(monkeypatch, *SOLVER_MUTANTS[name])
    weaken_incumbents(monkeypatch, solver)
    with pytest.raises(AssertionError, match=r"is claimed|the gap is"):
        check_solver(solver, seeds=10, tolerance=0.1)


def test_a_lying_model_is_caught_by_what_its_poses_score() -> None:
    """The bound of a user's model is as good as its constants."""

    class Lies(BlackBox):
        @property
        def lipschitz(self) -> tuple[float, float]:
            return 0.02, 0.02

    rng = np.random.default_rng(3)
    landmarks = Landmarks(rng.uniform(-3, 3, (3, 2)))
    problem = PoseProblem(Lies(Anisotropic()), landmarks, Region.box(-3, 3, -3, 3))
    poor = Pose2(3.0, 3.0, 0.0)
    with pytest.raises(SolverError, match="they are too low"):
        blackbox.prove(problem, PoseResult(poor, problem.score(poor)), tolerance=0.02, limit=200_000)
