"""Directories of files that are written whole or not at all, and never over what covey did not write."""

from __future__ import annotations

import contextlib
import os
import re
import secrets
import shutil
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from covey.errors import OutputError

PARTIAL = ".partial.mcap"
"""End of the name of a record whose run goes on, or was killed; it is in nobody's way."""


STAGING = re.compile(r"\.covey-\d+-[0-9a-f]{8}")
"""Names of the folders in which files are made before they are moved to their place."""

ABANDONED = 3600.0
"""Such a folder in which nothing was written for so many seconds was left by a process that was killed."""


def check_target(target: Path, names: Sequence[str], is_ours: Callable[[Path], bool], *, overwrite: bool) -> None:
    """Check that files may be written into a directory, before any work is done.

    Parameters
    ----------
    target : Path
        The directory; it need not exist.
    names : sequence of str
        The files.
    is_ours : callable
        Whether a directory that has some of them got them from covey.
    overwrite : bool
        Whether those may be replaced.

    Raises
    ------
    OutputError
        If the directory holds something that would be overwritten, is a file, or cannot be made.
    """
    if "\0" in str(target):
        raise OutputError(f"{str(target)!r}: cannot be used as a directory: it has a null character")
    try:
        if not os.path.lexists(target):
            parent = next((folder for folder in target.absolute().parents if os.path.lexists(folder)), target)
            if not parent.is_dir() or not os.access(parent, os.W_OK | os.X_OK):
                raise OutputError(f"{target}: cannot be made in {parent}; choose another directory")
            return
        if not target.is_dir():
            raise OutputError(f"{target}: expected a directory, got a file; choose another one")
        names_there = sorted(entry.name for entry in target.iterdir())
        present = [name for name in names_there if not name.endswith(PARTIAL) and not STAGING.fullmatch(name)]
    except OSError as error:
        raise OutputError(f"{target}: cannot be used as a directory: {error}") from error
    if present and not overwrite:
        raise OutputError(
            f"{target}: is not empty; choose another directory, "
            "or replace an earlier result with --force (overwrite=True)"
        )
    taken = [name for name in present if name in names]
    if taken and not is_ours(target):
        raise OutputError(
            f"{target}: {taken[0]} was not written by covey, so it is not replaced; choose another directory"
        )


@contextlib.contextmanager
def staged(target: Path, names: Sequence[str]) -> Iterator[Path]:
    """Give a directory to write files into; when all are there they are moved to the target, otherwise none is.

    Parameters
    ----------
    target : Path
        It is made if need be.
    names : sequence of str
        Every file that may be in it, the one that marks it as complete last.  Those that were not written this time
        are removed from the target.

    Raises
    ------
    OutputError
        If something cannot be written.
    """
    staging = (target if target.is_dir() else target.parent) / f".covey-{os.getpid()}-{secrets.token_hex(4)}"
    try:
        try:
            staging.parent.mkdir(parents=True, exist_ok=True)
            _remove_abandoned(staging.parent)
            staging.mkdir()
            yield staging
            _publish(staging, target, names)
        finally:
            shutil.rmtree(staging, ignore_errors=True)
    except OSError as error:
        raise OutputError(f"{target}: cannot be written: {error.strerror or error}") from error


def _remove_abandoned(folder: Path) -> None:
    """Remove what killed processes left; a film that is being written is touched all the time."""
    for left in folder.iterdir():
        if STAGING.fullmatch(left.name) and left.is_dir() and not left.is_symlink():
            with contextlib.suppress(FileNotFoundError):  # another process removes it too
                latest = max(path.stat().st_mtime for path in (left, *left.iterdir()))
                if time.time() - latest > ABANDONED:
                    shutil.rmtree(left, ignore_errors=True)


def _publish(staging: Path, target: Path, names: Sequence[str]) -> None:
    """Move finished files to their place; a Ctrl-C meanwhile takes effect only when that is done."""
    if not target.is_dir():
        staging.rename(target)
        return
    made = {path.name for path in staging.iterdir()}
    try:
        _move(staging, target, names, made)
    except KeyboardInterrupt:
        _move(staging, target, names, made)
        raise


def _move(staging: Path, target: Path, names: Sequence[str], made: set[str]) -> None:
    for name in names:
        if name not in made:
            (target / name).unlink(missing_ok=True)
        elif (staging / name).exists():
            (staging / name).replace(target / name)
