from __future__ import annotations

import itertools

import numpy as np
import pytest

from covey.runtime.drawing.palette import OKABE_ITO, VISIONS, colours, distinct, is_light, perceived, rgb


def smallest_distance(palette: tuple[str, ...], vision: str) -> float:
    seen = [perceived(rgb(colour), vision) for colour in palette]
    return min(float(np.linalg.norm(a - b)) for a, b in itertools.combinations(seen, 2))


@pytest.mark.parametrize("vision", VISIONS)
@pytest.mark.parametrize(("n", "apart"), [(8, 0.07), (16, 0.07), (64, 0.03)])
def test_colours_differ_for_every_kind_of_vision(vision: str, n: int, apart: float) -> None:
    # In OKLab two colours side by side are told apart from about 0.02 on.
    assert smallest_distance(distinct(n), vision) > apart


def test_simulation_leaves_greys_alone_and_confuses_what_it_should() -> None:
    grey = np.array([0.5, 0.5, 0.5])
    for vision in VISIONS:
        assert perceived(grey, vision) == pytest.approx(perceived(grey), abs=1e-3)
    red, green = np.array([0.8, 0.2, 0.1]), np.array([0.42, 0.42, 0.1])
    apart = np.linalg.norm(perceived(red) - perceived(green))
    assert np.linalg.norm(perceived(red, "protanopia") - perceived(green, "protanopia")) < 0.5 * apart


def test_agents_called_by_a_colour_get_it() -> None:
    assert colours(["Blue", "red", "green", "yellow"]) == tuple(
        OKABE_ITO[name] for name in ("blue", "red", "green", "yellow")
    )


@pytest.mark.parametrize("names", [["a"], ["blue", "blue"], ["purple", "pink"], [f"agent {i}" for i in range(64)]])
def test_every_agent_has_a_colour_of_its_own(names: list[str]) -> None:
    chosen = colours(names)
    assert len(set(chosen)) == len(names)


def test_text_on_colours() -> None:
    assert is_light("#F0E442")
    assert not is_light("#0072B2")
