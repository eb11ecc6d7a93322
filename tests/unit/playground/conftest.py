"""A server with a page of one line."""

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from covey.playground.server import PlaygroundServer


@pytest.fixture
def static(tmp_path: Path) -> Path:
    """A built page."""
    (tmp_path / "index.html").write_text("<!doctype html><title>page</title>")
    (tmp_path / "app.js").write_text("'use strict';")
    return tmp_path


@pytest.fixture
def serve(static: Path) -> Iterator[Callable[..., PlaygroundServer]]:
    """Starts servers, and closes them."""
    with contextlib.ExitStack() as stack:
        yield lambda **options: stack.enter_context(PlaygroundServer(static=static, **options))
