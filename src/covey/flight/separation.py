"""How close vehicles may come: scaled distance, speed caps, energy bound, the check at load time."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from covey.compiled import kernel
from covey.errors import ArgumentError

ROUNDS = 100
"""Projections onto caps at most; nearly always fewer than five are enough."""

EXCESS = 1e-3
"""Excess of a cap, m/s, at which projection counts as converged."""


def closest_approach(k_rep: float, threshold: float, speed: float) -> float:
    """Scaled distance at which the field alone, without damping, stops two vehicles that close head-on, metres.

    Parameters
    ----------
    k_rep, threshold : float
        As in `FieldGains`.
    speed : float
        Closing speed at the threshold, m/s.

    Notes
    -----
    Source: Sposato (2016), eq. (3.2).  Deviation: P4.

    Each of the two is accelerated by ½ k_rep (1/d − 1/ς), so that ½ v² = k_rep (ln(ς/d) − 1 + d/ς) where they stop.

    Examples
    --------
    >>> round(closest_approach(1.0, 1.0, 2.0), 3)
    0.052
    """
    if not (k_rep > 0.0 and threshold > 0.0 and speed >= 0.0):
        raise ArgumentError(
            f"k_rep, threshold, speed: expected k_rep and threshold above zero and speed from zero, "
            f"got {k_rep}, {threshold}, {speed}"
        )
    wanted = 0.5 * speed * speed / k_rep
    low, high = -(wanted + 1.0), 0.0  # ln(d/ς): at low, −ln(d/ς) − 1 + d/ς exceeds what is wanted
    for _ in range(100):
        middle = 0.5 * (low + high)
        if -middle - 1.0 + math.exp(middle) > wanted:
            low = middle
        else:
            high = middle
    return threshold * math.exp(low)


def safe_speed(k_rep: float, threshold: float, distance: float) -> float:
    """Closing speed that the field stops at a distance: the inverse of `closest_approach`, m/s.

    Examples
    --------
    >>> round(safe_speed(1.0, 1.0, closest_approach(1.0, 1.0, 2.0)), 6)
    2.0
    """
    if distance >= threshold:
        return 0.0
    return math.sqrt(2.0 * k_rep * (math.log(threshold / distance) - 1.0 + distance / threshold))


def check_separation(
    *,
    required: float,
    k_rep: float,
    threshold: float,
    max_speed: float,
    max_acceleration: float,
    brake_acceleration: float,
) -> None:
    """Check that gains, speed limit and body size keep vehicles apart.

    Parameters
    ----------
    required : float
        Required scaled separation of two vehicles, metres: body diameter plus margin.
    k_rep, threshold : float
        As in `FieldGains`.
    max_speed, max_acceleration : float
        Limits of one vehicle, m/s and m/s².
    brake_acceleration : float
        What the speed caps count on, m/s².

    Raises
    ------
    ArgumentError
        If two vehicles closing head-on at their speed limits come closer than required by the field alone, or if a
        vehicle cannot brake as its speed caps take for granted; the text says what to change.

    Notes
    -----
    Deviation: P4.
    """
    if not required > 0.0:
        raise ArgumentError(f"required: expected metres above zero, got {required}")
    if threshold <= required:
        raise ArgumentError(
            f"threshold: expected more than the required separation of {required:g} m, got {threshold:g}; "
            "raise it, or choose smaller vehicles or a smaller margin"
        )
    closest = closest_approach(k_rep, threshold, 2.0 * max_speed)
    if closest < required:
        slower = 0.5 * safe_speed(k_rep, threshold, required)
        stronger = k_rep * (max_speed / slower) ** 2
        raise ArgumentError(
            f"k_rep, threshold, max_speed: two vehicles at {max_speed:g} m/s would come within {closest:.3g} m, "
            f"expected at least {required:g} m; set max_speed <= {math.floor(slower * 1e3) / 1e3:g} m/s, "
            f"or k_rep >= {math.ceil(stronger * 1e3) / 1e3:g}, or raise the threshold"
        )
    turning = turning_acceleration(required, max_speed)
    if max_acceleration < brake_acceleration + turning:
        raise ArgumentError(
            f"brake_acceleration: expected at most max_acceleration − max_speed² / (4 required separation) = "
            f"{max_acceleration - turning:.3g} m/s², got {brake_acceleration:g}; lower it, lower max_speed, "
            "or raise max_acceleration"
        )


def turning_acceleration(required: float, max_speed: float) -> float:
    """Acceleration that being overtaken at the required separation may cost beside braking, m/s².

    The direction to the other turns at (v_other − v) / d, which costs v (v_other − v) / d, at most v_other² / (4 d).
    """
    return 0.25 * max_speed * max_speed / required


@kernel
def scaled_distance(dx: float, dy: float, dz: float, ratio: float) -> float:
    """Norm of an offset whose vertical part is divided by `ratio`, metres."""
    dzs = dz / ratio
    return math.sqrt(dx * dx + dy * dy + dzs * dzs)


@kernel
def speed_cap(gap: float, brake: float, reaction: float, sides: float) -> float:
    """Highest speed towards something at a gap, m/s; negative (backing off) where the gap is.

    Parameters
    ----------
    gap : float
        Distance beyond the one to keep, metres.
    brake : float
        Deceleration counted on, m/s².
    reaction : float
        Seconds for which one goes on before braking.
    sides : float
        2 where the other closes the gap just as fast, 1 where it stands still.

    Notes
    -----
    The c with sides (c reaction + c² / (2 brake)) = gap.  Without reaction time sqrt(brake gap) for two sides and
    sqrt(2 brake gap) for one.  With it the cap is Lipschitz in the gap, which ends in an exponential approach.
    """
    share = gap / sides
    if share <= 0.0:
        return share / reaction if reaction > 0.0 else 0.0
    return 2.0 * share / (reaction + math.sqrt(reaction * reaction + 2.0 * share / brake))


@kernel
def excess_speed(
    vx: float, vy: float, vz: float, ways: NDArray[np.float64], caps: NDArray[np.float64], count: int
) -> float:
    """By how much a velocity exceeds the worst of its caps, m/s, at least 0."""
    worst = 0.0
    for k in range(count):
        worst = max(worst, vx * ways[k, 0] + vy * ways[k, 1] + vz * ways[k, 2] - caps[k])
    return worst


@kernel
def cap_velocity(
    v: NDArray[np.float64],
    old: NDArray[np.float64],
    ways: NDArray[np.float64],
    caps: NDArray[np.float64],
    count: int,
    max_speed: float,
    max_change: float,
) -> None:
    """Project a velocity onto its caps, the speed limit, and what can be reached from the last velocity.

    Parameters
    ----------
    v : array, shape (3,)
        Wanted velocity, m/s; is overwritten.
    old : array, shape (3,)
        Last velocity, within the speed limit.
    ways, caps : arrays, shapes (>= count, 3) and (>= count,)
        v · ways[k] is to stay at or below caps[k].
    max_speed, max_change : float
        Norms of v and of v − old, m/s; these always hold.

    Notes
    -----
    Again and again onto the cap that is exceeded most, so that their order does not matter.  Should caps and limits
    have no point in common, braking is the last resort: the vehicle slows down along its path, unless what the
    projections found exceeds the caps less.
    """
    for _ in range(ROUNDS):
        worst = 0.0
        k = -1
        for other in range(count):
            over = v[0] * ways[other, 0] + v[1] * ways[other, 1] + v[2] * ways[other, 2] - caps[other]
            if over > worst:
                worst = over
                k = other
        if worst > 0.0:
            worst /= ways[k, 0] * ways[k, 0] + ways[k, 1] * ways[k, 1] + ways[k, 2] * ways[k, 2]
            for c in range(3):
                v[c] -= worst * ways[k, c]
        speed = math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
        if speed > max_speed:
            for c in range(3):
                v[c] *= max_speed / speed
        dx, dy, dz = v[0] - old[0], v[1] - old[1], v[2] - old[2]
        change = math.sqrt(dx * dx + dy * dy + dz * dz)
        if change > max_change:
            for c in range(3):
                v[c] = old[c] + (v[c] - old[c]) * (max_change / change)
        if worst <= EXCESS:
            break
    worst = excess_speed(v[0], v[1], v[2], ways, caps, count)
    if worst > EXCESS:
        speed = math.sqrt(old[0] * old[0] + old[1] * old[1] + old[2] * old[2])
        keep = max(0.0, 1.0 - max_change / max(speed, 1e-9))
        if excess_speed(old[0] * keep, old[1] * keep, old[2] * keep, ways, caps, count) < worst:
            for c in range(3):
                v[c] = old[c] * keep


@kernel
def sort_into_cells(
    positions: NDArray[np.float64],
    size: float,
    frame: NDArray[np.float64],
    starts: NDArray[np.int64],
    order: NDArray[np.int64],
) -> tuple[int, int]:
    """Sort positions into square columns over the plane.

    Parameters
    ----------
    positions : array, shape (n, 3)
        Metres, finite.
    size : float
        Least side of a cell, metres; larger where `starts` has no room for so many.
    frame : array, shape (3,)
        Is overwritten with the corner x, y and the side used.
    starts : array, shape (at least 2)
        Is overwritten: cell c = column * rows + row holds order[starts[c]:starts[c + 1]].
    order : array, shape (n,)
        Is overwritten with the indices of positions, cell by cell.

    Returns
    -------
    columns, rows : int
    """
    n = positions.shape[0]
    x0, x1, y0, y1 = math.inf, -math.inf, math.inf, -math.inf
    for i in range(n):
        x0 = min(x0, positions[i, 0])
        x1 = max(x1, positions[i, 0])
        y0 = min(y0, positions[i, 1])
        y1 = max(y1, positions[i, 1])
    room = starts.shape[0] - 1
    while ((x1 - x0) / size + 1.0) * ((y1 - y0) / size + 1.0) > room:
        size *= 1.5
    columns = int((x1 - x0) / size) + 1
    rows = int((y1 - y0) / size) + 1
    frame[0], frame[1], frame[2] = x0, y0, size
    for c in range(columns * rows + 1):
        starts[c] = 0
    for i in range(n):
        starts[int((positions[i, 0] - x0) / size) * rows + int((positions[i, 1] - y0) / size)] += 1
    total = 0
    for c in range(columns * rows + 1):
        total += starts[c]
        starts[c] = total
    for i in range(n - 1, -1, -1):
        c = int((positions[i, 0] - x0) / size) * rows + int((positions[i, 1] - y0) / size)
        starts[c] -= 1
        order[starts[c]] = i
    return columns, rows


@kernel
def _least_distance(
    positions: NDArray[np.float64],
    ratio: float,
    size: float,
    frame: NDArray[np.float64],
    starts: NDArray[np.int64],
    order: NDArray[np.int64],
) -> float:
    """Least scaled distance of a pair in the same or in neighbouring cells; exact if at most the side of a cell."""
    columns, rows = sort_into_cells(positions, size, frame, starts, order)
    best = math.inf
    for column in range(columns):
        for row in range(rows):
            for a in range(starts[column * rows + row], starts[column * rows + row + 1]):
                i = order[a]
                for other in range(max(column - 1, 0), min(column + 2, columns)):
                    begin = starts[other * rows + max(row - 1, 0)]
                    end = starts[other * rows + min(row + 1, rows - 1) + 1]
                    for b in range(begin, end):
                        j = order[b]
                        if j > i:
                            dx = positions[j, 0] - positions[i, 0]
                            dy = positions[j, 1] - positions[i, 1]
                            dz = (positions[j, 2] - positions[i, 2]) / ratio
                            best = min(best, dx * dx + dy * dy + dz * dz)
    return math.sqrt(best)


def min_separation(positions_W: NDArray[np.float64], vertical_ratio: float = 1.0) -> float:
    """Least scaled distance between any two vehicles, metres; infinite for fewer than two.

    Parameters
    ----------
    positions_W : array, shape (n, 3)
        Frame W, metres.
    vertical_ratio : float
        Vertical offsets are divided by it.

    Examples
    --------
    >>> import numpy as np
    >>> min_separation(np.array([[0.0, 0, 0], [3, 0, 0], [3, 0, 4]]), vertical_ratio=2.0)
    2.0
    """
    positions = np.ascontiguousarray(positions_W, dtype=np.float64)
    if positions.ndim != 2 or positions.shape[1] != 3 or not np.isfinite(positions).all():
        raise ArgumentError(f"positions_W: expected finite numbers of shape (n, 3), got shape {positions.shape}")
    n = len(positions)
    if n < 2:
        return math.inf
    width, depth = np.ptp(positions[:, 0]), np.ptp(positions[:, 1])
    size = max(math.sqrt(width * depth / n), width / n, depth / n, 1e-6)
    frame, starts, order = np.empty(3), np.empty(4 * n + 2, dtype=np.int64), np.empty(n, dtype=np.int64)
    while True:
        best = _least_distance(positions, float(vertical_ratio), float(size), frame, starts, order)
        if best <= frame[2] or frame[2] > max(width, depth):
            return best
        size = 2.0 * frame[2] if math.isinf(best) else best
