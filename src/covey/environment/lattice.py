"""Landmarks that are the cells of a square grid, for drawing them as an image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from covey.environment import Landmarks

OFF_GRID = 1e-3
"""Sides of a cell by which a landmark may be off its middle."""


@dataclass(frozen=True, eq=False)
class Lattice:
    """A square grid of cells, some of which are landmarks.

    Parameters
    ----------
    index : array of int64, shape (rows, columns)
        Which landmark each cell is, -1 for none; row 0 has the smallest y.
    loose : array of int64, shape (k,)
        The landmarks that are no cells: points, to be drawn on top of these.
    x_min, y_min : float
        Lower left corner of the grid, frame W, metres.
    cell_size : float
        Side of a cell, metres.
    """

    index: NDArray[np.int64]
    loose: NDArray[np.int64]
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

    The first landmark says where the grid is, since those added to a mission come last.  Loose are landmarks off it,
    or in a cell that one before them has.  It is no grid unless more than half of the landmarks are cells, or if hardly
    any of its cells are landmarks.

    Examples
    --------
    >>> cells = Landmarks(np.array([[0.5, 0.5], [1.5, 0.5], [0.5, 1.5], [0.7, 0.6]]), cell_size=1.0)
    >>> lattice = find_lattice(cells)
    >>> lattice.index
    array([[ 0,  1],
           [ 2, -1]])
    >>> lattice.loose
    array([3])
    """
    size, n = landmarks.cell_size, len(landmarks)
    if size is None or n == 0:
        return None
    positions = landmarks.positions_W
    steps = (positions - positions[0]) / size
    cells = np.rint(steps)
    which = np.flatnonzero((np.abs(steps - cells) <= OFF_GRID).all(axis=1))
    cells = cells[which] - cells[which].min(axis=0)
    if np.prod(cells.max(axis=0) + 1.0) > 1000 + 50 * n:
        return None
    j, i = cells.astype(np.int64).T
    index = np.full((i.max() + 1, j.max() + 1), -1, dtype=np.int64)
    taken, first = np.unique(i * index.shape[1] + j, return_index=True)
    index.flat[taken] = which[first]
    is_loose = np.ones(n, dtype=np.bool_)
    is_loose[index[index >= 0]] = False
    loose = np.flatnonzero(is_loose)
    if 2 * len(loose) >= n:
        return None
    low = positions[which].min(axis=0)
    return Lattice(index, loose, float(low[0]) - size / 2, float(low[1]) - size / 2, size)
