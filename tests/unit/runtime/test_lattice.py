"""Landmarks that are cells of a grid, and the points among them."""

import json
from dataclasses import replace
from typing import Any, TypeAlias

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import rgb_to_hsv
from numpy.typing import NDArray

from covey.cli.summary import _pixels
from covey.environment import GeoReference, Landmarks
from covey.environment.lattice import find_lattice
from covey.mission import parse_mission
from covey.runtime.drawing.film_map import Ground
from covey.runtime.drawing.map_drawing import draw_map
from covey.runtime.drawing.palette import colours, rgb
from covey.runtime.drawing.record_film import RecordFrames
from covey.runtime.plan import plan
from covey.runtime.records.geojson import to_geojson
from covey.runtime.result import Deployment
from covey.runtime.watching.feed import Scene, Update

Told: TypeAlias = tuple[Deployment, list[Scene | Update]]


def grid(columns: int, rows: int, size: float = 0.5, corner: tuple[float, float] = (0.1, -3.0)) -> NDArray[np.float64]:
    """Middles of cells, row after row."""
    x, y = np.meshgrid(np.arange(columns) + 0.5, np.arange(rows) + 0.5)
    return np.column_stack([x.ravel(), y.ravel()]) * size + corner


def with_points(*points: tuple[float, float], columns: int = 6, rows: int = 4) -> Landmarks:
    return Landmarks(np.concatenate([grid(columns, rows), np.array(points).reshape(-1, 2)]), cell_size=0.5)


@pytest.mark.parametrize("size", [0.1, 0.3, 0.5, 7.0])
@pytest.mark.parametrize("corner", [(0.0, 0.0), (0.1, -3.0), (1e5, -1e5)])
def test_a_grid_is_all_cells(size: float, corner: tuple[float, float]) -> None:
    lattice = find_lattice(Landmarks(grid(30, 20, size, corner), cell_size=size))
    assert lattice is not None
    assert len(lattice.loose) == 0
    np.testing.assert_array_equal(lattice.index, np.arange(600).reshape(20, 30))
    assert (lattice.x_min, lattice.y_min) == pytest.approx(corner)


def test_points_off_the_grid_are_loose_wherever_they_are() -> None:
    """In the middle of nowhere, too: they make the grid no larger."""
    lattice = find_lattice(with_points((0.2, -2.9), (1.1, -2.0), (1e7, 1e-3)))
    assert lattice is not None
    assert lattice.loose.tolist() == [24, 25, 26]
    np.testing.assert_array_equal(lattice.index, np.arange(24).reshape(4, 6))
    x, y = np.array([[0.2, -2.9]]).T
    assert lattice.at(x, y).tolist() == [0]


def test_a_cell_is_the_first_s_that_lies_there() -> None:
    first = grid(6, 4)
    lattice = find_lattice(with_points(*map(tuple, first[[0, 7, 7]])))
    assert lattice is not None
    assert lattice.loose.tolist() == [24, 25, 26]
    np.testing.assert_array_equal(lattice.index, np.arange(24).reshape(4, 6))


def test_points_on_the_grid_are_cells_of_it() -> None:
    lattice = find_lattice(with_points((0.35 - 0.5, -2.75), (0.35, -2.75 + 4 * 0.5)))
    assert lattice is not None
    assert len(lattice.loose) == 0
    assert lattice.index.shape == (5, 7)
    assert lattice.index[0].tolist() == [24, 0, 1, 2, 3, 4, 5]
    assert lattice.index[4].tolist() == [-1, 25, -1, -1, -1, -1, -1]


@pytest.mark.parametrize(("points", "found"), [(23, True), (24, False)])
def test_more_than_half_must_be_cells(points: int, found: bool) -> None:
    assert (find_lattice(with_points(*[(0.2, -2.9)] * points)) is not None) == found


def test_a_grid_that_would_be_almost_empty_is_none() -> None:
    assert find_lattice(with_points((0.35 + 500, -2.75 + 500))) is None


@pytest.fixture(scope="module")
def told() -> Told:
    """A plan of a grid to which two points are added, and what it told."""
    box = {"x_m": [-2, 2], "y_m": [-2, 2]}
    document = {
        "schema_version": 1,
        "name": "points",
        "environment": {"landmarks": {"grid": {**box, "spacing_m": 0.5}}, "region": {"box": box}},
        "agents": [{"name": "a", "pose": {"x_m": -1, "y_m": 0}}, {"name": "b", "pose": {"x_m": 1, "y_m": 0}}],
        "changes": [{"add": {"points": [[0.1, 0.1], [-1.0, -1.0]], "weight": 2.0}}],
    }
    feed: list[Scene | Update] = []
    return plan(parse_mission(json.dumps(document), format="json"), watch=feed.append), feed


