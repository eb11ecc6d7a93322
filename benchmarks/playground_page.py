"""The Playground's page in headless Chromium with software rendering: frames a second, and memory over an hour.

The frames depend on what else the machine does: `load` is how many processes wanted to run, beside `cpus` of them.
"""

from __future__ import annotations

import json
import os
import shutil
import statistics
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from playwright.sync_api import Browser, Page, WebSocketRoute, sync_playwright

from covey.playground.messages import Hello, encode
from covey.playground.sample import sample_feed
from covey.playground.server import PlaygroundServer
from covey.runtime.watching.feed import Ended, Motion, Scene

ARGUMENTS = ["--no-sandbox", "--disable-gpu"]
RATE = 30.0
"""Motions a second."""

WARM_UP = 3.0
WATCH = """seconds => new Promise(done => {
  const at = [];
  const before = window.covey.frames();
  const step = now => {
    at.push(now);
    if (now - at[0] < 1000 * seconds) requestAnimationFrame(step);
    else done({ at, drawn: window.covey.frames() - before });
  };
  requestAnimationFrame(step);
})"""
"""When frames were shown, and how many of them were drawn anew."""

DRAG = """() => {
  let k = 0;
  setInterval(() => {
    const [x, y] = [400 + 60 * Math.sin(0.1 * k), 400 + 60 * Math.cos(0.1 * k)];
    k++;
    const moved = new PointerEvent('pointermove', { pointerId: 1, clientX: x, clientY: y });
    document.getElementById('map').dispatchEvent(moved);
  }, 16);
}"""
"""Drag the map about in circles."""


def run(*, quick: bool = False) -> dict[str, Any]:
    """Return the figures."""
    chromium = shutil.which("chromium")
    if chromium is None:
        return {"skipped": "no chromium"}
    seconds = 4.0 if quick else 12.0
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=ARGUMENTS)
        results: dict[str, Any] = {
            name: _frames(browser, seconds=seconds, landmarks=landmarks, agents=100, gesture=gesture)
            for name, landmarks, gesture in (
                ("landmarks_10000", 10_000, False),
                ("landmarks_10000_dragged", 10_000, True),
                ("landmarks_100000", 100_000, False),
                ("landmarks_100000_dragged", 100_000, True),
            )
        }
        results["hour"] = _hour(browser, minutes=6 if quick else 60)
        browser.close()
    return results


def _frames(browser: Browser, *, seconds: float, landmarks: int, agents: int, gesture: bool) -> dict[str, float]:
    """Watch a made-up flight live, 30 motions and ten trades a second; `gesture`: while the map is dragged about."""
    feed = sample_feed(agents=agents, landmarks=landmarks, seconds=seconds + WARM_UP + 8.0, rate=RATE, trades=10.0)
    with PlaygroundServer() as server, _pump(feed, server):
        page = browser.new_page(viewport={"width": 1280, "height": 800})
        page.goto(server.public_url)
        page.locator("#cover").wait_for(state="hidden")
        page.wait_for_timeout(1000 * WARM_UP)
        if gesture:
            page.mouse.move(400, 400)
            page.mouse.down()
            page.evaluate(DRAG)
        before = _cpu(browser)
        told = page.evaluate(WATCH, seconds)
        used = _cpu(browser) - before
        page.close()
    gaps = sorted(b - a for a, b in zip(told["at"], told["at"][1:], strict=False))
    return {
        "drawn_per_s": round(told["drawn"] / seconds, 1),
        "frames_per_s": round(len(gaps) / seconds, 1),
        "gap_median_s": round(statistics.median(gaps) / 1000, 4),
        "gap_95_percent_s": round(gaps[int(0.95 * len(gaps))] / 1000, 4),
        "cpu_s_a_frame": round(used / max(1, told["drawn"]), 4),
        "load": round(os.getloadavg()[0], 1),
    }


def _cpu(browser: Browser) -> float:
    """Processor time of all of the browser's processes, seconds."""
    session = browser.new_browser_cdp_session()
    processes = session.send("SystemInfo.getProcessInfo")["processInfo"]
    session.detach()
    return float(sum(process["cpuTime"] for process in processes))


@contextmanager
def _pump(feed: Iterator[Any], server: PlaygroundServer) -> Iterator[None]:
    """Tell a server a feed at the speed of its own times."""
    over = threading.Event()
    scene, state = next(feed), next(feed)
    server.watch(scene)
    server.watch(state)

    def tell() -> None:
        started = time.monotonic()
        for item in feed:
            if over.wait(max(0.0, started + item.time - time.monotonic())) or isinstance(item, Ended):
                return
            server.watch(item)

    thread = threading.Thread(target=tell)
    thread.start()
    yield
    over.set()
    thread.join()


def _hour(browser: Browser, *, minutes: int) -> dict[str, Any]:
    """Tell a page an hour of a flight as fast as it takes it; its memory after each third, garbage collected."""
    lines: list[str] = []
    marks = [20 * minutes, 40 * minutes, 60 * minutes]
    feed = sample_feed(agents=16, landmarks=400, seconds=60.0 * minutes, rate=2.0, trades=0.5)

    def answer(socket: WebSocketRoute) -> None:
        socket.send(f"[{encode(Hello('live', False, ()))}]")
        sockets.append(socket)

    sockets: list[WebSocketRoute] = []
    with PlaygroundServer() as server:
        page = browser.new_page(viewport={"width": 1280, "height": 800})
        page.route_web_socket("**/api/feed", answer)
        page.goto(server.public_url)
        page.wait_for_timeout(500)
        heaps: list[float] = []
        for item in feed:
            lines.append(encode(item))
            moment = 0.0 if isinstance(item, Scene) else item.time
            # A frame each, so that none of the motions is left out as older than the newest.
            if isinstance(item, Motion) or len(lines) > 50:
                sockets[0].send(f"[{','.join(lines)}]")
                lines.clear()
                page.evaluate("() => new Promise(requestAnimationFrame)")
            if marks and moment >= marks[0] - 1:
                marks.pop(0)
                heaps.append(_heap(page))
        sizes = page.evaluate(
            "() => { const s = window.covey.state(); return [s.pathPoints, s.scorePoints, s.entries]; }"
        )
        page.close()
    return {"minutes": minutes, "heap_mb_after_each_third": heaps, "points_of_paths_curve_log": sizes}


def _heap(page: Page) -> float:
    session = page.context.new_cdp_session(page)
    session.send("HeapProfiler.collectGarbage")
    session.send("Performance.enable")
    metrics = session.send("Performance.getMetrics")["metrics"]
    session.detach()
    used = float(next(metric["value"] for metric in metrics if metric["name"] == "JSHeapUsedSize"))
    return round(used / 1e6, 2)


if __name__ == "__main__":
    print(json.dumps(run(quick=True), indent=2))
