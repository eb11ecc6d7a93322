"""Figures for a paper: right size, right fonts, only what a record has."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from numpy.typing import NDArray
from tests.unit.runtime.small import POLYGON, small
from tests.unit.runtime.test_telling import scene

from covey.errors import ArgumentError
from covey.runtime.drawing import map_drawing
from covey.runtime.drawing.figures import save_figure
from covey.runtime.drawing.map_drawing import draw_poses
from covey.runtime.drawing.record_figures import Kind, Story, record_figure
from covey.runtime.fly import fly
from covey.runtime.plan import plan
from covey.runtime.records.mcap_reader import Record
from covey.runtime.records.mcap_record import Recorder
from covey.runtime.watching.feed import Activity
from covey.runtime.watching.view import TeamView


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Story:
    path = tmp_path_factory.mktemp("record") / "record.mcap"
    with Recorder(path) as recorder:
        fly(scene(), vehicles="kinematic", watch=recorder)
    with Record(path) as record:
        return Story.of(record)


@pytest.fixture(scope="module")
def planned(tmp_path_factory: pytest.TempPathFactory) -> Story:
    path = tmp_path_factory.mktemp("record") / "record.mcap"
    with Recorder(path) as recorder:
        plan(small(region=POLYGON), watch=recorder, bound=True)
    with Record(path) as record:
        return Story.of(record)


def values(ax: Axes, line: int) -> list[float]:
    """Return the ordinates of a line."""
    return [float(value) for value in np.asarray(ax.lines[line].get_ydata())]


@pytest.mark.parametrize("kind", Kind)
@pytest.mark.parametrize("width", [88.0, 180.0])
def test_every_figure_is_as_wide_as_asked(flown: Story, kind: Kind, width: float, tmp_path: Path) -> None:
    figure = record_figure(flown, kind, width_mm=width)
    assert figure.get_size_inches()[0] * 25.4 == pytest.approx(width)
    for suffix in ("pdf", "svg", "png"):
        save_figure(figure, tmp_path / f"f.{suffix}")
        again = tmp_path / f"g.{suffix}"
        save_figure(record_figure(flown, kind, width_mm=width), again)
        assert (tmp_path / f"f.{suffix}").read_bytes() == again.read_bytes()
    assert b"/Type3" not in (tmp_path / "f.pdf").read_bytes()  # publishers take no fonts of type 3


def test_a_plan_has_no_figures_of_flight(planned: Story) -> None:
    assert planned.kinds == (Kind.DEPLOYMENT, Kind.SCORE, Kind.TRADES)
    for kind in planned.kinds:
        record_figure(planned, kind)
    with pytest.raises(ArgumentError, match="expected one of deployment, score, trades for this record, got tracking"):
        record_figure(planned, Kind.TRACKING)


def test_the_curves_are_those_of_the_record(flown: Story, planned: Story) -> None:
    score = record_figure(planned, Kind.SCORE).axes[0]
    expected = [float(planned.initial.scores.sum()), *(change.score for change in planned.changes)]
    assert values(score, 0) == expected
    assert values(score, -1)[0] == planned.view.bound
    separation = record_figure(flown, Kind.SEPARATION).axes[0]
    assert values(separation, 1)[0] == flown.scene.required_separation
    tracking = record_figure(flown, Kind.TRACKING).axes[0]
    assert [line.get_label() for line in tracking.lines] == ["blue", "red", "green"]
    assert float(np.asarray(tracking.lines[0].get_xdata())[-1]) <= flown.home


def test_who_has_left_is_not_on_the_map_and_what_changed_is_on_the_curve(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    changes = [{"leave": "blue"}, {"join": {"name": "grey", "pose": {"x_m": 0.0, "y_m": 0.0}}}, {"remove": [3]}]
    with Recorder(tmp_path / "record.mcap") as recorder:
        plan(scene(changes=changes), watch=recorder)
    with Record(tmp_path / "record.mcap") as record:
        story = Story.of(record)
    drawn: list[list[str]] = []

    def draw(*arguments: Any, **options: Any) -> NDArray[np.float64]:
        drawn.append(arguments[-1])
        return draw_poses(*arguments, **options)

    monkeypatch.setattr(map_drawing, "draw_poses", draw)
    record_figure(story, Kind.DEPLOYMENT)
    assert drawn == [["2", "3", "4"]]
    legend = record_figure(story, Kind.SCORE).axes[0].get_legend()
    assert legend is not None
    assert {"left", "joined", "landmarks changed"} <= {text.get_text() for text in legend.get_texts()}
    absent = replace(story, view=TeamView())
    absent.view.apply(story.scene)
    absent.view.activity[:] = Activity.GONE
    record_figure(absent, Kind.DEPLOYMENT)


@pytest.mark.parametrize("width", [10.0, 1000.0, float("nan")])
def test_widths_that_nobody_can_read_are_refused(planned: Story, width: float) -> None:
    with pytest.raises(ArgumentError, match="width_mm: expected from 50 to 400"):
        record_figure(planned, Kind.SCORE, width_mm=width)
