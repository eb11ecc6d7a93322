"""`exact`: the best pose with a proof, by branch and bound over boxes of positions and headings.

The bound of a box comes from `sensing.kernels.linear_bounds`: each landmark's part is at most the positive part of a
function that is linear in the offset from the box's centre and linear in the heading vector.  A sum of positive parts
of linear functions is convex, so over the box it is largest at one of its four corners, and over an arc of headings it
is bounded by its values at both ends.  The headings of a box are a row of arcs, of which neighbours share an end, so
four plain sums bound an arc.  Arcs at the ends of the row that cannot hold the best pose are dropped.  The overestimate
falls with the square of the size, so the number of boxes grows with the logarithm of the tolerance only.
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
"""The arcs of a box are halved when half an arc, radians, is more than this times half its longer side."""

SMALLEST = 1e-10
"""Boxes smaller than this times the region are not cut."""

BRIEF = Search(anchors=32, starts=8, rounds=((8, 4), (14, 1)))
"""What looks for a better pose before the proof of one that is known; the proof itself finds what is left."""

CIRCLE = 8
MOST_ARCS = 16
"""How many arcs the circle is at first, and how many the row of a box may have."""

BOX = 8
PSI, HALF_ARC, ARCS, BOUND = range(4, BOX)
"""Numbers of a box, after its position and half sizes; see `_branch`."""

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
def _bound_arcs(
    kind: int,
    columns: NDArray[np.float64],
    box: NDArray[np.float64],
    vertices: NDArray[np.float64],
    lines: NDArray[np.float64],
    bounds: NDArray[np.float64],
) -> None:
    """Fill an upper bound over each arc of a box; see `_branch`."""
    if kind == ISOTROPIC:
        linear_bounds(kind, columns, box[0], box[1], box[2], box[3], vertices, lines)
        corners = _corner_sums(lines, 0.0, 0.0, 1.0)
        for arc in range(int(box[ARCS])):
            bounds[arc] = max(max(corners[0], corners[1]), max(corners[2], corners[3]))
        return
    width = box[HALF_ARC]
    turn = 2.0 if kind == ORIENTED else 1.0
    c, s = math.cos(turn * width), math.sin(turn * width)
    first = (0.0, 0.0, 0.0, 0.0)
    for arc in range(int(box[ARCS])):
        begins = box[PSI] + 2.0 * width * arc
        ends = box[PSI] + 2.0 * width * (arc + 1)
        if kind == ORIENTED:
            middle, outer = begins + width, 1.0 / math.cos(width)
            vertices[0, 0], vertices[0, 1] = math.cos(begins), math.sin(begins)
            vertices[1, 0], vertices[1, 1] = math.cos(ends), math.sin(ends)
            vertices[2, 0], vertices[2, 1] = outer * math.cos(middle), outer * math.sin(middle)
        if kind == ORIENTED or arc == 0:
            linear_bounds(kind, columns, box[0], box[1], box[2], box[3], vertices, lines)
            first = _sums(kind, lines, math.cos(turn * begins), math.sin(turn * begins), c)
        last = _sums(kind, lines, math.cos(turn * ends), math.sin(turn * ends), c)
        bounds[arc] = 0.0
        for corner in range(4):
            bounds[arc] = max(bounds[arc], _arc(first[corner], last[corner], c, s))
        first = last


@kernel
def _drop_arcs(box: NDArray[np.float64], bounds: NDArray[np.float64], target: float) -> float:
    """Drop the arcs at the ends of a box's row whose bound is at most `target`; return the highest bound of these."""
    arcs = int(box[ARCS])
    first, longest = 0, 0
    if arcs * box[HALF_ARC] > math.pi - 1e-9:
        # all the circle: the row may begin anywhere, so after the longest run of arcs to drop
        run = 0
        for arc in range(2 * arcs):
            if bounds[arc % arcs] <= target:
                run += 1
            else:
                if longest < run:
                    first, longest = arc % arcs, run
                run = 0
    last = first + arcs - 1
    dropped = -math.inf
    while last >= first and bounds[first % arcs] <= target:
        dropped = max(dropped, bounds[first % arcs])
        first += 1
    while last >= first and bounds[last % arcs] <= target:
        dropped = max(dropped, bounds[last % arcs])
        last -= 1
    box[PSI] += 2.0 * box[HALF_ARC] * first
    box[ARCS] = last + 1 - first
    return dropped


