"""Pose problems, pair problems, and a bound on the whole team."""

from covey.optimize.base import PoseOptimizer, PoseProblem, PoseResult, Status
from covey.optimize.branch_and_bound import Exact
from covey.optimize.differential_evolution import DifferentialEvolution
from covey.optimize.pair import PairProblem, PairSearch
from covey.optimize.search import Search

__all__ = [
    "DifferentialEvolution",
    "Exact",
    "PairProblem",
    "PairSearch",
    "PoseOptimizer",
    "PoseProblem",
    "PoseResult",
    "Search",
    "Status",
]
