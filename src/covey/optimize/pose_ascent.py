"""Local ascent of one agent, compiled: the method of `covey.optimize.ascent`, with its three coordinates in registers.

A climb can be left and taken up again where it was, with the curvature that it has learnt.  So many climbs begin, and
the less a climb promises the sooner it is left (successive halving).
"""

from __future__ import annotations

import math
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from covey.compiled import kernel
from covey.optimize.ascent import contains_point, nearest_on_edges
from covey.sensing.kernels import gain_gradient

VALUE, X, Y, YAW = range(4)
STATE = 14
"""Numbers of a climb: value, position (optimal distances), heading, gradient (3), inverse Hessian (6), whether that is
still a guess.
"""

STRIDE = 0.2
"""Length of a climb's first step, optimal distances and radians."""

POLISH = 500
"""Evaluations at most for a climb to the end."""

COARSE = 1e3
"""How many times the precision asked for will do for a climb that is not the last."""

SAME = 0.02
"""Climbs that are this near each other, optimal distances and radians in all, are taken for one."""

NEIGHBOURS = 8
NEAR, FAR = 0.15, 0.35
NEARBY = np.array([[8, 3], [14, 1]])
"""From how many places around the best pose it climbs once more, how far away they lie by turns, optimal distances, and
the rounds of these climbs.
"""

SHAKES = 2
SHAKE = 0.03
CALM = 0.005
"""How often the best pose is shaken at the end, how far at first, optimal distances and radians, and how much less each
time.
"""

_Matrix: TypeAlias = tuple[float, float, float, float, float, float]
"""Upper triangle of a symmetric matrix, row by row."""


@kernel
def _value(
    kind: int,
    columns: NDArray[np.float64],
    unit: float,
    edges: NDArray[np.float64],
    x: float,
    y: float,
    yaw: float,
) -> tuple[float, float, float, float]:
    """Objective and gradient: that of the nearest point of the region, less the way to it, optimal distances."""
    px, py = x * unit, y * unit
    qx, qy, within = px, py, True
    if not contains_point(edges, px, py):
        qx, qy, _, within = nearest_on_edges(edges, px, py)
    value, gx, gy, gt = gain_gradient(kind, columns, 1.0 / unit, qx, qy, math.cos(yaw), math.sin(yaw))
    away = math.hypot(px - qx, py - qy)
    if away > 0.0:
        ex, ey = (px - qx) / away, (py - qy) / away
        along = gy * ex - gx * ey if within else 0.0
        gx, gy = -along * ey - ex, along * ex - ey
    return value - away / unit, gx, gy, gt


@kernel
def _times(h: _Matrix, x: float, y: float, z: float) -> tuple[float, float, float]:
    return h[0] * x + h[1] * y + h[2] * z, h[1] * x + h[3] * y + h[4] * z, h[2] * x + h[4] * y + h[5] * z


@kernel
def _multiple(diagonal: float) -> _Matrix:
    return diagonal, 0.0, 0.0, diagonal, 0.0, diagonal


@kernel
def _updated(h: _Matrix, sx: float, sy: float, st: float, yx: float, yy: float, yt: float, curve: float) -> _Matrix:
    """BFGS: the inverse Hessian after a step s along which the gradient fell by y; curve is s . y."""
    zx, zy, zt = _times(h, yx, yy, yt)
    r = 1.0 / curve
    q = (1.0 + (yx * zx + yy * zy + yt * zt) * r) * r
    return (
        h[0] + q * sx * sx - 2.0 * r * sx * zx,
        h[1] + q * sx * sy - r * (sx * zy + sy * zx),
        h[2] + q * sx * st - r * (sx * zt + st * zx),
        h[3] + q * sy * sy - 2.0 * r * sy * zy,
        h[4] + q * sy * st - r * (sy * zt + st * zy),
        h[5] + q * st * st - 2.0 * r * st * zt,
    )


@kernel
def _store(
    state: NDArray[np.float64],
    value: float,
    x: float,
    y: float,
    yaw: float,
    gx: float,
    gy: float,
    gt: float,
    h: _Matrix,
    fresh: bool,
) -> None:
    # number by number: assigning slices takes numba ten times as long to compile
    state[0], state[1], state[2], state[3] = value, x, y, yaw
    state[4], state[5], state[6] = gx, gy, gt
    state[7], state[8], state[9], state[10], state[11], state[12] = h
    state[13] = 1.0 if fresh else 0.0


