"""The Playground's page in a browser, and what is on it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from playwright.sync_api import Page

from covey.playground.server import PlaygroundServer
from covey.runtime.drawing.palette import rgb
from covey.runtime.watching.feed import NOBODY, Scene, TeamChange, Trading, Update
from covey.runtime.watching.view import TeamView

Feed: TypeAlias = Sequence[Scene | Update]

WHITE = (255, 255, 255)

FRAMES = "() => new Promise(done => requestAnimationFrame(() => requestAnimationFrame(() => done(null))))"

SAMPLE = """([layer, places]) => {
  const canvas = document.querySelector(`#map canvas[data-layer=${layer}]`);
  const box = canvas.getBoundingClientRect();
  const { width, height } = canvas;
  const copy = new OffscreenCanvas(width, height).getContext('2d', { willReadFrequently: true });
  copy.drawImage(canvas, 0, 0);
  const data = copy.getImageData(0, 0, width, height).data;
  return places.map(([x, y]) => {
    const at = window.covey.locate(x, y);
    const i = Math.floor((at.y - box.top) * height / box.height);
    const j = Math.floor((at.x - box.left) * width / box.width);
    const k = 4 * (i * width + j);
    return [data[k], data[k + 1], data[k + 2], data[k + 3]];
  });
}"""
"""Colours on a layer of the map at places in metres."""

SEEK = """x => {
  const bar = document.getElementById('scrub-input');
  bar.value = x;
  bar.dispatchEvent(new Event('input'));
}"""

Serve: TypeAlias = Callable[..., PlaygroundServer]


@dataclass
class Shown:
    """A page that shows a mission.

    Parameters
    ----------
    page : Page
    troubles : list of str
        What the page complained of, and what it asked for elsewhere.
    """

    page: Page
    troubles: list[str] = field(default_factory=list)

    def note(self, trouble: str, *, when: bool = True) -> None:
        """Remember what should not have happened."""
        if when:
            self.troubles.append(trouble)

    def ready(self) -> Shown:
        """Wait until there is something to see."""
        self.page.locator("#cover").wait_for(state="hidden")
        return self.settle()

    def settle(self) -> Shown:
        """Wait until what has happened is drawn."""
        self.page.evaluate(FRAMES)
        return self

    def wait(self, condition: Callable[[dict[str, Any]], bool], *, seconds: float = 20.0) -> dict[str, Any]:
        """Wait for a state of the page and return it."""
        for _ in range(math.ceil(seconds / 0.05)):
            state: dict[str, Any] | None = self.state()
            if state is not None and condition(state):
                self.settle()
                return state
            self.page.wait_for_timeout(50)
        raise AssertionError(f"not reached in {seconds} s: {self.state()}")

    def state(self) -> Any:
        """What the page says that it shows."""
        return self.page.evaluate("() => window.covey.state()")

    def seek(self, place: float) -> Shown:
        """Move the scrub bar."""
        self.page.evaluate(SEEK, str(place))
        return self.settle()

    def place(self, x: float, y: float) -> tuple[float, float]:
        """Where a point of frame W is on the page."""
        at = self.page.evaluate("([x, y]) => window.covey.locate(x, y)", [x, y])
        return at["x"], at["y"]

    def cells(self, scene: Scene) -> NDArray[np.int64]:
        """Colour on the screen of each landmark's cell, off its middle, where its number is: (n, 3)."""
        off = 0.33 * scene.cell_size
        places = [[float(x) - off, float(y) + off] for x, y, _ in scene.positions_W]
        return self.colours("cells", places)[:, :3]

    def colours(self, layer: str, places: Sequence[Sequence[float]]) -> NDArray[np.int64]:
        """Red, green, blue and opacity of a layer of the map at places in metres: (k, 4)."""
        return np.array(self.page.evaluate(SAMPLE, [layer, [list(map(float, place)) for place in places]]))

    def text(self, selector: str) -> str:
        """What is written there."""
        return self.page.locator(selector).inner_text()


def expected_cells(view: TeamView) -> NDArray[np.int64]:
    """The colour of each landmark's cell, as the thesis has it: its owner's, white while it is traded."""
    assert view.scene is not None
    assert (view.owner != NOBODY).all()
    palette = np.array([np.rint(255 * rgb(agent.colour)) for agent in view.scene.agents], dtype=np.int64)
    colours: NDArray[np.int64] = np.where(view.trading[:, None], WHITE, palette[view.owner])
    return colours


def views_by_event(feed: Feed) -> list[tuple[int, Scene | Update, TeamView]]:
    """Each change and offer of a plan with its number, and the state after it by the reducer in Python."""
    steps: list[tuple[int, Scene | Update, TeamView]] = []
    for end, item in enumerate(feed):
        if isinstance(item, TeamChange | Trading):
            view = TeamView()
            for earlier in feed[: end + 1]:
                view.apply(earlier)
            steps.append((len(steps) + 1, item, view))
    return steps
