"""The conformance suite for visibility models, over every model; and models with one fault, which it must find."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
from numpy.typing import NDArray
from tests.conformance.models import BlackBox, Lantern, Spotlight

from covey.environment import Landmarks
from covey.errors import InputError
from covey.sensing import MODELS, Anisotropic, Isotropic, Oriented, VisibilityModel, build_model
from covey.testing.visibility import check_visibility_model, sampled_slopes

DISTANCES = [0.01, 0.5, 1.0, 3.0, 1000.0]
BUILT_IN: list[VisibilityModel] = [model(distance) for model in MODELS.values() for distance in DISTANCES]
MINE: list[VisibilityModel] = [
    Spotlight(),
    Spotlight(0.0, 4.0),
    Spotlight(5.0, 0.2),
    Lantern(),
    BlackBox(Oriented(2.0)),
]


@pytest.mark.parametrize("model", [*BUILT_IN, *MINE], ids=repr)
def test_every_model_conforms(model: VisibilityModel) -> None:
    check_visibility_model(model, seed=3, samples=800)


@pytest.mark.parametrize("model", BUILT_IN, ids=repr)
def test_the_constants_of_built_in_models_are_tight(model: VisibilityModel) -> None:
    """A constant that is larger than need be would pass, and make every proof with it slower."""
    position, heading = sampled_slopes(model, 2000, rng=np.random.default_rng(0))
    assert position > 0.97 * model.lipschitz[0]
    assert heading >= 0.95 * model.lipschitz[1]


@dataclass(frozen=True)
class Faulty:
    """The thesis's camera with one fault."""

    fault: str

    name: ClassVar[str] = "faulty"

    @property
    def needs_normals(self) -> bool:
        return False

    @property
    def maximum(self) -> float:
        return 0.99 if self.fault == "maximum" else 1.0

    @property
    def lipschitz(self) -> tuple[float, float]:
        constants = {"per metre": (0.95, 1.0), "per radian": (1.0, 0.9), "negative": (-1.0, 1.0), "nan": (1.0, np.nan)}
        return constants.get(self.fault, (1.0, 1.0))

    def visibility(self, poses: NDArray[np.float64], landmarks: Landmarks) -> NDArray[np.float64]:
        seen = Anisotropic().visibility(poses, landmarks)
        if self.fault == "weights":
            seen = seen * np.minimum(1.0, landmarks.weights)
        elif self.fault == "shape":
            seen = seen.T
        elif self.fault == "float32":
            seen = seen.astype(np.float32)
        elif self.fault == "unclipped":
            seen = seen - 1e-6
        elif self.fault == "nan at the landmark":
            seen = np.where((landmarks.positions_W[None] == poses[:, None, :2]).all(axis=2), np.nan, seen)
        elif self.fault == "jump":
            seen = np.where(seen < 0.3, 0.0, seen)
        elif self.fault == "world frame":
            seen = 0.5 * seen * (1.0 + np.tanh(1e-3 * poses[:, 0:1]))
        elif self.fault == "neighbours":
            seen = 0.5 * seen * (1.0 + seen.sum(axis=1, keepdims=True) / (1 + seen.shape[1]))
        elif self.fault == "unwrapped heading":
            seen = 0.5 * seen / (1.0 + 0.01 * np.abs(poses[:, 2:3]))
        elif self.fault == "writes":
            poses += 1e-3
        return seen


def test_the_model_of_the_faults_conforms_without_one() -> None:
    check_visibility_model(Faulty("none"))


@pytest.mark.parametrize(
    ("fault", "text"),
    [
        ("maximum", "at most 0.99"),
        ("per metre", "per metre"),
        ("per radian", "per radian"),
        ("negative", "lipschitz"),
        ("nan", "lipschitz"),
        ("weights", "weights"),
        ("shape", "shape"),
        ("float32", "float64"),
        ("unclipped", "at least 0"),
        ("nan at the landmark", "finite"),
        ("jump", "per metre"),
        ("world frame", "moving"),
        ("neighbours", "alone"),
        ("unwrapped heading", "turn"),
        ("writes", "changed"),
    ],
)
def test_a_faulty_model_is_found(fault: str, text: str) -> None:
    with pytest.raises(AssertionError, match=text):
        check_visibility_model(Faulty(fault))


def test_a_model_that_knows_the_world_may_say_so() -> None:
    check_visibility_model(Faulty("world frame"), invariant=False)


def test_a_model_of_a_file_conforms(tmp_path: Path) -> None:
    path = tmp_path / "mine.py"
    path.write_text(
        "import numpy as np\n"
        "class Torch:\n"
        "    name, needs_normals, maximum, lipschitz = 'torch', False, 1.0, (1.0, 0.0)\n"
        "    def visibility(self, poses, landmarks):\n"
        "        away = landmarks.positions_W[None, :, :] - poses[:, None, :2]\n"
        "        return np.maximum(0.0, 1.0 - np.hypot(away[..., 0], away[..., 1]))\n",
        encoding="utf-8",
    )
    check_visibility_model(build_model(f"{path}:Torch"))
    with pytest.raises(InputError, match="Candle"):
        build_model(f"{path}:Candle")


def test_each_kind_is_there() -> None:
    assert {type(model) for model in BUILT_IN} == {Anisotropic, Isotropic, Oriented}
