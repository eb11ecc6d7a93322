"""`search` and `exact` beside scipy's differential evolution on random partitions of the thesis's scene."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from covey.environment import Landmarks
from covey.geometry import Region
from covey.optimize import DifferentialEvolution, Exact, PoseProblem, Search
from covey.sensing import Anisotropic

GAP = 1e-3
DE_RUNS = 10


def scene(cells: int = 20) -> Landmarks:
    """Cell centres of the 10 m x 10 m scene, cells x cells."""
    centres = (np.arange(cells) + 0.5) * 10.0 / cells - 5.0
    return Landmarks(np.stack(np.meshgrid(centres, centres), axis=-1).reshape(-1, 2))


def timed(optimizer: Any, problem: PoseProblem, seed: int, repeats: int = 1, **options: Any) -> tuple[float, Any]:
    """Best wall-clock time of some runs, seconds, and the result."""
    runs = []
    for _ in range(repeats):
        begun = time.perf_counter()
        result = optimizer.maximize(problem, rng=np.random.default_rng(seed), **options)
        runs.append((time.perf_counter() - begun, result))
    return min(runs, key=lambda run: run[0])


def run(quick: bool) -> dict[str, Any]:
    """Compare on 20 partitions of 100 landmarks, then on all 400 and on 10,000."""
    region, landmarks = Region.box(-5.0, 5.0, -5.0, 5.0), scene()
    rng = np.random.default_rng(2016)
    search, exact, evolution = Search(), Exact(), DifferentialEvolution()
    problems = [
        PoseProblem(Anisotropic(), landmarks.subset(np.sort(rng.choice(400, 100, replace=False))), region)
        for _ in range(4 if quick else 20)
    ]
    for optimizer in (search, exact):
        timed(optimizer, problems[0], 0)  # compile
    search_s, exact_s, evolution_s, losses, misses = [], [], [], [], []
    for problem in problems:
        runs = [timed(evolution, problem, seed) for seed in range(DE_RUNS)]
        seconds, found = timed(search, problem, 0, repeats=5)
        search_s.append(seconds)
        seconds, proof = timed(exact, problem, 0, repeats=3, tolerance=GAP)
        exact_s.append(seconds)
        evolution_s.append(float(np.median([seconds for seconds, _ in runs])))
        losses.append(found.score - max(result.score for _, result in runs))
        misses.append(proof.score - found.score)
        assert proof.gap <= GAP * (1.0 + 1e-9)
    one_de = float(np.median(evolution_s))
    growth = []
    for cells in (10, 20, 40) if quick else (10, 20, 40, 100):
        seconds, proof = timed(exact, PoseProblem(Anisotropic(), scene(cells), region), 0, tolerance=GAP)
        growth.append(
            {"landmarks": cells * cells, "seconds": seconds, "evaluations": proof.evaluations, "gap": proof.gap}
        )
    whole = next(row for row in growth if row["landmarks"] == 400)
    return {
        "partitions": len(problems),
        "gap": GAP,
        "search_ms": 1e3 * float(np.median(search_s)),
        "exact_ms": 1e3 * float(np.median(exact_s)),
        "de_ms": 1e3 * one_de,
        "de_over_search": one_de / float(np.median(search_s)),
        "de_over_search_least": float(np.min(np.array(evolution_s) / np.array(search_s))),
        "exact_over_de": float(np.median(exact_s)) / one_de,
        "exact_over_de_most": float(np.max(np.array(exact_s) / np.array(evolution_s))),
        "exact_400_over_de": whole["seconds"] / one_de,
        "search_minus_best_of_ten_de_least": float(np.min(losses)),
        "exact_minus_search_most": float(np.max(misses)),
        "exact_growth": growth,
    }
