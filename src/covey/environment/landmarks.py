"""The landmarks: what the team has to see."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from covey.errors import ArgumentError


@dataclass(frozen=True, eq=False)
class Landmarks:
    """The ordered set S of landmarks, with what each is worth and where it faces.

    Parameters
    ----------
    positions_W : array, shape (n, 2)
        Positions in the world frame, metres.
    weights : array, shape (n,), optional
        What each is worth, at least 0; 1 by default.
    normals_W : array, shape (n, 2), optional
        Outward unit normals, for models of oriented landmarks; they are normalised here.
    cell_size : float, optional
        Side of the square that a landmark stands for, metres, for drawing.

    Raises
    ------
    ArgumentError
        If a shape does not fit, a number is not finite, a weight is negative or a normal is zero.

    Notes
    -----
    Source: Sposato (2016), section 4.1 (positions), section 6.2 (orientations).

    Examples
    --------
    >>> len(Landmarks(np.zeros((3, 2))))
    3
    """

    positions_W: NDArray[np.float64]
    weights: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))
    normals_W: NDArray[np.float64] | None = None
    cell_size: float | None = None

    def __post_init__(self) -> None:
        positions = np.ascontiguousarray(self.positions_W, dtype=np.float64)
        if positions.ndim != 2 or positions.shape[1] != 2:
            raise ArgumentError(f"positions_W: expected shape (n, 2), got {positions.shape}")
        n = len(positions)
        weights = np.ascontiguousarray(self.weights, dtype=np.float64)
        if weights.shape == (0,):
            weights = np.ones(n)
        if weights.shape != (n,):
            raise ArgumentError(f"weights: expected shape ({n},), got {weights.shape}")
        if not np.isfinite(positions).all() or not np.isfinite(weights).all():
            raise ArgumentError("positions_W, weights: expected finite numbers, got NaN or infinity")
        if (weights < 0.0).any():
            raise ArgumentError(f"weights: expected at least 0, got {weights.min()}")
        normals = self.normals_W
        if normals is not None:
            normals = np.ascontiguousarray(normals, dtype=np.float64)
            if normals.shape != (n, 2):
                raise ArgumentError(f"normals_W: expected shape ({n}, 2), got {normals.shape}")
            length = np.linalg.norm(normals, axis=1, keepdims=True)
            if not np.isfinite(normals).all() or (length == 0.0).any():
                raise ArgumentError("normals_W: expected finite vectors of some length, got zero or NaN")
            normals = normals / length
        for name, array in (("positions_W", positions), ("weights", weights), ("normals_W", normals)):
            if array is not None:
                array = array.copy()
                array.setflags(write=False)
            object.__setattr__(self, name, array)

    def __len__(self) -> int:
        return len(self.positions_W)

    def subset(self, indices: NDArray[np.int64]) -> Landmarks:
        """Return the landmarks with these indices, shape (k,), in their order."""
        part = object.__new__(Landmarks)  # what is a part of valid landmarks need not be checked again
        object.__setattr__(part, "positions_W", self.positions_W[indices])
        object.__setattr__(part, "weights", self.weights[indices])
        object.__setattr__(part, "normals_W", None if self.normals_W is None else self.normals_W[indices])
        object.__setattr__(part, "cell_size", self.cell_size)
        return part
