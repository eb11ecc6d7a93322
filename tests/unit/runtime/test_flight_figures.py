from __future__ import annotations

import io
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray
from PIL import Image
from tests.unit.runtime.flights import flight, flight_of

from covey.errors import ArgumentError
from covey.flight.layout import REF_P, SIG_V1, SIG_V2, SIG_V3, P, V
from covey.flight.obstacles import Box, Obstacle, Prism, Sphere
from covey.runtime.drawing import flight_figures as figures
from covey.runtime.drawing.figures import save_figure
from covey.runtime.drawing.flight_drawing import EVENT_MARKS, tilts, under_way, yaws
from covey.runtime.drawing.flight_paths import outline, plan_frame
from covey.runtime.drawing.palette import colours
from covey.runtime.result import Deployment
from covey.vehicles.flight_log import FlightEvent, FlightLog

MakeDeployment = Callable[..., Deployment]


def panels(figure: Figure) -> dict[str, Axes]:
    """Axes by the label of their y axis."""
    return {ax.get_ylabel(): ax for ax in figure.axes if ax.get_ylabel()}


def line(ax: Axes, label: str) -> Line2D:
    (found,) = [line for line in ax.get_lines() if line.get_label() == label]
    return found


def values(ax: Axes, label: str) -> NDArray[np.float64]:
    return np.asarray(line(ax, label).get_ydata(), dtype=np.float64)


def pixels(figure: Figure) -> NDArray[np.int64]:
    buffer = io.BytesIO()
    save_figure(figure, buffer, kind="png")
    image = np.asarray(Image.open(buffer).convert("RGB"), dtype=np.int64)
    packed: NDArray[np.int64] = image @ np.array([65536, 256, 1])
    return packed


def test_position_is_what_was_logged() -> None:
    log = flight(3, duration=12.0)
    ax = panels(figures.position_figure(log, 1))
    assert list(ax) == ["x [m]", "y [m]", "z [m]"]
    for axis, panel in enumerate(ax.values()):
        np.testing.assert_array_equal(values(panel, "flown"), log.state[:, 1, P + axis])
        np.testing.assert_array_equal(values(panel, "reference"), log.reference[:, 1, REF_P + axis])
        np.testing.assert_array_equal(values(panel, "waypoint"), log.goal[:, 1, axis])
        assert panel.get_xlim() == (log.time[0], log.time[-1])
    every = panels(figures.position_figure(log))
    for index, name in enumerate(log.names):
        np.testing.assert_array_equal(values(every["z [m]"], name), log.state[:, index, P + 2])


@pytest.mark.parametrize(("which", "first", "unit"), [("position", P, "m"), ("velocity", V, "m/s")])
def test_errors_are_flown_less_reference(which: str, first: int, unit: str) -> None:
    log = flight(2, duration=12.0)
    errors = log.state[:, 0, first : first + 3] - log.reference[:, 0, first : first + 3]
    ax = panels(figures.error_figure(log, 0, which))
    for axis, name in enumerate("xyz"):
        np.testing.assert_array_equal(values(ax[f"error [{unit}]"], name), errors[:, axis])
    norms = np.linalg.norm(errors, axis=1)
    np.testing.assert_allclose(values(ax[f"its norm [{unit}]"], "norm"), norms)
    assert ax[f"its norm [{unit}]"].get_yscale() == "log"
    every = panels(figures.error_figure(log, None, which))[f"norm of the error [{unit}]"]
    np.testing.assert_allclose(values(every, log.names[0]), norms)
    assert every.get_ylim()[0] == 0.0


def test_lyapunov_functions_and_the_way_to_waypoints() -> None:
    log = flight(2, duration=20.0)
    figure = figures.lyapunov_figure(log, log.names[1])
    for ax in figure.axes:
        for column, label in ((SIG_V1, "V1"), (SIG_V2, "V2"), (SIG_V3, "V3")):
            np.testing.assert_array_equal(values(ax, label), log.signals[:, 1, column])
        assert len(ax.patches) == 3
    linear, logarithmic = figure.axes
    assert linear.get_ylim()[0] == 0.0
    assert logarithmic.get_yscale() == "log"
    assert logarithmic.get_ylim()[1] > log.signals[:, 1, SIG_V3].max()
    every = panels(figures.lyapunov_figure(log))["V3"]
    drawn = values(every, log.names[0])
    np.testing.assert_array_equal(drawn[~np.isnan(drawn)], log.signals[~np.isnan(drawn), 0, SIG_V3])


