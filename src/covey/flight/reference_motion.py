"""Compiled motion of references: one control period of the virtual vehicles that real ones follow.

A virtual vehicle is a double integrator.  What is put out is its motion through a first-order low-pass, which is again
an average of motions within the same limits, has a continuous acceleration, and a jerk of at most 2 max_acceleration
over the filter's time.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from covey.compiled import kernel
from covey.flight.fence import fence_room, in_view
from covey.flight.obstacles import box_distance, nearest
from covey.flight.potential_field import add_repulsion, repulsion
from covey.flight.separation import cap_velocity, scaled_distance, speed_cap

# columns of an options row
K_WP, K_V, K_REP, THRESHOLD, MAX_SPEED, MAX_ACCELERATION, BRAKE, FILTER, REACTION = range(9)
RESET, SEPARATION, RATIO, ALLOWANCE, KEEP_OFF, FLOOR, CEILING = range(9, 16)
YAW_RATE, YAW_ACCELERATION, ARRIVED, CORNER, LAG, OPTIONS = range(16, 22)

# columns of a virtual vehicle: position, velocity, filtered acceleration, yaw, yaw rate
VIRTUAL = 11

# columns of progress: path left, least path left so far (0 from arrival on), seconds since that fell, seconds until a
# stall is reported, part of the allowance that is kept (none where it has barred every way)
LEFT, BEST, SINCE, PATIENCE, SPARE, PROGRESS = range(6)
ADVANCE = 0.05
"""Metres by which the path left has to shrink to count as progress, or a tenth of it where that is less."""

INACTIVE, FLYING, BLOCKED = range(3)

NEAR = 5.0
"""Vehicles within this many times the distance of arrival do not stall: something may hold them off a little."""

CORNERS = 48
"""Corners of a route at most, its goal included."""

CAPS = 48
"""Speed caps heeded at once; the tightest are kept."""

HORIZON = 3.0
"""Seconds ahead in which a meeting is foreseen."""

GATE = 0.75
"""Others repel fully when they would pass within this part of the separation, and not at all beyond all of it."""

YAW_GAIN = 1.5
"""Yaw rate over yaw error near a goal, 1/s."""

OBSTACLE_REACH = 1.6
"""Obstacles repel within this many times the distance to keep."""


class Team(NamedTuple):
    """All that a team's references are made of, one row a vehicle.

    Parameters
    ----------
    modes : array of int, shape (n,)
        INACTIVE, FLYING or BLOCKED.
    options, virtual, progress : arrays, shapes (n, OPTIONS), (n, VIRTUAL) and (n, PROGRESS)
        Columns as named above.
    goals : array, shape (n, 4)
        Position in frame W, metres, and yaw.
    routes, cursors : arrays, shapes (n, CORNERS, 3) and (n, 2)
        Corners cursors[i, 0] to cursors[i, 1] - 1 of vehicle i are still ahead; the last is its goal.
    """

    modes: NDArray[np.int64]
    options: NDArray[np.float64]
    virtual: NDArray[np.float64]
    goals: NDArray[np.float64]
    routes: NDArray[np.float64]
    cursors: NDArray[np.int64]
    progress: NDArray[np.float64]


class Scene(NamedTuple):
    """What vehicles keep clear of.

    Parameters
    ----------
    rows, edges : arrays
        Obstacles, as from `covey.flight.obstacles.pack`.
    drift : array, shape (m, 3)
        Velocities of the obstacles, frame W, m/s.
    fence, spans : arrays
        Fences, as from `covey.flight.fence.Fences`.
    """

    rows: NDArray[np.float64]
    edges: NDArray[np.float64]
    drift: NDArray[np.float64]
    fence: NDArray[np.float64]
    spans: NDArray[np.int64]


class Room(NamedTuple):
    """Arrays to work in: for the cells of n vehicles, the speed caps of one, and vectors."""

    frame: NDArray[np.float64]
    starts: NDArray[np.int64]
    order: NDArray[np.int64]
    near: NDArray[np.int64]
    ways: NDArray[np.float64]
    caps: NDArray[np.float64]
    work: NDArray[np.float64]


def make_room(n: int) -> Room:
    """Make room for a team of n."""
    integers = np.empty(4 * n + 2, dtype=np.int64), np.empty(n, dtype=np.int64), np.empty(n, dtype=np.int64)
    return Room(np.empty(3), *integers, np.empty((CAPS, 3)), np.empty(CAPS), np.empty((4, 3)))


@kernel
def wanted_speed(left: float, k_wp: float, k_v: float, brake: float, max_speed: float) -> float:
    """Speed towards a goal with so much path left: linear at first, then what braking allows, then the limit."""
    slope = k_wp / k_v
    linear = brake / (slope * slope)
    speed = slope * left if left < linear else math.sqrt(brake * (2.0 * left - linear))
    return min(speed, max_speed)


@kernel
def _approach(dx: float, dy: float, dz: float, wx: float, wy: float, wz: float, ratio: float, horizon: float) -> float:
    """Least scaled distance within the horizon of an offset d that changes at w, metres."""
    rz = 1.0 / (ratio * ratio)
    speed2 = wx * wx + wy * wy + wz * wz * rz
    t = 0.0
    if speed2 > 1e-12:
        t = min(max(-(dx * wx + dy * wy + dz * wz * rz) / speed2, 0.0), horizon)
    return scaled_distance(dx + wx * t, dy + wy * t, dz + wz * t, ratio)


@kernel
def _add_cap(
    ways: NDArray[np.float64], caps: NDArray[np.float64], count: int, mx: float, my: float, mz: float, cap: float
) -> int:
    """Append a cap, or let it take the place of the loosest; return how many there are."""
    k = count
    if count == CAPS:
        k = 0
        for other in range(1, count):
            if caps[other] > caps[k]:
                k = other
        if caps[k] <= cap:
            return count
    ways[k, 0], ways[k, 1], ways[k, 2] = mx, my, mz
    caps[k] = cap
    return min(count + 1, CAPS)


@kernel
def advance(
    first: int,
    last: int,
    columns: int,
    lines: int,
    positions: NDArray[np.float64],
    velocities: NDArray[np.float64],
    team: Team,
    scene: Scene,
    room: Room,
    dt: float,
    out: NDArray[np.float64],
) -> int:
    """Move the references of vehicles first to last - 1 by one control period; return how many of them have stalled.

    Parameters
    ----------
    columns, lines : int
        Cells that `sort_into_cells` has sorted the positions into, in frame, starts and order of `room`.
    positions, velocities : arrays, shape (n, 3)
        As measured, frame W, m and m/s.  Of others a vehicle sees nothing else, so their order does not matter.
    team : Team
        What it holds of these vehicles is updated.
    scene : Scene
    room : Room
    dt : float
        Control period, s.
    out : array, shape (n, REFERENCE)
        Their rows are overwritten with references.

    Notes
    -----
    Source: Sposato (2016), eq. (3.1), (3.2).  Deviation: P2, P3, P4, P5.

    One function on purpose: the loop in one of its own would double the time to compile.
    """
    modes, options, progress = team.modes, team.options, team.progress
    routes, cursors, goals = team.routes, team.cursors, team.goals
    rows, edges, drift = scene.rows, scene.edges, scene.drift
    fence, spans = scene.fence, scene.spans
    ways, caps, work, near = room.ways, room.caps, room.work, room.near
    virtual = team.virtual
    stalled = 0
    for i in range(first, last):
        column = int((positions[i, 0] - room.frame[0]) / room.frame[2])
        line = int((positions[i, 1] - room.frame[1]) / room.frame[2])
        count = 0
        for other in range(max(column - 1, 0), min(column + 2, columns)):
            begin = room.starts[other * lines + max(line - 1, 0)]
            end = room.starts[other * lines + min(line + 1, lines - 1) + 1]
            for b in range(begin, end):
                near[count] = room.order[b]
                count += 1

        o = options[i]
        s = virtual[i]
        measured = positions[i]
        if modes[i] == INACTIVE:
            for c in range(3):
                s[c] = measured[c]
                s[3 + c] = 0.0
                s[6 + c] = 0.0
                out[i, c] = measured[c]
                out[i, 3 + c] = 0.0
                out[i, 6 + c] = 0.0
                out[i, 9 + c] = 0.0
            s[10] = 0.0
            out[i, 12] = s[9]
            out[i, 13] = 0.0
            continue

        p, u, v, old = work[0], work[1], work[2], work[3]
        # The reference is kept on a leash: a vehicle that cannot follow is not run away from.
        lag = o[FILTER]
        error2 = 0.0
        for c in range(3):
            p[c] = s[c] - lag * (s[3 + c] - lag * s[6 + c])
            error2 += (p[c] - measured[c]) ** 2
        if error2 > o[RESET] * o[RESET]:
            pull = 1.0 - o[RESET] / math.sqrt(error2)
            for c in range(3):
                s[c] += pull * (measured[c] - p[c])
        for c in range(3):
            p[c] = s[c]
            old[c] = s[3 + c]

        # attraction towards the next corner
        cursor, end, hidden = cursors[i, 0], cursors[i, 1], False
        ax, ay, az, leg = 0.0, 0.0, 0.0, 0.0
        while True:
            ax, ay, az = routes[i, cursor, 0] - p[0], routes[i, cursor, 1] - p[1], routes[i, cursor, 2] - p[2]
            leg = math.sqrt(ax * ax + ay * ay + az * az)
            if cursor + 1 >= end or leg > o[CORNER]:
                break
            # a corner that the fence hides the next one behind is flown to
            if leg > o[ARRIVED] and not in_view(
                fence[spans[i, 0] : spans[i, 1]], p[0], p[1], routes[i, cursor + 1, 0], routes[i, cursor + 1, 1]
            ):
                hidden = True
                break
            cursor += 1
        cursors[i, 0] = cursor
        left = leg
        for k in range(cursor, end - 1):
            left += math.sqrt(
                (routes[i, k + 1, 0] - routes[i, k, 0]) ** 2
                + (routes[i, k + 1, 1] - routes[i, k, 1]) ** 2
                + (routes[i, k + 1, 2] - routes[i, k, 2]) ** 2
            )
        speed = wanted_speed(leg if hidden else left, o[K_WP], o[K_V], 0.7 * o[BRAKE], o[MAX_SPEED])
        scale = speed / max(leg, 1e-9)
        u[0] = o[K_V] * (scale * ax - old[0])
        u[1] = o[K_V] * (scale * ay - old[1])
        u[2] = o[K_V] * (scale * az - old[2])
        horizon = min(HORIZON, left / max(speed, 1e-9)) if speed > 1e-3 else HORIZON

        # other vehicles: repulsion from those in the way, a cap on the speed towards all that are near
        caps_count = 0
        easing = min(1.0, left / o[SEPARATION])
        allowance = o[ALLOWANCE] * easing * progress[i, 4]
        for b in range(count):
            j = near[b]
            if j == i:
                continue
            parked = modes[j] == INACTIVE
            ratio = 1.0 if parked else max(o[RATIO], options[j, RATIO])
            keep = 0.5 * (o[SEPARATION] + options[j, SEPARATION])
            threshold = o[THRESHOLD] + keep - o[SEPARATION]
            # Twice: between virtual vehicles, the other's guessed from its measured motion, and between real ones.
            ahead = 0.0 if parked else options[j, LAG]
            order = 1.0 if i < j else -1.0
            for real in range(2):
                if real:
                    dx, dy, dz = (
                        positions[j, 0] - measured[0],
                        positions[j, 1] - measured[1],
                        positions[j, 2] - measured[2],
                    )
                else:
                    dx = positions[j, 0] + ahead * velocities[j, 0] - p[0]
                    dy = positions[j, 1] + ahead * velocities[j, 1] - p[1]
                    dz = positions[j, 2] + ahead * velocities[j, 2] - p[2]
                d = scaled_distance(dx, dy, dz, ratio)
                if d >= threshold:
                    continue
                if real == 0:
                    wx, wy, wz = (
                        velocities[j, 0] - scale * ax,
                        velocities[j, 1] - scale * ay,
                        velocities[j, 2] - scale * az,
                    )
                    miss = _approach(dx, dy, dz, wx, wy, wz, ratio, horizon)
                    gate = min(max((keep - miss) / ((1.0 - GATE) * keep), 0.0), 1.0)
                    if gate > 0.0:
                        weight = gate * gate * (3.0 - 2.0 * gate)
                        add_repulsion(dx, dy, dz, order, ratio, o[K_REP], threshold, weight, u)
                if d < 1e-6:
                    d, dx, dy, dz = 1e-6, -1e-6 * order, 0.0, 0.0
                mx, my, mz = dx / d, dy / d, dz / (d * ratio * ratio)
                brake = o[BRAKE] * math.sqrt(mx * mx + my * my + mz * mz)
                cap = speed_cap(d - keep - allowance, brake, o[REACTION], 1.0 if parked else 2.0)
                if cap < o[MAX_SPEED]:
                    caps_count = _add_cap(ways, caps, caps_count, mx, my, mz, max(cap, -0.5 * o[MAX_SPEED]))

        # obstacles
        keep = o[KEEP_OFF]
        reach = keep + o[RESET] + o[MAX_SPEED] * (o[REACTION] + o[MAX_SPEED] / o[BRAKE])
        for k in range(rows.shape[0]):
            if box_distance(rows, k, p[0], p[1], p[2]) > reach:
                continue
            d, nx, ny, nz = nearest(rows, edges, k, p[0], p[1], p[2])
            e, ex, ey, ez = nearest(rows, edges, k, measured[0], measured[1], measured[2])
            if e < d:
                d, nx, ny, nz = e, ex, ey, ez
            inward = -(drift[k, 0] * nx + drift[k, 1] * ny + drift[k, 2] * nz)
            cap = speed_cap(d - keep, o[BRAKE], o[REACTION], 1.0) + inward
            if cap < o[MAX_SPEED]:
                caps_count = _add_cap(ways, caps, caps_count, -nx, -ny, -nz, max(cap, -o[MAX_SPEED]))
            g = repulsion(d, o[K_REP], OBSTACLE_REACH * keep) * easing
            u[0] += g * nx
            u[1] += g * ny
            u[2] += g * nz

        # The fence: a cap on the speed towards each of its edges, so that corners hold too; outside it, the way back.
        # Seen from the virtual vehicle, and from what it leads, which would cut corners otherwise.
        for probe in range(2 if spans[i, 1] > spans[i, 0] else 0):
            back = probe * lag
            x, y = p[0] - back * (old[0] - lag * s[6]), p[1] - back * (old[1] - lag * s[7])
            left_room = fence_room(fence[spans[i, 0] : spans[i, 1]], x, y)
            closest, nx, ny = math.inf, 0.0, 0.0
            for k in range(spans[i, 0], spans[i, 1]):
                ex, ey = fence[k, 2] - fence[k, 0], fence[k, 3] - fence[k, 1]
                t = min(max(((x - fence[k, 0]) * ex + (y - fence[k, 1]) * ey) / (ex * ex + ey * ey), 0.0), 1.0)
                dx, dy = x - fence[k, 0] - t * ex, y - fence[k, 1] - t * ey
                d = math.sqrt(dx * dx + dy * dy)
                if d > reach:
                    continue
                if d < 1e-6:  # on the edge itself: rings have the region on their left
                    length = math.sqrt(ex * ex + ey * ey)
                    dx, dy, d = -1e-6 * ey / length, 1e-6 * ex / length, 1e-6
                elif left_room < 0.0:
                    dx, dy = -dx, -dy
                if d < closest:
                    closest, nx, ny = d, dx / d, dy / d
                if left_room >= 0.0:
                    cap = speed_cap(d, o[BRAKE], o[REACTION], 1.0)
                    if cap < o[MAX_SPEED]:
                        caps_count = _add_cap(ways, caps, caps_count, -dx / d, -dy / d, 0.0, cap)
            if closest < math.inf:
                if left_room < 0.0:
                    cap = max(speed_cap(left_room, o[BRAKE], o[REACTION], 1.0), -o[MAX_SPEED])
                    caps_count = _add_cap(ways, caps, caps_count, -nx, -ny, 0.0, cap)
                if probe == 0:
                    g = repulsion(keep + max(left_room, 0.0), o[K_REP], OBSTACLE_REACH * keep) * easing
                    u[0] += g * nx
                    u[1] += g * ny

        # the air space; a goal outside it, as in landing, opens it
        low = min(o[FLOOR], routes[i, end - 1, 2], p[2])
        high = max(o[CEILING], routes[i, end - 1, 2], p[2])
        if p[2] - low < reach:
            caps_count = _add_cap(
                ways, caps, caps_count, 0.0, 0.0, -1.0, speed_cap(p[2] - low, o[BRAKE], o[REACTION], 1.0)
            )
        if high - p[2] < reach:
            caps_count = _add_cap(
                ways, caps, caps_count, 0.0, 0.0, 1.0, speed_cap(high - p[2], o[BRAKE], o[REACTION], 1.0)
            )

        change = math.sqrt(u[0] * u[0] + u[1] * u[1] + u[2] * u[2])
        gain = dt * min(1.0, o[MAX_ACCELERATION] / max(change, 1e-9))
        for c in range(3):
            v[c] = old[c] + gain * u[c]
        cap_velocity(v, old, ways, caps, caps_count, o[MAX_SPEED], o[MAX_ACCELERATION] * dt)

        # virtual vehicle and low-pass: p = virtual p − lag v, v = virtual v − lag a, exactly
        fade = math.exp(-dt / lag)
        for c in range(3):
            force = (v[c] - old[c]) / dt
            s[c] += 0.5 * dt * (old[c] + v[c])
            s[3 + c] = v[c]
            s[6 + c] = force + (s[6 + c] - force) * fade
            out[i, 6 + c] = s[6 + c]
            out[i, 9 + c] = (force - s[6 + c]) / lag
            out[i, 3 + c] = v[c] - lag * s[6 + c]
            out[i, c] = s[c] - lag * out[i, 3 + c]

        # yaw: the shorter way, with a limited rate
        turn = goals[i, 3] - s[9]
        turn -= 2.0 * math.pi * math.ceil((turn - math.pi) / (2.0 * math.pi))
        rate = math.copysign(wanted_speed(abs(turn), YAW_GAIN, 1.0, 0.7 * o[YAW_ACCELERATION], o[YAW_RATE]), turn)
        step = o[YAW_ACCELERATION] * dt
        rate = min(max(rate, s[10] - step), s[10] + step)
        s[9] += 0.5 * dt * (s[10] + rate)
        s[10] = rate
        s[9] -= 2.0 * math.pi * math.ceil((s[9] - math.pi) / (2.0 * math.pi))
        out[i, 12] = s[9]
        out[i, 13] = s[10]

        # How far it has come; a vehicle that is all but there has not stalled.
        progress[i, 0] = left
        if left < o[ARRIVED]:
            off2 = (out[i, 0] - goals[i, 0]) ** 2 + (out[i, 1] - goals[i, 1]) ** 2 + (out[i, 2] - goals[i, 2]) ** 2
            progress[i, 1] = 0.0 if off2 < o[ARRIVED] * o[ARRIVED] else min(left, progress[i, 1])
            progress[i, 2] = 0.0
        elif left < progress[i, 1] - min(ADVANCE, 0.1 * progress[i, 1]):
            progress[i, 1] = left
            progress[i, 2] = 0.0
        elif left < NEAR * o[ARRIVED]:
            progress[i, 2] = 0.0
        else:
            progress[i, 2] += dt
        if modes[i] == FLYING and progress[i, 2] > progress[i, 3]:
            stalled += 1
    return stalled
