"""What every test gets: reproducible sweeps, Hypothesis profiles and figures without a screen."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import settings

os.environ.setdefault("MPLBACKEND", "Agg")

ROOT = Path(__file__).parents[1]

# No deadline: a kernel may be compiled in the middle of an example.  The blob replays a failure seen elsewhere.
settings.register_profile("test", deadline=None, max_examples=60, print_blob=True)
settings.register_profile("soak", deadline=None, max_examples=3000, print_blob=True)


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--soak", action="store_true", help="long seed sweeps and long fuzzing")


def pytest_configure(config: pytest.Config) -> None:
    settings.load_profile("soak" if config.getoption("--soak") else "test")


@pytest.fixture(scope="session")
def soak(request: pytest.FixtureRequest) -> bool:
    """Whether this is the long run."""
    return bool(request.config.getoption("--soak"))


@pytest.fixture(scope="session")
def seeds(soak: bool) -> Callable[[int, int], range]:
    """``seeds(few, many)``: the seeds of a sweep, few of them in `make test` and many in `make soak`."""
    return lambda few, many: range(many if soak else few)


@pytest.fixture(scope="session")
def root() -> Path:
    """The top folder of the project."""
    return ROOT
