"""The map shows what is the case."""

from __future__ import annotations

import re
from collections.abc import Callable

import numpy as np
import pytest
from tests.browsing import WHITE, Feed, Serve, Shown, expected_cells, views_by_event

from covey.playground.offline import feed_bytes
from covey.playground.sample import sample_feed
from covey.runtime.watching.feed import Scene, TeamChange, Trading
from covey.runtime.watching.view import TeamView

Show = Callable[..., Shown]

CONTRASTS = [
    ("--ink", "--panel"), ("--ink", "--page"), ("--ink", "--paper"), ("--ink", "--chip"), ("--faint", "--panel"),
    ("--faint", "--paper"), ("--faint", "--chip"), ("--accent-ink", "--accent"), ("--good", "--panel"),
    ("--bad", "--panel"), ("--warn", "--panel"),
]  # fmt: skip
"""Colours of texts, and what they stand on."""


FOCUSED = """() => {
  const { id, dataset, title } = document.activeElement;
  return id || dataset.agent || title;
}"""


def scene_of(feed: Feed) -> Scene:
    return next(item for item in feed if isinstance(item, Scene))


def luminance(colour: str) -> float:
    channels = [int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)]
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in channels]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def test_cells_match_the_partition_after_every_change_and_are_white_during_every_trade(
    show: Show, serve: Serve, planned: Feed, plan_record: bytes
) -> None:
    shown = show(serve(record=plan_record).public_url, width=800, height=600)
    scene = scene_of(planned)
    steps = views_by_event(planned)
    assert sum(isinstance(item, TeamChange) and item.kind.value == "trade" for _, item, _ in steps) > 5
    white = 0
    for number, item, view in steps:
        shown.seek(number)
        cells = shown.cells(scene)
        np.testing.assert_allclose(cells, expected_cells(view), atol=1, err_msg=f"after event {number}")
        if isinstance(item, Trading) and item.open:
            white += int((cells == WHITE).all(axis=1).sum())
    assert white > 0


@pytest.mark.parametrize("landmarks", [150, 12_000])
def test_cells_match_however_large_they_are(show: Show, serve: Serve, landmarks: int) -> None:
    """As single shapes, and as one image with a pixel a cell."""
    feed = tuple(sample_feed(agents=5, landmarks=landmarks, seconds=2.0, rate=5.0))
    shown = show(serve(record=feed_bytes(feed)).public_url)
    shown.seek(1.1)
    view = TeamView()
    for item in feed:
        if isinstance(item, Scene) or item.time <= 1.1:
            view.apply(item)
    np.testing.assert_allclose(shown.cells(scene_of(feed)), expected_cells(view), atol=1)


def test_hovering_tells_of_landmark_and_agent(show: Show, serve: Serve, planned: Feed, plan_record: bytes) -> None:
    shown = show(serve(record=plan_record).public_url)
    scene = scene_of(planned)
    number, _, view = views_by_event(planned)[-1]
    shown.seek(number)
    landmark = int(
        np.argmax(np.linalg.norm(view.poses[:, None, :2] - scene.positions_W[None, :, :2], axis=2).min(axis=0))
    )
    owner = scene.agents[int(view.owner[landmark])]
    shown.page.mouse.move(*shown.place(*map(float, scene.positions_W[landmark, :2])))
    tip = shown.text("#tip")
    assert f"landmark {landmark}" in tip
    assert f"watched by {int(view.owner[landmark]) + 1} {owner.name}" in tip
    assert re.search(r"visibility 0\.\d\d", tip)
    shown.page.mouse.move(*shown.place(*map(float, view.poses[1, :2])))
    assert f"2 {scene.agents[1].name}" in shown.text("#tip")


def test_a_chosen_agent_shows_what_it_sees_and_whom_it_traded_with(
    show: Show, serve: Serve, planned: Feed, plan_record: bytes
) -> None:
    shown = show(serve(record=plan_record).public_url)
    scene = scene_of(planned)
    number, _, view = views_by_event(planned)[-1]
    shown.seek(number)
    shown.page.mouse.click(*shown.place(*map(float, view.poses[3, :2])))
    shown.page.locator("#card").wait_for()
    assert scene.agents[3].name in shown.text("#card")
    trades = [
        item for item in planned if isinstance(item, TeamChange) and item.kind.value == "trade" and 3 in item.agents
    ]
    for partner in {agent for trade in trades for agent in trade.agents} - {3}:
        times = sum(partner in trade.agents for trade in trades)
        assert f"{scene.agents[partner].name} ×{times}" in shown.text("#card .partners")
    # The brightest cell is the one that it sees best: cividis grows lighter all the way.
    shown.settle()
    light = shown.cells(scene).sum(axis=1)
    x, y, yaw = view.poses[3, 0], view.poses[3, 1], 2 * np.arctan2(view.poses[3, 6], view.poses[3, 3])
    ahead = (scene.positions_W[:, 0] - x) * np.cos(yaw) + (scene.positions_W[:, 1] - y) * np.sin(yaw)
    square = ((scene.positions_W[:, :2] - view.poses[3, :2]) ** 2).sum(axis=1)
    seen = np.maximum(0, ahead) / np.maximum(1, square)
    assert light[np.argmax(seen)] == light.max()
    assert np.corrcoef(np.argsort(np.argsort(seen)), np.argsort(np.argsort(light)))[0, 1] > 0.9
    shown.page.keyboard.press("Escape")
    shown.settle()
    np.testing.assert_allclose(shown.cells(scene), expected_cells(view), atol=1)


