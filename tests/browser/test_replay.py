"""The same page plays records: from the server, and from a file without any network."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from tests.browsing import Feed, Serve, Shown, expected_cells, views_by_event

from covey.playground.offline import feed_bytes, offline_page
from covey.playground.server import STATIC
from covey.runtime.watching.feed import Scene, TeamChange
from covey.runtime.watching.view import TeamView

Show = Callable[..., Shown]


def test_any_place_of_a_record_shows_what_playing_up_to_it_shows(
    show: Show, serve: Serve, flown: Feed, flight_record: bytes
) -> None:
    shown = show(serve(record=flight_record).public_url)
    for moment in np.random.default_rng(0).permutation(np.linspace(0.0, 10.0, 12)):
        shown.seek(float(moment))
        view = TeamView()
        for item in flown:
            if isinstance(item, Scene) or item.time <= moment:
                view.apply(item)
        state = shown.state()
        assert state["owner"] == view.owner.tolist()
        assert state["trading"] == np.flatnonzero(view.trading).tolist()
        assert state["trades"] == view.trades
        assert state["score"] == pytest.approx(view.score)
        assert state["obstacles"] == len(view.obstacles)
        np.testing.assert_allclose(np.reshape(state["poses"], (-1, 7)), view.poses)


def test_steps_and_jumps_find_the_next_event_and_the_next_trade(
    show: Show, serve: Serve, planned: Feed, plan_record: bytes
) -> None:
    shown = show(serve(record=plan_record).public_url)
    steps = views_by_event(planned)
    trades = [number for number, item, _ in steps if isinstance(item, TeamChange) and item.kind.value == "trade"]
    page = shown.page
    for trade in trades[:3]:
        page.keyboard.press("n")
        assert shown.settle().state()["x"] == trade
    page.keyboard.press("p")
    assert shown.settle().state()["x"] == trades[1]
    page.keyboard.press(".")
    assert shown.settle().state()["x"] == trades[1] + 1
    page.keyboard.press(",")
    assert shown.settle().state()["x"] == trades[1]
    page.get_by_role("button", name="Next trade").click()
    assert shown.settle().state()["x"] == trades[2]
    page.keyboard.press("End")
    assert shown.settle().state()["x"] == len(steps)
    page.locator("#status", has_text="certificate holds").wait_for()
    page.get_by_label("trades only").check()
    page.locator("#log li:not([data-kind=trade])").first.wait_for(state="detached")
    assert page.locator("#log li[data-kind=trade]").count() == len(trades)


def test_it_plays_and_pauses(show: Show, serve: Serve, flight_record: bytes) -> None:
    shown = show(serve(record=flight_record, speed=4.0).public_url)
    page = shown.page
    assert page.get_by_label("Speed").input_value() == "4"
    page.keyboard.press("Space")
    shown.wait(lambda state: state["x"] > 1.0)
    page.keyboard.press("Space")
    shown.settle()
    held = shown.state()["x"]
    page.wait_for_timeout(200)
    assert shown.state()["x"] == held
    page.keyboard.press(">")
    assert page.get_by_label("Speed").input_value() == "8"
    page.keyboard.press("Space")
    shown.wait(lambda state: state["x"] == 10.0)
    page.get_by_role("button", name="Play", exact=True).wait_for()


def test_a_click_on_the_score_curve_goes_there(show: Show, serve: Serve, flight_record: bytes) -> None:
    shown = show(serve(record=flight_record).public_url)
    chart = shown.page.locator("#chart")
    box = chart.bounding_box()
    assert box is not None
    chart.click(position={"x": box["width"] / 2, "y": box["height"] / 2})
    assert math.isclose(shown.settle().state()["x"], 5.0, abs_tol=0.6)


def test_the_score_curve_is_read_out_under_the_pointer(show: Show, serve: Serve, flight_record: bytes) -> None:
    shown = show(serve(record=flight_record).public_url)
    picture = "() => document.getElementById('chart').toDataURL()"
    chart = shown.page.locator("#chart")
    shown.page.wait_for_timeout(500)  # nothing happens any more
    before = shown.page.evaluate(picture)
    chart.hover(position={"x": 200, "y": 60})
    assert shown.settle().page.evaluate(picture) != before
    shown.page.mouse.move(5, 5)
    assert shown.settle().page.evaluate(picture) == before


def test_a_file_from_the_disk_plays_without_a_network(
    show: Show, tmp_path: Path, planned: Feed, plan_record: bytes
) -> None:
    file = tmp_path / "replay.html"
    file.write_text(offline_page(plan_record), encoding="utf-8")
    shown = show(file.as_uri(), offline=True)
    number, _, view = views_by_event(planned)[-1]
    shown.seek(number)
    scene = next(item for item in planned if isinstance(item, Scene))
    np.testing.assert_allclose(shown.cells(scene), expected_cells(view), atol=1)
    shown.page.keyboard.press("3")
    shown.page.locator("#scene3d canvas").wait_for()


def test_the_built_page_alone_says_what_to_do(show: Show) -> None:
    shown = show((STATIC / "index.html").as_uri(), wait=False)
    shown.page.get_by_text("covey replay RECORD --html FILE").wait_for()


def test_an_empty_record_is_said_to_be_empty(show: Show, tmp_path: Path) -> None:
    file = tmp_path / "empty.html"
    file.write_text(offline_page(feed_bytes(())), encoding="utf-8")
    shown = show(file.as_uri(), wait=False)
    shown.page.get_by_text("This record is empty.").wait_for()
