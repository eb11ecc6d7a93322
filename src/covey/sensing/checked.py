"""A user's own visibility model, of which nothing is taken for granted."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from numbers import Real
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from covey.environment import Landmarks
from covey.errors import InputError
from covey.sensing.base import VisibilityModel

T = TypeVar("T")

REQUIRED = ("name", "needs_normals", "maximum", "lipschitz", "visibility")
ROUNDING = 1e-9
"""By how much visibilities may leave [0, maximum], times the larger of 1 and the maximum; they are clipped."""


def call_user_code(label: str, failed: str, call: Callable[[], T]) -> T:
    """Return what code of a user's returns; whatever it raises, an exit included, becomes one InputError.

    Examples
    --------
    >>> call_user_code("torch.py:Torch", "cannot be built", lambda: 1 / 0)
    Traceback (most recent call last):
    covey.errors.InputError: sensor model 'torch.py:Torch': cannot be built: ZeroDivisionError: division by zero
    """
    try:
        return call()
    except (Exception, SystemExit) as error:
        text = " ".join(str(error).split())
        kind = type(error).__name__
        raise InputError(f"sensor model {label!r}: {failed}: {kind}{': ' if text else ''}{text}") from error


@dataclass(frozen=True)
class CheckedModel:
    """A visibility model that raises `InputError` instead of whatever a faulty one does.

    Its constants are read and checked once; every answer is checked for shape, type and range.

    Parameters
    ----------
    model : VisibilityModel
        The user's.
    label : str
        How the mission names it, for example ``torch.py:Torch``.

    Raises
    ------
    InputError
        If a constant is missing or is not what `VisibilityModel` says.
    """

    model: VisibilityModel
    label: str
    name: str = field(init=False, compare=False)
    needs_normals: bool = field(init=False, compare=False)
    maximum: float = field(init=False, compare=False)
    lipschitz: tuple[float, float] = field(init=False, compare=False)

    def __post_init__(self) -> None:
        missing = [key for key in REQUIRED if not self._ask(key, partial(hasattr, self.model, key))]
        if missing:
            raise self._error(f"expected {', '.join(missing)} as in VisibilityModel, got none")
        name: object = self._ask("name", lambda: self.model.name)
        if not isinstance(name, str):
            raise self._error(f"name: expected text, got {_shown(name)}")
        needs: object = self._ask("needs_normals", lambda: self.model.needs_normals)
        if not isinstance(needs, bool | np.bool_):
            raise self._error(f"needs_normals: expected True or False, got {_shown(needs)}")
        maximum: object = self._ask("maximum", lambda: self.model.maximum)
        highest = _number(maximum)
        if highest is None:
            raise self._error(f"maximum: expected a finite number of at least 0, got {_shown(maximum)}")
        lipschitz: object = self._ask("lipschitz", lambda: self.model.lipschitz)
        given = lipschitz.tolist() if isinstance(lipschitz, np.ndarray) else lipschitz
        pair = given if isinstance(given, tuple | list) else ()
        constants = [number for number in map(_number, pair) if number is not None]
        if not len(pair) == len(constants) == 2:
            expected = "two finite numbers of at least 0 (per metre, per radian)"
            raise self._error(f"lipschitz: expected {expected}, got {_shown(lipschitz)}")
        object.__setattr__(self, "name", name)
        object.__setattr__(self, "needs_normals", bool(needs))
        object.__setattr__(self, "maximum", highest)
        object.__setattr__(self, "lipschitz", (constants[0], constants[1]))

    @property
    def optimal_distance(self) -> float:
        """The model's own, where it has one: metres.  AttributeError where it has none."""
        value: object = self._ask("optimal_distance", partial(getattr, self.model, "optimal_distance", None))
        distance = _number(value)
        if not distance:
            raise AttributeError("optimal_distance")
        return distance

    def visibility(self, poses: NDArray[np.float64], landmarks: Landmarks) -> NDArray[np.float64]:
        """Visibility of each landmark from each pose, shape (m, n), as in `VisibilityModel`.

        Raises
        ------
        InputError
            If the model raises anything, or returns another shape, other than floats, or numbers that are not finite
            or not in [0, maximum].
        """
        given = poses.view()
        given.setflags(write=False)
        seen = call_user_code(
            self.label, "visibility raised", lambda: np.asarray(self.model.visibility(given, landmarks))
        )
        shape = (len(poses), len(landmarks))
        if seen.shape != shape:
            raise self._error(f"visibility: expected shape (poses, landmarks) = {shape}, got {seen.shape}")
        if seen.dtype.kind != "f":
            raise self._error(f"visibility: expected float64, got {seen.dtype}")
        lowest, highest = float(seen.min(initial=0.0)), float(seen.max(initial=0.0))
        slack = ROUNDING * max(1.0, self.maximum)
        if not (math.isfinite(lowest) and math.isfinite(highest)):
            raise self._error("visibility: expected finite numbers, got NaN or infinity")
        if lowest < -slack:
            raise self._error(f"visibility: expected at least 0, got {lowest}")
        if highest > self.maximum + slack:
            raise self._error(f"visibility: expected at most its maximum {self.maximum}, got {highest}")
        return np.clip(seen.astype(np.float64, copy=False), 0.0, self.maximum)

    def _ask(self, key: str, call: Callable[[], T]) -> T:
        return call_user_code(self.label, f"{key} raised", call)

    def _error(self, text: str) -> InputError:
        return InputError(f"sensor model {self.label!r}: {text}")


def _number(value: object) -> float | None:
    """Return a finite number of at least 0, None for anything else."""
    if not isinstance(value, Real) or isinstance(value, bool):
        return None
    try:
        number = float(value)
    except OverflowError:
        return None
    return number if math.isfinite(number) and number >= 0.0 else None


def _shown(value: object) -> str:
    text = " ".join(repr(value).split())
    return text if len(text) <= 60 else f"{text[:57]}..."