def test_the_map_moves_and_zooms_by_mouse_keys_and_fingers(show: Show, serve: Serve, plan_record: bytes) -> None:
    shown = show(serve(record=plan_record).public_url, has_touch=True)
    page = shown.page
    home = shown.place(0, 0), shown.place(1, 0)

    def scale() -> float:
        return shown.place(1, 0)[0] - shown.place(0, 0)[0]

    still = tuple(map(round, shown.place(1, 1)))  # the mouse is at whole pixels
    page.mouse.move(*still)
    page.mouse.wheel(0, -200)
    shown.settle()
    assert scale() > 1.2 * (home[1][0] - home[0][0])
    assert shown.place(1, 1) == pytest.approx(still, abs=1)
    page.mouse.down()
    page.mouse.move(still[0] + 60, still[1] + 30, steps=4)
    page.mouse.up()
    assert shown.place(1, 1) == pytest.approx((still[0] + 60, still[1] + 30), abs=2)
    page.keyboard.press("0")
    assert shown.place(0, 0) == pytest.approx(home[0])
    before = scale()
    page.keyboard.press("+")
    page.locator("#map").focus()
    page.keyboard.press("ArrowLeft")
    assert scale() == pytest.approx(1.25 * before)
    page.keyboard.press("0")
    session = page.context.new_cdp_session(page)
    x, y = home[0]
    for kind, apart in (("touchStart", 40), ("touchMove", 60), ("touchMove", 80), ("touchEnd", 0)):
        points = [{"x": x - apart, "y": y, "id": 1}, {"x": x + apart, "y": y, "id": 2}] if apart else []
        session.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})
    assert scale() == pytest.approx(2 * before, rel=0.1)


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_it_follows_the_system_into_the_dark_and_every_text_can_be_read(
    show: Show, serve: Serve, plan_record: bytes, scheme: str
) -> None:
    shown = show(serve(record=plan_record).public_url, color_scheme=scheme)
    page = shown.page
    assert page.locator("html").get_attribute("data-theme") == scheme
    names = sorted({name for pair in CONTRASTS for name in pair})
    read = "names => names.map(name => getComputedStyle(document.documentElement).getPropertyValue(name).trim())"
    colours = dict(zip(names, page.evaluate(read, names), strict=True))
    for text, ground in CONTRASTS:
        bright, dull = sorted((luminance(colours[text]), luminance(colours[ground])), reverse=True)
        assert (bright + 0.05) / (dull + 0.05) >= 4.5, (text, ground)
    page.keyboard.press("d")
    other = {"light": "dark", "dark": "light"}[scheme]
    assert page.locator("html").get_attribute("data-theme") == other
    page.reload()
    page.locator("#cover").wait_for(state="hidden")
    assert page.locator("html").get_attribute("data-theme") == other


def test_it_fits_a_phone(show: Show, serve: Serve, plan_record: bytes) -> None:
    shown = show(serve(record=plan_record).public_url, width=390, height=844, has_touch=True, is_mobile=True)
    page = shown.page
    assert page.evaluate("() => document.documentElement.scrollWidth") == 390
    for selector in ("#map", "#player", "#score"):
        box = page.locator(selector).bounding_box()
        assert box is not None
        assert box["x"] >= 0
        assert box["x"] + box["width"] <= 390.5
    for made in page.locator("#tools button, #player button").all():
        if made.is_visible():
            box = made.bounding_box()
            assert box is not None
            assert min(box["width"], box["height"]) >= 36
    page.touchscreen.tap(*shown.place(0, 0))
    page.locator("#tip").wait_for()


def test_keys_are_listed_and_all_can_be_reached_without_a_mouse(show: Show, serve: Serve, plan_record: bytes) -> None:
    shown = show(serve(record=plan_record).public_url)
    page = shown.page
    page.keyboard.press("?")
    page.locator("dialog#help").wait_for()
    assert "next trade" in shown.text("dialog#help")
    page.keyboard.press("Escape")
    reached = []
    for _ in range(30):
        page.keyboard.press("Tab")
        reached.append(page.evaluate(FOCUSED))
    order = [
        reached.index(name) for name in ("view3d", "help-button", "map", "0", "3", "only-trades", "log", "scrub-input")
    ]
    assert order == sorted(order)
    page.keyboard.press("]")
    assert page.locator("tr[aria-selected=true]").get_attribute("data-agent") == "0"


def test_flights_show_their_vehicles_and_paths(show: Show, serve: Serve, flown: Feed, flight_record: bytes) -> None:
    shown = show(serve(record=flight_record).public_url)
    shown.seek(9.0)
    state = shown.state()
    view = TeamView()
    for item in flown:
        if isinstance(item, Scene) or item.time <= 9.0:
            view.apply(item)
    assert view.motion is not None
    np.testing.assert_allclose(np.reshape(state["flown"], (-1, 7)), view.motion.poses)
    assert state["pathPoints"] > 50
    assert state["activity"] == view.activity.tolist()
    shown.page.locator("tr[data-agent='3']", has_text="dead").wait_for()
    assert shown.text("#agents thead").split() == [
        "#",
        "name",
        "state",
        "owns",
        "score",
        "m/s",
        "battery",
        "link",
        "heard",
    ]
