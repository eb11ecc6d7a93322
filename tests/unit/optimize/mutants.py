"""Copies of the branch and bound with one line changed, in plain Python, to see whether the checks notice."""

from __future__ import annotations

import sys
import types
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from covey.environment import Landmarks
from covey.geometry import Pose2, Region
from covey.optimize import PoseProblem, PoseResult, Status, branch_and_bound
from covey.optimize.packing import landmark_columns
from covey.sensing import Anisotropic, CompiledModel, Isotropic, Oriented, kernels
from covey.testing.optimizers import check_pose_result

MODELS: list[CompiledModel] = [Anisotropic(), Oriented(), Isotropic()]


def _interpreted(name: str, text: str, monkeypatch: pytest.MonkeyPatch) -> types.ModuleType:
    """Run a module's text without compiling its kernels."""
    lines = [line for line in text.splitlines() if not line.startswith("from covey.compiled import")]
    lines.insert(
        lines.index("from __future__ import annotations") + 1, "kernel = fast_kernel = lambda function: function"
    )
    module = types.ModuleType(name)
    monkeypatch.setitem(sys.modules, name, module)
    exec(compile("\n".join(lines), name, "exec"), vars(module))
    return module


def _source(module: types.ModuleType) -> str:
    assert module.__file__ is not None
    return Path(module.__file__).read_text(encoding="utf-8")


def mutated(monkeypatch: pytest.MonkeyPatch, old: str = "", new: str = "") -> Any:
    """Return `branch_and_bound` in plain Python with the bounds of `kernels`, `old` replaced by `new`."""
    texts = {module.__name__: _source(module) for module in (kernels, branch_and_bound)}
    if old:
        assert sum(text.count(old) for text in texts.values()) == 1, f"expected {old!r} once in the sources"
        texts = {name: text.replace(old, new) for name, text in texts.items()}
    bounds = _interpreted("mutated_kernels", texts[kernels.__name__], monkeypatch)
    solver = _interpreted("mutated_branch_and_bound", texts[branch_and_bound.__name__], monkeypatch)
    vars(solver)["linear_bounds"] = vars(bounds)["linear_bounds"]
    return solver


def weaken_incumbents(monkeypatch: pytest.MonkeyPatch, solver: Any) -> None:
    """Let only the bounds find the optimum: a solver that knows it beforehand can hide that its bounds are wrong."""

    class KnowsNothing:
        def maximize(self, problem: PoseProblem, **options: object) -> PoseResult:
            x, y = problem.region.project(*problem.region.exterior[0])
            pose = Pose2(x, y, 0.0)
            return PoseResult(pose, problem.score(pose))

    monkeypatch.setattr(solver, "Search", KnowsNothing)
    monkeypatch.setattr(solver, "POLISH", 1)


def check_boxes(solver: Any, *, seeds: int, boxes: int = 60) -> None:
    """Check the bound of boxes of positions and headings against samples in them."""
    for number in range(seeds * boxes):
        rng = np.random.default_rng(number)
        model = MODELS[number % len(MODELS)]
        landmarks, thresholds = scene(rng, 10)
        columns = landmark_columns(landmarks, thresholds)
        half = 10.0 ** rng.uniform(-2.0, 0.3)
        width = rng.uniform(0.02, np.pi / 8)
        arcs = int(rng.integers(1, 4))
        sides = (half, half * rng.uniform(0.2, 1.0))
        box = np.array([*rng.normal(size=2), *sides, rng.uniform(-np.pi, np.pi), width, arcs, 0.0])
        bounds = np.empty(arcs)
        with np.errstate(all="ignore"):
            solver._bound_arcs(int(model.kernel), columns, box, np.empty((3, 2)), np.empty((9, len(landmarks))), bounds)
        offsets = rng.uniform(-1.0, 1.0, (400, 3))
        offsets[:200] = rng.choice([-1.0, 0.0, 1.0], (200, 3))
        arc = rng.integers(0, arcs, 400)
        yaws = box[4] + width * (2 * arc + 1 + offsets[:, 2])
        seen = model.visibility(np.column_stack([box[:2] + offsets[:, :2] * sides, yaws]), landmarks)
        scores = np.maximum(0.0, seen - thresholds) @ landmarks.weights
        worst = (scores - bounds[arc]).argmax()
        assert scores[worst] <= bounds[arc[worst]] + 1e-12, (
            f"{model}: a box is bounded by {bounds[arc[worst]]}, a pose in it scores {scores[worst]}"
        )


def check_solver(solver: Any, *, seeds: int, problems: int = 6, tolerance: float = 0.02) -> None:
    """Check the proofs of small problems against dense sampling."""
    hole = Region.polygon([[-2, -2], [2, -2], [2, 2], [-2, 2]], [[[-1, -1], [1, -1], [1, 1], [-1, 1]]])
    regions = [Region.box(-1.5, 1.5, -1.5, 1.5), hole, Region.polygon([[-2, -2], [2, -1], [1.5, 1]])]
    for number in range(seeds * problems):
        rng = np.random.default_rng(number)
        landmarks, thresholds = scene(rng, 5)
        model = MODELS[number % len(MODELS)]
        problem = PoseProblem(model, landmarks, regions[rng.integers(3)], 0.5 * thresholds)
        with np.errstate(all="ignore"):
            result = solver.Exact(limit=20_000).maximize(problem, tolerance=tolerance, rng=rng)
        # its status is that of another module's enumeration
        answer = PoseResult(result.pose, result.score, result.upper_bound, Status(result.status.value))
        check_pose_result(problem, answer, tolerance=tolerance, rng=rng, samples=800)


def scene(rng: np.random.Generator, n: int) -> tuple[Landmarks, np.ndarray[Any, np.dtype[np.float64]]]:
    """Draw weighted landmarks with normals, and thresholds."""
    bearing = rng.uniform(-np.pi, np.pi, n)
    normals = np.column_stack([np.cos(bearing), np.sin(bearing)])
    landmarks = Landmarks(rng.normal(size=(n, 2)) * rng.uniform(0.3, 2.0), rng.uniform(0.2, 2.0, n), normals)
    return landmarks, np.where(rng.random(n) < 0.6, 0.0, rng.uniform(0.0, 0.6, n))