def test_under_way_from_new_waypoint_until_reached() -> None:
    log = flight(1, duration=20.0)
    reached = [event.time for event in log.events if event.kind == "reached"]
    spans = under_way(log, 0)
    assert [end for _, end in spans] == reached
    changes = np.flatnonzero(np.abs(np.diff(np.nan_to_num(log.goal[:, 0]), axis=0)).sum(axis=1)) + 1
    assert [begin for begin, _ in spans] == log.time[changes].tolist()
    constant = flight(1, duration=5.0, goal=np.zeros((51, 1, 4)), events=())
    assert under_way(constant, 0) == []
    assert under_way(flight(1, duration=5.0, goal=np.full((51, 1, 4), np.nan)), 0) == []


def test_speed() -> None:
    log = flight(2, duration=12.0)
    speed = np.linalg.norm(log.state[:, :, V : V + 3], axis=2)
    ax = panels(figures.speed_figure(log, 0))["velocity [m/s]"]
    np.testing.assert_array_equal(values(ax, "speed"), speed[:, 0])
    np.testing.assert_array_equal(values(ax, "y"), log.state[:, 0, V + 1])
    both = panels(figures.speed_figure(log))["speed [m/s]"]
    np.testing.assert_array_equal(values(both, log.names[1]), speed[:, 1])


def test_separation_shows_what_is_required() -> None:
    log = flight(3, duration=12.0)
    (ax,) = figures.separation_figure(log).axes
    finite = np.isfinite(log.separation)
    drawn = values(ax, "closest two vehicles")
    np.testing.assert_array_equal(drawn[finite], log.separation[finite])
    assert np.isnan(drawn[~finite]).all()
    assert (~finite).any()
    assert values(ax, "required, 0.90 m").tolist() == [0.9, 0.9]
    least = float(log.separation.min())
    assert values(ax, f"least, {least:.2f} m").tolist() == [least]
    low, high = ax.get_ylim()
    assert low == 0.0
    assert high > 0.9
    far = np.where(np.arange(len(log.time)) < 40, 1.0, 500.0)
    (ax,) = figures.separation_figure(flight(3, duration=12.0, separation=far)).axes
    assert ax.get_ylim()[1] == pytest.approx(8 * 0.9)
    drawn = values(ax, "closest two vehicles")
    assert np.flatnonzero(np.isnan(drawn)).tolist() == [40]  # no vehicle moves so fast: another pair is the closest
    np.testing.assert_array_equal(np.delete(drawn, 40), far)


def test_scores_and_events(make_deployment: MakeDeployment) -> None:
    deployment = make_deployment()
    log = flight_of(deployment, duration=12.0)
    figure = figures.score_figure(log, deployment)
    ax = panels(figure)["score of the team"]
    np.testing.assert_array_equal(values(ax, "at committed poses"), log.score_committed)
    np.testing.assert_array_equal(values(ax, "as flown"), log.score_flown)
    assert values(ax, f"at the end {deployment.score.final:.2f}")[0] == deployment.score.final
    assert deployment.bound is not None
    assert values(ax, f"at most {deployment.bound.team_upper_bound:.2f}")[0] == deployment.bound.team_upper_bound
    rows = figure.axes[1]
    assert [text.get_text() for text in rows.get_yticklabels()] == ["take-off", "reached", "trade"]
    trades = [event.time for event in log.events if event.kind == "trade"]
    assert np.asarray(line(rows, "trade").get_xdata()).tolist() == trades


def test_events_of_every_kind_have_a_row() -> None:
    kinds = [*EVENT_MARKS, "something new"]
    events = tuple(FlightEvent(float(i), kind, (), kind) for i, kind in enumerate(kinds))
    figure = figures.score_figure(flight(2, duration=12.0, events=events))
    labels = [text.get_text() for text in figure.axes[1].get_yticklabels()]
    assert len(labels) == len(kinds)
    assert labels[-1] == "something new"
    assert len(figures.score_figure(flight(2, duration=12.0, events=())).axes) == 1