@kernel
def _cut(kind: int, box: NDArray[np.float64], children: NDArray[np.float64]) -> int:
    """Fill what a box is cut into, by position or by heading as CUT says, shape (2, BOX), and return how many."""
    for j in range(BOX):
        children[0, j] = children[1, j] = box[j]
    arcs = box[ARCS]
    if kind == ISOTROPIC or box[HALF_ARC] <= CUT * max(box[2], box[3]):
        axis = 0 if box[2] >= box[3] else 1
        half = 0.5 * box[2 + axis]
        children[0, axis] -= half
        children[1, axis] += half
        children[0, 2 + axis] = children[1, 2 + axis] = half
        return 2
    if 2.0 * arcs > MOST_ARCS:
        half = arcs // 2
        children[0, ARCS] = half
        children[1, ARCS] = arcs - half
        children[1, PSI] += 2.0 * box[HALF_ARC] * half
        return 2
    children[0, HALF_ARC] *= 0.5
    children[0, ARCS] *= 2.0
    return 1


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
    """Cut boxes from the top of the stack, at most `limit`: (boxes left, highest bound of what is closed, bounds).

    Parameters
    ----------
    columns : array, shape (6, n)
        Landmarks as in `linear_bounds`.
    edges, inset : arrays, shape (e, 4)
        The region's edges and those just inside it, in optimal distances.
    best : array, shape (4,)
        Incumbent: value, x, y, heading; improved in place.
    stack : array, shape (STACK, BOX)
        Open boxes: x, y, their half sizes, the heading where the row of arcs begins, half an arc, how many arcs, and an
        upper bound.
    closed : float
        Highest bound of a box or an arc closed so far.
    rounding : float
        What is added to every bound.
    smallest : float
        Half size of a box, optimal distances and radians, that is not cut any more: rounding is all that is left.
    """
    evaluations = 0
    lines = np.empty((9, columns.shape[1]))
    vertices = np.empty((3, 2))
    bounds = np.empty(MOST_ARCS)
    children = np.empty((2, BOX))
    pose = np.empty(3)
    state = np.empty(STATE)
    while top > 0 and limit > 0 and top < stack.shape[0] - 2:
        limit -= 1
        top -= 1
        if stack[top, BOUND] <= best[0] + tolerance:
            closed = max(closed, stack[top, BOUND])
            continue
        first = top
        for i in range(_cut(kind, stack[top], children)):
            box = children[i]
            x, y = box[0], box[1]
            if not contains_point(edges, x, y):
                qx, qy, _, _ = nearest_on_edges(edges, x, y)
                if math.hypot(qx - x, qy - y) > math.hypot(box[2], box[3]) + 1e-9:
                    continue  # no point of the box is in the region
            arcs = int(box[ARCS])
            _bound_arcs(kind, columns, box, vertices, lines, bounds)
            evaluations += arcs
            likely = 0
            for arc in range(arcs):
                bounds[arc] = min(bounds[arc] + rounding, box[BOUND])
                if bounds[arc] > bounds[likely]:
                    likely = arc
            box[BOUND] = bounds[likely]
            heading = box[PSI] + box[HALF_ARC] * (2.0 * likely + 1.0)
            closed = max(closed, _drop_arcs(box, bounds, best[0] + tolerance))
            if box[ARCS] == 0.0:
                continue
            if max(box[2], box[3]) < smallest and (kind == ISOTROPIC or box[HALF_ARC] < smallest):
                closed = max(closed, box[BOUND])
                continue
            if not contains_point(inset, x, y):
                x, y, _, _ = nearest_on_edges(inset, x, y)
            value = pose_value(kind, columns, 1.0, x, y, math.cos(heading), math.sin(heading))
            if value > best[0]:
                pose[0], pose[1], pose[2] = x, y, heading
                begin(kind, columns, 1.0, inset, pose, STRIDE, state)
                climb(kind, columns, 1.0, inset, state, POLISH, PRECISION)
                value = settle(1.0, inset, state, pose)
                if value > best[0]:
                    best[0] = value
                    best[1], best[2], best[3] = pose[0], pose[1], pose[2]
            for j in range(BOX):
                stack[top, j] = box[j]
            top += 1
        if top == first + 2 and stack[first, BOUND] > stack[first + 1, BOUND]:
            for j in range(BOX):
                stack[first, j], stack[first + 1, j] = stack[first + 1, j], stack[first, j]
    return top, closed, evaluations


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
        stack = np.zeros((STACK, BOX))
        arcs = 1 if kind == ISOTROPIC else CIRCLE
        everything = float(columns[4] @ np.maximum(0.0, model.maximum - columns[5]))
        size = 1.0 + width + height
        rounding = 1e-15 * (100.0 + size + columns.shape[1]) * everything
        working = max(tolerance, 50.0 * rounding)
        stack[0] = (0.0, 0.0, width, height, -math.pi, math.pi / arcs, arcs, everything)
        top, closed, evaluations = 1, -math.inf, known.evaluations
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
        upper = max(score, closed, float(stack[:top, BOUND].max(initial=-math.inf)))
        proved = upper <= score + tolerance + rounding
        return PoseResult(pose, score, upper, Status.PROVED if proved else Status.BUDGET, evaluations)
