"""Rotations as unit quaternions (w, x, y, z) that map the body frame B into the world frame W.

Compiled functions; those that return more than one number write it into `out`.

Notes
-----
Source: Sposato (2016), section 2.1.  Deviation: C4.  The rotation is ``R = Rz(yaw) Ry(pitch) Rx(roll)``.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from covey.compiled import kernel

Array = NDArray[np.float64]


@kernel
def normalise(quat: Array) -> None:
    """Scale a quaternion to length 1, in place.

    Parameters
    ----------
    quat : array, shape (4,)
    """
    scale = 1.0 / math.sqrt(quat[0] * quat[0] + quat[1] * quat[1] + quat[2] * quat[2] + quat[3] * quat[3])
    for i in range(4):
        quat[i] *= scale


@kernel
def product(a: Array, b: Array, out: Array) -> None:
    """Rotate by b, then by a.

    Parameters
    ----------
    a, b, out : array, shape (4,)
        `out` is neither of the others.

    Examples
    --------
    >>> quarter, out = np.array([0.5**0.5, 0.0, 0.0, 0.5**0.5]), np.empty(4)
    >>> product(quarter, quarter, out)
    >>> print(out.round(6) + 0.0)
    [0. 0. 0. 1.]
    """
    out[0] = a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3]
    out[1] = a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2]
    out[2] = a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1]
    out[3] = a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0]


@kernel
def rotate(quat: Array, vector_B: Array, out: Array) -> None:
    """Express a vector of the body frame in the world frame.

    Parameters
    ----------
    quat : array, shape (4,)
    vector_B, out : array, shape (3,)
        They may be the same.
    """
    w, x, y, z = quat[0], quat[1], quat[2], quat[3]
    a, b, c = vector_B[0], vector_B[1], vector_B[2]
    s = 2.0 * (y * c - z * b)
    t = 2.0 * (z * a - x * c)
    u = 2.0 * (x * b - y * a)
    out[0] = a + w * s + y * u - z * t
    out[1] = b + w * t + z * s - x * u
    out[2] = c + w * u + x * t - y * s


@kernel
def rotate_back(quat: Array, vector_W: Array, out: Array) -> None:
    """Express a vector of the world frame in the body frame.

    Parameters
    ----------
    quat : array, shape (4,)
    vector_W, out : array, shape (3,)
        They may be the same.
    """
    w, x, y, z = quat[0], -quat[1], -quat[2], -quat[3]
    a, b, c = vector_W[0], vector_W[1], vector_W[2]
    s = 2.0 * (y * c - z * b)
    t = 2.0 * (z * a - x * c)
    u = 2.0 * (x * b - y * a)
    out[0] = a + w * s + y * u - z * t
    out[1] = b + w * t + z * s - x * u
    out[2] = c + w * u + x * t - y * s


@kernel
def thrust_axis(quat: Array, out: Array) -> None:
    """Compute the body's z axis in the world frame, ``n = R e3``.

    Parameters
    ----------
    quat : array, shape (4,)
    out : array, shape (3,)
    """
    w, x, y, z = quat[0], quat[1], quat[2], quat[3]
    out[0] = 2.0 * (x * z + w * y)
    out[1] = 2.0 * (y * z - w * x)
    out[2] = 1.0 - 2.0 * (x * x + y * y)


@kernel
def matrix(quat: Array, out: Array) -> None:
    """Compute the rotation matrix R, body to world.

    Parameters
    ----------
    quat : array, shape (4,)
    out : array, shape (3, 3)
    """
    w, x, y, z = quat[0], quat[1], quat[2], quat[3]
    out[0, 0] = 1.0 - 2.0 * (y * y + z * z)
    out[0, 1] = 2.0 * (x * y - w * z)
    out[0, 2] = 2.0 * (x * z + w * y)
    out[1, 0] = 2.0 * (x * y + w * z)
    out[1, 1] = 1.0 - 2.0 * (x * x + z * z)
    out[1, 2] = 2.0 * (y * z - w * x)
    out[2, 0] = 2.0 * (x * z - w * y)
    out[2, 1] = 2.0 * (y * z + w * x)
    out[2, 2] = 1.0 - 2.0 * (x * x + y * y)


@kernel
def from_yaw_pitch_roll(yaw: float, pitch: float, roll: float, out: Array) -> None:
    """Build the quaternion of ``Rz(yaw) Ry(pitch) Rx(roll)``.

    Parameters
    ----------
    yaw, pitch, roll : float
        rad.
    out : array, shape (4,)

    Examples
    --------
    >>> quat, n = np.empty(4), np.empty(3)
    >>> from_yaw_pitch_roll(0.0, 0.1, 0.0, quat)  # nose down: thrust points forward
    >>> thrust_axis(quat, n)
    >>> print(n.round(4))
    [0.0998 0. 0.995 ]
    """
    cy, sy = math.cos(0.5 * yaw), math.sin(0.5 * yaw)
    cp, sp = math.cos(0.5 * pitch), math.sin(0.5 * pitch)
    cr, sr = math.cos(0.5 * roll), math.sin(0.5 * roll)
    out[0] = cy * cp * cr + sy * sp * sr
    out[1] = cy * cp * sr - sy * sp * cr
    out[2] = cy * sp * cr + sy * cp * sr
    out[3] = sy * cp * cr - cy * sp * sr


@kernel
def yaw_of(quat: Array) -> float:
    """Return the yaw angle, rad, in (-pi, pi]."""
    w, x, y, z = quat[0], quat[1], quat[2], quat[3]
    return math.atan2(2.0 * (x * y + w * z), 1.0 - 2.0 * (y * y + z * z))


@kernel
def pitch_of(quat: Array) -> float:
    """Return the pitch angle, rad, in [-pi/2, pi/2]; positive with the nose down."""
    return math.asin(min(1.0, max(-1.0, 2.0 * (quat[0] * quat[2] - quat[1] * quat[3]))))


@kernel
def roll_of(quat: Array) -> float:
    """Return the roll angle, rad, in (-pi, pi]; positive with the right side down."""
    w, x, y, z = quat[0], quat[1], quat[2], quat[3]
    return math.atan2(2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y))


@kernel
def tilt_of(quat: Array) -> float:
    """Return the angle between the body's z axis and the vertical, rad."""
    horizontal = quat[1] * quat[1] + quat[2] * quat[2]
    vertical = quat[0] * quat[0] + quat[3] * quat[3]
    return 2.0 * math.atan2(math.sqrt(horizontal), math.sqrt(vertical))
