"""The first run on a machine compiles covey's kernels; a process beside it takes on a part of that meanwhile."""

from __future__ import annotations

import contextlib
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path


@contextlib.contextmanager
def compiling_beside() -> Iterator[None]:
    """Have a second process compile what planning needs last, if nothing was ever compiled here.

    Numba compiles one kernel at a time in a process.  Both processes put what they have compiled into one cache;
    whoever needs a kernel that is not there yet compiles it, so nothing is waited for, and nothing lost if the other
    fails.
    """
    from covey.compiled import cache_directory

    if next(Path(cache_directory()).rglob("*.nbi"), None) is not None:
        yield
        return
    helper = subprocess.Popen(
        [sys.executable, "-m", __name__],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        yield
    finally:
        helper.terminate()
        helper.wait()


def compile_last() -> None:
    """Solve a tiny pair problem and prove a tiny pose problem."""
    import numpy as np

    from covey.environment import Landmarks
    from covey.geometry import Pose2, Region
    from covey.optimize import Exact, PairProblem, PairSearch, PoseProblem
    from covey.sensing import build_model

    rng = np.random.default_rng(0)
    landmarks = Landmarks(np.array([[0.2, 0.1], [0.8, 0.3], [0.4, 0.9], [0.7, 0.6]]))
    region, model = Region.box(0.0, 1.0, 0.0, 1.0), build_model("anisotropic", {"optimal_distance": 1.0})
    poses = (Pose2(0.1, 0.1, 0.0), Pose2(0.9, 0.9, 0.0))
    PairSearch().maximize(PairProblem((model, model), (region, region), poses, landmarks), rng=rng)
    Exact().maximize(PoseProblem(model, landmarks, region), start=poses[0], tolerance=0.1, rng=rng)


if __name__ == "__main__":
    compile_last()
