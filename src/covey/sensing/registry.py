"""Visibility models by the name that mission files use."""

from __future__ import annotations

import importlib
import importlib.util
import sys
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from types import ModuleType

from covey.errors import InputError
from covey.sensing.anisotropic import Anisotropic
from covey.sensing.base import VisibilityModel, is_compiled
from covey.sensing.blind import Blind
from covey.sensing.checked import CheckedModel, call_user_code
from covey.sensing.isotropic import Isotropic
from covey.sensing.oriented import Oriented

MODELS: Mapping[str, Callable[..., VisibilityModel]] = {
    "anisotropic": Anisotropic,
    "isotropic": Isotropic,
    "oriented": Oriented,
}


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

    Returns
    -------
    VisibilityModel
        A user's own comes as a `CheckedModel`, whose answers are checked.

    Raises
    ------
    InputError
        If there is no such model, it cannot be loaded or built, or its constants make no sense.

    Examples
    --------
    >>> build_model("isotropic", {"optimal_distance": 2.0})
    Isotropic(optimal_distance=2.0)
    """
    if name == Blind.name:
        return Blind()
    factory = MODELS.get(name)
    if factory is None:
        factory = call_user_code(name, "cannot be loaded", _finder(name, folder or Path.cwd()))
    given = dict(options or {})
    model = call_user_code(name, f"cannot be built with {given}", partial(factory, **given))
    return model if is_compiled(model) else CheckedModel(model, name)


def _finder(name: str, folder: Path) -> Callable[[], Callable[..., VisibilityModel]]:
    """Return what loads the class that a name stands for."""
    place, separator, attribute = name.rpartition(":")
    if not separator:
        raise InputError(f"sensor model {name!r}: expected one of {', '.join(MODELS)} or file.py:Class")

    def load() -> Callable[..., VisibilityModel]:
        module = _load_file(folder, place) if place.endswith(".py") else importlib.import_module(place)
        found: Callable[..., VisibilityModel] = getattr(module, attribute)
        return found

    return load


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