def test_altitude_thrust_tilt_and_heading() -> None:
    log = flight(2, duration=12.0)
    ax = panels(figures.altitude_figure(log))["altitude [m]"]
    np.testing.assert_array_equal(values(ax, log.names[1]), log.state[:, 1, P + 2])
    ax = panels(figures.command_figure(log, 1))["thrust [m/s²]"]
    np.testing.assert_array_equal(values(ax, log.names[1]), log.command[:, 1, 0])
    turned = flight(1, duration=1.0)
    angle, tilt = 0.7, 0.3
    turned.state[:, 0, 6:10] = [
        np.cos(angle / 2) * np.cos(tilt / 2),
        -np.sin(angle / 2) * np.sin(tilt / 2),
        np.cos(angle / 2) * np.sin(tilt / 2),
        np.sin(angle / 2) * np.cos(tilt / 2),
    ]
    np.testing.assert_allclose(yaws(turned), angle)
    np.testing.assert_allclose(tilts(turned), tilt)


def test_paths_from_above_and_in_space() -> None:
    log = flight(3, duration=12.0, objects=1)
    plan, space = (ax for ax in figures.paths_figure(log).axes if ax.get_xlabel())
    for index, name in enumerate(log.names):
        path = line(plan, name)
        np.testing.assert_array_equal(np.asarray(path.get_data()).T, log.state[:, index, P : P + 2])
        drawn: Any = line(space, name)
        np.testing.assert_array_equal(np.array(drawn.get_data_3d()).T, log.state[:, index, P : P + 3])
    assert plan.get_aspect() == 1.0
    assert plan.get_xlabel() == "x [m]"
    solid: Any = space
    for axis, limits in enumerate((solid.get_xlim(), solid.get_ylim(), solid.get_zlim())):
        assert limits[0] <= log.objects[..., axis].min()
        assert log.objects[..., axis].max() <= limits[1]
    low, high = plan.get_xlim()
    assert low < log.objects[:, 0, 0].min() - 0.5
    assert high > log.objects[:, 0, 0].max() + 0.5


def test_obstacles_are_drawn_where_they_are() -> None:
    ball = Sphere((20.0, 2.0, 1.5), 0.7)
    others: list[Obstacle] = [
        Box((-3.0, -3.0, 0.0), (-1.0, -2.2, 5.0)),
        Prism(((2.0, 1.0), (3.0, 1.0), (2.5, 2.5)), 0.0, 2.0),
    ]
    log = flight(2, duration=12.0)
    figure = figures.paths_figure(log, obstacles=[ball, *others])
    shapes = [list(patch.get_path().get_extents().extents) for patch in figure.axes[0].patches]
    assert [-3.0, -3.0, -1.0, -2.2] in shapes
    assert [2.0, 1.0, 3.0, 2.5] in shapes
    np.testing.assert_allclose(shapes[0], [19.3, 1.3, 20.7, 2.7], atol=1e-9)
    assert figure.axes[0].get_xlim()[1] > 20.7
    ring, bottom, top = outline(ball)
    np.testing.assert_allclose(np.linalg.norm(ring - [20.0, 2.0], axis=1), 0.7)
    assert (bottom, top) == pytest.approx((0.8, 2.2))


def test_frame_of_a_vehicle_that_stays_where_it_is() -> None:
    state = np.zeros((11, 1, 13))
    state[:, :, 6] = 1.0
    log = flight(1, duration=1.0, state=state, goal=np.full((11, 1, 4), np.nan))
    frame = plan_frame(log, None)
    assert frame.x[0] < 0.0 < frame.x[1]
    assert figures.paths_figure(log).axes


NAMES = [
    "overview",
    "paths",
    "position",
    "position-error",
    "velocity-error",
    "lyapunov",
    "altitude",
    "speed",
    "commands",
]


