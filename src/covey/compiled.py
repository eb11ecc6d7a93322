"""How covey compiles its numerical kernels, and where the machine code is kept.

Numba's own cache looks only at the file of the function itself: when a function that it calls changes in another file,
the old machine code goes on being used.  A proof must not rest on that, so the cache of covey's kernels is kept in a
folder named by a digest of all their sources.
"""

from __future__ import annotations

import functools
import hashlib
import os
import platform
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import ParamSpec, TypeVar

import numba

P = ParamSpec("P")
R = TypeVar("R")

FASTMATH = frozenset({"reassoc", "nsz", "arcp", "contract"})
"""Sums may be reordered so that they run in vector registers; proofs allow for the rounding of any order."""

_PACKAGES = ("geometry", "sensing", "optimize", "flight", "simulators")


@functools.cache
def cache_directory() -> str:
    """Return the folder of the compiled kernels: below NUMBA_CACHE_DIR or the user's cache folder."""
    digest = hashlib.sha256(f"{platform.python_version()} {numba.__version__} {platform.machine()}".encode())
    root = Path(__file__).parent
    for source in [Path(__file__), *sorted(path for package in _PACKAGES for path in (root / package).glob("*.py"))]:
        digest.update(source.read_bytes())
    name = f"kernels-{digest.hexdigest()[:16]}"
    given = os.environ.get("NUMBA_CACHE_DIR")
    if given:
        return str(Path(given) / name)
    if sys.platform == "win32":
        base = Path(os.environ.get("LOCALAPPDATA") or tempfile.gettempdir())
    else:
        base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    for parent in (base, Path(tempfile.gettempdir())):
        folder = parent / "covey" / name
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError:
            continue
        if os.access(folder, os.W_OK):
            return str(folder)
    return tempfile.mkdtemp(prefix="covey-")


def kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Compile a function without the interpreter lock, division by zero as in C, results kept between runs."""
    return _compile(function, fastmath=False)


def fast_kernel(function: Callable[P, R]) -> Callable[P, R]:
    """Compile like `kernel`, and let sums be reordered (`FASTMATH`)."""
    return _compile(function, fastmath=True)


def _compile(function: Callable[P, R], *, fastmath: bool) -> Callable[P, R]:
    before = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = cache_directory()
    try:
        compiled: Callable[P, R] = numba.njit(
            function, cache=True, error_model="numpy", nogil=True, fastmath=set(FASTMATH) if fastmath else False
        )
        return compiled
    finally:
        numba.config.CACHE_DIR = before
