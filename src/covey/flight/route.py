"""Ways around obstacles: A* on a grid in space, then shortcuts."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from covey.compiled import kernel
from covey.flight.fence import OPEN, SLACK, fence_room
from covey.flight.obstacles import PackedObstacles, clearance
from covey.flight.separation import scaled_distance

MARGIN = 0.2
"""Part of the distance to keep by which a route keeps farther off, so that caps on speed do not hold it up."""

STRIDE = 0.01
"""Least step, metres, at which a straight line is probed."""

UNKNOWN, FREE, TAKEN, DONE = range(4)


@kernel
def room_at(
    rows: NDArray[np.float64],
    edges: NDArray[np.float64],
    fence: NDArray[np.float64],
    blockers: NDArray[np.float64],
    keep_off: float,
    x: float,
    y: float,
    z: float,
) -> float:
    """Room left at a point beyond all distances to keep, metres; never changes faster than the point moves.

    fence, shape (e, 4): edges that the point itself has to stay inside of, as in `covey.flight.fence`.
    blockers, shape (b, 5): x, y, z, scaled distance to keep, vertical ratio (at least 1).
    """
    room = min(clearance(rows, edges, x, y, z) - keep_off, fence_room(fence, x, y) + SLACK)
    for b in range(blockers.shape[0]):
        d = scaled_distance(x - blockers[b, 0], y - blockers[b, 1], z - blockers[b, 2], blockers[b, 4])
        room = min(room, d - blockers[b, 3])
    return room


@kernel
def least_room(room: float, margin: float) -> float:
    """Room asked for along a line with so much room at its ends: what there is, as far as the margin, but a little."""
    least = min(room, margin) - STRIDE
    return least if room < 0.0 else max(least, 0.0)


@kernel
def _line_is_free(
    rows: NDArray[np.float64],
    edges: NDArray[np.float64],
    fence: NDArray[np.float64],
    blockers: NDArray[np.float64],
    keep_off: float,
    a: NDArray[np.float64],
    b: NDArray[np.float64],
    least: float,
) -> bool:
    """Whether there is at least so much room all along a straight line."""
    length = math.sqrt((b[0] - a[0]) ** 2 + (b[1] - a[1]) ** 2 + (b[2] - a[2]) ** 2)
    t = 0.0
    while True:
        f = t / length if length > 0.0 else 0.0
        x, y, z = a[0] + f * (b[0] - a[0]), a[1] + f * (b[1] - a[1]), a[2] + f * (b[2] - a[2])
        room = room_at(rows, edges, fence, blockers, keep_off, x, y, z) - least
        if room < 0.0:
            return False
        if t >= length:
            return True
        t = min(t + max(room, STRIDE), length)


@kernel
def _push(keys: NDArray[np.float64], nodes: NDArray[np.int64], size: int, key: float, node: int) -> None:
    """Add to a binary heap of so many entries; of equal keys the lower node comes first."""
    k = size
    while k > 0:
        up = (k - 1) // 2
        if keys[up] < key or (keys[up] == key and nodes[up] <= node):
            break
        keys[k], nodes[k] = keys[up], nodes[up]
        k = up
    keys[k], nodes[k] = key, node


@kernel
def _pop(keys: NDArray[np.float64], nodes: NDArray[np.int64], size: int) -> None:
    """Remove the first entry of a heap of so many."""
    key, node = keys[size - 1], nodes[size - 1]
    k = 0
    while True:
        down = 2 * k + 1
        if down >= size - 1:
            break
        right = down + 1
        if right < size - 1 and (
            keys[right] < keys[down] or (keys[right] == keys[down] and nodes[right] < nodes[down])
        ):
            down = right
        if keys[down] > key or (keys[down] == key and nodes[down] >= node):
            break
        keys[k], nodes[k] = keys[down], nodes[down]
        k = down
    keys[k], nodes[k] = key, node


@kernel
def _grow(keys: NDArray[np.float64], nodes: NDArray[np.int64]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Give a heap twice the room."""
    n = keys.shape[0]
    more_keys, more_nodes = np.empty(2 * n), np.empty(2 * n, dtype=np.int64)
    for k in range(n):
        more_keys[k], more_nodes[k] = keys[k], nodes[k]
    return more_keys, more_nodes


