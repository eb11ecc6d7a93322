"""Colours for agents that people with any colour vision can tell apart.

Up to eight agents get the colours of Okabe and Ito; further ones are chosen one by one so that each lies as far as can
be from all before it, for normal vision, protanopia, deuteranopia and tritanopia alike.  With many agents no palette is
enough, so figures also draw each agent's number.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

OKABE_ITO = {
    "blue": "#0072B2",
    "orange": "#E69F00",
    "green": "#009E73",
    "pink": "#CC79A7",
    "sky": "#56B4E9",
    "red": "#D55E00",
    "yellow": "#F0E442",
    "grey": "#555555",
}
"""The palette of Okabe and Ito (2008), its black softened so that black pose marks can be seen on it."""

SYNONYMS = {
    "purple": "pink", "magenta": "pink", "violet": "pink", "vermillion": "red",
    "cyan": "sky", "gray": "grey", "black": "grey",
}  # fmt: skip

VISIONS: dict[str, NDArray[np.float64]] = {
    "normal": np.eye(3),
    "protanopia": np.array(
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]]
    ),
    "deuteranopia": np.array(
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]]
    ),
    "tritanopia": np.array(
        [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]]
    ),
}
"""What each kind of colour vision makes of linear RGB: Machado, Oliveira and Fernandes (2009), severity 1."""

_OKLAB_LMS = np.array(
    [[0.4122214708, 0.5363325363, 0.0514459929], [0.2119034982, 0.6806995451, 0.1073969566],
     [0.0883024619, 0.2817188376, 0.6299787005]]
)  # fmt: skip
_OKLAB = np.array(
    [[0.2104542553, 0.7936177850, -0.0040720468], [1.9779984951, -2.4285922050, 0.4505937099],
     [0.0259040371, 0.7827717662, -0.8086757660]]
)  # fmt: skip


def colours(names: Sequence[str]) -> tuple[str, ...]:
    """Choose a colour for each agent.

    An agent that is called by the name of a colour (``blue``, ``red``, ...) gets that colour where it is free.

    Parameters
    ----------
    names : sequence of str
        The agents' names.

    Returns
    -------
    tuple of str
        One ``#rrggbb`` an agent, all different.

    Examples
    --------
    >>> colours(["north", "blue"])
    ('#E69F00', '#0072B2')
    """
    wanted = [SYNONYMS.get(name.casefold(), name.casefold()) for name in names]
    chosen: dict[int, str] = {}
    for index, name in enumerate(wanted):
        colour = OKABE_ITO.get(name)
        if colour is not None and colour not in chosen.values():
            chosen[index] = colour
    free = [colour for colour in distinct(len(names) + len(chosen)) if colour not in chosen.values()]
    left = iter(free)
    return tuple(chosen[index] if index in chosen else next(left) for index in range(len(names)))


@functools.lru_cache(maxsize=8)
def distinct(n: int) -> tuple[str, ...]:
    """Return n different colours, those of Okabe and Ito first, as ``#rrggbb``."""
    first = list(OKABE_ITO.values())
    if n <= len(first):
        return tuple(first[:n])
    levels = np.arange(0.0, 1.01, 0.1)
    candidates = np.stack(np.meshgrid(levels, levels, levels), axis=-1).reshape(-1, 3)
    seen = {vision: perceived(candidates, vision) for vision in VISIONS}
    # Neither so dark that a black mark is lost on it, nor so light that it reads as paper.
    lightness = seen["normal"][:, 0]
    usable = (lightness > 0.45) & (lightness < 0.93)
    nearest = np.where(usable, np.inf, -np.inf)
    chosen = [rgb(colour) for colour in first]
    for colour in chosen:
        nearest = np.minimum(nearest, _distance(seen, colour))
    while len(chosen) < n:
        index = int(np.argmax(nearest))
        chosen.append(candidates[index])
        nearest = np.minimum(nearest, _distance(seen, candidates[index]))
        nearest[index] = -np.inf
    return tuple(_hex(colour) for colour in chosen)


def perceived(colour: NDArray[np.float64], vision: str = "normal") -> NDArray[np.float64]:
    """Return how a kind of vision (a key of `VISIONS`) perceives sRGB colours, shape (..., 3) in [0, 1], in OKLab.

    The distance of two colours in OKLab tells how different they look; 0.02 is about the smallest that anyone notices.
    """
    linear = np.where(colour <= 0.04045, colour / 12.92, ((colour + 0.055) / 1.055) ** 2.4)
    cones = np.clip(linear @ VISIONS[vision].T, 0.0, 1.0) @ _OKLAB_LMS.T
    oklab: NDArray[np.float64] = np.cbrt(cones) @ _OKLAB.T
    return oklab


def rgb(colour: str) -> NDArray[np.float64]:
    """Return the sRGB value of ``#rrggbb``, shape (3,), in [0, 1]."""
    return np.array([int(colour[i : i + 2], 16) / 255.0 for i in (1, 3, 5)])


def is_light(colour: str) -> bool:
    """Whether dark text reads better on this colour than white."""
    return bool(perceived(rgb(colour))[0] > 0.62)


def _distance(seen: dict[str, NDArray[np.float64]], colour: NDArray[np.float64]) -> NDArray[np.float64]:
    """Smallest distance over all kinds of vision from each candidate to a colour."""
    distances = [np.linalg.norm(lab - perceived(colour, vision), axis=-1) for vision, lab in seen.items()]
    smallest: NDArray[np.float64] = np.min(distances, axis=0)
    return smallest


def _hex(colour: NDArray[np.float64]) -> str:
    return "#" + "".join(f"{round(float(value) * 255):02X}" for value in colour)
