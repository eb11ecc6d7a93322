"""Local ascent of several agents at once, compiled; `covey.optimize.pose_ascent` is the same for one.

The objective of m agents that share their landmarks freely is ``sum_k w_k max(0, max_i vis_i(A_i, s_k) - lambda_k)``;
with two it is the joint problem of a pairwise trade.  It is smooth but for kinks (a
landmark that changes hands, one at exactly the optimal distance), and its best poses often lie on such kinks.  BFGS
with a weak Wolfe line search is the method of choice there (Lewis and Overton, *Nonsmooth optimization via quasi-Newton
methods*, Mathematical Programming 141, 2013).

The region enters exactly: the ascent maximises ``f(proj(p)) - |p - proj(p)|``, whose maximisers are those of f in the
region.  So does the distance that two agents must keep: proj then also pushes them apart, each half of the way.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from covey.compiled import fast_kernel, kernel
from covey.geometry import polygon
from covey.sensing.kernels import ISOTROPIC, ORIENTED, visibility_gradients

SHAKES = 4
SHAKE = 0.03
"""How often the best poses are shaken at the end, and how far at first, in optimal distances and radians."""

PUSHES = 10
STUCK = 1e6
"""How often two agents are pushed apart and back into their regions, and what it costs if they are still too close."""

COARSE = 1e3
"""How many times the precision asked for will do for an ascent that is not the last."""

contains_point = kernel(polygon.contains_point)
nearest_on_edges = kernel(polygon.nearest_on_edges)


@fast_kernel
def _share(
    landmarks: NDArray[np.float64],
    seen: NDArray[np.float64],
    owners: NDArray[np.int64],
    gradient: NDArray[np.float64],
) -> float:
    """Give each landmark to the agent that sees it best and sum up."""
    n = landmarks.shape[1]
    m = seen.shape[0]
    if m == 2:
        for k in range(n):
            owners[k] = 1 if seen[1, 0, k] > seen[0, 0, k] else 0
    elif m > 2:
        for k in range(n):
            owners[k] = 0
            for i in range(1, m):
                if seen[i, 0, k] > seen[owners[k], 0, k]:
                    owners[k] = i
    total = 0.0
    for i in range(m):
        gx = gy = gt = 0.0
        for k in range(n):
            gain = seen[i, 0, k] - landmarks[5, k]
            w = landmarks[4, k] if gain > 0.0 and owners[k] == i else 0.0
            total += w * gain
            gx -= w * seen[i, 1, k]
            gy -= w * seen[i, 2, k]
            gt += w * seen[i, 3, k]
        gradient[3 * i] = gx
        gradient[3 * i + 1] = gy
        gradient[3 * i + 2] = gt
    return total


@kernel
def _push_apart(
    edges: NDArray[np.float64], offsets: NDArray[np.int64], spacing: float, poses: NDArray[np.float64]
) -> bool:
    """Move two agents apart where they are closer than `spacing`, metres, within their regions; whether it worked."""
    for _ in range(PUSHES):
        dx, dy = poses[1, 0] - poses[0, 0], poses[1, 1] - poses[0, 1]
        d = math.hypot(dx, dy)
        if d >= spacing:
            return True
        push = 0.5 * (spacing * (1.0 + 1e-9) - d)
        ux, uy = (dx / d, dy / d) if d > 1e-9 * spacing else (1.0, 0.0)
        for i in range(2):
            side = 2.0 * i - 1.0
            px, py = poses[i, 0] + side * push * ux, poses[i, 1] + side * push * uy
            region = edges[offsets[i] : offsets[i + 1]]
            if not contains_point(region, px, py):
                px, py, _, _ = nearest_on_edges(region, px, py)
            poses[i, 0], poses[i, 1] = px, py
    return math.hypot(poses[1, 0] - poses[0, 0], poses[1, 1] - poses[0, 1]) >= spacing


@kernel
def _pull_back(
    scales: NDArray[np.float64],
    spacing: float,
    x: NDArray[np.float64],
    poses: NDArray[np.float64],
    gradient: NDArray[np.float64],
) -> None:
    """Turn the gradient at two poses that were pushed apart into that by x, and lead x out of where it was pushed."""
    dx = x[3] * scales[1] - x[0] * scales[0]
    dy = x[4] * scales[1] - x[1] * scales[0]
    ux, uy = (poses[1, 0] - poses[0, 0]) / spacing, (poses[1, 1] - poses[0, 1]) / spacing
    turn = 0.5 * spacing / max(math.hypot(dx, dy), 0.05 * spacing)
    outward = 0.5 * (1.0 / scales[0] + 1.0 / scales[1])
    mx = 0.5 * (gradient[0] / scales[0] + gradient[3] / scales[1])
    my = 0.5 * (gradient[1] / scales[0] + gradient[4] / scales[1])
    along = turn * (
        (gradient[0] / scales[0] - gradient[3] / scales[1]) * -uy
        + (gradient[1] / scales[0] - gradient[4] / scales[1]) * ux
    )
    gradient[0] = scales[0] * (mx - along * uy - outward * ux)
    gradient[1] = scales[0] * (my + along * ux - outward * uy)
    gradient[3] = scales[1] * (mx + along * uy + outward * ux)
    gradient[4] = scales[1] * (my - along * ux + outward * uy)


@kernel
def objective(
    kinds: NDArray[np.int64],
    scales: NDArray[np.float64],
    landmarks: NDArray[np.float64],
    edges: NDArray[np.float64],
    offsets: NDArray[np.int64],
    spacing: float,
    x: NDArray[np.float64],
    gradient: NDArray[np.float64],
    poses: NDArray[np.float64],
    seen: NDArray[np.float64],
    owners: NDArray[np.int64],
) -> float:
    """Objective at x and its gradient.

    Parameters
    ----------
    kinds, scales : arrays, shape (m,)
        Each agent's model and optimal distance, metres.
    landmarks : array, shape (6, n)
        Rows x, y (metres), normal x, y, weight, threshold.
    edges, offsets : arrays, shape (e, 4) and (m + 1,)
        Edges of all regions, metres; agent i's are rows offsets[i] to offsets[i + 1].
    spacing : float
        How far apart two agents must be, metres; 0 if they need not, or if there is another number of them.
    x : array, shape (3 m,)
        Positions in units of each agent's optimal distance, and headings.
    gradient : array, shape (3 m,)
        Is overwritten with the gradient by x.
    poses : array, shape (m, 5)
        Is overwritten: position inside the region (metres), heading, and its cosine and sine.
    seen, owners : arrays, shape (m, 4, n) and (n,)
        Scratch memory.
    """
    m = kinds.shape[0]
    penalty = 0.0
    for i in range(m):
        px = x[3 * i] * scales[i]
        py = x[3 * i + 1] * scales[i]
        poses[i, 0] = px
        poses[i, 1] = py
        region = edges[offsets[i] : offsets[i + 1]]
        if not contains_point(region, px, py):
            poses[i, 0], poses[i, 1], _, _ = nearest_on_edges(region, px, py)
            penalty += math.hypot(px - poses[i, 0], py - poses[i, 1]) / scales[i]
        poses[i, 2] = x[3 * i + 2]
        poses[i, 3] = math.cos(x[3 * i + 2])
        poses[i, 4] = math.sin(x[3 * i + 2])
    pushed = spacing > 0.0 and math.hypot(poses[1, 0] - poses[0, 0], poses[1, 1] - poses[0, 1]) < spacing
    if pushed:
        penalty = 0.0 if _push_apart(edges, offsets, spacing, poses) else STUCK
        for i in range(m):
            penalty += (
                math.hypot(x[3 * i] * scales[i] - poses[i, 0], x[3 * i + 1] * scales[i] - poses[i, 1]) / scales[i]
            )
    for i in range(m):
        visibility_gradients(
            kinds[i], landmarks, 1.0 / scales[i], poses[i, 0], poses[i, 1], poses[i, 3], poses[i, 4], seen[i]
        )
    total = _share(landmarks, seen, owners, gradient)
    if pushed:
        _pull_back(scales, spacing, x, poses, gradient)
    elif penalty > 0.0:
        for i in range(m):
            px = x[3 * i] * scales[i]
            py = x[3 * i + 1] * scales[i]
            ex = px - poses[i, 0]
            ey = py - poses[i, 1]
            size = math.hypot(ex, ey)
            if size > 0.0:
                ex /= size
                ey /= size
                _, _, _, within = nearest_on_edges(edges[offsets[i] : offsets[i + 1]], px, py)
                along = gradient[3 * i] * -ey + gradient[3 * i + 1] * ex if within else 0.0
                gradient[3 * i] = along * -ey - ex
                gradient[3 * i + 1] = along * ex - ey
    return total - penalty


@kernel
def _length(vector: NDArray[np.float64]) -> float:
    total = 0.0
    for i in range(vector.shape[0]):
        total += vector[i] * vector[i]
    return math.sqrt(total)


@kernel
def _reset(hessian: NDArray[np.float64], diagonal: float) -> None:
    for i in range(hessian.shape[0]):
        for j in range(hessian.shape[0]):
            hessian[i, j] = diagonal if i == j else 0.0


@kernel
def ascend(
    kinds: NDArray[np.int64],
    scales: NDArray[np.float64],
    landmarks: NDArray[np.float64],
    edges: NDArray[np.float64],
    offsets: NDArray[np.int64],
    spacing: float,
    start: NDArray[np.float64],
    budget: int,
    precision: float,
) -> tuple[float, NDArray[np.float64], int]:
    """Climb from poses, shape (m, 3), metres and radians: (value, poses inside the regions, evaluations).

    It ends when two steps together gain less than `precision`, when no step gains, or after `budget` evaluations.
    """
    m = kinds.shape[0]
    size = 3 * m
    x = np.empty(size)
    for i in range(m):
        x[3 * i] = start[i, 0] / scales[i]
        x[3 * i + 1] = start[i, 1] / scales[i]
        x[3 * i + 2] = start[i, 2]
    poses = np.empty((m, 5))
    g = np.empty(size)
    seen = np.empty((m, 4, landmarks.shape[1]))
    owners = np.empty(landmarks.shape[1], dtype=np.int64)
    trial = np.empty(size)
    trial_g = np.empty(size)
    step = np.empty(size)
    y = np.empty(size)
    hy = np.empty(size)
    hessian = np.zeros((size, size))
    f = objective(kinds, scales, landmarks, edges, offsets, spacing, x, g, poses, seen, owners)
    evaluations = 1
    norm = _length(g)
    _reset(hessian, 0.2 / max(norm, 1e-12))
    fresh = True
    last = f
    since = 0
    while evaluations < budget and norm > 1e-12:
        slope = 0.0
        for i in range(size):
            step[i] = 0.0
            for j in range(size):
                step[i] += hessian[i, j] * g[j]
            slope += step[i] * g[i]
        if slope <= 0.0:
            break
        t, low, high = 1.0, 0.0, math.inf
        gained = False
        value = f
        for _ in range(30):
            for i in range(size):
                trial[i] = x[i] + t * step[i]
            value = objective(kinds, scales, landmarks, edges, offsets, spacing, trial, trial_g, poses, seen, owners)
            evaluations += 1
            if value < f + 1e-4 * t * slope:
                high = t
            else:
                gained = value > f
                rate = 0.0
                for i in range(size):
                    rate += trial_g[i] * step[i]
                if rate <= 0.5 * slope or evaluations >= budget:
                    break
                low = t
            t = 0.5 * (low + high) if high < math.inf else 2.0 * t
            if evaluations >= budget and not gained:
                break
        if not gained:
            if fresh:
                break
            # the curvature learnt may be of the other side of a kink: once more from the plain gradient
            _reset(hessian, 1e-3 / max(norm, 1e-12))
            fresh = True
            continue
        sy = 0.0
        for i in range(size):
            step[i] = trial[i] - x[i]
            y[i] = g[i] - trial_g[i]
            sy += step[i] * y[i]
            x[i] = trial[i]
            g[i] = trial_g[i]
        f = value
        if sy > 1e-14:
            if fresh:
                _reset(hessian, sy / _length(y) ** 2)
            yhy = 0.0
            for i in range(size):
                hy[i] = 0.0
                for j in range(size):
                    hy[i] += hessian[i, j] * y[j]
                yhy += hy[i] * y[i]
            c = (1.0 + yhy / sy) / sy
            for i in range(size):
                for j in range(size):
                    hessian[i, j] += c * step[i] * step[j] - (hy[i] * step[j] + step[i] * hy[j]) / sy
            fresh = False
        norm = _length(g)
        since += 1
        if since == 3:
            if f - last < precision:
                break
            last = f
            since = 0
    value = objective(kinds, scales, landmarks, edges, offsets, spacing, x, trial_g, poses, seen, owners)
    found = np.empty((m, 3))
    total = value
    for i in range(m):
        for j in range(3):
            found[i, j] = poses[i, j]
        total += math.hypot(x[3 * i] * scales[i] - poses[i, 0], x[3 * i + 1] * scales[i] - poses[i, 1]) / scales[i]
    return total, found, evaluations


@kernel
def climb_all(
    kinds: NDArray[np.int64],
    scales: NDArray[np.float64],
    landmarks: NDArray[np.float64],
    edges: NDArray[np.float64],
    offsets: NDArray[np.int64],
    spacing: float,
    starts: NDArray[np.float64],
    budget: int,
    keep: int,
    polish: int,
    precision: float,
) -> tuple[float, NDArray[np.float64], int]:
    """Climb from every start, shape (s, m, 3), on a small budget, then from the `keep` best with `polish`: as `ascend`.

    `starts` is overwritten.
    """
    count = starts.shape[0]
    values = np.empty(count)
    total = 0
    for i in range(count):
        values[i], found, evaluations = ascend(
            kinds, scales, landmarks, edges, offsets, spacing, starts[i], budget, 1e-3 * precision
        )
        for a in range(found.shape[0]):
            for j in range(3):
                starts[i, a, j] = found[a, j]
        total += evaluations
    best = -math.inf
    result = starts[0]
    for _ in range(min(keep, count)):
        top = 0
        for i in range(1, count):
            if values[i] > values[top]:
                top = i
        if values[top] == -math.inf:
            break
        value, found, evaluations = ascend(
            kinds, scales, landmarks, edges, offsets, spacing, starts[top], polish, COARSE * precision
        )
        total += evaluations
        # starts that have climbed to the same place are of no more use
        near = values[top] - 1e-9
        for i in range(count):
            if values[i] >= near:
                values[i] = -math.inf
        if value > best:
            best, result = value, found
    # an ascent may end on a ridge of kinks a little below the summit; it finds the rest from a hair's breadth beside,
    # each time from ten times nearer and to a tenth of the precision
    beside = np.empty_like(result)
    finer = COARSE
    for attempt in range(SHAKES):
        for a in range(beside.shape[0]):
            for j in range(3):
                shake = SHAKE * finer / COARSE * math.cos(2.4 * (attempt + 1) * (3 * a + j + 1))
                beside[a, j] = result[a, j] + (shake * scales[a] if j < 2 else shake)
        finer *= 0.1
        value, found, evaluations = ascend(
            kinds, scales, landmarks, edges, offsets, spacing, beside, polish, max(1.0, finer) * precision
        )
        total += evaluations
        if value > best:
            best, result = value, found
    return best, result, total


@fast_kernel
def pose_value(
    kind: int, columns: NDArray[np.float64], inverse: float, px: float, py: float, c: float, s: float
) -> float:
    """Value of a pose problem at one pose; lengths times `inverse` are optimal distances."""
    total = 0.0
    for k in range(columns.shape[1]):
        qx = (columns[0, k] - px) * inverse
        qy = (columns[1, k] - py) * inverse
        i = 1.0 / max(1.0, qx * qx + qy * qy)
        if kind == ISOTROPIC:
            value = math.sqrt(qx * qx + qy * qy) * i
        else:
            value = (qx * c + qy * s) * i
            if kind == ORIENTED:
                value *= max(0.0, -(columns[2, k] * c + columns[3, k] * s))
        total += columns[4, k] * max(0.0, value - columns[5, k])
    return total


@kernel
def pose_values(
    kind: int, columns: NDArray[np.float64], inverse: float, poses: NDArray[np.float64], values: NDArray[np.float64]
) -> None:
    """Fill values, shape (s,), of a pose problem at poses, shape (s, 3)."""
    for i in range(poses.shape[0]):
        values[i] = pose_value(
            kind, columns, inverse, poses[i, 0], poses[i, 1], math.cos(poses[i, 2]), math.sin(poses[i, 2])
        )
