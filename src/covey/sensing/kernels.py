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
    kind: int,
    landmarks: NDArray[np.float64],
    inverse: float,
    px: float,
    py: float,
    c: float,
    s: float,
    gradient: NDArray[np.float64],
) -> float:
    """Sum of ``w_k max(0, vis - lambda_k)`` over all landmarks from one pose, and its gradient.

    The formulas are those of `visibility_gradients`, whose arguments these are; summing on the way saves the trip
    through memory.  `gradient`, shape (3,), is overwritten: by the position in optimal distances, and by the heading.
    """
    total = gx = gy = gt = 0.0
    for k in range(landmarks.shape[1]):
        qx = (landmarks[0, k] - px) * inverse
        qy = (landmarks[1, k] - py) * inverse
        r2 = qx * qx + qy * qy
        i = 1.0 / max(r2, 1.0)
        w = landmarks[4, k]
        if kind == ISOTROPIC:
            r = math.sqrt(max(r2, 1e-300))
            gain = r * i - landmarks[5, k]
            w = w if gain > 0.0 else 0.0
            g = -i / r if r2 > 1.0 else 1.0 / r
            total += w * gain
            gx -= w * g * qx
            gy -= w * g * qy
        else:
            value = (qx * c + qy * s) * i
            turn = (qy * c - qx * s) * i
            g = 2.0 * value * i if r2 > 1.0 else 0.0
            if kind == ORIENTED:
                facing = max(0.0, -(landmarks[2, k] * c + landmarks[3, k] * s))
                turn = turn * facing + value * (landmarks[2, k] * s - landmarks[3, k] * c)
                gain = value * facing - landmarks[5, k]
                w = w if gain > 0.0 else 0.0
                total += w * gain
                gt += w * turn
                w *= facing
            else:
                gain = value - landmarks[5, k]
                w = w if gain > 0.0 else 0.0
                total += w * gain
                gt += w * turn
            gx -= w * (c * i - g * qx)
            gy -= w * (s * i - g * qy)
    gradient[0] = gx
    gradient[1] = gy
    gradient[2] = gt
    return total


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
) -> float:
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
        Corners of a triangle that holds all (cos psi, sin psi) of the box.
    out : array, shape (9, n)
        Is overwritten with a, b, c at the centre and their changes per ox and per oy.

    Returns
    -------
    float
        Sum of the weighted remainders: how much of the bound is due to the size of the box.
    """
    h2 = hx * hx + hy * hy
    h = math.sqrt(h2)
    close = (2.0 - h) * (2.0 - h) if h < 2.0 else -1.0
    slack = 0.0
    for k in range(columns.shape[1]):
        qx = columns[0, k] - px
        qy = columns[1, k] - py
        dx = max(0.0, abs(qx) - hx)
        dy = max(0.0, abs(qy) - hy)
        inverse = 1.0 / math.sqrt(max(dx * dx + dy * dy, 1e-300))
        r2 = qx * qx + qy * qy
        far = r2 > 1.0
        # no visibility in the box exceeds this
        top = min(1.0, inverse)
        # far: v = q / |q|^2 at the centre, its derivative, and half its largest second derivative, 2 / r^3, times h^2;
        # near: v . d <= q . d wherever q . d >= 0, which is linear as it stands
        remainder = h2 * inverse * inverse * inverse if far else 0.0
        useful = remainder < top if far else r2 < close
        i = 1.0 / max(r2, 1.0)
        w = columns[4, k]
        if kind == ISOTROPIC:
            # near: |q| is convex, so its tangent plus the second-order remainder; the tangent's length is 1
            r = math.sqrt(r2)
            curve = 0.5 * h2 * inverse
            curve = remainder if far else curve
            # nearer than the optimal distance it is at most |q|, which vanishes at the landmark
            top = min(top, r + h)
            useful = curve < top
            scale = (-i / r if far else 1.0 / max(r, 1e-300)) if useful else 0.0
            rest = curve if useful else top
            out[0, k] = out[1, k] = 0.0
            out[2, k] = w * ((r * i if useful else 0.0) + rest - columns[5, k])
            out[3, k] = out[4, k] = out[6, k] = out[7, k] = 0.0
            out[5, k] = -w * hx * scale * qx
            out[8, k] = -w * hy * scale * qy
            slack += w * rest
            continue
        k2 = 2.0 * i * i if far and useful else 0.0
        i = i if useful else 0.0
        rest = remainder if useful else top
        ux = qx * i
        uy = qy * i
        xx = hx * (k2 * qx * qx - i)
        xy = hx * k2 * qx * qy
        yx = hy * k2 * qx * qy
        yy = hy * (k2 * qy * qy - i)
        if kind == ANISOTROPIC:
            out[0, k] = w * ux
            out[1, k] = w * uy
            out[2, k] = w * (rest - columns[5, k])
            out[3, k] = w * xx
            out[4, k] = w * xy
            out[6, k] = w * yx
            out[7, k] = w * yy
            out[5, k] = out[8, k] = 0.0
        else:
            mx = -columns[2, k]
            my = -columns[3, k]
            ahead = facing = -1.0
            for j in range(3):
                tx = vertices[j, 0]
                ty = vertices[j, 1]
                reach = ux * tx + uy * ty + abs(xx * tx + xy * ty) + abs(yx * tx + yy * ty) + rest
                ahead = max(ahead, reach)
                facing = max(facing, mx * tx + my * ty)
            # outside v . d > 0 and m . d > 0 the product of the two may be positive, the visibility is not
            w = 0.5 * w if ahead > 0.0 and facing > 0.0 else 0.0
            out[0, k] = w * (ux * mx - uy * my)
            out[1, k] = w * (ux * my + uy * mx)
            out[2, k] = w * (ux * mx + uy * my + 2.0 * (rest - columns[5, k]))
            out[3, k] = w * (xx * mx - xy * my)
            out[4, k] = w * (xx * my + xy * mx)
            out[5, k] = w * (xx * mx + xy * my)
            out[6, k] = w * (yx * mx - yy * my)
            out[7, k] = w * (yx * my + yy * mx)
            out[8, k] = w * (yx * mx + yy * my)
            w *= 2.0
        slack += w * rest
    return slack
