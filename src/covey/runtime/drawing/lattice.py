"""Landmarks that are the cells of a square grid, for drawing them as an image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from covey.environment import Landmarks


@dataclass(frozen=True, eq=False)
class Lattice:
    """A square grid of cells, some of which are landmarks.

    Parameters
    ----------
    index : array of int64, shape (rows, columns)
        Which landmark each cell is, -1 for none; row 0 has the smallest y.
    x_min, y_min : float
        Lower left corner of the grid, frame W, metres.
    cell_size : float
        Side of a cell, metres.
    """

    index: NDArray[np.int64]
    x_min: float
    y_min: float
    cell_size: float

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """(x_min, x_max, y_min, y_max), metres."""
        rows, columns = self.index.shape
        return (
            self.x_min,
            self.x_min + columns * self.cell_size,
            self.y_min,
            self.y_min + rows * self.cell_size,
        )

    def at(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.int64]:
        """Which landmark's cell holds each point, -1 for none; x and y have the same shape, metres."""
        rows, columns = self.index.shape
        i = np.floor((y - self.y_min) / self.cell_size).astype(np.int64)
        j = np.floor((x - self.x_min) / self.cell_size).astype(np.int64)
        inside = (i >= 0) & (i < rows) & (j >= 0) & (j < columns)
        found = self.index[np.clip(i, 0, rows - 1), np.clip(j, 0, columns - 1)]
        result: NDArray[np.int64] = np.where(inside, found, -1)
        return result


def find_lattice(landmarks: Landmarks) -> Lattice | None:
    """Recognise the cells of a square grid; None where the landmarks are something else.

    Examples
    --------
    >>> cells = Landmarks(np.array([[0.5, 0.5], [1.5, 0.5], [0.5, 1.5]]), cell_size=1.0)
    >>> find_lattice(cells).index
    array([[ 0,  1],
           [ 2, -1]])
    """
    size = landmarks.cell_size
    if size is None or len(landmarks) == 0:
        return None
    low = landmarks.positions_W.min(axis=0)
    steps = (landmarks.positions_W - low) / size
    cells = np.rint(steps)
    shape = cells.max(axis=0) + 1
    if np.abs(steps - cells).max() > 1e-3 or shape.prod() > 1000 + 50 * len(landmarks):
        return None
    columns, rows = (int(count) for count in shape)
    j, i = cells.astype(np.int64).T
    index = np.full((rows, columns), -1, dtype=np.int64)
    index[i, j] = np.arange(len(landmarks))
    if np.count_nonzero(index >= 0) < len(landmarks):
        return None
    return Lattice(index, float(low[0]) - size / 2, float(low[1]) - size / 2, size)
