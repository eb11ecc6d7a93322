"""The documentation's pictures are what the program draws now; `make images` draws them anew."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from covey.mission import load_mission
from covey.runtime.drawing.figures import deployment_figure, save_figure
from covey.runtime.drawing.flight_figures import flight_overview
from covey.runtime.fly import fly
from covey.runtime.plan import plan

ROOT = Path(__file__).parents[2]
CLOSE = 0.01
"""Results differ a little from processor to processor, and so may how many trades it took."""

NUMBER = re.compile(r"-?\d+(?:\.\d+)?")


def words(file: Path) -> str:
    """What is written at the head of a picture."""
    with Image.open(file) as image:
        return str(image.info["Description"])


@pytest.mark.parametrize("name", ["deployment", "flight"])
def test_the_head_of_a_picture_says_what_the_program_finds_today(name: str, tmp_path: Path) -> None:
    mission = load_mission(ROOT / "examples" / "thesis-5.1.yaml")
    if name == "deployment":
        figure = deployment_figure(plan(mission))
    else:
        flight = fly(mission, vehicles="mujoco")
        figure = flight_overview(flight.log, flight.deployment, obstacles=flight.obstacles)
    save_figure(figure, tmp_path / "now.png")
    now, shown = words(tmp_path / "now.png"), words(ROOT / "docs" / "images" / f"{name}.png")
    assert NUMBER.sub("#", now) == NUMBER.sub("#", shown)
    found, drawn = ([float(text) for text in NUMBER.findall(head) if "." in text] for head in (now, shown))
    np.testing.assert_allclose(found, drawn, rtol=CLOSE)