def test_cells_stay_cells_when_points_are_added(told: Told) -> None:
    deployment, feed = told
    lattice = find_lattice(deployment.mission.landmarks)
    assert lattice is not None
    assert lattice.loose.tolist() == [64, 65]
    np.testing.assert_array_equal(lattice.index, np.arange(64).reshape(8, 8))
    assert [item.cell_size for item in feed if isinstance(item, Scene)] == [0.5, 0.5]


def test_landmarks_of_which_hardly_any_are_cells_are_points() -> None:
    box = {"x_m": [-1, 1], "y_m": [-1, 1]}
    document = {
        "schema_version": 1,
        "name": "points",
        "environment": {"landmarks": {"grid": {**box, "spacing_m": 1.0}}, "region": {"box": box}},
        "agents": [{"name": "a", "pose": {"x_m": -1, "y_m": 0}}, {"name": "b", "pose": {"x_m": 1, "y_m": 0}}],
        "changes": [{"add": {"points": [[0.1 * k, 0.2] for k in range(5)]}}],
    }
    deployment = plan(parse_mission(json.dumps(document), format="json"))
    assert len(deployment.mission.landmarks) == 9
    assert deployment.mission.landmarks.cell_size is None


def shown_points(ax: Axes, deployment: Deployment) -> int:
    """How many points are drawn where landmarks were added, in the hues of their owners."""
    added, owner = deployment.mission.landmarks.positions_W[64:], deployment.owner[64:]
    parts: list[Any] = [part for part in ax.collections if np.array_equal(np.asarray(part.get_offsets()), added)]
    hues = np.array([rgb_to_hsv(rgb(colour))[0] for colour in colours(["a", "b"])])
    return sum(
        int((np.abs(rgb_to_hsv(part.get_facecolor()[:, :3])[:, 0] - hues[owner]) < 0.02).sum()) for part in parts
    )


def test_figures_draw_cells_and_points_on_top(told: Told) -> None:
    deployment, _ = told
    figure, ax = plt.subplots()
    draw_map(ax, deployment.mission, deployment.poses, deployment.owner)
    (cells,) = (part for part in ax.collections if isinstance(part, PolyCollection))
    assert len(cells.get_paths()) == 64
    assert shown_points(ax, deployment) == 2
    plt.close(figure)


def test_films_draw_points_on_top(told: Told) -> None:
    deployment, feed = told
    frames = RecordFrames(feed, fps=1, dpi=50, speed=None)
    frames.picture(len(frames.times) - 1)
    assert shown_points(frames._figure.axes[0], deployment) == 2
    figure, ax = plt.subplots()
    ax.set(xlim=(-2, 2), ylim=(-2, 2))
    ground = Ground(ax, deployment.mission, [(0.0, deployment.owner, deployment.poses)], colours(["a", "b"]), 60.0)
    ground.update(0.0, 0, settled=True)
    assert shown_points(ax, deployment) == 2
    plt.close(figure)


def test_the_map_in_the_terminal_shows_points(told: Told) -> None:
    deployment, _ = told
    other = 1 - deployment.owner[:64]
    cells = find_lattice(deployment.mission.landmarks)
    assert cells is not None
    x, y = deployment.mission.landmarks.positions_W[64:].T
    # Each point belongs to whoever does not own the cell beneath it.
    owners = np.concatenate([deployment.owner[:64], other[cells.at(x, y)]])
    agents = tuple(
        replace(agent, landmarks=np.flatnonzero(owners == index)) for index, agent in enumerate(deployment.agents)
    )
    pixels, (left, bottom, size) = _pixels(replace(deployment, agents=agents))
    i, j = ((y - bottom) / size).astype(int), ((x - left) / size).astype(int)
    np.testing.assert_array_equal(pixels[i, j], owners[64:])


def test_who_owns_what_is_told_to_maps_as_points_where_some_are_no_cells(told: Told) -> None:
    deployment = replace(told[0], mission=replace(told[0].mission, georeference=GeoReference(11.0, 57.0)))
    owns = [part for part in to_geojson(deployment)["features"] if part["properties"]["kind"] == "owns"]
    assert [part["geometry"]["type"] for part in owns] == ["MultiPoint", "MultiPoint"]
    assert sum(len(part["geometry"]["coordinates"]) for part in owns) == 66
