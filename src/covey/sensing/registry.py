"""Visibility models by the name that mission files use."""

from __future__ import annotations

import importlib
import importlib.util
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from types import ModuleType

from covey.errors import InputError
from covey.sensing.anisotropic import Anisotropic
from covey.sensing.base import VisibilityModel
from covey.sensing.isotropic import Isotropic
from covey.sensing.oriented import Oriented

MODELS: Mapping[str, Callable[..., VisibilityModel]] = {
    "anisotropic": Anisotropic,
    "isotropic": Isotropic,
    "oriented": Oriented,
}

REQUIRED = ("name", "needs_normals", "maximum", "lipschitz", "visibility")


def build_model(
    name: str, options: Mapping[str, float] | None = None, *, folder: Path | None = None
) -> VisibilityModel:
    """Build a model from its name, or from ``module:Class`` or ``file.py:Class`` for a user's own.

    Parameters
    ----------
    name : str
    options : mapping, optional
        Keyword arguments of the model, SI units.
    folder : Path, optional
        Where a relative ``file.py`` is looked for; the working directory by default.

    Raises
    ------
    InputError
        If there is no such model, or it cannot be loaded or built.

    Examples
    --------
    >>> build_model("isotropic", {"optimal_distance": 2.0})
    Isotropic(optimal_distance=2.0)
    """
    factory = MODELS.get(name)
    if factory is None:
        place, separator, attribute = name.rpartition(":")
        if not separator:
            raise InputError(f"sensor model {name!r}: expected one of {', '.join(MODELS)} or file.py:Class")
        try:
            own_file = place.endswith(".py")
            module = _load_file(folder or Path.cwd(), place) if own_file else importlib.import_module(place)
            factory = getattr(module, attribute)
        except (ImportError, OSError, SyntaxError, AttributeError) as error:
            raise InputError(f"sensor model {name!r}: cannot be loaded: {error}") from error
    try:
        model = factory(**(options or {}))
    except (TypeError, ValueError) as error:
        raise InputError(f"sensor model {name!r}: cannot be built with {dict(options or {})}: {error}") from error
    missing = [key for key in REQUIRED if not hasattr(model, key)]
    if missing:
        raise InputError(f"sensor model {name!r}: expected {', '.join(missing)} as in VisibilityModel, got none")
    return model


def _load_file(folder: Path, place: str) -> ModuleType:
    path = (folder / place).resolve()
    key = f"covey_user_model_{path.stem}_{abs(hash(str(path)))}"
    if key in sys.modules:
        return sys.modules[key]
    specification = importlib.util.spec_from_file_location(key, path)
    if specification is None or specification.loader is None or not path.exists():
        raise ImportError(f"no such file: {path}")
    module = importlib.util.module_from_spec(specification)
    sys.modules[key] = module
    try:
        specification.loader.exec_module(module)
    except BaseException:
        del sys.modules[key]
        raise
    return module