@kernel
def begin(
    kind: int,
    columns: NDArray[np.float64],
    unit: float,
    edges: NDArray[np.float64],
    pose: NDArray[np.float64],
    stride: float,
    state: NDArray[np.float64],
) -> None:
    """Begin a climb at a pose, shape (3,), metres and radians; see `climb`."""
    x, y, yaw = pose[0] / unit, pose[1] / unit, pose[2]
    value, gx, gy, gt = _value(kind, columns, unit, edges, x, y, yaw)
    h = stride / max(math.sqrt(gx * gx + gy * gy + gt * gt), 1e-12)
    _store(state, value, x, y, yaw, gx, gy, gt, _multiple(h), True)


@kernel
def climb(
    kind: int,
    columns: NDArray[np.float64],
    unit: float,
    edges: NDArray[np.float64],
    state: NDArray[np.float64],
    budget: int,
    precision: float,
) -> int:
    """Go on with a climb: how many evaluations it took.

    It ends when three steps together gain less than `precision`, when no step gains, or after `budget` evaluations.

    Parameters
    ----------
    kind, unit : int, float
        The model and its optimal distance, metres.
    columns : array, shape (6, n)
        See `landmark_columns`.
    edges : array, shape (e, 4)
        Of the region, metres.
    state : array, shape (STATE,)
        Is overwritten with where the climb is then.  The position may lie outside the region; `settle` moves it there.
    """
    f, x, y, t = state[0], state[1], state[2], state[3]
    gx, gy, gt = state[4], state[5], state[6]
    h = (state[7], state[8], state[9], state[10], state[11], state[12])
    fresh = state[13] > 0.0
    evaluations = 0
    last = f
    since = 0
    while evaluations < budget:
        norm = math.sqrt(gx * gx + gy * gy + gt * gt)
        sx, sy, st = _times(h, gx, gy, gt)
        slope = sx * gx + sy * gy + st * gt
        if norm <= 1e-12 or slope <= 0.0:
            break
        a, low, high = 1.0, 0.0, math.inf
        gained = False
        value, x1, y1, t1, gx1, gy1, gt1 = f, x, y, t, gx, gy, gt
        for _ in range(30):
            x1, y1, t1 = x + a * sx, y + a * sy, t + a * st
            value, gx1, gy1, gt1 = _value(kind, columns, unit, edges, x1, y1, t1)
            evaluations += 1
            if value < f + 1e-4 * a * slope:
                high = a
            else:
                gained = value > f
                if gx1 * sx + gy1 * sy + gt1 * st <= 0.5 * slope or evaluations >= budget:
                    break
                low = a
            a = 0.5 * (low + high) if high < math.inf else 2.0 * a
            if evaluations >= budget and not gained:
                break
        if not gained:
            if fresh or evaluations >= budget:
                break
            # the curvature learnt may be of the other side of a kink: once more from the plain gradient
            h = _multiple(1e-3 / max(norm, 1e-12))
            fresh = True
            continue
        sx, sy, st = x1 - x, y1 - y, t1 - t
        yx, yy, yt = gx - gx1, gy - gy1, gt - gt1
        curve = sx * yx + sy * yy + st * yt
        f, x, y, t, gx, gy, gt = value, x1, y1, t1, gx1, gy1, gt1
        if curve > 1e-14:
            if fresh:
                h = _multiple(curve / (yx * yx + yy * yy + yt * yt))
            h = _updated(h, sx, sy, st, yx, yy, yt, curve)
            fresh = False
        since += 1
        if since == 3:
            if f - last < precision:
                break
            last = f
            since = 0
    _store(state, f, x, y, t, gx, gy, gt, h, fresh)
    return evaluations


@kernel
def settle(unit: float, edges: NDArray[np.float64], state: NDArray[np.float64], pose: NDArray[np.float64]) -> float:
    """Fill the pose, shape (3,), metres and radians, inside the region, that a climb is at; return its value."""
    value = float(state[VALUE])
    pose[0], pose[1], pose[2] = state[X] * unit, state[Y] * unit, state[YAW]
    if not contains_point(edges, pose[0], pose[1]):
        x, y, _, _ = nearest_on_edges(edges, pose[0], pose[1])
        value += math.hypot(pose[0] - x, pose[1] - y) / unit
        pose[0], pose[1] = x, y
    return value


