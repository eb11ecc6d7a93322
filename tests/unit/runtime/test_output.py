"""Directories that are written whole or not at all."""

from __future__ import annotations

import os
import time
from pathlib import Path

import pytest

from covey.errors import OutputError
from covey.runtime.records.output import ABANDONED, check_target, staged


def leave(folder: Path, name: str, age: float) -> Path:
    """Make what a killed process leaves."""
    left = folder / name
    left.mkdir()
    file = left / "flight.mp4"
    file.write_bytes(b"half a film")
    then = time.time() - age
    for path in (file, left):
        os.utime(path, (then, then))
    return left


def test_what_killed_processes_left_is_removed_and_nothing_else(tmp_path: Path) -> None:
    abandoned = leave(tmp_path, ".covey-77-0123abcd", 2.0 * ABANDONED)
    at_work = leave(tmp_path, ".covey-78-0123abcd", 0.0)
    foreign = leave(tmp_path, ".covey-mine", 2.0 * ABANDONED)
    still_written = leave(tmp_path, ".covey-79-0123abcd", 2.0 * ABANDONED)
    os.utime(still_written / "flight.mp4")
    with staged(tmp_path / "out", ["a"]) as folder:
        (folder / "a").write_text("a")
    assert not abandoned.exists()
    assert all(path.exists() for path in (at_work, foreign, still_written))
    assert (tmp_path / "out" / "a").read_text() == "a"


def test_what_a_killed_process_left_is_in_nobodys_way(tmp_path: Path) -> None:
    leave(tmp_path, ".covey-77-0123abcd", 0.0)
    check_target(tmp_path, ["a"], lambda _: False, overwrite=False)
    (tmp_path / "b").touch()
    with pytest.raises(OutputError, match="is not empty"):
        check_target(tmp_path, ["a"], lambda _: False, overwrite=False)
