"""Landmarks made from a shape: a grid, the inside of a polygon, the length of a curve."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from covey.environment.landmarks import Landmarks
from covey.errors import ArgumentError
from covey.geometry import Region

MAX_LANDMARKS = 1_000_000
"""More landmarks than this are refused before any memory is taken."""

_CHUNK = 1_000_000
_MAX_CELLS = 64_000_000


def cells(low: float, high: float, spacing: float) -> int:
    """How many whole cells of `spacing` fit into [low, high].

    Examples
    --------
    >>> cells(-5.0, 5.0, 0.5), cells(0.0, 1.0, 0.3)
    (20, 3)
    """
    ratio = (high - low) / spacing
    nearest = round(ratio)
    # 0.6 / 0.2 is 2.999...: a range that is a multiple up to rounding counts as one.
    return nearest if abs(ratio - nearest) <= 1e-9 * max(1.0, ratio) else math.floor(ratio)


def _centres(low: float, n: int, spacing: float) -> NDArray[np.float64]:
    return np.asarray(low + (np.arange(n) + 0.5) * spacing, dtype=np.float64)


def _spacing(spacing: float) -> None:
    if not (math.isfinite(spacing) and spacing > 0.0):
        raise ArgumentError(f"spacing: expected a number above 0, got {spacing}")


def _refuse_too_many(count: int, about: bool) -> None:
    if count > MAX_LANDMARKS:
        # Beyond 2^53 a count is only known roughly, and nobody reads its digits.
        shown = f"{count:,}" if count < 10**15 else f"{float(min(count, 10**300)):.1e}"
        raise ArgumentError(
            f"spacing: expected at most {MAX_LANDMARKS:,} landmarks, this makes {'about ' if about else ''}{shown}"
        )


def grid_landmarks(x_min: float, x_max: float, y_min: float, y_max: float, spacing: float) -> Landmarks:
    """Put a landmark at the centre of every cell of a grid.

    Parameters
    ----------
    x_min, x_max, y_min, y_max : float
        The box, metres, frame W.
    spacing : float
        Side of a cell, metres.  Cells start at (x_min, y_min); where a range is no multiple of the spacing, the strip
        at its upper end that is narrower than a cell gets no landmark.

    Returns
    -------
    Landmarks
        Row by row from (x_min, y_min), x running fastest.

    Raises
    ------
    ArgumentError
        If a range is empty, no cell fits in it, or there would be more than a million.

    Notes
    -----
    Source: Sposato (2016), section 5.1.  Deviation: V5.

    Examples
    --------
    >>> grid_landmarks(-5, 5, -5, 5, 0.5).positions_W[[0, -1]]
    array([[-4.75, -4.75],
           [ 4.75,  4.75]])
    """
    _spacing(spacing)
    counts = []
    for name, low, high in (("x", x_min, x_max), ("y", y_min, y_max)):
        if not low < high:
            raise ArgumentError(f"{name}: expected min < max, got [{low:g}, {high:g}]")
        if not math.isfinite((high - low) / spacing):
            raise ArgumentError(f"spacing: expected at most {MAX_LANDMARKS:,} landmarks, {spacing:g} m makes more")
        counts.append(cells(low, high, spacing))
        if counts[-1] == 0:
            raise ArgumentError(f"spacing: expected at most the range {name} [{low:g}, {high:g}], got {spacing:g} m")
    _refuse_too_many(counts[0] * counts[1], about=False)
    x, y = np.meshgrid(_centres(x_min, counts[0], spacing), _centres(y_min, counts[1], spacing))
    return Landmarks(np.column_stack([x.ravel(), y.ravel()]), cell_size=spacing)


def polygon_landmarks(region: Region, spacing: float) -> Landmarks:
    """Put a landmark at every cell centre that lies inside a polygon and outside its holes.

    Parameters
    ----------
    region : Region
        The polygon.
    spacing : float
        Side of a cell, metres.  The grid starts at the lower left corner of the polygon's bounding box.

    Raises
    ------
    ArgumentError
        If no cell centre lies inside, or there would be more than a million.

    Examples
    --------
    >>> len(polygon_landmarks(Region.polygon([[0, 0], [4, 0], [0, 4]]), 1.0))
    6
    """
    import shapely

    _spacing(spacing)
    x_min, x_max, y_min, y_max = region.bounds
    shape = region.shape
    expected = shape.area / spacing / spacing
    width, height = (x_max - x_min) / spacing, (y_max - y_min) / spacing
    if not math.isfinite(expected * width * height):
        raise ArgumentError(f"spacing: expected at most {MAX_LANDMARKS:,} landmarks, {spacing:g} m makes more")
    # A border cell may fall either way: leave room for a whole border before refusing on an estimate.
    if expected - 2.0 * (width + height) > MAX_LANDMARKS:
        _refuse_too_many(round(expected), about=True)
    nx, ny = math.ceil(width), math.ceil(height)
    if nx * ny > _MAX_CELLS:
        raise ArgumentError(
            f"spacing: expected at most {_MAX_CELLS:,} cells in the bounding box, this makes {nx * ny:,}"
        )
    shapely.prepare(shape)
    x = _centres(x_min, nx, spacing)
    y = _centres(y_min, ny, spacing)
    parts = []
    rows = max(1, _CHUNK // nx)
    for first in range(0, ny, rows):
        gx, gy = np.meshgrid(x, y[first : first + rows])
        inside = shapely.contains_xy(shape, gx.ravel(), gy.ravel())
        parts.append(np.column_stack([gx.ravel()[inside], gy.ravel()[inside]]))
    positions = np.concatenate(parts)
    _refuse_too_many(len(positions), about=False)
    if not len(positions):
        raise ArgumentError(f"spacing: expected a cell centre inside the polygon, {spacing:g} m leaves none")
    return Landmarks(positions, cell_size=spacing)


def curve_landmarks(corners: NDArray[np.float64], spacing: float, *, closed: bool, faces: str) -> Landmarks:
    """Put landmarks along a polyline, equal lengths apart, each with its normal.

    The length is cut into ``round(length / spacing)`` equal pieces, at least one, and a landmark sits in the middle of
    each, so that it stands for its piece as a grid's landmark stands for its cell.

    Parameters
    ----------
    corners : array, shape (k, 2)
        Corners in order, metres, frame W.
    spacing : float
        Length of a piece, metres.
    closed : bool
        Whether the last corner is joined to the first.
    faces : str
        Where the normals point: "left" or "right" of the way from the first corner to the last, or, for a closed
        curve, "outside" or "inside".

    Raises
    ------
    ArgumentError
        If the curve has no length, an open one is to face outside or inside, or there would be more than a million.

    Notes
    -----
    Source: Sposato (2016), section 6.2: a structure to inspect is a curve cut into oriented landmarks.

    Examples
    --------
    >>> marks = curve_landmarks(np.array([[0.0, 0.0], [2.0, 0.0]]), 1.0, closed=False, faces="left")
    >>> marks.positions_W
    array([[0.5, 0. ],
           [1.5, 0. ]])
    >>> marks.normals_W[0].tolist()
    [0.0, 1.0]
    """
    _spacing(spacing)
    corners = np.asarray(corners, dtype=np.float64)
    if corners.ndim != 2 or corners.shape[1] != 2 or len(corners) < 2:
        raise ArgumentError(f"curve: expected at least 2 corners [x, y], got shape {corners.shape}")
    if closed:
        corners = np.vstack([corners, corners[:1]])
    steps = np.diff(corners, axis=0)
    lengths = np.hypot(steps[:, 0], steps[:, 1])
    keep = lengths > 0.0
    corners, steps, lengths = corners[:-1][keep], steps[keep], lengths[keep]
    total = float(lengths.sum())
    if total == 0.0:
        raise ArgumentError("curve: expected some length, got the same point throughout")
    if not math.isfinite(total / spacing):
        raise ArgumentError(f"spacing: expected at most {MAX_LANDMARKS:,} landmarks, {spacing:g} m makes more")
    n = max(1, round(total / spacing))
    _refuse_too_many(n, about=False)
    ends = np.cumsum(lengths)
    along = (np.arange(n) + 0.5) * (total / n)
    segment = np.minimum(np.searchsorted(ends, along, side="right"), len(ends) - 1)
    part = (along - (ends[segment] - lengths[segment])) / lengths[segment]
    positions = corners[segment] + part[:, None] * steps[segment]
    left = np.column_stack([-steps[:, 1], steps[:, 0]]) / lengths[:, None]
    return Landmarks(positions, normals_W=_side(corners, closed, faces) * left[segment] + 0.0)


def _side(corners: NDArray[np.float64], closed: bool, faces: str) -> float:
    """+1 for normals to the left of the way along the curve, -1 for normals to its right."""
    if faces in ("left", "right"):
        return 1.0 if faces == "left" else -1.0
    if faces not in ("outside", "inside"):
        raise ArgumentError(f"faces: expected 'left', 'right', 'outside' or 'inside', got {faces!r}")
    if not closed:
        raise ArgumentError(f"faces: expected 'left' or 'right' for an open curve, got {faces!r}")
    x, y = (corners - corners.mean(axis=0)).T
    area = float(x @ np.roll(y, -1) - y @ np.roll(x, -1))
    if area == 0.0:
        raise ArgumentError(f"faces: expected 'left' or 'right' for a curve around no area, got {faces!r}")
    return -1.0 if (area > 0.0) == (faces == "outside") else 1.0
