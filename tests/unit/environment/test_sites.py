"""Landmarks from grids, polygons and curves."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st

from covey.environment import curve_landmarks, grid_landmarks, polygon_landmarks
from covey.environment.sites import cells
from covey.errors import ArgumentError
from covey.geometry import Region


@given(st.integers(1, 300), st.integers(1, 300), st.floats(1e-3, 1e3), st.floats(-1e3, 1e3))
def test_grid_counts_exactly(nx: int, ny: int, spacing: float, corner: float) -> None:
    marks = grid_landmarks(corner, corner + nx * spacing, corner, corner + ny * spacing, spacing)
    assert len(marks) == nx * ny
    np.testing.assert_allclose(marks.positions_W[0], corner + spacing / 2, atol=1e-9 * (1 + abs(corner)))


@pytest.mark.parametrize(("high", "spacing", "count"), [(1.0, 0.3, 3), (0.6, 0.2, 3), (0.7, 0.1, 7), (10, 0.1, 100)])
def test_whole_cells(high: float, spacing: float, count: int) -> None:
    assert cells(0.0, high, spacing) == count


def test_grid_of_ten_thousand() -> None:
    assert len(grid_landmarks(0, 50, 0, 50, 0.5)) == 10_000


def test_grid_runs_along_x_first() -> None:
    assert grid_landmarks(0, 3, 0, 2, 1).positions_W.tolist() == [
        [0.5, 0.5], [1.5, 0.5], [2.5, 0.5], [0.5, 1.5], [1.5, 1.5], [2.5, 1.5]
    ]  # fmt: skip


@pytest.mark.parametrize("spacing", [0.0, -1.0, math.nan, math.inf])
def test_spacing_is_positive(spacing: float) -> None:
    with pytest.raises(ArgumentError, match="spacing: expected a number above 0"):
        grid_landmarks(0, 1, 0, 1, spacing)


@pytest.mark.parametrize("spacing", [1e-4, 1e-9, 1e-300, 5e-324])
def test_too_many_are_refused_before_they_exist(spacing: float) -> None:
    square = Region.box(0, 1000, 0, 1000)
    line = np.array([[0.0, 0.0], [1000.0, 0.0]])
    with pytest.raises(ArgumentError, match="at most 1,000,000 landmarks"):
        grid_landmarks(0, 1000, 0, 1000, spacing)
    with pytest.raises(ArgumentError, match="at most 1,000,000 landmarks"):
        polygon_landmarks(square, spacing)
    with pytest.raises(ArgumentError, match="at most 1,000,000 landmarks"):
        curve_landmarks(line, spacing, closed=False, faces="left")


def test_a_million_is_allowed() -> None:
    assert len(polygon_landmarks(Region.box(0, 1000, 0, 1000), 1.0)) == 1_000_000


def test_sliver_with_a_huge_bounding_box_is_refused() -> None:
    sliver = Region.polygon([[0, 0], [1e5, 1e5], [1e5, 1e5 + 0.1]])
    with pytest.raises(ArgumentError, match="cells in the bounding box"):
        polygon_landmarks(sliver, 0.5)


@given(
    st.lists(st.tuples(st.floats(0.3, 1.0), st.floats(0.0, 1.0)), min_size=3, max_size=12),
    st.floats(0.02, 0.2),
)
def test_polygon_landmarks_are_the_cell_centres_inside(corners: list[tuple[float, float]], spacing: float) -> None:
    """A star-shaped outline around a square hole."""
    angles = [2 * math.pi * (i + 0.9 * turn) / len(corners) for i, (_, turn) in enumerate(corners)]
    outline = [(r * math.cos(a), r * math.sin(a)) for (r, _), a in zip(corners, angles, strict=True)]
    hole = np.array([[-0.05, -0.05], [0.05, -0.05], [0.05, 0.05], [-0.05, 0.05]])
    shape = shapely.Polygon(outline, [hole])
    if not shape.is_valid:
        return
    region = Region(np.array(outline), (hole,))
    try:
        marks = polygon_landmarks(region, spacing).positions_W
    except ArgumentError:
        marks = np.empty((0, 2))
    assert shapely.contains_xy(shape, marks[:, 0], marks[:, 1]).all()
    x0, x1, y0, y1 = region.bounds
    every = grid_landmarks(x0, x1 + spacing, y0, y1 + spacing, spacing).positions_W
    assert len(marks) == shapely.contains_xy(shape, every[:, 0], every[:, 1]).sum()


def test_box_polygon_is_the_grid() -> None:
    box = polygon_landmarks(Region.box(-5, 5, -5, 5), 0.5)
    grid = grid_landmarks(-5, 5, -5, 5, 0.5)
    np.testing.assert_allclose(box.positions_W, grid.positions_W, atol=1e-12)
    assert box.cell_size == grid.cell_size


def _circle(n: int) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    angle = np.arange(n) * 2 * np.pi / n
    return np.column_stack([np.cos(angle), np.sin(angle)])


def test_curve_is_cut_into_equal_lengths() -> None:
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 0.0], [1.0, 3.0]])
    marks = curve_landmarks(corners, 0.5, closed=False, faces="left")
    assert len(marks) == 8
    along = np.where(marks.positions_W[:, 0] < 1.0, marks.positions_W[:, 0], 1.0 + marks.positions_W[:, 1])
    np.testing.assert_allclose(along, 0.25 + 0.5 * np.arange(8))
    assert marks.normals_W is not None
    np.testing.assert_allclose(marks.normals_W[:2], [[0, 1]] * 2)
    np.testing.assert_allclose(marks.normals_W[2:], [[-1, 0]] * 6)


@pytest.mark.parametrize("turn", [1, -1])
@pytest.mark.parametrize(("faces", "sign"), [("outside", 1), ("inside", -1)])
def test_closed_curve_knows_its_outside_whichever_way_it_runs(turn: int, faces: str, sign: int) -> None:
    marks = curve_landmarks(_circle(40)[::turn] + np.array([7.0, -3.0]), 0.1, closed=True, faces=faces)
    assert len(marks) == 63
    assert marks.normals_W is not None
    outward = marks.positions_W - [7.0, -3.0]
    assert (sign * (marks.normals_W * outward).sum(axis=1) > 0.99).all()
    np.testing.assert_allclose(np.hypot(*marks.normals_W.T), 1.0)


def test_left_and_right_are_opposite() -> None:
    left = curve_landmarks(_circle(9), 0.1, closed=False, faces="left").normals_W
    right = curve_landmarks(_circle(9), 0.1, closed=False, faces="right").normals_W
    assert left is not None
    assert right is not None
    np.testing.assert_allclose(left, -right)


def test_short_curve_keeps_one_landmark() -> None:
    marks = curve_landmarks(np.array([[0.0, 0.0], [1.0, 0.0]]), 100.0, closed=False, faces="left")
    assert marks.positions_W.tolist() == [[0.5, 0.0]]


@pytest.mark.parametrize(
    ("corners", "closed", "faces", "words"),
    [
        ([[0, 0], [0, 0]], False, "left", "curve: expected some length"),
        ([[0, 0]], False, "left", "curve: expected at least 2 corners"),
        ([[0, 0], [1, 0]], False, "outside", "'left' or 'right' for an open curve"),
        ([[0, 0], [1, 0]], True, "outside", "around no area"),
        ([[0, 0], [1, 0]], True, "up", "faces: expected 'left', 'right', 'outside' or 'inside', got 'up'"),
    ],
)
def test_curves_that_are_none(corners: list[list[float]], closed: bool, faces: str, words: str) -> None:
    with pytest.raises(ArgumentError, match=words):
        curve_landmarks(np.array(corners, dtype=float), 0.1, closed=closed, faces=faces)