@pytest.mark.parametrize(
    ("n", "scored", "more"),
    [(1, False, set()), (3, False, {"separation"}), (3, True, {"separation", "score"}), (1, True, {"score"})],
)
def test_figures_that_make_sense(n: int, scored: bool, more: set[str]) -> None:
    made = figures.flight_figures(flight(n, duration=8.0, scored=scored))
    assert next(iter(made)) == "overview"
    assert set(made) == {*NAMES, *more}


@pytest.mark.parametrize("agents", [1, 16, 40])
def test_every_vehicle_is_seen_and_nothing_overlaps(agents: int, make_deployment: MakeDeployment) -> None:
    deployment = make_deployment(agents=agents)
    log = flight_of(deployment, duration=20.0)
    figure = figures.flight_overview(log, deployment)
    image = pixels(figure)
    for name, colour in zip(log.names, colours(log.names), strict=True):
        assert np.count_nonzero(image == int(colour[1:], 16)) > 40, name
    check_layout(figure)
    check_layout(figures.paths_figure(log, deployment))
    check_layout(figures.position_figure(log))
    check_layout(figures.score_figure(log, deployment))


def check_layout(figure: Figure) -> None:
    """Titles, legends and labels lie on the page, and titles and legends do not cover each other or a panel."""
    canvas: Any = figure.canvas
    canvas.draw()
    renderer = canvas.get_renderer()
    page = figure.bbox
    boxes = [text.get_window_extent(renderer) for text in figure.texts]
    for ax in figure.axes:
        legend = ax.get_legend()
        if legend is not None:
            boxes.append(legend.get_window_extent(renderer))
        for label in (ax.xaxis.label, ax.yaxis.label):
            if label.get_text() and ax.name != "3d":
                boxes.append(label.get_window_extent(renderer))
        if ax.axison and ax.name != "3d":
            boxes.append(ax.get_window_extent(renderer))
    for index, box in enumerate(boxes):
        assert box.x0 >= page.x0
        assert box.x1 <= page.x1
        assert box.y0 >= page.y0
        assert box.y1 <= page.y1
        for other in boxes[:index]:
            across = min(box.x1, other.x1) - max(box.x0, other.x0)
            up = min(box.y1, other.y1) - max(box.y0, other.y0)
            assert min(across, up) < 3.0, (box, other)


def test_odd_names_are_drawn_as_they_are() -> None:
    log = flight(3, duration=8.0, names=("$x^2$", "相机\n", "a" * 90))
    for figure in (figures.flight_overview(log), figures.position_figure(log, 1)):
        assert len(np.unique(pixels(figure))) > 3


def test_the_same_log_gives_the_same_picture(make_deployment: MakeDeployment) -> None:
    deployment = make_deployment()
    log = flight_of(deployment, duration=8.0)
    files = [io.BytesIO(), io.BytesIO()]
    for file in files:
        save_figure(figures.score_figure(log, deployment), file, kind="pdf")
    assert files[0].getvalue() == files[1].getvalue()
    assert files[0].getvalue().startswith(b"%PDF")


def cut(log: FlightLog, moments: int) -> FlightLog:
    samples = {name: value for name, value in vars(log).items() if np.ndim(value) and len(value) == len(log.time)}
    arrays = {name: value[:moments] for name, value in samples.items()}
    return FlightLog(**{**vars(log), **arrays})


@pytest.mark.parametrize("moments", [0, 1])
def test_empty_log(moments: int) -> None:
    log = cut(flight(2, duration=8.0), moments)
    with pytest.raises(ArgumentError, match=f"got {moments} moments of 2 vehicles"):
        figures.flight_figures(log)
    with pytest.raises(ArgumentError, match="record a flight first"):
        figures.position_figure(log, 0)


def test_bad_requests() -> None:
    log = flight(1, duration=8.0, scored=False)
    for wrong in (1, -1, "nobody"):
        with pytest.raises(ArgumentError, match=f"vehicle: expected an index below 1 .* got {wrong!r}"):
            figures.position_figure(log, wrong)
    with pytest.raises(ArgumentError, match="which: expected 'position' or 'velocity', got 'speed'"):
        figures.error_figure(log, 0, "speed")
    with pytest.raises(ArgumentError, match="two vehicles in the air"):
        figures.separation_figure(log)
    with pytest.raises(ArgumentError, match="a flight without a mission"):
        figures.score_figure(log)
