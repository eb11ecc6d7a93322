"""`exact`: the best pose with a proof, by branch and bound over boxes of positions and headings.

The bound of a box comes from `sensing.kernels.linear_bounds`: each landmark's part is at most the positive part of a
function that is linear in the offset from the box's centre and linear in the heading vector.  A sum of positive parts
of linear functions is convex, so over the box it is largest at one of its four corners, and over an arc of headings it
is bounded by its values at both ends.  Eight plain sums bound a box, and the overestimate falls with the square of its
size, so the number of boxes grows with the logarithm of the tolerance only.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from covey.compiled import fast_kernel, kernel
from covey.errors import ArgumentError
from covey.geometry import Pose2
from covey.optimize import blackbox
from covey.optimize.ascent import contains_point, nearest_on_edges, pose_value
from covey.optimize.base import PoseProblem, PoseResult, Status
from covey.optimize.packing import landmark_columns
from covey.optimize.pose_ascent import POLISH, STATE, STRIDE, begin, climb, settle
from covey.optimize.search import PRECISION, Search
from covey.sensing.base import is_compiled
from covey.sensing.kernels import ANISOTROPIC, ISOTROPIC, ORIENTED, linear_bounds

CUT = 3.0
"""The heading of a box is cut when half its arc, radians, is more than this times half its longer side."""

SMALLEST = 1e-10
"""Boxes smaller than this times the region are not cut."""

BRIEF = Search(anchors=32, starts=8, rounds=((8, 4), (14, 1)))
"""What looks for a better pose before the proof of one that is known; the proof itself finds what is left."""

SECTORS = 8
STACK = 20_000
CHUNK = 20_000_000
"""Boxes times landmarks between two looks at whether to go on."""


@fast_kernel
def _corner_sums(lines: NDArray[np.float64], tx: float, ty: float, c: float) -> tuple[float, float, float, float]:
    """Sums over the landmarks at the four corners of a box and one end of its arc; c is the cosine of half the arc."""
    pp = pm = mp = mm = 0.0
    for k in range(lines.shape[1]):
        centre = lines[0, k] * tx + lines[1, k] * ty
        ex = lines[3, k] * tx + lines[4, k] * ty
        ey = lines[6, k] * tx + lines[7, k] * ty
        plus = lines[2, k] + lines[5, k]
        minus = lines[2, k] - lines[5, k]
        change = lines[8, k]
        pp += max(0.0, centre + ex + ey + _constant(plus + change, c))
        pm += max(0.0, centre + ex - ey + _constant(plus - change, c))
        mp += max(0.0, centre - ex + ey + _constant(minus + change, c))
        mm += max(0.0, centre - ex - ey + _constant(minus - change, c))
    return pp, pm, mp, mm


@fast_kernel
def _level_corner_sums(lines: NDArray[np.float64], tx: float, ty: float, c: float) -> tuple[float, float, float, float]:
    """Return `_corner_sums` where the constants do not change with the offset."""
    pp = pm = mp = mm = 0.0
    for k in range(lines.shape[1]):
        centre = lines[0, k] * tx + lines[1, k] * ty + _constant(lines[2, k], c)
        ex = lines[3, k] * tx + lines[4, k] * ty
        ey = lines[6, k] * tx + lines[7, k] * ty
        plus = centre + ex
        minus = centre - ex
        pp += max(0.0, plus + ey)
        pm += max(0.0, plus - ey)
        mp += max(0.0, minus + ey)
        mm += max(0.0, minus - ey)
    return pp, pm, mp, mm


@kernel
def _sums(kind: int, lines: NDArray[np.float64], tx: float, ty: float, c: float) -> tuple[float, float, float, float]:
    if kind == ANISOTROPIC:
        return _level_corner_sums(lines, tx, ty, c)
    return _corner_sums(lines, tx, ty, c)


@fast_kernel
def _constant(level: float, c: float) -> float:
    """Raise a constant so far that it holds when both ends of the arc are added up with factors of 1 to 1/c in all."""
    return max(level, c * level)


@kernel
def _arc(first: float, last: float, c: float, s: float) -> float:
    """Largest value over an arc of half angle w, c and s its cosine and sine, of a convex function given at both ends.

    A heading on the arc is the sum of its ends times sin(w - t) / sin(2 w) and sin(w + t) / sin(2 w), so the function
    there is at most the same sum of its values.  That sum is a sinusoid in t.
    """
    total = first + last
    change = abs(last - first)
    if change * c * c >= total * s * s:
        return max(first, last)
    a, b = total / c, change / s
    return 0.5 * math.sqrt(a * a + b * b)


@kernel
def _box_bound(
    kind: int,
    columns: NDArray[np.float64],
    box: NDArray[np.float64],
    target: float,
    vertices: NDArray[np.float64],
    lines: NDArray[np.float64],
) -> tuple[float, bool]:
    """Upper bound over a box (x, y, heading and their half sizes), and whether its heading is the side to cut.

    A bound above `target` may come before all of the box is looked at only where the box is kept anyway.
    """
    psi, width = box[2], box[5]
    if kind == ORIENTED:
        vertices[0, 0], vertices[0, 1] = math.cos(psi - width), math.sin(psi - width)
        vertices[1, 0], vertices[1, 1] = math.cos(psi + width), math.sin(psi + width)
        outer = 1.0 / math.cos(width)
        vertices[2, 0], vertices[2, 1] = outer * math.cos(psi), outer * math.sin(psi)
        psi, width = 2.0 * psi, 2.0 * width
    linear_bounds(kind, columns, box[0], box[1], box[3], box[4], vertices, lines)
    if kind == ISOTROPIC:
        corners = _corner_sums(lines, 0.0, 0.0, 1.0)
        return max(max(corners[0], corners[1]), max(corners[2], corners[3])), False
    c, s = math.cos(width), math.sin(width)
    dx, dy = math.cos(psi), math.sin(psi)
    first = _sums(kind, lines, dx * c + dy * s, dy * c - dx * s, c)
    bound = max(max(first[0], first[1]), max(first[2], first[3]))
    turned = width > CUT * max(box[3], box[4])
    if bound > target:
        return math.inf, turned
    last = _sums(kind, lines, dx * c - dy * s, dy * c + dx * s, c)
    for corner in range(4):
        bound = max(bound, _arc(first[corner], last[corner], c, s))
    return bound, turned


@kernel
def _branch(
    kind: int,
    columns: NDArray[np.float64],
    edges: NDArray[np.float64],
    inset: NDArray[np.float64],
    tolerance: float,
    limit: int,
    best: NDArray[np.float64],
    stack: NDArray[np.float64],
    top: int,
    closed: float,
    rounding: float,
    smallest: float,
) -> tuple[int, float, int]:
    """Cut boxes from the top of the stack, at most `limit`: (boxes left, highest bound of a closed one, bounds).

    Parameters
    ----------
    columns : array, shape (6, n)
        Landmarks as in `linear_bounds`.
    edges, inset : arrays, shape (e, 4)
        The region's edges and those just inside it, in optimal distances.
    best : array, shape (4,)
        Incumbent: value, x, y, heading; improved in place.
    stack : array, shape (STACK, 8)
        Open boxes: x, y, heading, their half sizes, bound, whether the heading is cut next.
    closed : float
        Highest bound of a box closed so far.
    rounding : float
        What is added to every bound.
    smallest : float
        Half size of a box, optimal distances and radians, that is not cut any more: rounding is all that is left.
    """
    bounds = 0
    n = columns.shape[1]
    lines = np.empty((9, n))
    vertices = np.empty((3, 2))
    pose = np.empty(3)
    state = np.empty(STATE)
    box = np.empty(8)
    parent = np.empty(8)
    while top > 0 and limit > 0 and top < stack.shape[0] - 2:
        limit -= 1
        top -= 1
        bound = stack[top, 6]
        if bound <= best[0] + tolerance:
            closed = max(closed, bound)
            continue
        for j in range(8):
            parent[j] = stack[top, j]
        first = top
        for side in (-1.0, 1.0):
            for j in range(8):
                box[j] = parent[j]
            j = 2 if parent[7] > 0.0 else (0 if parent[3] >= parent[4] else 1)
            box[j + 3] *= 0.5
            box[j] += side * box[j + 3]
            x, y = box[0], box[1]
            if not contains_point(edges, x, y):
                qx, qy, _, _ = nearest_on_edges(edges, x, y)
                if math.hypot(qx - x, qy - y) > math.hypot(box[3], box[4]) + 1e-9:
                    continue  # no point of the box is in the region
            child, turn = _box_bound(kind, columns, box, best[0] + tolerance, vertices, lines)
            bounds += 1
            child = min(child + rounding, bound)
            if max(box[3], box[4]) < smallest and (kind == ISOTROPIC or box[5] < smallest):
                child, _ = _box_bound(kind, columns, box, math.inf, vertices, lines)
                closed = max(closed, min(child + rounding, bound))
                continue
            if child <= best[0] + tolerance:
                closed = max(closed, child)
                continue
            if not contains_point(inset, x, y):
                x, y, _, _ = nearest_on_edges(inset, x, y)
            value = pose_value(kind, columns, 1.0, x, y, math.cos(box[2]), math.sin(box[2]))
            if value > best[0]:
                pose[:] = (x, y, box[2])
                begin(kind, columns, 1.0, inset, pose, STRIDE, state)
                climb(kind, columns, 1.0, inset, state, POLISH, PRECISION)
                value = settle(1.0, inset, state, pose)
                if value > best[0]:
                    best[0] = value
                    best[1:] = pose
            for j in range(6):
                stack[top, j] = box[j]
            stack[top, 6] = child
            stack[top, 7] = 1.0 if turn else 0.0
            top += 1
        if top == first + 2 and stack[first, 6] > stack[first + 1, 6]:
            for j in range(8):
                stack[first, j], stack[first + 1, j] = stack[first + 1, j], stack[first, j]
    return top, closed, bounds


@dataclass(frozen=True)
class Exact:
    """Branch and bound: the best pose to a proved gap, over any region.

    Parameters
    ----------
    limit : int
        How many boxes at most.  When they do not suffice, or rounding does not allow the tolerance asked for, the
        result's status is BUDGET, and its bound still holds.
    cancelled : callable, optional
        Asked every now and then; when it says so the work ends as if the limit were reached.

    Notes
    -----
    Each box costs O(n).  Boxes grow little with the number n of landmarks, and with the logarithm of 1/tolerance; where
    the best pose lies on a ridge, some landmarks being at just the optimal distance, with 1/sqrt(tolerance).  A model
    that is not built in is bounded by its Lipschitz constants (`covey.optimize.blackbox`), where boxes grow with a
    power of 1/tolerance.  Source: Sposato (2016), section 4.7, whose proof needs such a solver.  Deviation: V1, V4.

    Examples
    --------
    >>> import numpy as np
    >>> from covey.environment import Landmarks
    >>> from covey.geometry import Region
    >>> from covey.sensing import Anisotropic
    >>> problem = PoseProblem(Anisotropic(), Landmarks(np.array([[0.0, 0.0]])), Region.box(-5, 5, -5, 5))
    >>> result = Exact().maximize(problem, tolerance=1e-6, rng=np.random.default_rng(0))
    >>> result.status.value, round(result.upper_bound, 5)
    ('proved', 1.0)
    """

    limit: int = 20_000_000
    cancelled: Callable[[], bool] | None = None
    name: str = "exact"

    def maximize(
        self,
        problem: PoseProblem,
        *,
        start: Pose2 | None = None,
        tolerance: float = 1e-3,
        rng: np.random.Generator,
    ) -> PoseResult:
        """Solve a pose problem to the tolerance; see `PoseOptimizer.maximize`."""
        if not tolerance > 0.0:
            raise ArgumentError(f"tolerance: expected a number above 0, got {tolerance}")
        model = problem.model
        first = Search() if start is None else BRIEF
        known = first.maximize(problem, start=start, tolerance=tolerance, rng=rng)
        if not is_compiled(model):
            return blackbox.prove(problem, known, tolerance=tolerance, limit=self.limit, cancelled=self.cancelled)
        unit, kind = model.optimal_distance, int(model.kernel)
        x0, x1, y0, y1 = problem.region.bounds
        # lengths in optimal distances from the middle of the region, so that far from the origin no digits are lost
        middle = np.array([0.5 * (x0 + x1), 0.5 * (y0 + y1)])
        width, height = 0.5 * (x1 - x0) / unit, 0.5 * (y1 - y0) / unit
        columns = landmark_columns(problem.landmarks, problem.thresholds)
        columns[:2] = (columns[:2] - middle[:, None]) / unit
        edges = (problem.region.edges - np.tile(middle, 2)) / unit
        inset = (problem.region.inset_edges - np.tile(middle, 2)) / unit
        best = np.array([known.score, *((known.pose.position_W - middle) / unit), known.pose.yaw])
        stack = np.zeros((STACK, 8))
        sectors = 1 if kind == ISOTROPIC else SECTORS
        everything = float(columns[4] @ np.maximum(0.0, model.maximum - columns[5]))
        size = 1.0 + width + height
        rounding = 1e-15 * (100.0 + size + columns.shape[1]) * everything
        working = max(tolerance, 50.0 * rounding)
        for sector in range(sectors):
            arc = math.pi / sectors
            stack[sector] = (0.0, 0.0, -math.pi + (2 * sector + 1) * arc, width, height, arc, everything, 0.0)
        top, closed, evaluations = sectors, -math.inf, known.evaluations
        budget = self.limit
        while top > 0 and budget > 0 and top < STACK - 2 and not (self.cancelled and self.cancelled()):
            chunk = min(budget, max(50, CHUNK // max(1, len(problem.landmarks))))
            top, closed, bounds = _branch(
                kind,
                columns,
                edges,
                inset,
                working,
                chunk,
                best,
                stack,
                top,
                closed,
                rounding,
                SMALLEST * size,
            )
            budget -= chunk
            evaluations += bounds
        pose = known.pose
        if best[0] > known.score:
            pose = Pose2(best[1] * unit + middle[0], best[2] * unit + middle[1], best[3])
        score = problem.score(pose)
        # a box that is kept is not bounded to the end; those that are left here are
        vertices, lines = np.empty((3, 2)), np.empty((9, columns.shape[1]))
        left = [min(box[6], _box_bound(kind, columns, box, math.inf, vertices, lines)[0]) for box in stack[:top]]
        upper = max(score, closed, max(left, default=-math.inf) + rounding)
        proved = upper <= score + tolerance + rounding
        return PoseResult(pose, score, upper, Status.PROVED if proved else Status.BUDGET, evaluations)