@kernel
def _keep(
    unit: float, edges: NDArray[np.float64], state: NDArray[np.float64], value: float, best: NDArray[np.float64]
) -> float:
    """Overwrite the best pose with where a climb is if that is better than `value`; return the higher value."""
    pose = np.empty(3)
    found = settle(unit, edges, state, pose)
    if found <= value:
        return value
    for j in range(3):
        best[j] = pose[j]
    return found


@kernel
def _select(states: NDArray[np.float64], count: int, keep: int) -> int:
    """Move the best of the first `count` climbs, of several at one place one, to the front: how many, at most keep."""
    kept = 0
    while kept < keep:
        top = kept
        for i in range(kept + 1, count):
            if states[i, VALUE] > states[top, VALUE]:
                top = i
        if kept >= count or states[top, VALUE] == -math.inf:
            break
        known = False
        for i in range(kept):
            turn = (states[i, YAW] - states[top, YAW]) / (2.0 * math.pi)
            turn = 2.0 * math.pi * abs(turn - math.floor(turn + 0.5))
            if math.hypot(states[i, X] - states[top, X], states[i, Y] - states[top, Y]) + turn < SAME:
                known = True
        if known:
            states[top, VALUE] = -math.inf
            continue
        for j in range(STATE):
            states[kept, j], states[top, j] = states[top, j], states[kept, j]
        kept += 1
    return kept


@kernel
def _compete(
    kind: int,
    columns: NDArray[np.float64],
    unit: float,
    edges: NDArray[np.float64],
    states: NDArray[np.float64],
    rounds: NDArray[np.int64],
    precision: float,
) -> int:
    """Go on with climbs, fewer with each round, the last ones to the end, and put the best first: evaluations."""
    left = states.shape[0]
    total = 0
    for j in range(rounds.shape[0] + 1):
        last = j == rounds.shape[0]
        budget = POLISH if last else rounds[j, 0]
        for i in range(left):
            total += climb(kind, columns, unit, edges, states[i], budget, (COARSE if last else 1e-3) * precision)
        left = _select(states, left, 1 if last else rounds[j, 1])
    return total


@kernel
def summit(
    kind: int,
    columns: NDArray[np.float64],
    unit: float,
    edges: NDArray[np.float64],
    starts: NDArray[np.float64],
    rounds: NDArray[np.int64],
    precision: float,
    best: NDArray[np.float64],
) -> tuple[float, int]:
    """Climb from every start, from the most promising ones to the end, and then look around: (value, evaluations).

    Parameters
    ----------
    starts : array, shape (s, 3)
        Poses, metres and radians, one at least; overwritten with where each climb has come to, in any order.
    rounds : array, shape (r, 2)
        Evaluations a climb in each round, and how many climbs go on after it.
    precision : float
        See `climb`.
    best : array, shape (3,)
        Is overwritten with the best pose.
    """
    count = starts.shape[0]
    states = np.empty((max(count, NEIGHBOURS), STATE))
    beside = np.empty(3)
    value = -math.inf
    evaluations = 0
    # summits lie in groups, so after the starts come places around the best that was found
    for around in (False, True):
        places = NEIGHBOURS if around else count
        for i in range(places):
            if around:
                angle = 2.0 * math.pi * i / NEIGHBOURS
                far = unit * (NEAR if i % 2 else FAR)
                beside[0], beside[1] = best[0] + far * math.cos(angle), best[1] + far * math.sin(angle)
                beside[2] = best[2]
            begin(kind, columns, unit, edges, beside if around else starts[i], STRIDE, states[i])
        evaluations += places + _compete(
            kind, columns, unit, edges, states[:places], NEARBY if around else rounds, precision
        )
        if not around:
            for i in range(count):
                settle(unit, edges, states[i], starts[i])
        value = _keep(unit, edges, states[0], value, best)
    # a climb may end on a ridge of kinks a little below the summit; it finds the rest from a hair's breadth beside,
    # each time from nearer and to a finer precision
    far = SHAKE
    for attempt in range(SHAKES):
        for j in range(3):
            shake = far * math.cos(2.4 * (attempt + 1) * (j + 1))
            beside[j] = best[j] + (shake * unit if j < 2 else shake)
        begin(kind, columns, unit, edges, beside, far, states[0])
        far *= CALM
        finer = max(1.0, COARSE * far / SHAKE) * precision
        evaluations += 1 + climb(kind, columns, unit, edges, states[0], POLISH, finer)
        value = _keep(unit, edges, states[0], value, best)
    return value, evaluations
