"""Chromium, and servers for it to visit."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from playwright.sync_api import Browser, ConsoleMessage, Route, sync_playwright
from tests.browsing import Feed, Serve, Shown

from covey.mission import load_mission
from covey.playground.offline import feed_bytes
from covey.playground.sample import sample_feed
from covey.playground.server import PlaygroundServer
from covey.runtime.plan import plan
from covey.runtime.watching.feed import Scene, Update

ARGUMENTS = ["--no-sandbox", "--disable-gpu", "--enable-unsafe-swiftshader"]
"""As root in a container, without a graphics card, with WebGL in software."""


@pytest.fixture(scope="module")
def chromium() -> Iterator[Browser]:
    """A browser; not for the whole session, since its event loop keeps others from running in this thread."""
    path = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if path is None:
        pytest.skip("no Chromium to test the page in; on Debian: apt-get install chromium")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=ARGUMENTS)
        yield browser
        browser.close()


@pytest.fixture
def show(chromium: Browser) -> Iterator[Callable[..., Shown]]:
    """Opens pages, which may neither complain nor call anybody else.

    ``show(url, width=, height=, wait=, script=, **options of the context)``: `wait` until there is something to see;
    the `script` runs before the page's own.
    """
    with contextlib.ExitStack() as stack:
        opened: list[Shown] = []

        def open_page(
            url: str, *, width: int = 1280, height: int = 800, wait: bool = True, script: str = "", **options: Any
        ) -> Shown:
            context = chromium.new_context(viewport={"width": width, "height": height}, **options)
            stack.callback(context.close)
            shown = Shown(context.new_page())
            opened.append(shown)
            own = "file://" if url.startswith("file:") else url.partition("#")[0]

            def guard(route: Route) -> None:
                if route.request.url.startswith((own, "data:", "blob:")):
                    route.continue_()
                else:
                    shown.troubles.append(f"asked for {route.request.url}")
                    route.abort()

            context.route("**/*", guard)
            page = shown.page
            page.on("pageerror", lambda error: shown.note(f"error: {error}"))
            page.on("console", lambda message: shown.note(message.text, when=_complains(message)))
            page.on("websocket", lambda socket: shown.note(socket.url, when=not _is_own(socket.url, own)))
            if script:
                context.add_init_script(script)
            page.goto(url)
            return shown.ready() if wait else shown

        yield open_page
        for shown in opened:
            assert shown.troubles == []


def _complains(message: ConsoleMessage) -> bool:
    """Whether it is the page that complains, and not the driver of graphics about its speed."""
    return message.type in ("error", "warning") and not message.text.startswith("[.WebGL")


def _is_own(address: str, own: str) -> bool:
    return address.replace("ws:", "http:").startswith(own)


@pytest.fixture
def serve() -> Iterator[Serve]:
    """Starts servers, and closes them."""
    with contextlib.ExitStack() as stack:
        yield lambda **options: stack.enter_context(PlaygroundServer(**options))


@pytest.fixture(scope="session")
def planned(root: Path) -> Feed:
    """What planning the thesis's mission told."""
    feed: list[Scene | Update] = []
    plan(load_mission(root / "examples" / "thesis-5.1.yaml"), watch=feed.append)
    return feed


@pytest.fixture(scope="session")
def plan_record(planned: Feed) -> bytes:
    return feed_bytes(planned)


@pytest.fixture(scope="session")
def flown() -> Feed:
    """A made-up flight of ten seconds: 4 vehicles, an obstacle, trades, a death."""
    return tuple(sample_feed(agents=4, landmarks=150, seconds=10.0, rate=10.0))


@pytest.fixture(scope="session")
def flight_record(flown: Feed) -> bytes:
    return feed_bytes(flown)
