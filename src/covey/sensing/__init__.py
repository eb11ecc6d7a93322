"""How well a camera sees a landmark."""

from covey.sensing.anisotropic import Anisotropic
from covey.sensing.base import CompiledModel, Kernel, VisibilityModel, is_compiled
from covey.sensing.isotropic import Isotropic
from covey.sensing.oriented import Oriented
from covey.sensing.registry import MODELS, build_model

__all__ = [
    "MODELS",
    "Anisotropic",
    "CompiledModel",
    "Isotropic",
    "Kernel",
    "Oriented",
    "VisibilityModel",
    "build_model",
    "is_compiled",
]
