"""The 3-D view and the projector."""

from __future__ import annotations

from collections.abc import Callable
from io import BytesIO

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image
from tests.browsing import Serve, Shown

Show = Callable[..., Shown]

CORNERS = """() => {
  const sheet = document.querySelector('#projector .sheet');
  const matrix = new DOMMatrix(sheet.style.transform);
  const [w, h] = [sheet.offsetWidth, sheet.offsetHeight];
  return [[0, 0], [w, 0], [w, h], [0, h], [w / 2, h / 2]].map(([x, y]) => {
    const to = matrix.transformPoint(new DOMPoint(x, y));
    return [to.x / to.w, to.y / to.w];
  });
}"""
"""Where the sheet's corners and its middle are on the screen."""


NO_WEBGL = """
const get = HTMLCanvasElement.prototype.getContext;
HTMLCanvasElement.prototype.getContext = function (kind, ...more) {
  return kind.startsWith('webgl') ? null : get.call(this, kind, ...more);
};
"""

EXACT = 0.1
"""Pixels: the page's transformation is read back with six digits."""


def corners(shown: Shown) -> NDArray[np.float64]:
    return np.array(shown.page.evaluate(CORNERS))


def projector(show: Show, url: str) -> Shown:
    shown = show(f"{url}#projector", wait=False)
    shown.page.locator("#projector .sheet canvas[data-layer=cells]").wait_for()
    return shown.settle()


def test_vehicles_are_seen_in_three_dimensions(show: Show, serve: Serve, flight_record: bytes) -> None:
    shown = show(serve(record=flight_record).public_url, width=900, height=700)
    page = shown.page
    shown.seek(5.0)
    page.get_by_role("button", name="3-D").click()
    canvas = page.locator("#scene3d canvas")
    canvas.wait_for()
    assert page.locator("#map").is_hidden()
    shown.settle()
    first = canvas.screenshot()
    shown.seek(8.0)
    shown.settle()
    assert canvas.screenshot() != first
    page.keyboard.press("3")
    assert page.locator("#map").is_visible()


def test_without_webgl_the_map_stays_and_a_message_says_why(show: Show, serve: Serve, flight_record: bytes) -> None:
    shown = show(serve(record=flight_record).public_url, script=NO_WEBGL)
    page = shown.page
    page.keyboard.press("3")
    page.get_by_text("no WebGL").wait_for()
    assert page.locator("#map").is_visible()
    assert shown.seek(5.0).state()["x"] == 5.0


def test_the_projector_shows_nothing_but_the_map_and_keeps_its_corners(
    show: Show, serve: Serve, plan_record: bytes
) -> None:
    server = serve(record=plan_record)
    shown = projector(show, server.public_url)
    page = shown.page
    assert page.get_by_text("Mark the corners").is_visible()
    fitted = corners(shown)
    page.keyboard.press("2")
    for _ in range(5):
        page.keyboard.press("Shift+ArrowLeft")
    page.keyboard.press("ArrowDown")
    page.keyboard.press("Alt+ArrowDown")
    by_keys = corners(shown)
    np.testing.assert_allclose(by_keys[1] - fitted[1], [-50.0, 1.25], atol=EXACT)
    np.testing.assert_allclose(by_keys[[0, 2, 3]], fitted[[0, 2, 3]], atol=EXACT)
    handle = page.get_by_role("button", name="lower left corner")
    box = handle.bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + 22, box["y"] + 22)
    page.mouse.down()
    page.mouse.move(300, 700, steps=4)
    page.mouse.up()
    placed = corners(shown)
    np.testing.assert_allclose(placed[3], [300.0, 700.0], atol=1.0)
    # A projective map takes the middle to where the diagonals cross.
    a, b, c, d, middle = placed
    along = np.linalg.solve(np.array([c - a, b - d]).T, b - a)
    np.testing.assert_allclose(middle, a + along[0] * (c - a), atol=2 * EXACT)
    page.keyboard.press("c")
    assert page.locator("#projector .corner").count() == 0
    assert page.locator("canvas[data-layer=grid]").is_hidden()
    for selector in ("#bar", "#side", "#player"):
        box = page.locator(selector).bounding_box()
        assert box is not None
        centre = [box["x"] + box["width"] / 2, min(box["y"] + box["height"] / 2, 790)]
        assert page.evaluate("([x, y]) => document.elementFromPoint(x, y).closest('#projector') !== null", centre)
    page.reload()
    page.locator("#projector .sheet canvas[data-layer=cells]").wait_for()
    shown.settle()
    np.testing.assert_allclose(corners(shown), placed, atol=1e-6)
    assert page.locator("#projector .corner").count() == 0


def test_corners_that_would_turn_the_picture_inside_out_are_not_taken(
    show: Show, serve: Serve, plan_record: bytes
) -> None:
    shown = projector(show, serve(record=plan_record).public_url)
    fitted = corners(shown)
    handle = shown.page.get_by_role("button", name="upper left corner")
    box = handle.bounding_box()
    assert box is not None
    shown.page.mouse.move(box["x"] + 22, box["y"] + 22)
    shown.page.mouse.down()
    shown.page.mouse.move(*fitted[2] + 50.0)
    shown.page.mouse.up()
    np.testing.assert_allclose(corners(shown), fitted, atol=1.5)


def test_what_is_remembered_of_the_corners_may_be_nonsense(show: Show, serve: Serve, plan_record: bytes) -> None:
    server = serve(record=plan_record)
    shown = projector(show, server.public_url)
    page = shown.page
    fitted = corners(shown)
    page.keyboard.press("ArrowLeft")
    (key,) = page.evaluate("() => Object.keys(localStorage).filter(key => key.startsWith('covey.keystone'))")
    for nonsense in ("[]", "{", "null", '[{"x":1}]', "[1,2,3,4]"):
        page.evaluate("([key, value]) => localStorage.setItem(key, value)", [key, nonsense])
        page.reload()
        page.locator("#projector .sheet canvas[data-layer=cells]").wait_for()
        np.testing.assert_allclose(corners(shown.settle()), fitted, atol=1e-6)


@pytest.mark.parametrize("landmark", [0, 210, 399])
def test_landmarks_are_where_the_corners_put_them(show: Show, serve: Serve, plan_record: bytes, landmark: int) -> None:
    """At true scale: with corners at known places each square metre is where it should be."""
    shown = projector(show, serve(record=plan_record).public_url)
    page = shown.page
    page.keyboard.press("c")
    a, _, c, _, _ = corners(shown)
    column, row = landmark % 20, landmark // 20
    x, y = (column + 0.2) / 20, 1 - (row + 0.2) / 20
    place = a + [x, y] * (c - a)
    shot = page.screenshot(clip={"x": place[0], "y": place[1], "width": 1, "height": 1})
    with Image.open(BytesIO(shot)) as image:
        colour = np.asarray(image.convert("RGB"))[0, 0]
    state = shown.state()
    expected = state["colours"][state["owner"][landmark]]
    np.testing.assert_allclose(colour, [int(expected[i : i + 2], 16) for i in (1, 3, 5)], atol=12)
