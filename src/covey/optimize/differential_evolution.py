"""`differential-evolution`: scipy's, the optimiser that the thesis used."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from covey.geometry import Pose2
from covey.optimize import blackbox
from covey.optimize.base import PoseProblem, PoseResult
from covey.optimize.search import into_region


@dataclass(frozen=True)
class DifferentialEvolution:
    """Differential evolution over the region's bounding box; trials outside a region that is no box are moved into it.

    Parameters
    ----------
    spread : float
        scipy's `tol`: it stops when the population's scores lie this close together, which is no gap to the best pose.

    Notes
    -----
    Source: Sposato (2016), section 4.4.  Deviation: V4.
    """

    spread: float = 1e-3
    name: str = "differential-evolution"

    def maximize(
        self,
        problem: PoseProblem,
        *,
        start: Pose2 | None = None,
        tolerance: float = 1e-3,
        rng: np.random.Generator,
    ) -> PoseResult:
        """Evolve a population; see `PoseOptimizer.maximize`.  The tolerance plays no part."""
        from scipy.optimize import differential_evolution

        region = problem.region
        box = region.is_box
        low = np.array([*region.inset_edges[:, :2].min(axis=0), -math.pi])
        high = np.array([*region.inset_edges[:, :2].max(axis=0), math.pi])
        # a start on the very edge would be refused, if only for its rounding
        margin = 1e-9 * (high - low)
        first = None if start is None else np.clip(start.as_array(), low + margin, high - margin)

        def cost(columns: NDArray[np.float64]) -> NDArray[np.float64]:
            poses = np.array(columns.T, ndmin=2)
            return -blackbox.values(problem, poses if box else into_region(poses, region))

        result = differential_evolution(
            cost,
            list(zip(low, high, strict=True)),
            tol=self.spread,
            vectorized=True,
            updating="deferred",
            x0=first,
            rng=rng,
        )
        pose = Pose2.from_array(into_region(np.array(result.x, ndmin=2), region)[0])
        score = problem.score(pose)
        if start is not None and problem.score(start) >= score:
            pose, score = start, problem.score(start)
        return PoseResult(pose, score, evaluations=int(result.nfev))
