"""A user's own model that is broken: one error that names it, wherever it breaks."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.conformance.models import Lantern, Spotlight
from tests.unit.runtime.small import small

from covey import plan
from covey.environment import Landmarks
from covey.errors import InputError, SolverError
from covey.geometry import Pose2, Region
from covey.mission import Mission
from covey.optimize import Exact, PoseProblem
from covey.runtime.agent import build_models
from covey.sensing import Anisotropic, VisibilityModel, build_model, is_compiled
from covey.sensing.checked import CheckedModel

SOUND = """\
import sys
import numpy as np


class Torch:
    name, needs_normals, maximum, lipschitz = "torch", False, 1.0, (1.0, 0.0)
    calls = 0

    def visibility(self, poses, landmarks):
        self.calls += 1
        away = landmarks.positions_W[None, :, :] - poses[:, None, :2]
        seen = np.maximum(0.0, 1.0 - np.hypot(away[..., 0], away[..., 1]))
        return seen
"""


def written(folder: Path, old: str = "", new: str = "") -> str:
    """Write the torch with one change and return how a mission names it."""
    assert old in SOUND
    (folder / "torch.py").write_text(SOUND.replace(old, new, 1) if old else SOUND, "utf-8")
    return f"{folder / 'torch.py'}:Torch"


def mission_with(model: str) -> Mission:
    return small(sensor={"model": model}, agents={"count": 2}, spacing=1.0)


def test_a_sound_model_is_checked_and_plans(tmp_path: Path) -> None:
    mission = mission_with(written(tmp_path))
    first, second = build_models(mission)
    assert first is second
    assert (first.name, first.needs_normals, first.maximum, first.lipschitz) == ("torch", False, 1.0, (1.0, 0.0))
    assert not is_compiled(first)
    assert not hasattr(first, "optimal_distance")


def test_built_in_models_are_not_wrapped() -> None:
    assert isinstance(build_model("anisotropic"), Anisotropic)
    assert isinstance(build_model("covey.sensing:Anisotropic"), Anisotropic)
    assert all(is_compiled(model) for model in build_models(small()))


def test_equal_models_stay_equal() -> None:
    assert CheckedModel(Spotlight(), "a") == CheckedModel(Spotlight(), "a")
    assert CheckedModel(Spotlight(), "a") != CheckedModel(Spotlight(2.0), "a")


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ("import sys", "raise RuntimeError('no camera')", "cannot be loaded: RuntimeError: no camera"),
        ("import sys", "import sys; sys.exit('bye')", "cannot be loaded: SystemExit: bye"),
        ("import sys", "import sys; sys.exit()", "cannot be loaded: SystemExit"),
        ("import sys", "1 / 0", "cannot be loaded: ZeroDivisionError"),
        ("import sys", "def :", "cannot be loaded: SyntaxError"),
        ("class Torch", "class Candle", "cannot be loaded: AttributeError.*Torch"),
        ("calls = 0", "def __init__(self): raise KeyError('lens')", "cannot be built with .*KeyError: 'lens'"),
        ("calls = 0", "def __init__(self): sys.exit(3)", "cannot be built with .*SystemExit: 3"),
        ("calls = 0", "def __init__(self, width): pass", "cannot be built with .*width"),
        ('"torch"', "None", "name: expected text, got None"),
        ("False", "'no'", "needs_normals: expected True or False, got 'no'"),
        ("False", "True", "expected landmarks with normals, got none"),
        ("1.0,", "None,", "maximum: expected a finite number of at least 0, got None"),
        ("1.0,", "float('nan'),", "maximum: expected a finite number of at least 0, got nan"),
        ("1.0,", "-1.0,", "maximum: expected a finite number of at least 0, got -1.0"),
        ("1.0,", "10**400,", "maximum: expected a finite number of at least 0, got 1000"),
        ("(1.0, 0.0)", "'abc'", "lipschitz: expected two finite numbers .*got 'abc'"),
        ("(1.0, 0.0)", "(1.0,)", "lipschitz: expected two finite numbers"),
        ("(1.0, 0.0)", "(1.0, -1.0)", "lipschitz: expected two finite numbers"),
        ("(1.0, 0.0)", "(1.0, float('inf'))", "lipschitz: expected two finite numbers"),
        ("(1.0, 0.0)", "((1.0,), (2.0, 3.0))", "lipschitz"),
        ("calls = 0", "maximum = property(lambda self: 1 / 0)", "maximum raised: ZeroDivisionError"),
        ("def visibility", "def seeing", "expected visibility as in VisibilityModel, got none"),
        ("def visibility", "visibility = 3\n\n    def see", "visibility raised: TypeError"),
        ("self.calls += 1", "raise RuntimeError('no light')", "visibility raised: RuntimeError: no light"),
        ("self.calls += 1", "sys.exit(1)", "visibility raised: SystemExit: 1"),
        ("self.calls += 1", "poses[:] = 0.0", "visibility raised: ValueError.*read-only"),
        ("return seen", "return seen.T", r"expected shape \(poses, landmarks\) = \(8, 16\), got \(16, 8\)"),
        ("return seen", "return seen[0]", "expected shape"),
        ("return seen", "return None", "expected shape"),
        ("return seen", "return [[1.0], [1.0, 2.0]]", "visibility raised: ValueError"),
        ("return seen", "return seen > 0.5", "expected float64, got bool"),
        ("return seen", "return seen.astype(str)", "expected float64, got <U"),
        ("return seen", "return seen + np.nan", "expected finite numbers, got NaN"),
        ("return seen", "return seen + np.inf", "expected finite numbers, got NaN or inf"),
        ("return seen", "return seen - 0.5", "expected at least 0, got -0.5"),
        ("return seen", "return seen + 2.0", r"expected at most its maximum 1.0, got 2\."),
    ],
)
def test_a_broken_model_is_one_error_before_planning(tmp_path: Path, old: str, new: str, text: str) -> None:
    name = written(tmp_path, old, new)
    with pytest.raises(InputError, match=rf"^sensor model '[^']*torch\.py:Torch': .*{text}") as caught:
        build_models(mission_with(name))
    assert "\n" not in str(caught.value)


def test_a_model_that_breaks_later_is_one_error_too(tmp_path: Path) -> None:
    change = "self.calls += 1\n        if self.calls > 3: raise RuntimeError('worn out')"
    mission = mission_with(written(tmp_path, "self.calls += 1", change))
    build_models(mission)
    with pytest.raises(InputError, match="visibility raised: RuntimeError: worn out"):
        plan(mission)


def test_rounding_is_forgiven_and_clipped() -> None:
    class Rounded(Lantern):
        def visibility(self, poses: NDArray[np.float64], landmarks: Landmarks) -> NDArray[np.float64]:
            return np.array([[-1e-17, 2.5 * (1.0 + 1e-12)]], dtype=np.float64)

    seen = CheckedModel(Rounded(), "rounded").visibility(np.zeros((1, 3)), Landmarks(np.zeros((2, 2))))
    assert seen.tolist() == [[0.0, 2.5]]


class Boaster(Spotlight):
    """Sees twice as well as it says."""

    def visibility(self, poses: NDArray[np.float64], landmarks: Landmarks) -> NDArray[np.float64]:
        return 2.0 * super().visibility(poses, landmarks)


class Jumper(Spotlight):
    """Visibility changes much faster than it says."""

    @property
    def lipschitz(self) -> tuple[float, float]:
        return 1e-3, 1e-3


@pytest.mark.parametrize("model", [Boaster(), Jumper()])
def test_a_proof_that_is_refuted_by_a_pose_is_no_proof(model: VisibilityModel) -> None:
    rng = np.random.default_rng(0)
    landmarks = Landmarks(rng.uniform(-1.0, 1.0, (6, 2)) * [1.0, 0.01])
    problem = PoseProblem(model, landmarks, Region.box(-3, 3, -3, 3))
    with pytest.raises(SolverError, match=r"sensor model 'spotlight'.*too low"):
        Exact().maximize(problem, start=Pose2(0.0, 0.0, 0.0), tolerance=1e-2, rng=rng)


def test_a_plan_with_a_model_that_boasts_is_refused(tmp_path: Path) -> None:
    # only from close by, so that the first look does not see it
    mission = mission_with(written(tmp_path, "return seen", "return np.where(seen > 0.9, 5.0, seen)"))
    with pytest.raises(InputError, match="expected at most its maximum"):
        plan(mission)