@kernel
def _search(
    rows: NDArray[np.float64],
    edges: NDArray[np.float64],
    fence: NDArray[np.float64],
    blockers: NDArray[np.float64],
    keep_off: float,
    low: NDArray[np.float64],
    shape: NDArray[np.int64],
    h: float,
    margin: float,
    start: NDArray[np.float64],
    goal: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Find a way from start to goal through the points low + h (i, j, k): shape (c, 3), empty when there is none."""
    ny, nz = shape[1], shape[2]
    n = shape[0] * ny * nz
    state = np.zeros(n, dtype=np.int8)
    cost = np.empty(n)
    parent = np.empty(n, dtype=np.int32)
    keys, nodes = np.empty(1024), np.empty(1024, dtype=np.int64)
    size = 0
    point, last = np.empty(3), np.empty(3)

    # every point of the grid near the start that it can go to straight away
    around = math.ceil(2.0 * margin / h) + 1
    here = room_at(rows, edges, fence, blockers, keep_off, start[0], start[1], start[2])
    ci = round((start[0] - low[0]) / h)
    cj = round((start[1] - low[1]) / h)
    ck = round((start[2] - low[2]) / h)
    if here < 0.0:
        around += math.ceil(min(-here, 2.0) * 2.5 / h)
    for i in range(max(ci - around, 0), min(ci + around + 1, shape[0])):
        for j in range(max(cj - around, 0), min(cj + around + 1, ny)):
            for k in range(max(ck - around, 0), min(ck + around + 1, nz)):
                point[0], point[1], point[2] = low[0] + h * i, low[1] + h * j, low[2] + h * k
                if room_at(rows, edges, fence, blockers, keep_off, point[0], point[1], point[2]) < margin:
                    continue
                if not _line_is_free(rows, edges, fence, blockers, keep_off, start, point, least_room(here, margin)):
                    continue
                node = (i * ny + j) * nz + k
                cost[node] = math.sqrt(
                    (point[0] - start[0]) ** 2 + (point[1] - start[1]) ** 2 + (point[2] - start[2]) ** 2
                )
                parent[node] = -1
                state[node] = FREE
                if size + 1 >= keys.shape[0]:
                    keys, nodes = _grow(keys, nodes)
                ahead = math.sqrt((point[0] - goal[0]) ** 2 + (point[1] - goal[1]) ** 2 + (point[2] - goal[2]) ** 2)
                _push(keys, nodes, size, cost[node] + ahead, node)
                size += 1

    there = room_at(rows, edges, fence, blockers, keep_off, goal[0], goal[1], goal[2])
    close = h * (around + 1.0)
    found = -1
    while size > 0 and found < 0:
        node = nodes[0]
        _pop(keys, nodes, size)
        size -= 1
        if state[node] == DONE:
            continue
        state[node] = DONE
        i, j, k = node // (ny * nz), (node // nz) % ny, node % nz
        last[0], last[1], last[2] = low[0] + h * i, low[1] + h * j, low[2] + h * k
        ahead = math.sqrt((last[0] - goal[0]) ** 2 + (last[1] - goal[1]) ** 2 + (last[2] - goal[2]) ** 2)
        if ahead < close and _line_is_free(
            rows, edges, fence, blockers, keep_off, last, goal, least_room(there, margin)
        ):
            found = node
            break
        for di in range(-1, 2):
            for dj in range(-1, 2):
                for dk in range(-1, 2):
                    a, b, c = i + di, j + dj, k + dk
                    if a < 0 or b < 0 or c < 0 or a >= shape[0] or b >= ny or c >= nz:
                        continue
                    other = (a * ny + b) * nz + c
                    if state[other] == TAKEN or state[other] == DONE:
                        continue
                    x, y, z = low[0] + h * a, low[1] + h * b, low[2] + h * c
                    fresh = state[other] == UNKNOWN
                    if fresh and room_at(rows, edges, fence, blockers, keep_off, x, y, z) < margin:
                        state[other] = TAKEN
                        continue
                    total = cost[node] + h * math.sqrt(float(di * di + dj * dj + dk * dk))
                    if fresh or total < cost[other] - 1e-12:
                        state[other] = FREE
                        cost[other] = total
                        parent[other] = node
                        if size + 1 >= keys.shape[0]:
                            keys, nodes = _grow(keys, nodes)
                        ahead = math.sqrt((x - goal[0]) ** 2 + (y - goal[1]) ** 2 + (z - goal[2]) ** 2)
                        _push(keys, nodes, size, total + ahead, other)
                        size += 1

    count = 0
    node = found
    while node >= 0:
        count += 1
        node = parent[node]
    path = np.empty((count + 1 if count else 0, 3))
    node = found
    for r in range(count - 1, -1, -1):
        i, j, k = node // (ny * nz), (node // nz) % ny, node % nz
        path[r, 0], path[r, 1], path[r, 2] = low[0] + h * i, low[1] + h * j, low[2] + h * k
        node = parent[node]
    if count:
        for c in range(3):
            path[count, c] = goal[c]
    return path


@kernel
def _shorten(
    rows: NDArray[np.float64],
    edges: NDArray[np.float64],
    fence: NDArray[np.float64],
    blockers: NDArray[np.float64],
    keep_off: float,
    margin: float,
    start: NDArray[np.float64],
    path: NDArray[np.float64],
) -> int:
    """Leave out corners that need not be flown to, in place; return how many are left."""
    count = path.shape[0]
    here = start.copy()
    kept, k = 0, 0
    while k < count:
        room = room_at(rows, edges, fence, blockers, keep_off, here[0], here[1], here[2])
        best = k
        for far in range(count - 1, k, -1):
            there = room_at(rows, edges, fence, blockers, keep_off, path[far, 0], path[far, 1], path[far, 2])
            least = least_room(min(room, there), 0.5 * margin)
            if _line_is_free(rows, edges, fence, blockers, keep_off, here, path[far], least):
                best = far
                break
        for c in range(3):
            here[c] = path[best, c]
            path[kept, c] = here[c]
        kept += 1
        k = best + 1
    return kept


class Router:
    """Plans ways around a set of obstacles, inside a fence.

    Parameters
    ----------
    obstacles : PackedObstacles
    floor, ceiling : float
        Altitudes between which a way leads, metres; start and goal may lie outside.
    fence : array, shape (e, 4)
        Edges that ways stay inside of, as from `covey.flight.fence.fence_of`.
    """

    def __init__(
        self,
        obstacles: PackedObstacles,
        *,
        floor: float = -math.inf,
        ceiling: float = math.inf,
        fence: NDArray[np.float64] = OPEN,
    ) -> None:
        self.obstacles = obstacles
        self.fence = fence
        self.floor = floor
        self.ceiling = ceiling

    def room(self, point_W: NDArray[np.float64], keep_off: float, blockers: NDArray[np.float64] | None = None) -> float:
        """Room left at a point, metres, negative where it is too close to something; blockers as in `route`."""
        x, y, z = (float(value) for value in point_W)
        return room_at(*self.obstacles, self.fence, _table(blockers), float(keep_off), x, y, z)

    def line_is_free(
        self,
        a_W: NDArray[np.float64],
        b_W: NDArray[np.float64],
        keep_off: float,
        blockers: NDArray[np.float64] | None = None,
    ) -> bool:
        """Whether one can fly straight from a to b; blockers as in `route`."""
        return _line_is_free(
            *self.obstacles,
            self.fence,
            _table(blockers),
            float(keep_off),
            np.array(a_W, float),
            np.array(b_W, float),
            0.0,
        )

    def route(
        self,
        start_W: NDArray[np.float64],
        goal_W: NDArray[np.float64],
        keep_off: float,
        blockers: NDArray[np.float64] | None = None,
        *,
        cells: int = 60_000,
    ) -> NDArray[np.float64] | None:
        """Find a short way.

        Parameters
        ----------
        start_W, goal_W : arrays, shape (3,)
            Frame W, metres.
        keep_off : float
            Distance to keep from obstacles, metres.
        blockers : array, shape (b, 5), optional
            Vehicles to go around: x, y, z, scaled distance to keep, vertical ratio.
        cells : int
            Points of the grids to search; the last and finest has eight times as many.

        Returns
        -------
        array, shape (k, 3), or None
            Corners after the start, the goal last.  None if the goal is too close to something or there is no way. A
            gap may be missed that is narrower than twice keep_off and the finest spacing, keep_off / 4 or what so many
            points allow for.

        Examples
        --------
        >>> import numpy as np
        >>> from covey.flight.obstacles import Box, pack
        >>> router = Router(pack([Box((-1, -1, 0), (1, 1, 9))]), floor=0.5, ceiling=3.0)
        >>> start, goal = np.array([-3.0, 0, 1]), np.array([3.0, 0, 1])
        >>> router.line_is_free(start, goal, 0.4)
        False
        >>> len(router.route(start, goal, 0.4))
        3
        """
        start, goal = np.array(start_W, dtype=np.float64), np.array(goal_W, dtype=np.float64)
        table, keep_off = _table(blockers), float(keep_off)
        scene = *self.obstacles, self.fence
        rows = self.obstacles.rows
        if room_at(*scene, table, keep_off, float(goal[0]), float(goal[1]), float(goal[2])) < 0.0:
            return None
        if _line_is_free(*scene, table, keep_off, start, goal, 0.0):
            return goal[np.newaxis]
        ends = np.vstack([start, goal])
        near = np.vstack([ends - 6.0 * keep_off, ends + 6.0 * keep_off])
        far = [ends]
        wide = MARGIN * keep_off
        pad = keep_off + 3.0 * wide
        if len(rows):
            far += [rows[:, 0:3] - pad, rows[:, 3:6] + pad]
        if len(self.fence):
            corners = np.column_stack([self.fence[:, :2], np.full(len(self.fence), start[2])])
            far += [corners.min(axis=0, keepdims=True), corners.max(axis=0, keepdims=True)]
        if len(table):
            size = table[:, 3:4] * np.array([1.0, 1.0, 1.0]) + 3.0 * wide
            size[:, 2] *= table[:, 4]
            far += [table[:, :3] - size, table[:, :3] + size]
        whole = np.vstack(far)
        spacing = 0.5 * keep_off
        tries = (
            (near, cells, spacing, wide),
            (whole, cells, spacing, wide),
            (whole, 8 * cells, 0.5 * spacing, 0.1 * wide),
        )
        for points, limit, h, margin in tries:
            low, high = points.min(axis=0), points.max(axis=0)
            low[2] = min(max(low[2], self.floor), ends[:, 2].min())
            high[2] = max(min(high[2], self.ceiling), ends[:, 2].max())
            while np.prod((high - low) / h + 3.0) > limit:
                h *= 1.1
            # the goal is a point of the grid
            below = np.floor((goal - low) / h + 1e-9) + np.array([1.0, 1.0, 0.0])
            above = np.floor((high - goal) / h + 1e-9) + np.array([1.0, 1.0, 0.0])
            shape = (below + above + 1.0).astype(np.int64)
            path = _search(*scene, table, keep_off, goal - below * h, shape, h, margin, start, goal)
            if len(path):
                return path[: _shorten(*scene, table, keep_off, margin, start, path)].copy()
        return None


def _table(blockers: NDArray[np.float64] | None) -> NDArray[np.float64]:
    return np.empty((0, 5)) if blockers is None else np.ascontiguousarray(blockers, dtype=np.float64)
