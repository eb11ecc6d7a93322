"""Compiled visibility of the built-in models: values, gradients, and bounds over boxes of positions.

All lengths here are in units of the optimal distance (deviation I3), so q = (s - p) / optimal_distance.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from covey.compiled import fast_kernel
from covey.sensing.base import Kernel

ANISOTROPIC = int(Kernel.ANISOTROPIC)
ISOTROPIC = int(Kernel.ISOTROPIC)
ORIENTED = int(Kernel.ORIENTED)


@fast_kernel
def visibility_gradients(
    kind: int,
    landmarks: NDArray[np.float64],
    inverse: float,
    px: float,
    py: float,
    c: float,
    s: float,
    out: NDArray[np.float64],
) -> None:
    """Visibility of every landmark from one pose, and its derivatives.

    Parameters
    ----------
    landmarks : array, shape (6, n)
        Rows x, y (metres), normal x, y, weight, threshold.
    inverse : float
        One over the optimal distance, per metre.
    px, py, c, s : float
        Position in metres; cosine and sine of the heading.
    out : array, shape (4, n)
        Is overwritten with visibility and derivatives by q_x, q_y (optimal distances) and heading (radians).  Where the
        visibility is zero the first row may be negative and the others are of no meaning.
    """
    for k in range(landmarks.shape[1]):
        qx = (landmarks[0, k] - px) * inverse
        qy = (landmarks[1, k] - py) * inverse
        r2 = qx * qx + qy * qy
        far = r2 > 1.0
        i = 1.0 / max(r2, 1.0)
        if kind == ISOTROPIC:
            r = math.sqrt(max(r2, 1e-300))
            g = -i / r if far else 1.0 / r
            out[0, k] = r * i
            out[1, k] = g * qx
            out[2, k] = g * qy
            out[3, k] = 0.0
        else:
            value = (qx * c + qy * s) * i
            g = 2.0 * value * i if far else 0.0
            gx = c * i - g * qx
            gy = s * i - g * qy
            turn = (qy * c - qx * s) * i
            if kind == ORIENTED:
                facing = max(0.0, -(landmarks[2, k] * c + landmarks[3, k] * s))
                turn = turn * facing + value * (landmarks[2, k] * s - landmarks[3, k] * c)
                value *= facing
                gx *= facing
                gy *= facing
            out[0, k] = value
            out[1, k] = gx
            out[2, k] = gy
            out[3, k] = turn


@fast_kernel
def gain_gradient(
    kind: int, landmarks: NDArray[np.float64], inverse: float, px: float, py: float, c: float, s: float
) -> tuple[float, float, float, float]:
    """Sum of ``w_k max(0, vis - lambda_k)`` over all landmarks from one pose, and its gradient.

    The formulas are those of `visibility_gradients`, whose arguments these are; summing on the way saves the trip
    through memory, and so does summing along and across the heading.  The gradient is by the position in optimal
    distances (two numbers), and by the heading.
    """
    total = ahead = across = gt = 0.0
    for k in range(landmarks.shape[1]):
        qx = (landmarks[0, k] - px) * inverse
        qy = (landmarks[1, k] - py) * inverse
        u = qx * c + qy * s
        v = qy * c - qx * s
        r2 = u * u + v * v
        i = 1.0 / max(r2, 1.0)
        w = landmarks[4, k]
        if kind == ISOTROPIC:
            r = math.sqrt(max(r2, 1e-300))
            gain = r * i - landmarks[5, k]
            w = w if gain > 0.0 else 0.0
            g = -i / r if r2 > 1.0 else 1.0 / r
            total += w * gain
            ahead -= w * g * u
            across -= w * g * v
        else:
            value = u * i
            turn = v * i
            g = 2.0 * value if r2 > 1.0 else 0.0
            if kind == ORIENTED:
                facing = max(0.0, -(landmarks[2, k] * c + landmarks[3, k] * s))
                gain = value * facing - landmarks[5, k]
                w = w if gain > 0.0 else 0.0
                total += w * gain
                gt += w * (turn * facing + value * (landmarks[2, k] * s - landmarks[3, k] * c))
                w *= facing
            else:
                gain = value - landmarks[5, k]
                w = w if gain > 0.0 else 0.0
                total += w * gain
                gt += w * turn
            ahead += w * (g * value - i)
            across += w * (g * turn)
    return total, ahead * c - across * s, ahead * s + across * c, gt


@fast_kernel
def best_turn(
    landmarks: NDArray[np.float32], inverse: np.float32, px: np.float32, py: np.float32, c: np.float32, s: np.float32
) -> tuple[np.float32, np.float32, np.float32]:
    """Turn the anisotropic sensor, where it stands, to what it sees: (V along d, V across d, sum of gains there).

    Over the landmarks that count, those with vis > lambda, the sum of gains is V . d - L with one vector V and one
    number L.  It is largest where d points along V, and landmarks that count there on top only add to it: the sum
    returned is what there is at least.  The arguments are those of `gain_gradient`, in single precision, which will do
    to choose among poses.
    """
    zero, one = np.float32(0.0), np.float32(1.0)
    total = ahead = across = zero
    for k in range(landmarks.shape[1]):
        qx = (landmarks[0, k] - px) * inverse
        qy = (landmarks[1, k] - py) * inverse
        i = one / max(qx * qx + qy * qy, one)
        value = (qx * c + qy * s) * i
        gain = value - landmarks[5, k]
        w = landmarks[4, k] if gain > zero else zero
        total += w * gain
        ahead += w * value
        across += w * ((qy * c - qx * s) * i)
    return ahead, across, total + np.sqrt(ahead * ahead + across * across) - ahead


@fast_kernel
def linear_bounds(
    kind: int,
    columns: NDArray[np.float64],
    px: float,
    py: float,
    hx: float,
    hy: float,
    vertices: NDArray[np.float64],
    out: NDArray[np.float64],
) -> None:
    """Bound every landmark's part of a pose problem over a box of positions and headings by linear functions.

    For a position at offset (ox hx, oy hy), -1 <= ox, oy <= 1, from the box's centre and a heading in the box,

        w_k max(0, vis - lambda_k) <= max(0, (a, b) . D + c)      with (a, b, c) linear in (ox, oy)

    where D is (cos psi, sin psi), or (cos 2 psi, sin 2 psi) for the oriented model.  The right side is convex in D for
    a fixed offset and convex in the offset for a fixed D.

    Parameters
    ----------
    columns : array, shape (6, n)
        Landmarks: x, y, normal x, y, weight, threshold; lengths in optimal distances.
    px, py, hx, hy : float
        Centre and half sizes of the box, optimal distances.
    vertices : array, shape (3, 2)
        Corners of a triangle that holds all (cos psi, sin psi) of the box; only the oriented model looks at them.
    out : array, shape (9, n)
        Is overwritten with a, b, c at the centre and their changes per ox and per oy.
    """
    # a loop for each model: in one loop with branches no sum runs in vector registers
    if kind == ANISOTROPIC:
        _anisotropic_bounds(columns, px, py, hx, hy, out)
    elif kind == ISOTROPIC:
        _isotropic_bounds(columns, px, py, hx, hy, out)
    else:
        _oriented_bounds(columns, px, py, hx, hy, vertices, out)


@fast_kernel
def _ahead(qx: float, qy: float, hx: float, hy: float) -> tuple[float, float, float, float, float, float]:
    """Bound v . d over a box, where it is positive, by (u + ox x + oy y) . d + rest: (u_x, u_y, k, k_xx, k_yy, rest).

    The changes are x = hx (k_xx, k) and y = hy (k, k_yy).
    """
    h2 = hx * hx + hy * hy
    dx = max(0.0, abs(qx) - hx)
    dy = max(0.0, abs(qy) - hy)
    inverse = 1.0 / math.sqrt(max(dx * dx + dy * dy, 1e-300))
    r2 = qx * qx + qy * qy
    far = r2 > 1.0
    i = 1.0 / max(r2, 1.0)
    # no visibility in the box exceeds this
    top = min(1.0, inverse)
    # far: as complex numbers v = 1 / conj(q), and 1 / (w + z) = 1 / w - z / w^2 + z^2 / (w^2 (w + z)) exactly;
    # near: v . d <= q . d wherever q . d >= 0, which is linear as it stands
    remainder = h2 * inverse * i if far else 0.0
    useful = remainder < top if far else h2 < 1.0
    k2 = 2.0 * i * i if far and useful else 0.0
    i = i if useful else 0.0
    rest = remainder if useful else top
    return qx * i, qy * i, k2 * qx * qy, k2 * qx * qx - i, k2 * qy * qy - i, rest


@fast_kernel
def _anisotropic_bounds(
    columns: NDArray[np.float64], px: float, py: float, hx: float, hy: float, out: NDArray[np.float64]
) -> None:
    for k in range(columns.shape[1]):
        ux, uy, xy, xx, yy, rest = _ahead(columns[0, k] - px, columns[1, k] - py, hx, hy)
        w = columns[4, k]
        out[0, k] = w * ux
        out[1, k] = w * uy
        out[2, k] = w * (rest - columns[5, k])
        out[3, k] = w * hx * xx
        out[4, k] = w * hx * xy
        out[5, k] = 0.0
        out[6, k] = w * hy * xy
        out[7, k] = w * hy * yy
        out[8, k] = 0.0


@fast_kernel
def _reach(ux: float, uy: float, xx: float, xy: float, yx: float, yy: float, tx: float, ty: float) -> float:
    """Largest value over the box of a function that is linear in the offset, for one heading."""
    return ux * tx + uy * ty + abs(xx * tx + xy * ty) + abs(yx * tx + yy * ty)


@fast_kernel
def _oriented_bounds(
    columns: NDArray[np.float64],
    px: float,
    py: float,
    hx: float,
    hy: float,
    vertices: NDArray[np.float64],
    out: NDArray[np.float64],
) -> None:
    ax, ay = vertices[0, 0], vertices[0, 1]
    bx, by = vertices[1, 0], vertices[1, 1]
    tx, ty = vertices[2, 0], vertices[2, 1]
    for k in range(columns.shape[1]):
        ux, uy, bend, xx, yy, rest = _ahead(columns[0, k] - px, columns[1, k] - py, hx, hy)
        xx *= hx
        xy = hx * bend
        yx = hy * bend
        yy *= hy
        mx = -columns[2, k]
        my = -columns[3, k]
        ahead = _reach(ux, uy, xx, xy, yx, yy, ax, ay)
        ahead = max(ahead, _reach(ux, uy, xx, xy, yx, yy, bx, by))
        ahead = max(ahead, _reach(ux, uy, xx, xy, yx, yy, tx, ty))
        facing = max(max(mx * ax + my * ay, mx * bx + my * by), mx * tx + my * ty)
        # outside v . d > 0 and m . d > 0 the product of the two may be positive, the visibility is not
        w = 0.5 * columns[4, k] if ahead + rest > 0.0 and facing > 0.0 else 0.0
        out[0, k] = w * (ux * mx - uy * my)
        out[1, k] = w * (ux * my + uy * mx)
        out[2, k] = w * (ux * mx + uy * my + 2.0 * (rest - columns[5, k]))
        out[3, k] = w * (xx * mx - xy * my)
        out[4, k] = w * (xx * my + xy * mx)
        out[5, k] = w * (xx * mx + xy * my)
        out[6, k] = w * (yx * mx - yy * my)
        out[7, k] = w * (yx * my + yy * mx)
        out[8, k] = w * (yx * mx + yy * my)


@fast_kernel
def _isotropic_bounds(
    columns: NDArray[np.float64], px: float, py: float, hx: float, hy: float, out: NDArray[np.float64]
) -> None:
    h2 = hx * hx + hy * hy
    h = math.sqrt(h2)
    for k in range(columns.shape[1]):
        qx = columns[0, k] - px
        qy = columns[1, k] - py
        gap_x = max(0.0, abs(qx) - hx)
        gap_y = max(0.0, abs(qy) - hy)
        inverse = 1.0 / math.sqrt(max(gap_x * gap_x + gap_y * gap_y, 1e-300))
        r2 = qx * qx + qy * qy
        r = math.sqrt(r2)
        far = r2 > 1.0
        # far: 1 / |q| bends by at most 2 / r^3, so half of that times h^2; near: |q| bends by at most 1 / r
        curve = h2 * inverse * (inverse * inverse if far else 0.5)
        # nearer than the optimal distance it is at most |q|, which vanishes at the landmark
        top = min(min(1.0, inverse), r + h)
        useful = curve < top
        scale = (-1.0 / (r2 * r) if far else 1.0 / max(r, 1e-300)) if useful else 0.0
        rest = curve if useful else top
        w = columns[4, k]
        for row in range(9):
            out[row, k] = 0.0
        out[2, k] = w * ((1.0 / r if far else r) * (1.0 if useful else 0.0) + rest - columns[5, k])
        out[5, k] = -w * hx * scale * qx
        out[8, k] = -w * hy * scale * qy
