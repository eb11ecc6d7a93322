"""Draw the pictures of the page in the documentation anew: ``python -m tests.browser.pictures``."""

from __future__ import annotations

import shutil
import sys
from pathlib import Path

from playwright.sync_api import Browser, Page, ViewportSize, sync_playwright
from tests.browser.conftest import ARGUMENTS
from tests.browsing import Feed, Shown

from covey.mission import load_mission
from covey.playground.offline import feed_bytes
from covey.playground.server import PlaygroundServer
from covey.runtime.fly import fly
from covey.runtime.plan import plan
from covey.runtime.watching.feed import Scene, Trading, Update

ROOT = Path(__file__).parents[2]
IMAGES = ROOT / "docs" / "images"
SIZE = ViewportSize(width=1280, height=800)


def main() -> int:
    """Plan, fly, and take the pictures."""
    chromium = shutil.which("chromium")
    if chromium is None:
        print("no chromium; on Debian: apt-get install chromium", file=sys.stderr)
        return 2
    mission = load_mission(ROOT / "examples" / "thesis-5.1.yaml")
    planned: list[Scene | Update] = []
    plan(mission, watch=planned.append)
    flown: list[Scene | Update] = []
    fly(mission, watch=flown.append)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=ARGUMENTS)
        _picture(browser, planned, "playground", scheme="light")
        _picture(browser, flown, "playground-flight", scheme="dark", at=0.55, keys="]")
        _picture(browser, flown, "playground-3d", scheme="light", at=0.55, keys="3")
        browser.close()
    return 0


def _picture(browser: Browser, feed: Feed, name: str, *, scheme: str, at: float = 0.0, keys: str = "") -> None:
    """Show a record at a share of its length, or during the last offer of many landmarks."""
    with PlaygroundServer(record=feed_bytes(feed)) as server:
        page = browser.new_page(viewport=SIZE, color_scheme="dark" if scheme == "dark" else "light")
        page.goto(server.public_url)
        shown = Shown(page).ready()
        place = at * _end(page) if at else _offer(feed)
        shown.seek(place)
        for key in keys:
            page.keyboard.press(key)
        page.wait_for_timeout(1500)
        page.screenshot(path=IMAGES / f"{name}.png")
        page.close()


def _end(page: Page) -> float:
    return float(page.locator("#scrub-input").get_attribute("max") or 0.0)


def _offer(feed: Feed) -> int:
    """Number of the event in the middle of which white is seen best."""
    events = [item for item in feed if type(item).__name__ in ("TeamChange", "Trading")]
    offers = [
        number
        for number, item in enumerate(events, 1)
        if isinstance(item, Trading) and item.open and 15 <= len(item.give) + len(item.want) <= 60
    ]
    return offers[-1]


if __name__ == "__main__":
    sys.exit(main())
