"""The evidence that comes with a deployment: Definition 3, checked, and a bound on what any deployment could score."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

ROUNDING = 1e-9
"""Sums of visibilities are compared up to this, times their size."""


@dataclass(frozen=True)
class Violation:
    """One thing that a deployment should be and is not.

    Parameters
    ----------
    kind : str
        ``incomplete`` (a landmark without owner), ``overlap`` (with several), ``region`` (a pose outside its region),
        ``separation`` (two agents that share an altitude are too close), ``pose`` (a better pose exists),
        ``unproved`` (the proof of a pose ran out of budget), ``trade`` (another agent sees a landmark better),
        ``score`` (a score that is stated, of an agent, of the team or at the end of the history, is not what the
        poses give), ``bound`` (the bound that is stated lies below the stated score).
    agents : tuple of str
        Who is concerned.
    landmark : int or None
        Which landmark is concerned.
    amount : float
        By how much.
    message : str
        The same in words.
    """

    kind: str
    agents: tuple[str, ...]
    landmark: int | None
    amount: float
    message: str


@dataclass(frozen=True)
class Certificate:
    """Whether a deployment is a Voronoi configuration with tolerance sigma, and if not, where.

    Parameters
    ----------
    holds : bool
        Whether there is no violation.
    sigma : float
        The tolerance.
    worst_pose_gap : float
        No agent could score more than this above its score by another pose: proved.
    worst_trade_gain : float
        No landmark is seen better than by its owner by more than this.
    violations : tuple of Violation

    Notes
    -----
    Source: Sposato (2016), Definition 3.  Deviation: V2.
    """

    holds: bool
    sigma: float
    worst_pose_gap: float
    worst_trade_gain: float
    violations: tuple[Violation, ...] = ()


@dataclass(frozen=True)
class TeamBound:
    """What no deployment of a team can exceed.

    Parameters
    ----------
    team_upper_bound : float
        No deployment scores more: proved over all poses and partitions.
    gap : float
        How far below it the deployment's score is, relative to the bound.
    """

    team_upper_bound: float
    gap: float


def partition_violations(names: Sequence[str], sets: Sequence[NDArray[np.int64]], count: int) -> list[Violation]:
    """Check that the sets are disjoint and together hold each landmark 0 .. count - 1."""
    owners = np.zeros(count, dtype=np.int64)
    for landmarks in sets:
        np.add.at(owners, landmarks, 1)
    violations = [
        Violation("incomplete", (), int(k), 1.0, f"landmark {k} has no owner") for k in np.flatnonzero(owners == 0)
    ]
    for k in np.flatnonzero(owners > 1):
        several = tuple(name for name, landmarks in zip(names, sets, strict=True) if k in landmarks)
        message = f"landmark {k} is owned {owners[k]} times, by {', '.join(several)}"
        violations.append(Violation("overlap", several, int(k), float(owners[k] - 1), message))
    return violations


def trade_violations(
    names: Sequence[str], visibility: NDArray[np.float64], sets: Sequence[NDArray[np.int64]], sigma: float
) -> tuple[float, list[Violation]]:
    """Check the second condition of Definition 3: (worst gain, violations).

    `visibility` has shape (m, n), every agent's view of every landmark.
    """
    violations = []
    worst = 0.0
    best = visibility.argmax(axis=0) if len(visibility) else np.zeros(0, dtype=np.int64)
    for i, landmarks in enumerate(sets):
        gain = visibility[best[landmarks], landmarks] - visibility[i, landmarks]
        worst = max(worst, float(gain.max(initial=0.0)))
        for k, amount in zip(landmarks[gain > sigma + ROUNDING], gain[gain > sigma + ROUNDING], strict=True):
            other = names[best[k]]
            message = (
                f"landmark {k} of {names[i]} is seen better by {other}, by {amount:.6g}; at most {sigma:g} is allowed"
            )
            violations.append(Violation("trade", (names[i], other), int(k), float(amount), message))
    return worst, violations


def pose_violations(
    name: str, score: float, best_score: float, upper_bound: float, sigma: float
) -> tuple[float, list[Violation]]:
    """Check the first condition of Definition 3 for one agent: (proved gap, violations).

    Parameters
    ----------
    score : float
        What the agent scores.
    best_score : float
        The best score that the proof found for its landmarks.
    upper_bound : float
        What no pose exceeds.
    """
    gap = upper_bound - score
    slack = ROUNDING * max(1.0, abs(score))
    if best_score - score > sigma + slack:
        message = f"{name} could score {best_score - score:.6g} more from another pose; at most {sigma:g} is allowed"
        return gap, [Violation("pose", (name,), None, best_score - score, message)]
    if gap > sigma + slack:
        message = f"{name}: the proof ran out of budget with a gap of {gap:.6g}; {sigma:g} is asked for"
        return gap, [Violation("unproved", (name,), None, gap, message)]
    return gap, []
