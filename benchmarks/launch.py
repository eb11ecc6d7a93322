"""Eight agents, each a process of its own on this machine: how long they take to start and to settle without flying.

What they score stands beside the scores of `plan`.
"""

from __future__ import annotations

import resource
import statistics
from pathlib import Path
from typing import Any

from covey.mission import load_mission
from covey.runtime.network.launch import LaunchOptions, launch
from covey.runtime.plan import plan

MISSION = Path(__file__).parents[1] / "examples" / "eight-agents.yaml"


def run(quick: bool) -> dict[str, Any]:
    """Seconds until all agents are heard, seconds from then until the observer knows that it is over, scores."""
    seeds = range(1) if quick else range(10)
    planned = [plan(load_mission(MISSION, seed=seed)).score.final for seed in (range(3) if quick else range(20))]
    starts, settles, scores, held, cpu = [], [], [], 0, []
    for seed in seeds:
        before = _cpu()
        deployment, report = launch(load_mission(MISSION, seed=seed), MISSION, LaunchOptions(timeout=300.0))
        cpu.append(_cpu() - before)
        if report.start_s is None or report.settle_s is None:
            raise RuntimeError(f"seed {seed}: not all agents were heard")
        starts.append(report.start_s)
        settles.append(report.settle_s)
        scores.append(deployment.score.final)
        held += deployment.certificate is not None and deployment.certificate.holds
    return {
        "missions": len(scores),
        "certificates_hold": held,
        "start_s": round(statistics.median(starts), 3),
        "settle_s": round(statistics.median(settles), 3),
        "settle_most_s": round(max(settles), 3),
        "agents_cpu_s": round(statistics.median(cpu), 3),
        "score_least": round(min(scores), 3),
        "score_median": round(statistics.median(scores), 3),
        "score_most": round(max(scores), 3),
        "plan_score_least": round(min(planned), 3),
        "plan_score_median": round(statistics.median(planned), 3),
        "plan_score_most": round(max(planned), 3),
    }


def _cpu() -> float:
    """Return the processor time of all processes that have ended, seconds."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime
